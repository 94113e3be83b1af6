"""Whole tasks in the closed loop, several seeds each: the rows of `bench/closed_loop.py`."""

from __future__ import annotations

from typing import Any

from harness import Result, Table
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from tasks.runs import sentence, summed

CASES = (
    ("follow_2", "sinusoids"), ("sort_4", "sinusoids"), ("sort_10", "sinusoids"),
    ("sort_10", "rotations"),
)  # fmt: skip
SEEDS = 5

COLUMNS = {
    "scenario": "scenario", "method": "method", "succeeded": "succeeded", "dropped": "dropped",
    "time_s": "time, median [s]", "longest_s": "longest [s]", "rms_mm": "RMS error [mm]",
    "missed_percent": "missed [%]", "solve_ms": "solve, median [ms]",
    "solve_p99_ms": "solve, 99 % [ms]", "limit_percent": "of limits [%]",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Run scenarios with several seeds."""
    rig = load_rig()
    cases, seeds = (CASES[:2], 1) if quick else (CASES, SEEDS)
    rows: list[dict[str, Any]] = []
    samples: list[dict[str, Any]] = []
    for scenario, method in cases:
        runs = [summary(Setup(scenario, seed, method), rig) for seed in range(seeds)]
        row = {"scenario": scenario, "method": method} | summed(runs)
        rows.append({key: row[key] for key in COLUMNS})
        samples += runs
    title = f"{seeds} seed{'s' if seeds > 1 else ''} each, Gamma = {rig.gamma:.1f}"
    note = (
        "Time is simulated. Missed: asked minus predicted displacement. Published for this "
        "machine: 10 parts sorted and 2 trajectories, simulated, without figures."
    )
    table = Table("tasks", title, COLUMNS, rows, note)
    return Result([table], [sentence(row) for row in rows], samples)
