"""Write the tables of docs/guide/leaderboard.md, from the results in benchmarks/*.json.

python tools/leaderboard.py
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from plate_core import PlateError

ROOT = Path(__file__).resolve().parents[1]
PAGE, RESULTS = ROOT / "docs/guide/leaderboard.md", ROOT / "benchmarks"

MARK = "<!-- made of benchmarks/ -->\n"
"""What stands above it in the page is written by hand."""

ERRORS = {"error_mm": "error [mm]", "turn_error_deg": "error [degrees]"}
"""Columns of a task in which there are any."""

LEAST = 20
"""Seeds that a result has of a task: those from 0 on."""


def page() -> str:
    """Return the page: what is written by hand, and the tables."""
    return PAGE.read_text("utf-8").split(MARK)[0] + MARK + tables(RESULTS)


def tables(folder: Path) -> str:
    """Return a table for each task and world, of the results in a folder.

    Raises
    ------
    PlateError
        If a file is no result, or not of seeds from 0 on: names it.
    """
    from plate_gym import TASKS  # needs gymnasium: --help does not
    from plate_gym.bench import ranges, read, validate

    results = {path.name: read(path) for path in folder.glob("*.json")}
    for name, result in results.items():
        try:
            validate(result)
        except PlateError as problem:
            raise PlateError(f"{name}: {problem}") from problem
        for task, found in result["tasks"].items():
            seeds = sorted(own["seed"] for own in found["rows"])
            if seeds != list(range(max(len(seeds), LEAST))):
                raise PlateError(
                    f"{name}: {task}: seeds are {ranges(seeds)}, allowed: from 0 on, {LEAST} or "
                    "more"
                )
    text = ""
    for task in TASKS:
        there = {name: result for name, result in results.items() if task in result["tasks"]}
        worlds = {result["world"] for result in there.values()}
        every = [own for result in there.values() for own in result["tasks"][task]["rows"]]
        errors = [key for key in ERRORS if any(own[key] for own in every)]
        told = [ERRORS[key] for key in errors]
        columns = ["agent", "seeds", "done [%]", "plate time [s]", *told, "lost", "decision [ms]"]
        for world in sorted(worlds, key=lambda world: (world != "nominal", world)):
            rows = sorted(
                row(name, result["agent"], result["tasks"][task], errors)
                for name, result in there.items()
                if result["world"] == world
            )
            lines = [" | ".join(columns), " | ".join(["---"] * len(columns))]
            lines += [line for _, _, line in rows]
            text += f"\n## {task}, {world}\n\n" + "".join(f"| {line} |\n" for line in lines)
    return text


def row(
    file: str, agent: str, found: dict[str, Any], errors: list[str]
) -> tuple[float, float, str]:
    """Return the row of an agent's result, behind what rows are ordered by."""
    from plate_gym.bench import ranges, summary

    found = summary(found["rows"])  # not what it claims to be
    low, high = (100 * share for share in found["success_interval"])
    share, took = 100 * found["success"], found.get("time_s", np.inf)
    cells = [
        f"[{agent}](../../benchmarks/{file})",
        ranges(sorted(own["seed"] for own in found["rows"])),
        f"{share:.0f} ({low:.0f} to {high:.0f})",
        f"{took:.1f}" if np.isfinite(took) else "-",
        *(f"{np.median([own[key] for own in found['rows']]):.3g}" for key in errors),
        str(found["dropped"]),
        f"{found['decision_ms']:.3g}",
    ]
    return -share, took, " | ".join(cells)


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    try:
        PAGE.write_text(page(), encoding="utf-8")
    except PlateError as problem:
        sys.exit(f"error: {problem}")
