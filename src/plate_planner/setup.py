"""Build plate_planner as an ament_python package."""

from setuptools import find_packages, setup

from plate_native import CompileKernels, kernels, node_programs

NAME = "plate_planner"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["*.hpp", "*.cpp"], NAME: ["py.typed", "*.pyi"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["plate_core", "numpy", "scipy", "shapely"],
    extras_require={"test": ["pytest"]},
    ext_modules=[kernels(NAME)],
    cmdclass={"build_ext": CompileKernels, "install_scripts": node_programs("planner")},
    zip_safe=False,
    maintainer="The plate developers",
    maintainer_email="plate@example.org",
    description="Computes the requested force on each part from a task and the parts' positions.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"planner = {NAME}.node:main"]},
)
