"""How many parts a rig sorts: the default one, more and more parts.

The whole loop in a clean world: image noise, even friction, parts that collide.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from harness import Cache, Result, Table, processes, resumed
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from tasks.runs import sentence, summed

COUNTS = {50: 2, 32: 2, 24: 3, 16: 5, 10: 5}
"""Parts that are sorted, and how many seeds; the longest first: a run of 50 parts takes as long as
thirty of 10."""

TIME_LIMIT_S = 900.0
"""Of a sort."""

COLUMNS = {
    "scenario": "scenario", "gamma": "shaking ratio", "parts": "parts", "succeeded": "succeeded",
    "dropped": "dropped", "time_s": "time, median [s]", "longest_s": "longest [s]",
    "rms_mm": "RMS error, median [mm]", "worst_rms_mm": "of the worst run [mm]",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Sort all numbers of parts."""
    rig, cache = load_rig(), Cache.of(__name__)
    counts = {10: 1} if quick else COUNTS
    with TemporaryDirectory() as folder:
        files = {count: sort_file(Path(folder), count) for count in counts}
        work = {
            f"{count} {seed}": (Setup(files[count], seed), rig)
            for count, runs in counts.items()
            for seed in range(runs)
        }
        with processes() as pool:
            done = iter(resumed(pool, summary, work, cache))
    rows = []
    for count, runs in counts.items():
        mine = [next(done) for _ in range(runs)]
        row = {"scenario": f"sort_{count}", "gamma": rig.gamma, "parts": count} | summed(mine)
        rows.append({key: row[key] for key in COLUMNS})
    note = "Seeds from 0 on; time is simulated. Image noise, even friction, parts that collide."
    rows = rows[::-1]
    return Result(
        [Table("parts", "How many parts are sorted", COLUMNS, rows, note)],
        [sentence(row) for row in rows],
    )


def sort_file(folder: Path, count: int) -> str:
    """Write a scenario like sort_10 with `count` parts; returns its path."""
    numbers = {"black": count - count // 2, "grey": count // 2}
    sides = {"black": "left", "grey": "right"}
    there = [name for name, number in numbers.items() if number]
    scenario: dict[str, Any] = {
        "description": f"Sort {count} scattered parts, black to the left, grey to the right.",
        "parts": [{"class": name, "count": numbers[name]} for name in there],
        "task": {
            "kind": "sort", "sides": {name: sides[name] for name in there}, "goal_fraction": 0.6,
            "hold_s": 0.5,
        },
        "time_limit_s": TIME_LIMIT_S,
    }  # fmt: skip
    path = folder / f"sort_{count}.yaml"
    path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    return str(path)
