"""Manipulability of parts at given positions (section 3.3 of the paper).

The average forces on parts at rest are a mean of unit forces. Each twist in the plate's motion
contributes one column of unit forces. This module evaluates all columns of a library of twists:

- Their second moment describes the forces of random motions. The condition number is the square
  root of the ratio of its maximum and minimum eigenvalues. The eigenvector of the minimum
  eigenvalue is the direction that is the most difficult to push.
- Their convex hull contains the forces of all mixtures. The maximum force in a direction is the
  extent of the hull in this direction. It is the reciprocal of the minimum time for a unit of
  force, from a linear programme.

A real cycle may produce less: the model neglects the time for ramps, the closure of the motion, the
limits of stroke, speed and acceleration, and the displacement of parts within a cycle. It may also
produce a few per cent more, by rotations between those of the library.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateError, Rig

from ..library import Library, least_time
from ..library.condition import columns_of, second_moment, unit

DEAR = 1e6
"""Price of a unit of unmet force [cycles / (mu m g)]. This price is higher than the price of any
feasible force."""

DESCENTS = 12
"""Maximum number of steps from one face of the hull to a nearer one."""

STARTS = 8
"""Number of random start directions in the search for the nearest face, besides the most difficult
direction."""


@dataclass(frozen=True)
class Manipulability:
    """Measures of how independently M parts can be pushed.

    Forces on all parts are one vector (2 M,): part 1 x, part 1 y, part 2 x, ... A unit of force has
    a mean square over the parts of one (mu m g)^2.

    Attributes
    ----------
    condition : float
        Ratio of the forces in the easiest and in the most difficult direction, at least 1.
        Infinite if a direction is infeasible.
    worst_direction : (2 M,)
        Most difficult direction by the second moment; a unit of force.
    weakest_force : float
        Minimum over directions of the library's maximum force [mu m g]. It is a local minimum: the
        search may miss a smaller one. Ramps, closure and limits are neglected.
    weakest_direction : (2 M,)
        Direction of `weakest_force`; a unit of force.
    """

    condition: float
    worst_direction: np.ndarray
    weakest_force: float
    weakest_direction: np.ndarray


def manipulability(
    rig: Rig, position: np.ndarray, library: Library | None = None, seed: int = 0
) -> Manipulability:
    """Compute how independently parts at given positions can be pushed.

    Parameters
    ----------
    rig : Rig
    position : (M, 2)
        Parts at rest [m], plate_home.
    library : Library, optional
        Rotations that the plate may use. Default: a grid of centres over the plate. Two parts
        closer than the grid's spacing count as hard to push independently.
    seed : int
        Random seed of the start directions in the search for `weakest_direction`.
    """
    columns = columns_of(rig, position, library)
    condition, worst = second_moment(columns)
    rng = np.random.default_rng(seed)
    starts = [worst, *(unit(row) for row in rng.normal(size=(STARTS, len(columns))))]
    weakest_force, weakest = min(
        (_nearest_face(columns, start) for start in starts), key=lambda pair: pair[0]
    )
    return Manipulability(condition, worst, weakest_force, weakest)


def library_force(
    rig: Rig, position: np.ndarray, direction: np.ndarray, library: Library | None = None
) -> np.ndarray:
    """Return the library's maximum force [mu m g] in each direction (D, 2 M).

    Ramps between rotations, closure, and the limits of stroke, speed and acceleration are
    neglected. Directions must not be zero. They are scaled to a unit of force, see
    `Manipulability`.
    """
    columns = columns_of(rig, position, library)
    direction = np.atleast_2d(np.asarray(direction, dtype=float))
    if direction.shape[1] != len(columns) or not np.all(np.any(direction, axis=1)):
        raise PlateError(
            f"direction has shape {direction.shape}, allowed: (D, {len(columns)}), nonzero"
        )
    return np.array([_force_along(columns, unit(row))[0] for row in direction])


def _force_along(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the maximum multiple of a direction (2 M,) in the hull, and the normal of the face
    there."""
    rows, count = columns.shape
    dear = np.full(rows, DEAR)
    plan = least_time(columns, direction, np.ones(count), dear, dear)
    if np.max(np.abs(plan.miss)) > 1e-6:
        return 0.0, plan.price
    return 1 / plan.cost, plan.price


def _nearest_face(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Find a face of the hull at a minimum distance from 0, and its direction.

    Each step goes along the normal of the last face. The search ends when the next face is not
    nearer.
    """
    force, normal = _force_along(columns, direction)
    for _ in range(DESCENTS):
        if force == 0 or not np.any(normal):
            break
        further = unit(normal)
        less, normal = _force_along(columns, further)
        if less >= force * (1 - 1e-9):
            break
        force, direction = less, further
    return force, direction
