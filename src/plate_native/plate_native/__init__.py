"""Kernels in C++: how they are compiled, and the headers that those of several packages share.

A package keeps its kernels beside the Python files that call them: `NAME.hpp` has those of
`NAME.py`, and any `.cpp` file in the package has bindings, which nanobind puts into the module
`PACKAGE._kernels`. No setting of the compiler changes a sum, whatever the processor: no product is
fused with a sum, none is put in another order, and functions that are compiled for several widths
of vectors (`PLATE_WIDE`) return the same to the last bit.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from setuptools import Extension
from setuptools.command.build_ext import build_ext

__all__ = ["OPTIONS", "CompileKernels", "kernels"]

OPTIONS = (
    "-std=c++20", "-O3", "-g0", "-fno-lto", "-fPIC", "-fvisibility=hidden",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd",
    "-fno-stack-protector", "-DNDEBUG", "-DNB_COMPACT_ASSERTIONS",
)  # fmt: skip
"""Of the compiler, for all kernels."""

WARNINGS = ("-Wall", "-Wextra", "-Wno-missing-field-initializers", "-Wno-unknown-pragmas")

DEBIAN = Path("/usr/share/nanobind")
"""Where the package nanobind-dev of Debian and Ubuntu has it."""


def kernels(package: str) -> Extension:
    """Return the compiled module of a package, for its setup.py."""
    return Extension(f"{package}._kernels", [f"{package}/kernels.cpp"], language="c++")


def _nanobind() -> Path:
    """Where nanobind's sources are: pip's, or those of Debian and Ubuntu."""
    found = importlib.util.find_spec("nanobind")
    places = list(found.submodule_search_locations or ()) if found else []
    for place in [*map(Path, places), DEBIAN]:
        if (place / "src/nb_combined.cpp").exists():
            return place
    raise FileNotFoundError("nanobind is missing: pip install nanobind (or apt: nanobind-dev)")


class CompileKernels(build_ext):
    """Compiles what has changed of all `.cpp` files beside a module's first one and below it,
    several at a time. The module is put beside them, too, for who runs the sources."""

    def build_extension(self, extension: Extension) -> None:
        """Compile a module's sources, then link them."""
        package, nanobind = Path(extension.sources[0]).parent, _nanobind()
        sources = [*sorted(package.rglob("*.cpp")), nanobind / "src/nb_combined.cpp"]
        include = [
            package, Path(__file__).parent / "include",
            nanobind / "include", nanobind / "ext/robin_map/include", *self.compiler.include_dirs,
        ]  # fmt: skip
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        with ThreadPoolExecutor(jobs) as pool:
            objects = list(pool.map(partial(self._object, [f"-I{i}" for i in include]), sources))
        made = Path(self.get_ext_fullpath(extension.name))
        made.parent.mkdir(parents=True, exist_ok=True)
        with _whole(made) as part:
            self.compiler.link_shared_object(objects, str(part), target_lang="c++")
        if made.resolve() != (package / made.name).resolve():
            with _whole(package / made.name) as part:
                shutil.copy2(made, part)

    def _object(self, include: list[str], source: Path) -> str:
        made = Path(self.build_temp, re.sub(r"[^\w]+", "_", str(source))).with_suffix(".o")
        rules = made.with_suffix(".d")  # which files it was made of, as the compiler writes it
        stamp = made.with_suffix(".of")
        compiler = os.environ.get("CXX", "c++").split()
        own = ("-Os", "-w") if source.name == "nb_combined.cpp" else WARNINGS
        words = [*compiler, *OPTIONS, *own, *os.environ.get("CXXFLAGS", "").split()]
        if stamp.exists() and stamp.read_text() == _digest(words, rules):
            return str(made)
        made.parent.mkdir(parents=True, exist_ok=True)
        stamp.unlink(missing_ok=True)
        with _whole(made) as part:
            self.spawn(
                [*words, *include, "-MMD", "-MF", str(rules), "-c", str(source), "-o", str(part)]
            )
        stamp.write_text(_digest(words, rules))
        return str(made)


def _digest(words: list[str], rules: Path) -> str:
    """Of a command and of what is in all files that the compiler has read."""
    digest = hashlib.sha256(" ".join(words).encode())
    try:
        text = rules.read_text(encoding="utf-8").replace("\\\n", " ").partition(":")[2]
        for word in re.findall(r"(?:\\ |\S)+", text):
            digest.update(Path(word.replace("\\ ", " ")).read_bytes())
    except FileNotFoundError:
        return ""
    return digest.hexdigest()


@contextmanager
def _whole(made: Path) -> Iterator[Path]:
    """A file to write in place of this one, which is there in whole or not at all."""
    part = made.with_name(f"part-{made.name}")
    yield part
    part.replace(made)
