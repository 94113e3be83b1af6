"""Small and weak rigs: success, time and error, compared with the prediction of `feasible`.

The results help to choose the components of a rig. Results are compared with the prediction of
`ros2 run plate_bringup feasible`. The complete loop is simulated with image noise and uneven
friction. The 90 runs take about ten minutes on two cores.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import Setup
from plate_bringup.rehearsal import rehearse_task
from plate_core import Rig, load_rig
from plate_core.tasks import load_scenario
from tasks.runs import UNEVEN, cached_runs, summarise

RATIOS = (2, 3, 5, 10)
"""Shaking ratios of the default plate: its acceleration `accel_mps2` divided by mu g."""

STROKES_MM = (2,)
"""Strokes of the default plate [mm]."""

FORCES_N = ((10, 5), (20, 10))
"""Peak and continuous forces of the default plate's motors [N]."""

SCENARIOS = ("sort_4", "sort_10", "follow_2")

SEEDS = range(50_000, 50_003)
"""Seeds. No parameter was tuned with these seeds."""

FULL_PACE = 0.95
"""Fraction of the requested speed. The table omits a speed above this fraction, because it is
practically the requested speed."""


def measure(quick: bool) -> Result:
    """Run all tasks on all rigs."""
    cache, seeds = Cache.of(__name__), SEEDS[:1] if quick else SEEDS
    kinds = {
        (name, "follow_2_desk" if (name, task) == ("desk", "follow_2") else task): rig
        for name, rig in compared_rigs().items()
        for task in (SCENARIOS[:1] if quick else SCENARIOS)
    }
    predicted_cases = {(*kind, "feasible"): [(rig, kind[1])] for kind, rig in kinds.items()}
    predictions = by_case(predicted, predicted_cases, cache)
    cases = {
        kind: [(Setup(kind[1], seed), UNEVEN, rig) for seed in seeds] for kind, rig in kinds.items()
    }
    rows = [
        {"rig": kind[0], "gamma": kinds[kind].gamma, "scenario": kind[1]}
        | summarise(runs)
        | prediction[0]
        for (kind, runs), prediction in zip(
            cached_runs(cache, cases).items(), predictions.values(), strict=True
        )
    ]
    facts = {"first": seeds[0], "last": seeds[-1]}
    return Result([Table.of("rigs", rows, **facts), Table.of("by_rig", rig_rows(rows), **facts)])


def compared_rigs() -> dict[str, Rig]:
    """Return the compared rigs by name."""
    default = load_rig()

    def limited_rig(**limits: float) -> Rig:
        return replace(default, limits=replace(default.limits, **limits))

    return {
        **{f"Gamma {g:g}": limited_rig(accel=g * default.friction.accel) for g in RATIOS},
        "default": default,
        **{f"stroke {s:g} mm": limited_rig(stroke_m=1e-3 * s) for s in STROKES_MM},
        **{f"motors {p} N": limited_rig(force=p, continuous_force=c) for p, c in FORCES_N},
        "four voice coils": load_rig("voice_coils"),
        "desk": load_rig("desk"),
    }


def predicted(rig: Rig, scenario: str) -> dict[str, Any]:
    """Return the prediction of `feasible` for a task."""
    verdict = rehearse_task(rig, load_scenario(scenario))
    return {
        "feasible": "likely" if verdict.likely else "not likely",
        "feasible_s": verdict.time_s if np.isfinite(verdict.time_s) else None,
        "binds": verdict.limit_use.binding_limit,
    }


def rig_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for each rig with the results of all tasks. Each result is followed by the
    prediction of `feasible` in brackets."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        rig_row = found.setdefault(row["rig"], {"rig": row["rig"], "gamma": row["gamma"]})
        result = [row["succeeded"]]
        if row["time_s"] is not None:
            result.append(f"{row['time_s']:.0f} s")
        if row["rms_mm"] is not None:
            result.append(f"{row['rms_mm']:.2f} mm")
        if row["pace"] is not None and row["pace"] < FULL_PACE:
            result.append(f"{100 * row['pace']:.0f} % of the speed")
        prediction = "yes" if row["feasible"] == "likely" else "no"
        if row["feasible_s"] is not None:
            prediction += f", {row['feasible_s']:.0f} s"
        rig_row[row["scenario"].removesuffix("_desk")] = f"{', '.join(result)} ({prediction})"
    return list(found.values())
