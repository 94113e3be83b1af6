"""Provenance of a result. The provenance consists of the code, the libraries, the files and the
properties of the computer that determine the rows of the result."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plate_bringup.identity import files_of, libraries_of, machine

from .tasks import TASKS, digest

__all__ = ["commit", "files", "sources", "versions"]

LIBRARIES = ("vibrating-plate", "plate_gym", "gymnasium")
"""Libraries whose versions are stored in a result if they are installed. A result also contains the
versions that `machine` returns."""

PACKAGES = (
    "bringup", "core", "driver", "feeder", "gym", "native", "planner", "sim", "solver", "vision",
)  # fmt: skip
"""Packages whose sources determine a result. A result contains one digest of all these sources. The
prefix `plate_` of the names is omitted here."""


def terms(result: dict[str, Any]) -> dict[str, Any]:
    """Return the values in a result that determine its rows, by name."""
    names = {f"file {name}": mark for name, mark in result.get("files", {}).items()}
    found = {key: result[key] for key in ("agent", "world", "sources")}
    return result["versions"] | result.get("limits", {}) | names | found


def versions(agent: str = "") -> dict[str, str]:
    """Return the properties of the computer from `machine`. Also return the versions of Python, of
    the installed `LIBRARIES`, and of the libraries that the agent imports."""
    found = {"python": sys.version.split()[0]}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found |= {name: text for name, text in machine().items() if name != "Python"}
    return found | (libraries_of(module_of(agent)) if ":" in agent else {})


def files(agent: str) -> dict[str, str]:
    """Return digests of the source files of an agent `MODULE:CLASS`. For agents of this package,
    the result is empty."""
    return files_of(module_of(agent)) if ":" in agent else {}


def module_of(agent: str) -> str:
    """Return the first part of the module name of an agent `MODULE:CLASS`, before the first dot.
    Modules inside a package are not searched, because this search would run the code of the
    package."""
    return agent.partition(":")[0].partition(".")[0]


def commit() -> str:
    """Return the git commit of this project. Return an empty text if git does not track this
    file."""
    this_file = Path(__file__).resolve()
    git = partial(
        subprocess.run, cwd=this_file.parent, capture_output=True, text=True, check=True, timeout=60
    )
    try:
        top = Path(git(["git", "rev-parse", "--show-toplevel"]).stdout.strip())
        # compare with the source file, because the build copies this file to install/
        kept = top / "src/plate_gym/plate_gym" / this_file.name
        git(["git", "ls-files", "--error-unmatch", str(kept)])
        same = kept.read_bytes() == this_file.read_bytes()
        return str(git(["git", "describe", "--always", "--dirty"]).stdout.strip()) if same else ""
    except (OSError, subprocess.SubprocessError):
        return ""


def sources() -> str:
    """Return a digest of the source files of `PACKAGES` and of the files that define the tasks."""
    mark = hashlib.sha256()
    for name in PACKAGES:
        spec = find_spec(f"plate_{name}")
        assert spec is not None
        assert spec.origin is not None
        package = Path(spec.origin).parent
        for path in sorted(package.rglob("*")):
            if path.suffix in (".py", ".hpp", ".cpp"):
                mark.update(f"{name}/{path.relative_to(package).as_posix()}\n".encode())
                mark.update(path.read_bytes())
    mark.update("".join(digest(scenario) for scenario, _ in TASKS.values()).encode())
    return mark.hexdigest()[:16]
