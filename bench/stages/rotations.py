"""Method A: guaranteed forces, minimum time, closure.

Parts have random positions, at least 10 % of the plate's width apart. A request has a force of size
r in a random direction for each part. The guaranteed force is the maximum r that takes one cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linprog

from harness import Result, Table, race
from plate_core import Rig, load_rig
from plate_solver import RotationSolver, average_force
from plate_solver.library import Library, grid, least_time, ring, solve_weights
from plate_solver.rotations import plan_rotations, with_return_strokes

PARTS = 10
APART = 0.1
"""Minimum distance between parts [widths of the plate]."""

GAIN = 30.0
"""Bound on inverse singular values, as in section 3.1.5."""

REALISED = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3)
"""Fractions of the guaranteed force for which motions are computed."""


def measure(quick: bool) -> Result:
    """Measure forces, times and closures."""
    rig = load_rig()
    count = 6 if quick else 40
    rows = force_rows(rig, count) + realised_rows(rig, 4 if quick else count)
    rows += time_rows(rig, 0.2 if quick else 3.0)
    return Result([Table.of("rotations", rows, parts=PARTS, count=count, gamma=rig.gamma)])


def row(case: str, label: str, value: float, ours: bool) -> dict[str, Any]:
    """Return the row of a force [mu mg] or a time [ms]."""
    return {"value": value, "case": case, "label": label, "ours": ours}


def time_rows(rig: Rig, seconds: float) -> list[dict[str, Any]]:
    """Time the linear programme with warm and cold start, HiGHS, least squares and the SVD."""
    library = Library.around(rig.plate.half)
    position, direction = request(rig, PARTS, 0)
    moved = position + 1e-3 * np.random.default_rng(0).normal(size=position.shape)
    matrix, requested = library.forces(moved), direction.T.ravel()
    ones, dear = np.ones(matrix.shape[1]), np.full(len(matrix), 1e3)
    basis = least_time(library.forces(position), requested, ones, dear, dear).basis
    both = np.hstack([matrix, -matrix])
    few = Library.about(grid(rig.plate.half), rig.plate.half).forces(moved)
    timed = race(
        {
            "ours, cold": lambda: least_time(matrix, requested, ones, dear, dear),
            "ours, last basis": lambda: least_time(matrix, requested, ones, dear, dear, basis),
            "scipy linprog (HiGHS)": lambda: linprog(
                np.ones(both.shape[1]), A_eq=both, b_eq=requested, method="highs"
            ),
            "numpy lstsq, library": lambda: np.linalg.lstsq(matrix, requested, rcond=None),
            "SVD, 24 centres": lambda: solve_weights(few, requested, GAIN),
        },
        seconds,
    )
    ours = least_time(matrix, requested, ones, dear, dear).cost
    peer = linprog(np.ones(both.shape[1]), A_eq=both, b_eq=requested, method="highs").fun
    if abs(ours - peer) > 1e-6 * peer:
        raise RuntimeError(f"least times differ: {ours} and {peer} by HiGHS")
    return [row("time", n, 1e3 * timed.median(n), n.startswith("ours")) for n in timed.times]


def realised_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Convert guaranteed forces to closed motions, by both methods of closing a motion."""
    rows = []
    for closure in ("sequence", "strokes"):
        solver = RotationSolver(rig, closure=closure, restarts=1)
        found = []
        for seed in range(count):
            position, direction = request(rig, PARTS, seed)
            plan = plan_rotations(solver.library, position, direction)
            met = 0.0
            for share in REALISED:
                force = share * (with_return_strokes(plan) if closure == "strokes" else plan).met
                solver.reset()
                solution = solver.solve(position, force * direction)
                miss = average_force(solution.cycle, position) - force * direction
                if np.max(np.abs(miss)) <= solver.options.tolerance:
                    met = force
                    break
            found.append(met)
        rows.append(row("force", f"realised, {closure}", float(np.percentile(found, 10)), True))
    return rows


def scatter(rig: Rig, parts: int, rng: np.random.Generator) -> np.ndarray:
    """Return random positions (M, 2) [m] with the minimum distance `APART`."""
    chosen = np.empty((0, 2))
    while len(chosen) < parts:
        new = rng.uniform(-0.9, 0.9, 2) * rig.plate.half
        if np.all(np.hypot(*(chosen - new).T) >= APART * rig.plate.width_m):
            chosen = np.vstack([chosen, new])
    return chosen


def request(rig: Rig, parts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return positions [m] and unit vectors (M, 2) of a trial."""
    rng = np.random.default_rng([seed, parts])
    position = scatter(rig, parts, rng)
    angle = rng.uniform(0, 2 * np.pi, parts)
    return position, np.column_stack([np.cos(angle), np.sin(angle)])


def force_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Return rows of guaranteed forces with the library and with few centres, by several
    methods."""
    half = rig.plate.half
    sets = {
        "library": Library.around(half),
        "24 on a grid": Library.about(grid(half), half),
        "24 on a ring": Library.about(ring(half), half),
    }
    ways: list[tuple[str, str, Callable[[np.ndarray, np.ndarray], float]]] = []
    for name, library in sets.items():
        ways.append((name, "least time", partial(by_time, library)))
        if name != "library":
            ways.append((name, "SVD", partial(by_svd, [library])))
    few = [sets["24 on a grid"], sets["24 on a ring"]]
    ways.append(("grid or ring", "SVD, better set", partial(by_svd, few)))
    rows = []
    for centres, method, way in ways:
        forces = [way(*request(rig, PARTS, k)) for k in range(count)]
        ours = (centres, method) == ("library", "least time")
        rows.append(row("force", f"{centres}, {method}", float(np.percentile(forces, 10)), ours))
    return rows


def by_time(library: Library, position: np.ndarray, direction: np.ndarray) -> float:
    """Return the guaranteed force of the minimum-time plan, with its closure."""
    return 1 / plan_rotations(library, position, direction).times.cost


def by_svd(libraries: list[Library], position: np.ndarray, direction: np.ndarray) -> float:
    """Return the guaranteed force of the minimum-norm weights, with the best set of centres.

    The force is the minimum component along the request, divided by the time that the rotations
    take (the sum of the absolute weights)."""
    forces = []
    for library in libraries:
        matrix = library.forces(position)
        weights, _ = solve_weights(matrix, direction.T.ravel(), GAIN)
        got = (matrix @ weights).reshape(2, -1).T
        least = max(np.min(np.sum(got * direction, axis=1)), 0)
        forces.append(float(least / np.sum(np.abs(weights))))
    return max(forces)
