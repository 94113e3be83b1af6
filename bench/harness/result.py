"""Result of a measurement: its tables, its sentences, and the file that contains them."""

from __future__ import annotations

import importlib
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from plate_core.files import draft

ROOT = Path(__file__).resolve().parents[2]

TEXTS: dict[str, Any] = yaml.safe_load(
    Path(__file__).with_name("tables.yaml").read_text(encoding="utf-8")
)
"""Texts of each table by its key: `title`, `columns`, and for most tables `note`."""

PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba", "pymunk", "mujoco")


@dataclass(frozen=True)
class Table:
    """Rows of one measurement.

    Attributes
    ----------
    key : str
        Name by which charts refer to it.
    title, note : str
        Texts for readers.
    columns : mapping of str to str
        Heading with unit, by key of a row.
    rows : list of dict
        Rows. Values whose key is not in `columns` are not written.
    """

    key: str
    title: str
    columns: Mapping[str, str]
    rows: list[dict[str, Any]]
    note: str = ""

    @classmethod
    def of(cls, key: str, rows: list[dict[str, Any]], **facts: Any) -> Table:
        """Return a table with its texts from tables.yaml. In these texts, `facts` replace the names
        in braces."""
        texts = TEXTS[key]
        title, note = (texts.get(name, "").format(**facts) for name in ("title", "note"))
        return cls(key, title, texts["columns"], rows, note)


@dataclass(frozen=True)
class Result:
    """Result of a measurement: tables, sentences that summarise them, raw samples for charts."""

    tables: list[Table]
    summary: list[str] = field(default_factory=list)
    samples: list[dict[str, Any]] = field(default_factory=list)


def optional(name: str) -> Any:
    """Return a module, or None if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def missing(*packages: str) -> list[str]:
    """Return a sentence for each baseline that is not installed, with the command that installs
    it."""
    lacking = [name for name in packages if optional(name) is None]
    install = "pip install -r requirements-bench.txt"
    return [f"baseline {n} is not installed: {install}" for n in lacking]


def rounded(value: Any, digits: int = 4) -> Any:
    """Return a value in which all floats are rounded to a few significant digits, also in nested
    lists and dicts. NaN becomes None."""
    if isinstance(value, Mapping):
        return {key: rounded(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item, digits) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def machine() -> dict[str, Any]:
    """Return facts on which the results depend: number of CPU cores, load, threads, versions."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "cpus": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "blas_threads": os.environ.get("OPENBLAS_NUM_THREADS", "not set"),
        "python": platform.python_version(),
        **versions,
    }


def commit() -> str:
    """Return the name that `git describe` gives to the current commit. Empty without git."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def folder_made(path: Path) -> bool:
    """Create a folder for results. If this fails, print an error and return False."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        why = f"{problem.strerror}, allowed: a folder that can be created"
        print(f"error: out is {path}: {why}", file=sys.stderr)
        return False
    return True


def write(
    path: Path, name: str, about: str, quick: bool, seconds: float, code: str, result: Result
) -> None:
    """Write a measurement's JSON file atomically. `code` is a digest of the measured code."""
    content = {
        "name": name,
        "about": about,
        "quick": quick,
        "seconds": round(seconds, 1),
        "commit": commit(),
        "code": code,
        "machine": machine(),
        **asdict(result),
    }
    for table in content["tables"]:
        table["rows"] = [{key: row.get(key) for key in table["columns"]} for row in table["rows"]]
    path.parent.mkdir(parents=True, exist_ok=True)
    with draft(path, "result") as file:
        file.write((json.dumps(rounded(content), indent=1) + "\n").encode())


def shown(value: Any) -> str:
    """Return the text of a table's cell."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}".replace(",", " ")
    return str(value)


def text_table(table: Mapping[str, Any]) -> Iterable[str]:
    """Yield the lines of a table (as in the JSON file) for a terminal."""
    columns = table["columns"]
    cells = [[shown(row.get(key)) for key in columns] for row in table["rows"]]
    heads = list(columns.values())
    widths = [max([len(head), *(len(row[i]) for row in cells)]) for i, head in enumerate(heads)]
    yield table["title"]
    for row in [heads, *cells]:
        yield "  " + "  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True))
