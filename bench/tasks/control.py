"""The closed loop with more and less computing time of the solver.

The complete loop is simulated, with image noise and friction that is uneven by 10 %.
"""

from __future__ import annotations

from collections.abc import Mapping

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import load_rig
from plate_solver import EFFORT
from tasks.runs import UNEVEN, Loop, runs_of, summed

SCENARIOS = ("follow_3", "sort_10")
SEEDS = range(11_000, 11_006)
"""Seeds of all runs. A seed determines start positions, image noise, friction and the solver's
random numbers."""

EFFORTS: dict[str, tuple[dict[str, int], ...]] = {
    "sinusoids": (
        {"iterations": 1, "restarts": 0}, {"iterations": 6, "restarts": 0}, {"iterations": 8}, {},
        {"iterations": 24}, {"restarts": 20}, {"restarts": 60},
    ),
    "rotations": ({"iterations": 1, "restarts": 0}, {}, {"iterations": 40, "restarts": 4}),
}  # fmt: skip
"""Options of the solver, by method. An empty mapping has the controller's defaults."""


def measure(quick: bool) -> Result:
    """Run every scenario with all options of the solver."""
    rig = load_rig()
    scenarios, seeds = (SCENARIOS[:1], SEEDS[:1]) if quick else (SCENARIOS, SEEDS)
    cases: dict[tuple[str, str, str], list[Loop]] = {}
    rows = []
    for scenario in scenarios:
        for method, efforts in EFFORTS.items():
            for effort in efforts[::2] if quick else efforts:
                words = {key: str(n) for key, n in effort.items()}
                settings: Mapping[str, str] = {"method": method, **UNEVEN, **words}
                loops = [(Setup(scenario, seed), settings, rig) for seed in seeds]
                cases[scenario, method, str(effort)] = loops
                rows.append({"scenario": scenario, "method": method, "default": not effort})
                rows[-1] |= EFFORT[method] | effort
    for row, runs in zip(rows, runs_of(Cache.of(__name__), cases).values(), strict=True):
        row |= summed(runs)
    facts = {"first": seeds[0], "last": seeds[-1], "gamma": rig.gamma}
    return Result([Table.of("control", rows, **facts)])
