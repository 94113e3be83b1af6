"""The closed loop with more and less time for the solver: tracking error and time of a sort.

The whole loop of `loop.run`: image noise, friction uneven by 10 %. Runs are spread over the cores
and kept as soon as they end, in `out/bench/control.jsonl`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from harness import Result, Table
from loop import Setup, with_settings
from spread import processes
from store import Store

from plate_core import load_rig
from plate_solver.controller import EFFORT

SCENARIOS = ("follow_3", "sort_10")
SEEDS = range(11_000, 11_002)
"""Of all runs: scatter, image noise, friction and the solver's chance."""

DIRT = {"friction_spread": "0.1", "friction_patches": "0.1"}

EFFORTS: dict[str, tuple[dict[str, int], ...]] = {
    "sinusoids": (
        {"iterations": 1, "restarts": 0}, {"iterations": 6, "restarts": 0}, {},
        {"iterations": 48, "restarts": 12},
    ),
    "rotations": ({"iterations": 1, "restarts": 0}, {}, {"iterations": 40, "restarts": 4}),
}  # fmt: skip
"""Options of the solver by method; none: the controller's own."""


def measure(quick: bool) -> Result:
    """Run every scenario with every effort."""
    rig = load_rig()
    scenarios, seeds = (SCENARIOS[:1], SEEDS[:1]) if quick else (SCENARIOS, SEEDS)
    cases = [
        (scenario, method, effort)
        for scenario in scenarios
        for method, efforts in EFFORTS.items()
        for effort in (efforts[::2] if quick else efforts)
    ]
    setups = {}
    for scenario, method, effort in cases:
        settings = {"method": method, **DIRT, **{key: str(n) for key, n in effort.items()}}
        for seed in seeds:
            name = f"{scenario} {method} {effort} {seed}"
            setups[name] = with_settings(Setup(scenario, seed), settings)
    with processes(os.cpu_count() or 1) as pool:
        runs = Store("control", pool).runs(rig, setups)
    rows = [
        row_of(*case, runs[k * len(seeds) : (k + 1) * len(seeds)]) for k, case in enumerate(cases)
    ]
    return Result(
        [
            Table(
                "control",
                f"Effort of the solver, seeds {seeds[0]} to {seeds[-1]}, Gamma = {rig.gamma:.1f}",
                {
                    "scenario": "scenario", "method": "method", "iterations": "iterations",
                    "restarts": "restarts", "default": "default", "runs": "runs",
                    "good": "ended well", "rms_mm": "RMS error [mm]", "time_s": "time [s]",
                    "solve_ms": "answer, median [ms]", "solve_p99_ms": "99 % [ms]",
                },
                rows,
                "Medians over the runs; time is simulated, of the runs that ended well. Answer: "
                "time of the cores of the controller for one cycle; the cycle lasts 100 to 200 ms.",
            )
        ],
        [sentence(row) for row in rows if row["default"]],
    )  # fmt: skip


def row_of(
    scenario: str, method: str, effort: dict[str, int], runs: list[dict[str, Any]]
) -> dict[str, Any]:
    """Sum up the runs with one effort."""
    errors = [run["rms_error_m"] for run in runs if run["rms_error_m"] is not None]
    times = [run["time_s"] for run in runs if run["success"]]
    return {
        "scenario": scenario,
        "method": method,
        **EFFORT[method] | effort,
        "default": not effort,
        "runs": len(runs),
        "good": sum(bool(run["success"]) for run in runs),
        "rms_mm": 1e3 * float(np.median(errors)) if errors else None,
        "time_s": float(np.median(times)) if times else None,
        "solve_ms": float(np.median([run["solve_ms_median"] for run in runs])),
        "solve_p99_ms": float(np.median([run["solve_ms_p99"] for run in runs])),
    }


def sentence(row: dict[str, Any]) -> str:
    """Sum up one row."""
    text = f"{row['scenario']}, {row['method']}: {row['good']} of {row['runs']} ended well"
    text += f", RMS {row['rms_mm']:.3f} mm" if row["rms_mm"] is not None else ""
    text += f", {row['time_s']:.0f} s" if row["time_s"] is not None else ""
    return text + f", {row['solve_ms']:.1f} ms an answer"
