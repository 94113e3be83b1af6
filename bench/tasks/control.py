"""The closed loop with more and less time for the solver: tracking error and time of a sort.

The whole loop: image noise, friction uneven by 10 %.
"""

from __future__ import annotations

from harness import Cache, Result, Table, processes
from plate_bringup.loop import Setup
from plate_core import load_rig
from plate_solver import EFFORT
from tasks.runs import UNEVEN, runs_of, summed

SCENARIOS = ("follow_3", "sort_10")
SEEDS = range(11_000, 11_006)
"""Of all runs: scatter, image noise, friction and the solver's random numbers."""

EFFORTS: dict[str, tuple[dict[str, int], ...]] = {
    "sinusoids": (
        {"iterations": 1, "restarts": 0}, {"iterations": 6, "restarts": 0}, {},
        {"restarts": 20}, {"restarts": 60},
    ),
    "rotations": ({"iterations": 1, "restarts": 0}, {}, {"iterations": 40, "restarts": 4}),
}  # fmt: skip
"""Options of the solver by method; none: the controller's own."""

COLUMNS = {
    "scenario": "scenario", "method": "method", "iterations": "iterations", "restarts": "restarts",
    "default": "default", "runs": "runs", "good": "ended well", "rms_mm": "RMS error [mm]",
    "time_s": "time [s]", "solve_ms": "answer, median [ms]", "solve_p99_ms": "99 % [ms]",
}  # fmt: skip


def measure(quick: bool) -> Result:
    """Run every scenario with every effort."""
    rig = load_rig()
    scenarios, seeds = (SCENARIOS[:1], SEEDS[:1]) if quick else (SCENARIOS, SEEDS)
    kinds = [
        (scenario, method, effort)
        for scenario in scenarios
        for method, efforts in EFFORTS.items()
        for effort in (efforts[::2] if quick else efforts)
    ]
    cases = {}
    for scenario, method, effort in kinds:
        settings = {"method": method, **UNEVEN, **{key: str(n) for key, n in effort.items()}}
        for seed in seeds:
            cases[f"{scenario} {method} {effort} {seed}"] = Setup(scenario, seed), settings
    with processes() as pool:
        runs = runs_of(pool, Cache.of(__name__), rig, cases)
    rows = []
    for number, (scenario, method, effort) in enumerate(kinds):
        row = summed(runs[number * len(seeds) : (number + 1) * len(seeds)])
        row |= {"scenario": scenario, "method": method, "default": not effort}
        row |= EFFORT[method] | effort
        rows.append({key: row[key] for key in COLUMNS})
    title = f"Effort of the solver, seeds {seeds[0]} to {seeds[-1]}, Gamma = {rig.gamma:.1f}"
    note = (
        "Medians over the runs; time is simulated, of the runs that ended well. Answer: time of "
        "the cores of the controller for one cycle; the cycle lasts 100 to 200 ms."
    )
    table = Table("control", title, COLUMNS, rows, note)
    return Result([table])
