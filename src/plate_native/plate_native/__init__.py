"""Builds the C++ kernels, and contains the headers that the kernels of several packages use.

In each package, the kernels are in the same folder as the Python files that call them. `NAME.hpp`
contains the kernels of `NAME.py`. The `.cpp` files contain bindings, which nanobind compiles to the
module `PACKAGE._kernels`. Results do not depend on the processor. The compiler does not fuse
products with sums, and it does not reorder sums. Functions that are compiled for several vector
widths (`PLATE_WIDE`) return bitwise equal results.
"""

from __future__ import annotations

import importlib.util
import math
import os
import re
import shutil
import sys
import sysconfig
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path

from setuptools import Extension
from setuptools.command.build_ext import build_ext

from . import cache
from .programs import node_programs

__all__ = ["OPTIONS", "CompileKernels", "kernels", "node_programs"]

OPTIONS = (
    "-std=c++20", "-O3", "-g0", "-fno-lto", "-fPIC", "-fvisibility=hidden",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd",
    "-fno-stack-protector", "-DNDEBUG", "-DNB_COMPACT_ASSERTIONS",
)  # fmt: skip
"""Compiler options of all kernels."""

WARNINGS = ("-Wall", "-Wextra", "-Wno-missing-field-initializers", "-Wno-unknown-pragmas")

DEBIAN = Path("/usr/share/nanobind")
"""Folder of nanobind if it was installed by the package nanobind-dev of Debian or Ubuntu."""


def kernels(package: str) -> Extension:
    """Return the extension module of a package. The setup.py of the package calls this function."""
    return Extension(f"{package}._kernels", [f"{package}/kernels.cpp"], language="c++")


def _nanobind() -> Path:
    """Return the folder of nanobind's sources. pip or a package of Debian or Ubuntu has installed
    them."""
    found = importlib.util.find_spec("nanobind")
    places = list(found.submodule_search_locations or ()) if found else []
    for place in [*map(Path, places), DEBIAN]:
        if (place / "src/nb_combined.cpp").exists():
            return place
    raise FileNotFoundError("nanobind is not installed: pip install nanobind (apt: nanobind-dev)")


class CompileKernels(build_ext):
    """Compiles the changed `.cpp` files in the folder of a module and below it, in parallel. The
    compiled module is also copied into the folder of its sources, so that it can be used in the
    source tree."""

    def build_extension(self, extension: Extension) -> None:
        """Compile a module's sources, then link them."""
        package, nanobind = Path(extension.sources[0]).parent, _nanobind()
        sources = [*sorted(package.rglob("*.cpp")), nanobind / "src/nb_combined.cpp"]
        shared = Path(__file__).parent / "include"
        include = [
            package, shared, nanobind / "include", nanobind / "ext/robin_map/include",
            *self.compiler.include_dirs,
        ]  # fmt: skip
        places = {"package": package, "shared": shared, "nanobind": nanobind, "": Path("/")}
        compile_one = partial(self._object, [f"-I{i}" for i in include], places)
        jobs = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        with ThreadPoolExecutor(jobs) as pool:
            objects = list(pool.map(compile_one, sources))
        made = Path(self.get_ext_fullpath(extension.name))
        made.parent.mkdir(parents=True, exist_ok=True)
        with _whole(made) as part:
            self.compiler.link_shared_object(objects, str(part), target_lang="c++")
        if made.resolve() != (package / made.name).resolve():
            with _whole(package / made.name) as part:
                shutil.copy2(made, part)

    def _object(self, include: list[str], places: dict[str, Path], source: Path) -> str:
        made = Path(self.build_temp, re.sub(r"[^\w]+", "_", str(source))).with_suffix(".o")
        flags = ("-Os", "-w") if source.name == "nb_combined.cpp" else WARNINGS
        compiler = os.environ.get("CXX", "c++").split()
        command = [*compiler, *OPTIONS, *flags, *os.environ.get("CXXFLAGS", "").split()]
        python = [sys.version, sysconfig.get_path("include")]
        first = cache.key_of(*command, *python, _compiler(*command), _named(str(source), places))
        folders = [Path(self.build_temp, "kept"), cache.of_user()]
        made.parent.mkdir(parents=True, exist_ok=True)
        # first read the list of the object's source files, then compute their digest
        for folder in folders:
            read = cache.take(folder, first)
            content = read and cache.take(folder, _key(first, read, places))
            if content:
                made.write_bytes(content)
                return str(made)
        rules, begun = made.with_suffix(".d"), time.time()
        with _whole(made) as part:
            self.spawn(
                [*command, *include, "-MMD", "-MF", str(rules), "-c", str(source), "-o", str(part)]
            )
        read = _files_read(rules, places)
        key = _key(first, read, places, since=begun)
        for folder in folders:
            cache.keep(folder, first, read)
            cache.keep(folder, key, made.read_bytes())
        return str(made)


_compiler = lru_cache(lambda *words: cache.compiler(list(words)))


def _named(path: str, places: dict[str, Path]) -> str:
    """Convert a path to a form that is equal in all clones of the project. The form consists of the
    name of a base folder, and the path below this folder."""
    for name, place in places.items():
        if path.startswith(f"{place}/"):
            return f"{name}//{path[len(f'{place}/') :]}"
    return f"/{os.path.abspath(path)}"


def _files_read(rules: Path, places: dict[str, Path]) -> bytes:
    """Return the files that a compiler has read, one per line. The names are extracted from the
    make rule that the compiler writes."""
    text = os.fsdecode(rules.read_bytes()).replace("\\\n", " ").partition(":")[2]
    files = (word.replace("\\ ", " ") for word in re.findall(r"(?:\\ |\S)+", text))
    return os.fsencode("\n".join(_named(word, places) for word in files))


def _key(first: str, read: bytes, places: dict[str, Path], since: float = math.inf) -> str:
    """Return the cache key of an object file: a digest of `first` and of the content of all files
    that the compiler has read. The result is empty if a file is missing or has changed after the
    time `since`, because the compiler may have read an earlier content."""
    lines = (line.partition("//") for line in os.fsdecode(read).split("\n"))
    files = [Path(places[index], name) for index, _, name in lines]
    try:
        states = [file.stat() for file in files]
        if any(since < max(s.st_mtime, s.st_ctime) <= time.time() for s in states):
            return ""
        return cache.key_of(first, *(file.read_bytes() for file in files))
    except FileNotFoundError:
        return ""


@contextmanager
def _whole(made: Path) -> Iterator[Path]:
    """Yield the path of a temporary file. At the end of the context, the temporary file atomically
    replaces the file `made`."""
    part = made.with_name(f"part-{made.name}")
    yield part
    part.replace(made)
