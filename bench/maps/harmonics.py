"""Method B: number of parts for which arbitrary forces can be requested, by the number of
harmonics."""

from __future__ import annotations

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import Rig, load_rig
from plate_solver import SinusoidSolver, average_force
from stages.scenes import MAX_FORCE, targets

FORCE = 0.02
"""Size of the requested forces [mu m g]. The forces are small, so that only the number of
parameters limits the success."""

TOLERANCE = 1e-4
"""Maximum error of a force in a solved request [mu m g]."""

RESTARTS = 100
HARMONICS, PARTS = (1, 2, 3, 4), tuple(range(1, 13))
SEED = 82
REQUESTS = 8
"""Number of random requests for each cell."""


def max_parts(harmonics: int) -> int:
    """Return the maximum number of parts with arbitrary forces: (6 N - 2)/2, and 0 for N = 1.

    N sines and N cosines for each of three degrees of freedom have 6 N parameters. Two parameters,
    the scale of all amplitudes and the time shift, do not change the forces. Section 3.2.2 of the
    paper does not subtract these two parameters. M parts have 2 M force components. A single
    harmonic has no mean force (3.2.1).
    """
    return 3 * harmonics - 1 if harmonics > 1 else 0


def solved_fraction(
    rig: Rig, parts: int, harmonics: int, requests: int, restarts: int = RESTARTS
) -> float:
    """Return the fraction of random requests that are solved, checked by the exact averaged
    force."""
    solver = SinusoidSolver(rig, harmonics=harmonics, restarts=restarts)
    rng = np.random.default_rng([SEED, parts, harmonics])
    count = 0
    for position, force in targets(rig, parts, requests, rng):
        force = FORCE / MAX_FORCE * force
        solver.reset()
        motion = solver.solve(position, force).cycle
        count += bool(np.max(np.abs(average_force(motion, position) - force)) <= 2 * TOLERANCE)
    return count / requests


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    numbers, counts = (HARMONICS[:2], PARTS[:7]) if quick else (HARMONICS, PARTS)
    requests, restarts = (3, 30) if quick else (REQUESTS, RESTARTS)
    z = [[solved_fraction(rig, m, n, requests, restarts) for n in numbers] for m in counts]
    return [grid(numbers, counts, z, numbers, [max_parts(n) + 0.5 for n in numbers])]


MAP = StabilityMap(
    key="harmonics",
    title="Too many parts: number of parts and harmonics, Method B",
    x_label="harmonics N",
    y_label="parts M",
    z_label="fraction of solved requests [-]",
    line_label="2 M = 6 N - 2 for N > 1, and no part for N = 1",
    level=0.5,
    measure=measure,
    bounds=(0.0, 1.0),
    steps=True,
    finding="Motions with one harmonic exert no mean force on any part. Two harmonics are enough "
    "for requests with five parts.",
    note=f"Each cell has {REQUESTS} random requests with forces up to {FORCE:g} mu mg. A request "
    f"counts as solved if its error is at most {2 * TOLERANCE:g} mu mg.",
)
