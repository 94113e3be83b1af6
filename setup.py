"""Compile the kernels of the library: `pip install .`; pyproject.toml has all the rest."""

import sys

from setuptools import setup

sys.path.insert(0, "src/plate_native")
from plate_native import CompileKernels, kernels

NAMES = ("plate_planner", "plate_sim", "plate_solver", "plate_vision")

setup(
    ext_modules=[kernels(name, f"src/{name}") for name in NAMES],
    cmdclass={"build_ext": CompileKernels},
)
