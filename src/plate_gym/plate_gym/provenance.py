"""Provenance of a result: the code, libraries, files and computer that determine its rows."""

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
"""Libraries whose versions a result contains if they are installed. It also contains the versions
that `machine` returns."""

PACKAGES = (
    "bringup", "core", "driver", "feeder", "gym", "native", "planner", "sim", "solver", "vision",
)  # fmt: skip
"""Packages of whose sources a result contains a digest. Their names begin with `plate_`."""


def terms(result: dict[str, Any]) -> dict[str, Any]:
    """Return the parts of a result that determine its rows, by name."""
    names = {f"file {name}": mark for name, mark in result.get("files", {}).items()}
    found = {key: result[key] for key in ("agent", "world", "sources")}
    return result["versions"] | result.get("limits", {}) | names | found


def versions(agent: str = "") -> dict[str, str]:
    """Return the facts of `machine`, and the versions of Python, of the installed `LIBRARIES`, and
    of the libraries that the agent imports."""
    found = {"python": sys.version.split()[0]}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found |= {name: text for name, text in machine().items() if name != "Python"}
    return found | (libraries_of(module_of(agent)) if ":" in agent else {})


def files(agent: str) -> dict[str, str]:
    """Return digests of the files of an agent `MODULE:CLASS`. For agents of this package, there are
    none."""
    return files_of(module_of(agent)) if ":" in agent else {}


def module_of(agent: str) -> str:
    """Return the first part of the module name of an agent `MODULE:CLASS`. The modules in a package
    are not searched for, because this search would run the package's code."""
    return agent.partition(":")[0].partition(".")[0]


def commit() -> str:
    """Return the commit of this project, or an empty text if git does not track this file."""
    here = Path(__file__).resolve()
    git = partial(
        subprocess.run, cwd=here.parent, capture_output=True, text=True, check=True, timeout=60
    )
    try:
        top = Path(git(["git", "rev-parse", "--show-toplevel"]).stdout.strip())
        kept = top / "src/plate_gym/plate_gym" / here.name  # the build copies this file to install/
        git(["git", "ls-files", "--error-unmatch", str(kept)])
        same = kept.read_bytes() == here.read_bytes()
        return str(git(["git", "describe", "--always", "--dirty"]).stdout.strip()) if same else ""
    except (OSError, subprocess.SubprocessError):
        return ""


def sources() -> str:
    """Return a digest of the sources of `PACKAGES` and of the files of the tasks."""
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
