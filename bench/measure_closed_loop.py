"""Whole tasks in the closed loop, several seeds each: the rows of `bench/closed_loop.py`."""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import Result, Table
from loop import Setup, summary

from plate_core import load_rig

RUNS = (
    ("follow_2", "sinusoids"),
    ("sort_4", "sinusoids"),
    ("sort_10", "sinusoids"),
    ("sort_10", "rotations"),
)
SEEDS = 5


def measure(quick: bool) -> Result:
    """Run scenarios with several seeds."""
    rig = load_rig()
    runs, seeds = (RUNS[:2], 1) if quick else (RUNS, SEEDS)
    rows, samples = [], []
    for scenario, method in runs:
        mine = [summary(Setup(scenario, seed, method), rig) for seed in range(seeds)]
        rows.append(task_row(mine))
        samples += mine
    return Result(
        [
            Table(
                "tasks",
                f"{seeds} seed{'s' if seeds > 1 else ''} each, Gamma = {rig.gamma:.1f}",
                {
                    "scenario": "scenario", "method": "method", "succeeded": "succeeded",
                    "dropped": "dropped", "time_s": "time, median [s]", "longest_s": "longest [s]",
                    "rms_mm": "RMS error [mm]", "missed_percent": "missed [%]",
                    "solve_ms": "solve, median [ms]", "solve_p99_ms": "solve, 99 % [ms]",
                    "limit_percent": "of limits [%]",
                },
                rows,
                "Time is simulated. Missed: asked minus predicted displacement. Published for this "
                "machine: 10 parts sorted and 2 trajectories, simulated, without figures.",
            )
        ],
        [sentence(row) for row in rows],
        samples,
    )  # fmt: skip


def task_row(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the runs of one scenario by one method."""
    good = [run for run in runs if run["success"]]
    times = [run["time_s"] for run in good] or [float("nan")]
    errors = [run["rms_error_m"] for run in runs if run["rms_error_m"] is not None]
    return {
        "scenario": runs[0]["scenario"],
        "method": runs[0]["method"],
        "succeeded": f"{len(good)} of {len(runs)}",
        "dropped": sum(run["dropped"] for run in runs),
        "time_s": float(np.median(times)),
        "longest_s": max(times),
        "rms_mm": 1e3 * float(np.median(errors)) if errors else None,
        "missed_percent": 100 * float(np.median([run["missed_share"] for run in runs])),
        "solve_ms": float(np.median([run["solve_ms_median"] for run in runs])),
        "solve_p99_ms": float(np.median([run["solve_ms_p99"] for run in runs])),
        "limit_percent": 100 * max(run["limit_share_max"] for run in runs),
    }


def sentence(row: dict[str, Any]) -> str:
    """Sum up one row."""
    text = f"{row['scenario']}, {row['method']}: {row['succeeded']}, {row['dropped']} dropped"
    text += f", {row['time_s']:.1f} s" if np.isfinite(row["time_s"]) else ""
    text += f", RMS {row['rms_mm']:.2f} mm" if row["rms_mm"] is not None else ""
    return text + f", {row['solve_ms']:.1f} ms a solve"
