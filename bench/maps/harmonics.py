"""Method B: how many parts can be served, by the number of harmonics."""

from __future__ import annotations

import numpy as np

from maps.grid import Grid, StabilityMap, grid
from plate_core import Rig, load_rig
from plate_solver import SinusoidSolver, average_force
from stages.scenes import LARGEST, targets

FORCE = 0.02
"""Size of the requests [mu m g]: small, so that it is directions that run out, not force."""

TOLERANCE = 1e-4
"""A request is solved if no force is further off [mu m g]."""

RESTARTS = 100
HARMONICS, PARTS = (1, 2, 3, 4), tuple(range(1, 13))
SEED = 82
REQUESTS = 8
"""Random requests for each cell."""


def most_parts(harmonics: int) -> int:
    """Return for how many parts all forces can be asked for: (6 N - 2)/2, none for N = 1.

    N sinusoids and cosines for each of three degrees of freedom are 6 N parameters; two of them,
    the scale of all amplitudes and the start of time, change no force (section 3.2.2 of the paper
    forgets them), and M parts have 2 M forces. One harmonic gives no force at all (3.2.1).
    """
    return 3 * harmonics - 1 if harmonics > 1 else 0


def solved(rig: Rig, parts: int, harmonics: int, requests: int, restarts: int = RESTARTS) -> float:
    """Return the share of random requests that are solved, by the exact average of the motion."""
    solver = SinusoidSolver(rig, harmonics=harmonics, restarts=restarts)
    rng = np.random.default_rng([SEED, parts, harmonics])
    count = 0
    for position, force in targets(rig, parts, requests, rng):
        force = FORCE / LARGEST * force
        solver.reset()
        motion = solver.solve(position, force).cycle
        count += bool(np.max(np.abs(average_force(motion, position) - force)) <= 2 * TOLERANCE)
    return count / requests


def measure(quick: bool) -> list[Grid]:
    """Measure all cells."""
    rig = load_rig()
    numbers, counts = (HARMONICS[:2], PARTS[:7]) if quick else (HARMONICS, PARTS)
    requests, restarts = (3, 30) if quick else (REQUESTS, RESTARTS)
    z = [[solved(rig, m, n, requests, restarts) for n in numbers] for m in counts]
    return [grid(numbers, counts, z, numbers, [most_parts(n) + 0.5 for n in numbers])]


MAP = StabilityMap(
    key="harmonics",
    title="Too many parts: number of parts and harmonics, Method B",
    x_label="harmonics N",
    y_label="parts M",
    z_label="share of requests solved [-]",
    line_label="theory: 2 M = 6 N - 2",
    level=0.5,
    measure=measure,
    bounds=(0.0, 1.0),
    steps=True,
    finding="One harmonic moves no part, two move five.",
    note=f"{REQUESTS} random requests up to {FORCE:g} mu mg, solved to {TOLERANCE:g}.",
)
