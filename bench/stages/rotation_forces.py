"""Forces that rotations can guarantee at random parts, by a library and by few centres."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from plate_core import Rig
from plate_solver.centres import grid, ring, solve_weights
from plate_solver.library import Library
from plate_solver.rotation_plan import plan_rotations
from plate_solver.shares import solve_shares

PARTS = 10
APART = 0.1
"""Least distance of parts, in widths of the plate."""

WORST_STARTS = 8
"""Starts of the search for the worst directions."""

GAIN = 30.0
"""Bound on inverse singular values, as in section 3.1.5."""


def scatter(rig: Rig, parts: int, rng: np.random.Generator) -> np.ndarray:
    """Return random places (M, 2) [m] with the distance asked for."""
    chosen = np.empty((0, 2))
    while len(chosen) < parts:
        new = rng.uniform(-0.9, 0.9, 2) * rig.plate.half
        if np.all(np.hypot(*(chosen - new).T) >= APART * rig.plate.width_m):
            chosen = np.vstack([chosen, new])
    return chosen


def request(rig: Rig, parts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places and unit vectors (M, 2) of a trial."""
    rng = np.random.default_rng([seed, parts])
    position = scatter(rig, parts, rng)
    angle = rng.uniform(0, 2 * np.pi, parts)
    return position, np.column_stack([np.cos(angle), np.sin(angle)])


def force_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Guaranteed forces by the library, and by few centres, in several ways."""
    half = rig.plate.half
    sets = {
        "library": Library.around(half),
        "24 on a grid": Library.about(grid(half), half),
        "24 on a ring": Library.about(ring(half), half),
    }
    rows = []
    for name, library in sets.items():
        rows.append(force_row(rig, name, "least time", count, partial(by_time, library)))
        if name != "library":
            rows.append(force_row(rig, name, "SVD", count, partial(by_svd, library)))
        rows[-1]["number"] = len(library.twist)
    few = [sets["24 on a grid"], sets["24 on a ring"]]
    rows.append(
        force_row(
            rig, "grid or ring", "SVD, better set", count,
            lambda p, f: max(by_svd(library, p, f) for library in few),
        )
    )  # fmt: skip
    return rows


def force_row(
    rig: Rig,
    centres: str,
    method: str,
    count: int,
    guaranteed: Callable[[np.ndarray, np.ndarray], float],
) -> dict[str, Any]:
    """Sum up the trials of one method."""
    found, worst = [], []
    library = Library.around(rig.plate.half)
    for seed in range(count):
        position, direction = request(rig, PARTS, seed)
        found.append(guaranteed(position, direction))
        if centres == "library":
            worst.append(worst_direction(library, position, seed))
    return {
        "centres": centres,
        "method": method,
        "number": 24,
        "p10": float(np.percentile(found, 10)),
        "median": float(np.median(found)),
        "worst_p10": float(np.percentile(worst, 10)) if worst else None,
    }


def by_time(library: Library, position: np.ndarray, direction: np.ndarray) -> float:
    """Guaranteed force of the least-time plan, closure included."""
    return 1 / plan_rotations(library, position, direction).shares.cost


def by_svd(library: Library, position: np.ndarray, direction: np.ndarray) -> float:
    """Guaranteed force of the smallest weights: least component along the request, per time."""
    matrix = library.forces(position)
    weights, _ = solve_weights(matrix, direction.T.ravel(), GAIN)
    got = (matrix @ weights).reshape(2, -1).T
    return float(max(np.min(np.sum(got * direction, axis=1)), 0) / np.sum(np.abs(weights)))


def worst_direction(library: Library, position: np.ndarray, seed: int) -> float:
    """Guaranteed force in the worst directions that a search finds.

    Time is the greatest y . f over prices y that no rotation exceeds, so along the prices of a
    request it is greater still: f is turned along y until that is all.
    """
    rng = np.random.default_rng(seed)
    matrix, time = library.forces(position), 0.0
    ones, dear = np.ones(matrix.shape[1]), np.full(len(matrix), 1e4)
    for _ in range(WORST_STARTS):
        force = rng.normal(size=(2, len(position)))
        last = -1.0
        for _ in range(30):
            force /= np.maximum(np.hypot(*force), 1e-12)
            shares = solve_shares(matrix, force.ravel(), ones, dear, dear)
            if shares.cost <= last * (1 + 1e-6):
                break
            last, force = shares.cost, shares.price.reshape(2, -1).copy()
        time = max(time, last)
    return 1 / time
