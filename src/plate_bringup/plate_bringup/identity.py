"""Identity of the code, the libraries and the processor. The results of a run with a given seed
depend on these facts."""

from __future__ import annotations

import ast
import hashlib
import importlib
import os
import platform
from functools import lru_cache
from importlib.machinery import ModuleSpec
from importlib.metadata import packages_distributions, version
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from plate_core import PlateError, config_path
from plate_core.files import read_file
from plate_solver import METHODS

from .loop import ALIKE, Setup, run

__all__ = [
    "clone", "code_of", "code_of_packages", "differences", "facts", "files_of", "libraries_of",
    "machine",
]  # fmt: skip

PACKAGES = (
    "bringup", "core", "driver", "feeder", "native", "planner", "sim", "solver", "vision",
)  # fmt: skip
"""Names of the packages on which every run depends, without `plate_`."""

LIBRARIES = ("numpy", "scipy", "cv2", "shapely")
"""Modules whose versions can change a result."""

MAX_PATH = 200
"""Maximum length of a text in a module that may be the path of a file [characters]."""

MAX_FILES, MAX_BYTES = 10_000, 10_000_000_000
"""Maximum number of the files of a module, and maximum sum of their sizes [bytes]. A sparse file of
any size would otherwise be read for hours."""

MAX_NAMED = 100_000
"""Maximum number of paths that the texts of a Python file can form. All these paths are tried."""

MAX_SOURCE_BYTES = 1_000_000
"""Maximum size of a Python file of a module [bytes]. Parsing needs some hundred times this
memory."""

TRIAL, TRIAL_CYCLES = "sort_4", 4
"""Scenario of the short runs whose results are compared, and their number of cycles."""

REQUIRED = ("avx2", "fma")
"""Features of a processor. If the environment variables `ALIKE` are set, all processors with these
features give identical results."""


def differences(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Return a text for each fact that differs between two processes. The facts are those of
    `facts`."""
    texts = []
    for name in expected | found:
        if name not in found:
            advice = " (put its folder into PYTHONPATH)" if name.startswith("file ") else ""
            texts.append(f"{name} is missing, allowed: {expected[name]!r}{advice}")
        elif expected.get(name) != found[name]:
            texts.append(f"{name} is {found.get(name)!r}, allowed: {expected.get(name)!r}")
    return texts


@lru_cache
def facts(bench: bool = False, modules: tuple[str, ...] = (), agent: str = "") -> dict[str, str]:
    """Return facts about this process that determine the results of a seed.

    The facts are those of `machine`, and digests of the code of the packages. If `bench` is true,
    they include a digest of `bench` and `tools` of the clone. For each of `modules`, they include
    the code and the versions of its libraries. If `agent` is given, they include the files and
    libraries of this module.
    """
    found = machine() | {"code of the packages": code_of_packages()}
    for name in modules:
        found |= {f"code of {name}": code_of(name)} | libraries_of(name)
    if agent:
        found |= {f"file {name}": mark for name, mark in files_of(agent).items()}
        found |= libraries_of(agent)
    if bench:
        found["code of bench"] = _bench_digest()
    return found


@lru_cache
def machine() -> dict[str, str]:
    """Return facts about the computer: the versions of Python, the C library and `LIBRARIES`, the
    environment variables `ALIKE`, and the processor. A digest of the first cycles of short runs is
    included, because compilers and BLAS libraries can also change results."""
    found = {
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "C library": " ".join(platform.libc_ver()),
    }
    for name in LIBRARIES:
        found[name] = str(importlib.import_module(name).__version__)
    found |= {name: os.environ.get(name, "") for name in ALIKE}
    found["processor"] = _processor_model(ALIKE.items() <= os.environ.items())
    found["first cycles"] = _first_cycles_digest()
    return found


def _processor_model(alike: bool) -> str:
    """Return the model of the processor. If `alike` is True and the processor has the features
    `REQUIRED`, return these features instead. Results on a processor with these features do not
    depend on its model."""
    lines = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
    about = {name.strip(): value.strip() for name, _, value in reversed(lines)}
    if alike and set(REQUIRED) <= set(about.get("flags", "").split()):
        return f"{platform.machine()} with {', '.join(REQUIRED)}"
    keys = ("vendor_id", "cpu family", "model", "model name")
    return " ".join([platform.machine(), *(about.get(key, "") for key in keys)]).strip()


@lru_cache
def code_of_packages() -> str:
    """Return a digest of the sources of `PACKAGES`, including their kernels and the
    configuration."""
    return code_of(*(f"plate_{name}" for name in PACKAGES))


def code_of(*modules: str) -> str:
    """Return a digest of the sources of modules or packages, including their kernels. The digest of
    `plate_core` includes its configuration."""
    mark = hashlib.sha256()
    for name in modules:
        spec = _find_spec(name)
        if spec is None or spec.origin is None:
            return f"no module {name}"
        origin = Path(spec.origin)
        if spec.submodule_search_locations is not None:
            _add_folder(mark, origin.parent, name)
        else:
            mark.update(origin.read_bytes())
        if name == "plate_core":
            _add_folder(mark, config_path("rig.yaml").parent, "config")
    return mark.hexdigest()[:16]


def files_of(module: str) -> dict[str, str]:
    """Return digests of the files of a module that is not part of the project, by path. The module
    is not imported.

    For a package, with or without `__init__.py`, the result contains all files in its folder,
    except hidden files and bytecode. For a module in a single file, it contains this file and the
    files in the same folder that the module names. The module can name a file by an import, or by a
    text such as "weights.npz". If the module does not exist, the result is empty.

    Raises
    ------
    PlateError
        If there are more than `MAX_FILES` files, or they are larger than `MAX_BYTES` together, or a
        Python file is larger than `MAX_SOURCE_BYTES` or names too many paths, or folders are nested
        too deeply.
    """
    files = sorted(_module_files(module).items())
    size = sum(path.stat().st_size for _, path in files)
    if len(files) > MAX_FILES or size > MAX_BYTES:
        raise PlateError(
            f"module {module} has {len(files)} files with {size / 1e6:.4g} MB, allowed: at most "
            f"{MAX_FILES} files with {MAX_BYTES / 1e6:g} MB"
        )
    marks = {}
    for name, path in files:
        with path.open("rb") as file:
            marks[name] = hashlib.file_digest(file, "sha256").hexdigest()[:16]
    return marks


def libraries_of(module: str) -> dict[str, str]:
    """Return the versions of the installed libraries that the files of a module import."""
    names = {
        name for path in _module_files(module).values() for name in _find_imports_and_paths(path)[0]
    }
    among = packages_distributions() if names else {}
    project = {f"plate_{name}" for name in PACKAGES}
    return {
        label: version(label)
        for name in sorted(names - project & set(among))
        for label in among.get(name, ())
    }


def _module_files(module: str) -> dict[str, Path]:
    """Return the paths of the files whose digests `files_of` returns, by the same keys."""
    spec = _find_spec(module)
    if folders := _package_folders(spec):
        # If several folders contain a file with the same name, Python imports the file from the
        # first folder. Therefore the first folder is processed last here.
        return {
            path.relative_to(folder.parent).as_posix(): path
            for folder in reversed(folders)
            for path in _all_files(folder)
        }
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return {}
    first = Path(spec.origin)
    found: set[Path] = set()
    waiting = {first}
    while waiting:
        path = waiting.pop()
        found.add(path)
        imported, texts = _find_imports_and_paths(path)
        # If the module is in a folder of installed libraries, its neighbouring files belong to
        # other libraries.
        near = set() if first.parent.name.endswith("-packages") else imported
        places = [first.parent, *(first.parent / text for text in texts)]
        folders = [place for place in places if os.path.isdir(place)]
        if len(folders) * len(texts) > MAX_NAMED:
            raise PlateError(
                f"{path}: has {len(texts)} texts, and {len(folders) - 1} of them are names of "
                f"folders, allowed: a product of both up to {MAX_NAMED}"
            )
        named = {folder / text for folder in folders for text in texts}
        named |= {first.parent / f"{name}.py" for name in near}
        # For a name that is too long, `os.path.isfile` returns False instead of raising an error.
        waiting |= {path for path in named if os.path.isfile(path)}
        for name in near:
            if first.parent / name in _package_folders(_find_spec(name)):
                waiting |= _all_files(first.parent / name)
        waiting -= found
    return {path.relative_to(first.parent).as_posix(): path for path in found}


def _package_folders(spec: ModuleSpec | None) -> list[Path]:
    """Return the folders of a package. A package without `__init__.py` can have several."""
    places = None if spec is None else spec.submodule_search_locations
    return [Path(place) for place in places or ()]


def _all_files(folder: Path) -> set[Path]:
    """Return the files in the folder of a package, except hidden files and bytecode."""
    try:
        return {
            path
            for path in folder.rglob("*")
            if path.is_file()
            and not any(
                part.startswith(".") or part == "__pycache__"
                for part in path.relative_to(folder).parts
            )
        }
    except RecursionError:
        raise PlateError(f"{folder}: its folders are nested too deeply") from None


def _find_imports_and_paths(path: Path) -> tuple[set[str], set[str]]:
    """Return the top-level names of the modules that a Python file imports, and the texts in the
    file that can be paths of files in its folder. For files that are not Python files, both results
    are empty."""
    imported: set[str] = set()
    texts: set[str] = set()
    if path.suffix != ".py":
        return imported, texts
    source = read_file(path, MAX_SOURCE_BYTES)
    try:
        nodes = list(ast.walk(ast.parse(source)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        nodes = []
    for node in nodes:
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            imported.add(node.module.partition(".")[0])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
            short = 0 < len(text) <= MAX_PATH and text.isprintable()
            if short and not {"/", ".."} & set(Path(text).parts):
                texts.add(text)
    return imported, texts


def _find_spec(module: str) -> ModuleSpec | None:
    try:
        return find_spec(module)
    except ValueError:  # find_spec raises a ValueError for names such as __main__
        return None


def _add_folder(mark: Any, place: Path, name: str) -> None:
    """Add the sources in the folder `place` to the digest `mark`."""
    for path in sorted(place.rglob("*")):
        if path.suffix in (".py", ".hpp", ".cpp", ".yaml"):
            mark.update(f"{name}/{path.relative_to(place).as_posix()}\n".encode())
            mark.update(path.read_bytes())


def _bench_digest() -> str:
    """Return a digest of `bench` and `tools` of the clone from which this package was installed."""
    folder = clone()
    if folder is None:
        return "no clone"
    mark = hashlib.sha256()
    for name in ("bench", "tools"):
        _add_folder(mark, folder / name, name)
    return mark.hexdigest()[:16]


def clone() -> Path | None:
    """Return the clone from which this package was installed, or None if there is no clone."""
    parents = Path(__file__).resolve().parents
    return next((folder for folder in parents if (folder / "bench/harness").is_dir()), None)


def _first_cycles_digest() -> str:
    """Return a digest of the first cycles that each method computes for the scenario `TRIAL`."""
    mark = hashlib.blake2b(digest_size=8)
    for method in dict.fromkeys(METHODS.values()):
        for moment in islice(run(Setup(TRIAL, method=method)), TRIAL_CYCLES):
            cycle = moment.result.cycle
            for knots in (cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel):
                mark.update(knots.tobytes())
            mark.update(moment.world.position.tobytes())
    return mark.hexdigest()
