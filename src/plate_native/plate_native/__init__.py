"""Kernels in C++: how they are compiled, and the headers that those of several packages share.

A package keeps its kernels beside the Python files that call them: `NAME.hpp` has those of
`NAME.py`, and any `.cpp` file in the package has bindings, which nanobind puts into the module
`PACKAGE._kernels`. No setting of the compiler changes a sum, whatever the processor: no product is
fused with a sum, none is put in another order, and functions that are compiled for several widths
of vectors (`PLATE_WIDE`) return the same to the last bit.
"""

from __future__ import annotations

import importlib.util
import os
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from setuptools import Extension
from setuptools.command.build_ext import build_ext

__all__ = ["CompileKernels", "kernels"]

OPTIONS = (
    "-std=c++20", "-O3", "-g0", "-fno-lto", "-fPIC", "-fvisibility=hidden",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd",
    "-fno-stack-protector",
)  # fmt: skip
WARNINGS = ("-Wall", "-Wextra", "-Wno-missing-field-initializers", "-Wno-unknown-pragmas")


def kernels(package: str, folder: str | Path = ".") -> Extension:
    """Return the compiled module of a package, whose Python files are in `folder`/`package`."""
    nanobind = _nanobind()
    return Extension(
        f"{package}._kernels",
        sorted(str(path) for path in Path(folder, package).rglob("*.cpp")),
        include_dirs=[
            str(Path(folder, package)),
            str(Path(__file__).parent / "include"),
            str(nanobind / "include"),
            str(nanobind / "ext/robin_map/include"),
        ],
        define_macros=[("NDEBUG", None), ("NB_COMPACT_ASSERTIONS", None)],
        extra_compile_args=list(OPTIONS),
        language="c++",
    )


def _nanobind() -> Path:
    """Where nanobind's sources are: pip's, or those of Debian and Ubuntu."""
    found = importlib.util.find_spec("nanobind")
    places = list(found.submodule_search_locations or ()) if found else []
    for place in map(Path, [*places, "/usr/share/nanobind"]):
        if (place / "src/nb_combined.cpp").exists():
            return place
    raise FileNotFoundError("nanobind is missing: pip install nanobind (or apt: nanobind-dev)")


class CompileKernels(build_ext):
    """Compiles what has changed, several files at a time."""

    def build_extension(self, extension: Extension) -> None:
        """Compile a module's sources, then link them."""
        sources = [*extension.sources, str(_nanobind() / "src/nb_combined.cpp")]
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        with ThreadPoolExecutor(jobs) as pool:
            objects = list(pool.map(partial(self._object, extension), sources))
        made = Path(self.get_ext_fullpath(extension.name))
        made.parent.mkdir(parents=True, exist_ok=True)
        if not _is_newer(made, map(Path, objects)):
            self.compiler.link_shared_object(objects, str(made), target_lang="c++")

    def _object(self, extension: Extension, source: str) -> str:
        made = Path(self.build_temp, re.sub(r"[^\w]+", "_", source)).with_suffix(".o")
        rules = made.with_suffix(".d")  # which headers it was made of, as the compiler writes it
        if rules.exists() and _is_newer(made, _prerequisites(rules)):
            return str(made)
        made.parent.mkdir(parents=True, exist_ok=True)
        include = [f"-I{place}" for place in (*extension.include_dirs, *self.compiler.include_dirs)]
        macros = [f"-D{name}" for name, _ in extension.define_macros]
        compiler = os.environ.get("CXX", "c++").split()
        own = ("-Os", "-w") if source.endswith("nb_combined.cpp") else WARNINGS
        options = [*extension.extra_compile_args, *own, *os.environ.get("CXXFLAGS", "").split()]
        options += [*macros, *include]
        self.spawn([*compiler, *options, "-MMD", "-MF", str(rules), "-c", source, "-o", str(made)])
        return str(made)


def _prerequisites(rules: Path) -> list[Path]:
    text = rules.read_text(encoding="utf-8").replace("\\\n", " ").split(":", 1)[1]
    return [Path(word.replace("\\ ", " ")) for word in re.findall(r"(?:\\ |\S)+", text)]


def _is_newer(made: Path, sources) -> bool:
    try:
        return made.stat().st_mtime_ns > max(path.stat().st_mtime_ns for path in sources)
    except FileNotFoundError:
        return False
