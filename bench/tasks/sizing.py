"""What a rig is asked before it is bought: how hard it must shake, and how many parts it sorts.

The whole loop of `harness.loop` in a clean world: image noise, even friction, parts that collide.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from harness import Cache, Result, Table, processes, resumed
from harness.loop import Setup, summary
from plate_core import Rig, load_rig
from tasks.runs import sentence, summed

RATIOS = (40, 20, 10, 5)
"""Shaking ratios: the plate's acceleration over mu g."""

SCENARIOS = ("sort_4", "follow_2", "sort_10")

COUNTS = {50: 2, 32: 2, 24: 3, 16: 5, 10: 5}
"""Parts that are sorted on the default rig, and how many seeds; the longest first: a run of 50
parts takes as long as thirty of 10."""

SEEDS = 5
"""At each shaking ratio."""

TIME_LIMIT_S = 900.0
"""Of a sort."""

COLUMNS = {
    "scenario": "scenario", "gamma": "shaking ratio", "parts": "parts", "succeeded": "succeeded",
    "dropped": "dropped", "time_s": "time, median [s]", "longest_s": "longest [s]",
    "rms_mm": "RMS error, median [mm]", "worst_rms_mm": "of the worst run [mm]",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Run all tasks at all shaking ratios, and sort all numbers of parts."""
    rig, cache = load_rig(), Cache.of(__name__)
    ratios, counts = (RATIOS[1::2], {10: 1}) if quick else (RATIOS, COUNTS)
    scenarios, seeds = (SCENARIOS[:2], 1) if quick else (SCENARIOS, SEEDS)
    with TemporaryDirectory() as folder:
        # A row's scenario, shaking ratio, number of runs, and where the scenario is
        kinds = [(f"sort_{n}", rig.gamma, k, sort_file(Path(folder), n)) for n, k in counts.items()]
        kinds += [(name, float(g), seeds, name) for name in scenarios for g in ratios]
        work = {
            f"{name} {gamma:g} {seed}": (Setup(scenario, seed), shaken(rig, gamma))
            for name, gamma, runs, scenario in kinds
            for seed in range(runs)
        }
        with processes() as pool:
            done = iter(resumed(pool, summary, work, cache))
    rows = []
    for name, gamma, runs, _ in kinds:
        mine = [next(done) for _ in range(runs)]
        row = {"scenario": name, "gamma": gamma, "parts": mine[0]["parts"]} | summed(mine)
        rows.append({key: row[key] for key in COLUMNS})
    by_parts, by_ratio = rows[: len(counts)][::-1], rows[len(counts) :]
    note = "Seeds from 0 on; time is simulated. Image noise, even friction, parts that collide."
    return Result(
        [
            Table("ratio", "How hard the plate must shake", COLUMNS, by_ratio, note),
            Table("parts", "How many parts are sorted", COLUMNS, by_parts, note),
        ],
        [f"shaking ratio {row['gamma']:.3g}: {sentence(row)}" for row in by_ratio]
        + [sentence(row) for row in by_parts],
    )


def shaken(rig: Rig, gamma: float) -> Rig:
    """Return the rig with a limit of acceleration that gives a shaking ratio."""
    return replace(rig, limits=replace(rig.limits, accel=gamma * rig.friction.accel))


def sort_file(folder: Path, count: int) -> str:
    """Write a scenario like sort_10 with `count` parts; returns its path."""
    scenario: dict[str, Any] = {
        "description": f"Sort {count} scattered parts, black to the left, grey to the right.",
        "parts": [{"class": name, "count": count // 2} for name in ("black", "grey")],
        "task": {
            "kind": "sort", "sides": {"black": "left", "grey": "right"}, "goal_fraction": 0.6,
            "hold_s": 0.5,
        },
        "time_limit_s": TIME_LIMIT_S,
    }  # fmt: skip
    path = folder / f"sort_{count}.yaml"
    path.write_text(yaml.safe_dump(scenario), encoding="utf-8")
    return str(path)
