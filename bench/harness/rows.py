"""JSON file with one row per run. A later call adds the missing rows. A call without new rows does
not change the file."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from plate_core import PlateError
from plate_core.files import OwnFile

WRITE_S = 1.0
"""Minimum time between two writes of the file [s]."""


class Rows:
    """Rows by seed. When the context ends, new rows are written to the file.

    Parameters
    ----------
    path : Path, optional
        File of the rows. Default: no file is read or written.
    marks : mapping
        Digests of the code and the settings of the runs, and facts about the computer by name. Each
        row contains them.

    Raises
    ------
    PlateError
        If the file contains anything other than rows with these marks, or if another process writes
        it.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path | None, marks: Mapping[str, str | dict[str, str]]) -> None:
        self._file: OwnFile | None = None
        self._marks, self._written, self._new = marks, time.monotonic(), 0
        self.by_seed: dict[int, dict[str, Any]] = {}
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = OwnFile(path)
            if path.is_file():
                self.by_seed = {row["seed"]: row for row in self._read(path)}

    def __enter__(self) -> Rows:
        return self

    def __exit__(
        self, kind: type | None, problem: BaseException | None, where: TracebackType | None
    ) -> None:
        if self._file is not None:
            with self._file:
                self.write()

    def add(self, row: dict[str, Any]) -> None:
        """Add the row of a run."""
        self.by_seed[row["seed"]] = {**row, **self._marks}
        self._new += 1
        if time.monotonic() - self._written > WRITE_S:
            self.write()

    def _read(self, path: Path) -> list[dict[str, Any]]:
        other = "allowed: a new file, or a result of this command"
        try:
            rows = json.loads(path.read_text(encoding="utf-8") or "[]")
        except (ValueError, RecursionError) as problem:
            raise PlateError(f"{path} is not JSON ({problem}), {other}") from problem
        keys = {"seed", *self._marks}
        if not isinstance(rows, list) or not all(
            isinstance(row, dict) and keys <= row.keys() and type(row["seed"]) is int
            for row in rows
        ):
            raise PlateError(f"{path}: not every row has {', '.join(sorted(keys))}, {other}")
        for row in rows:
            for name in self._marks:
                was: Any = row[name]
                now: Any = self._marks[name]
                if was == now:
                    continue
                if isinstance(was, dict) and isinstance(now, dict):
                    name = next(key for key in now | was if now.get(key) != was.get(key))
                    was, now = was.get(name), now.get(name)
                raise PlateError(
                    f"{path}: seed {row['seed']} was run with {name} {was!r}, and this command has "
                    f"{now!r}, allowed: the same {name}, or another file for the results"
                )
        return rows

    def write(self) -> None:
        """If there are new rows, write all rows to the file now."""
        if self._file is None or not self._new:
            return
        rows = [self.by_seed[seed] for seed in sorted(self.by_seed)]
        self._file.write(json.dumps(rows, indent=1) + "\n")
        self._written = time.monotonic()
