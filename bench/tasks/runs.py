"""Common functions of the measurements of tasks: run the closed loop many times, with a cache, and
summarise the runs in a row."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from harness import Cache, by_case
from plate_bringup.loop import Setup, summary, with_settings
from plate_core import Rig
from plate_core.tasks import PartGroup, Scenario, SortTask, load_scenario

UNEVEN = {"friction_spread": "0.1", "friction_patches": "0.1"}
"""Settings of `bench/closed_loop.py` for uneven friction: it differs by 10 % between parts, and by
10 % over the plate."""

Loop = tuple[Setup, Mapping[str, str], Rig]
"""Setup of a run, settings of `bench/closed_loop.py`, and rig."""


def sorting_scenario(count: int) -> Scenario:
    """Return a scenario like `sort_10` with `count` parts, half of them black."""
    scenario = load_scenario("sort_10")
    assert isinstance(scenario.task, SortTask)
    groups = (PartGroup("black", count - count // 2), PartGroup("grey", count // 2))
    parts = tuple(group for group in groups if group.count)
    task = replace(
        scenario.task, regions={part.label: scenario.task.regions[part.label] for part in parts}
    )
    return replace(scenario, parts=parts, task=task, time_limit_s=900.0)


def cached_runs(
    cache: Cache, cases: Mapping[Any, Sequence[Loop]]
) -> dict[Any, list[dict[str, Any]]]:
    """Return a row as in `bench/closed_loop.py` for each run, by case. Only runs that are not in
    the cache are executed."""
    work = {
        case: [(with_settings(setup, settings), rig) for setup, settings, rig in loops]
        for case, loops in cases.items()
    }
    return by_case(summary, work, cache)


def summarise(runs: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one row for the runs of a case. A value for which no run has data is None.

    Times of the task are simulated times of successful runs. `most` and `worst` are values of the
    worst run. All other values are medians over the runs.
    """
    runs = list(runs)
    good = [run for run in runs if run["success"]]

    def values(key: str, unit: float = 1.0, of: Iterable[Mapping[str, Any]] = runs) -> list[float]:
        return [unit * run[key] for run in of if run[key] is not None]

    times, rms = values("time_s", of=good), values("rms_error_m", 1e3)
    return {
        "runs": len(runs),
        "good": len(good),
        "succeeded": f"{len(good)} of {len(runs)}",
        "dropped": sum(run["dropped"] for run in runs),
        "time_s": median(times),
        "longest_s": max(times, default=None),
        "rms_mm": median(rms),
        "worst_rms_mm": max(rms, default=None),
        "max_mm": max(values("max_error_m", 1e3), default=None),
        "turn_deg": max(values("turn_error_deg"), default=None),
        "pace": median([run["pace"] for run in runs if run.get("pace") is not None]),
        "solve_ms": median(values("solve_ms_median")),
        "solve_p99_ms": median(values("solve_ms_p99")),
        "step_ms": median(values("step_ms_median")),
        "step_p99_ms": median(values("step_ms_p99")),
    }


def median(values: list[float]) -> float | None:
    """Return the median. None if the list is empty."""
    return float(np.median(values)) if values else None
