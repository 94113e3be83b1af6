"""Runs of the closed loop, kept as soon as they end, so that a measurement cut short goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from concurrent.futures import Executor
from typing import Any

from digest import code_of
from harness import ROOT
from loop import Setup, summary
from spread import spread

from plate_core import Rig


class Store:
    """Rows by name in `out/bench/NAME.jsonl`, of the measurement with that name as it is now."""

    def __init__(self, name: str, pool: Executor) -> None:
        self._path, self._pool, self._version = (
            ROOT / f"out/bench/{name}.jsonl",
            pool,
            code_of(name),
        )
        there = self._path.exists()
        lines = self._path.read_text(encoding="utf-8").splitlines() if there else []
        rows = [json.loads(line) for line in lines]
        self._rows = {r["name"]: r["run"] for r in rows if r["version"] == self._version}

    def runs(self, rig: Rig, setups: Mapping[str, Setup]) -> list[dict[str, Any]]:
        """Return rows of `bench/closed_loop.py` by name, from the file or by running them."""
        missing = [name for name in setups if name not in self._rows]
        work = [(setups[name], rig) for name in missing]
        for name, row in zip(missing, spread(self._pool, summary, work, _silent), strict=True):
            self._keep(name, row)
        return [self._rows[name] for name in setups]

    def _keep(self, name: str, row: dict[str, Any]) -> None:
        self._rows[name] = row
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"version": self._version, "name": name, "run": row}) + "\n")


def _silent(text: str) -> None:
    """Progress is told by the row of measurements."""
