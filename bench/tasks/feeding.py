"""A feeder in production, compared with feeders that shake and take images: speed, accuracy.

Each case changes one value of the base case: the number of parts on the plate, the gripper's
clearance, the robot's cycle, the pick window, or the type of part. The baselines are those of
`tasks.shaking`. All feeders have the same hopper, robot, camera and noise. The hopper drops only
requested parts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import Setup
from plate_bringup.production import filled, produce
from plate_core.tasks import FeedTask, Scenario, load_scenario
from tasks.shaking import Shaker

RECIPES = {"discs": "feed", "nuts": "feed_nuts", "bars": "feed_bars"}
"""Recipe, by type of part. The recipe for bars requests their angle within 5 degrees."""

METHODS = ("ours", "vibrated", "thrown")
"""The project's feeder, and the baselines."""

SEEDS = range(60_000, 60_003)
TIME_S, QUICK_S = 60.0, 10.0
"""Simulated duration of a production run, and of a quick production run [s]."""


@dataclass(frozen=True)
class Case:
    """One case of production.

    Attributes
    ----------
    kind : str
        Type of part, a key of `RECIPES`.
    fill : int
        Number of parts on the plate to which the hopper refills.
    clearance_m : float
        Clearance of the gripper [m].
    cycle_s : float
        Cycle time of the robot [s].
    window_m : float or None
        Side length of a square pick window in the middle of the recipe's window [m]. None: the
        recipe's window.
    """

    kind: str = "discs"
    fill: int = 20
    clearance_m: float = 6e-3
    cycle_s: float = 2.0
    window_m: float | None = None

    @property
    def recipe(self) -> Scenario:
        """Return the recipe as a scenario."""
        recipe = filled(load_scenario(RECIPES[self.kind]), self.fill)
        task = recipe.task
        assert isinstance(task, FeedTask)
        assert task.hopper is not None
        pick = task.picks[0]
        hopper = replace(task.hopper, mix={pick.label: 1.0})
        if self.window_m is not None:
            (x0, y0), (x1, y1), half = pick.low, pick.high, self.window_m / 2
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            pick = replace(pick, low=(x - half, y - half), high=(x + half, y + half))
        task = replace(task, hopper=hopper, picks=(pick,), clearance_m=self.clearance_m)
        return replace(recipe, task=task)


BASE = Case()

CASES = {
    "fill": [replace(BASE, fill=n) for n in (5, 10, 20, 40)],
    "clearance": [replace(BASE, clearance_m=c) for c in (3e-3, 6e-3, 12e-3)],
    "cycle": [replace(BASE, cycle_s=s) for s in (1.0, 2.0, 4.0)],
    "window": [replace(BASE, window_m=0.1), BASE],
    "kind": [replace(BASE, kind=k) for k in RECIPES],
}
"""Cases, grouped by the value that they change. Each group contains the base case."""


def measure(quick: bool) -> Result:
    """Run all cases with all feeders."""
    seeds, time_s = (SEEDS[:1], QUICK_S) if quick else (SEEDS, TIME_S)
    work = {
        (changed, case, method, time_s): [(case, method, seed, time_s) for seed in seeds]
        for changed in CASES
        for case in CASES[changed]
        if not quick or case == BASE or changed == "kind"
        for method in METHODS
    }
    found = by_case(run_case, work, Cache.of(__name__))
    rows = [row(changed, case, method, runs) for (changed, case, method, _), runs in found.items()]
    facts = {"time": time_s, "first": seeds[0], "last": seeds[-1]}
    return Result([Table.of("feeding", rows, **facts)])


def run_case(case: Case, method: str, seed: int, time_s: float) -> dict[str, Any]:
    """Run one production, and return its result as values that JSON can represent."""
    setup = Setup(case.recipe, seed)
    if method == "ours":
        return produce(setup, case.cycle_s, time_s).row
    return Shaker(setup, case.cycle_s, is_thrown=method == "thrown").run(time_s).row


def row(changed: str, case: Case, method: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row that summarises the runs of a case."""

    def finite(values: list[float]) -> list[float]:
        return [v for v in values if v is not None and np.isfinite(v)] or [np.nan]

    def mean(values: list[float]) -> float:
        return float(np.mean(finite(values)))

    return {
        "changed": changed, "kind": case.kind, "fill": case.fill,
        "clearance_mm": 1e3 * case.clearance_m,
        "window_mm": None if case.window_m is None else 1e3 * case.window_m,
        "cycle_s": case.cycle_s, "method": method,
        "runs": len(runs),
        "parts_per_min": mean([r["parts_per_min"] for r in runs]),
        "least_per_min": min(r["parts_per_min"] for r in runs),
        "waiting": 100 * mean([r["waiting"] for r in runs]),
        "most_waiting": 100 * max(finite([r["waiting"] for r in runs])),
        "first_s": mean([r["first_s"] for r in runs]),
        "failed": sum(r["failed"] for r in runs), "lost": sum(r["lost"] for r in runs),
        "error_mm": mean([r["error_mm"][0] for r in runs]),
        "error_95_mm": mean([r["error_mm"][1] for r in runs]),
        "error_most_mm": max(finite([r["error_mm"][2] for r in runs])),
        "turn_95_deg": mean([r["error_deg"][1] for r in runs]),
        "turn_most_deg": max(finite([r["error_deg"][2] for r in runs])),
        "cpu": 100 * mean([r["cpu"] for r in runs]) if method == "ours" else None,
    }  # fmt: skip
