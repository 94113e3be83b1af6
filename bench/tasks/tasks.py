"""Every scenario with many seeds, in worlds that agree with the loop's model or differ from it.

About 2000 runs take two hours on two cores. An interrupted measurement continues where it stopped.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import Rig, load_rig
from plate_core.rig import Suspension, mass_matrix, modal_matrices
from tasks.runs import UNEVEN, cached_runs, summarise

FIRST_SEED = 20_000
"""First seed. No parameter of the project was chosen by runs with this seed or larger seeds."""

LATE, LOST = {"latency": "0.05"}, {"missed_parts": "0.05", "false_parts": "0.01"}

MOTOR_GAIN = (1.1, 0.9, 1.1, 0.9)
"""Ratios of the motors' actual to their requested force."""


WEAK = "motors off by 10 %"
"""Part of the name of the world with the force errors of `MOTOR_GAIN`. The last world has the same
force errors."""

WORLDS: dict[str, dict[str, str]] = {
    "clean": {},
    "dirt": UNEVEN,
    "dirt, friction 30 % less": UNEVEN | {"mu_scale": "0.7"},
    "dirt, friction 30 % more": UNEVEN | {"mu_scale": "1.3"},
    f"dirt, {WEAK}": UNEVEN,
    "dirt, images 50 ms late": UNEVEN | LATE,
    "dirt, 5 % missed, 1 % false": UNEVEN | LOST,
    "all of these": UNEVEN | LATE | LOST | {"mu_scale": "0.7"},
}
"""Simulated worlds by name. The settings of `bench/closed_loop.py` describe their differences from
the world that planner and solver assume."""

CASES = (
    ("sort_10", "sinusoids", "dirt", 300),
    ("follow_2", "sinusoids", "dirt", 100),
    ("follow_5", "sinusoids", "dirt", 100),
    ("assemble_8", "sinusoids", "dirt", 100),
    ("sort_16", "sinusoids", "dirt", 100),
    ("follow_3", "sinusoids", "dirt", 20),
    ("spin_1", "sinusoids", "dirt", 20),
    ("follow_2", "sinusoids", "clean", 20),
    *((name, "sinusoids", world, 50)
      for world in list(WORLDS)[2:] for name in ("sort_10", "follow_2")),
    ("sort_10", "rotations", "dirt", 300),
    ("follow_2", "rotations", "dirt", 20),
    ("sort_4", "sinusoids", "dirt", 20),
    ("coin_circle", "sinusoids", "dirt", 20),
    ("spin_1", "rotations", "dirt", 20),
)  # fmt: skip
"""Scenario, method, world, number of seeds."""


def measure(quick: bool) -> Result:
    """Run all cases."""
    rig, cases = load_rig(), {}
    for name, method, world, count in [("follow_2", "sinusoids", "dirt", 2)] if quick else CASES:
        played = weak_rig(rig) if WEAK in world or world == "all of these" else rig
        seeds = range(FIRST_SEED, FIRST_SEED + count)
        loops = [(Setup(name, seed, method), WORLDS[world], played) for seed in seeds]
        cases[name, method, world] = loops
    rows = [
        dict(zip(("scenario", "method", "world"), case, strict=True)) | summarise(runs)
        for case, runs in cached_runs(Cache.of(__name__), cases).items()
    ]
    return Result([Table.of("many_seeds", rows, seed=FIRST_SEED, gamma=rig.gamma)])


def weak_rig(rig: Rig) -> Rig:
    """Return the rig with motors whose actual forces are the requested forces times `MOTOR_GAIN`.

    The plate has a soft suspension (5 Hz, well damped). The plate's drive compensates for the
    suspension, but not for the errors of the motor forces.
    """
    mass = mass_matrix(rig.plate.mass_kg, rig.plate.inertia_kgm2)
    damping, stiffness = modal_matrices(mass, np.full(3, 5.0), np.full(3, 0.5))
    hung = Suspension(mass, damping, stiffness, (1.0, 1.0, 1.0), motor_gain=MOTOR_GAIN)
    return replace(rig, suspension=hung)
