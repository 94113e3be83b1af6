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
"""Line that separates the handwritten text from the generated tables."""

ERRORS = {"error_mm": "error [mm]", "turn_error_deg": "error [degrees]"}
LOST = "lost"
"""Headings of columns. A table omits these columns if all their values are zero."""

MIN_SEEDS = 20
"""Minimum number of seeds per task. The seeds start at 0."""


def page() -> str:
    """Return the content of the page, with the old text and the new tables."""
    return PAGE.read_text("utf-8").split(MARK)[0] + MARK + tables(RESULTS)


def tables(folder: Path) -> str:
    """Return one table per task, from the results in a folder.

    Raises
    ------
    PlateError
        If a file is not a result, or its seeds do not start at 0. The message contains the name of
        the file.
    """
    # plate_gym is imported here, so that --help works without gymnasium
    from plate_gym import TASKS
    from plate_gym.result import ranges, read, validate

    results = {path.name: read(path) for path in folder.glob("*.json")}
    for name, result in results.items():
        try:
            validate(result)
        except PlateError as problem:
            raise PlateError(f"{name}: {problem}") from problem
        for task, found in result["tasks"].items():
            seeds = sorted(episode["seed"] for episode in found["rows"])
            if seeds != list(range(max(len(seeds), MIN_SEEDS))):
                raise PlateError(
                    f"{name}: {task}: seeds are {ranges(seeds)}, allowed: 0, 1, 2, ... "
                    f"without gaps, at least {MIN_SEEDS} seeds"
                )
    text = ""
    for task in TASKS:
        with_task = {name: result for name, result in results.items() if task in result["tasks"]}
        rows = sorted(
            (row(name, result, task) for name, result in with_task.items()),
            key=lambda one: (one[0], one[1]["agent"]),
        )
        text += f"\n## {task}\n"
        if listed := [cells for order, cells in rows if order[2]]:
            omitted = {
                key
                for key in (*ERRORS.values(), LOST)
                if all(float(cells[key]) == 0 for cells in listed)
            }
            columns = [key for key in listed[0] if key not in omitted]
            text += f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}\n"
            for cells in listed:
                text += f"| {' | '.join(cells[key] for key in columns)} |\n"
        failed: dict[str, list[str]] = {}
        for name, result in sorted(with_task.items()):
            if not any(episode["success"] for episode in result["tasks"][task]["rows"]):
                link = f"[{result['world']}](../../benchmarks/{name})"
                failed.setdefault(result["agent"], []).append(link)
        if failed:
            by_agent = "; ".join(
                f"{agent}: {', '.join(episode)}" for agent, episode in failed.items()
            )
            text += f"\nNo completed episode: {by_agent}.\n"
    return text


Order = tuple[bool, str, float, float]
"""Sort key of rows: nominal world first, then name of the world, then fraction of completed
episodes (descending), then plate time."""


def row(file: str, result: dict[str, Any], task: str) -> tuple[Order, dict[str, str]]:
    """Return the sort key of a result, and its cells in the table of a task, by heading."""
    from plate_gym.result import summary

    world = result["world"]
    # compute the summary again, because the summary in the file can be wrong
    found = summary(result["tasks"][task]["rows"])
    low, high = (100 * fraction for fraction in found["success_interval"])
    fraction, took, count = found["success"], found.get("time_s", np.inf), len(found["rows"])
    ended = [episode for episode in found["rows"] if "failure" not in episode] or found["rows"]
    interval = f" ({low:.0f}-{high:.0f} %)"
    link = f"[{result['agent']}](../../benchmarks/{file})"
    cells = {
        "agent": link if world == "nominal" else f"{link}, {world}",
        "done": f"{fraction * count:.0f}/{count}" + interval * (fraction < 1),
        "plate time [s]": f"{took:.1f}" if np.isfinite(took) else "-",
        **{
            heading: f"{np.median([episode[key] for episode in ended]):.3g}"
            for key, heading in ERRORS.items()
        },
        LOST: str(found["dropped"]),
        "decision [ms]": f"{found['decision_ms']:.3g}",
    }
    return (world != "nominal", world, -fraction, took), cells


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    try:
        PAGE.write_text(page(), encoding="utf-8")
    except PlateError as problem:
        sys.exit(f"error: {problem}")
