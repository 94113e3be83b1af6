"""Manipulability of parts at given positions (section 3.3 of the paper).

The average forces on parts at rest are a mean of unit forces. Each twist in the plate's motion
contributes one column of unit forces. This module evaluates all columns of a library of twists in
two ways:

- Their second moment describes the forces of random motions. The condition number is the square
  root of the ratio of its maximum and minimum eigenvalues. The eigenvector of the minimum
  eigenvalue is the direction in which a force is the most difficult to produce.
- Their convex hull contains the forces of all motions that combine the library's twists. The
  maximum force in a direction is the extent of the hull in this direction. A linear programme
  computes the minimum time for a unit of force. The maximum force is the reciprocal of this time.

A real cycle may produce less force, because the model neglects several effects: the ramps between
rotations, the closure of the motion, the limits, and the displacement of parts within a cycle. A
real cycle may also produce a few per cent more force, because it can rotate about points between
the centres of the library.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateError, Rig

from ..library import Library, least_time
from ..library.condition import columns_of, second_moment, unit

DEAR = 1e6
"""Price of a unit of unmet force [cycles / (mu m g)]. The price is higher than the cost of any
feasible force, so that no feasible force is left unmet."""

DESCENTS = 12
"""Maximum number of steps of a search from one face of the hull to a nearer one."""

STARTS = 8
"""Number of random start directions of the search for the nearest face. The most difficult
direction is an additional start."""


@dataclass(frozen=True)
class Manipulability:
    """Measures for pushing M parts independently in different directions.

    The forces on all parts form one vector (2 M,): part 1 x, part 1 y, part 2 x, and so on. A unit
    of force is a vector whose mean square over the parts is one (mu m g)^2.

    Attributes
    ----------
    condition : float
        Ratio of the forces in the easiest and in the most difficult direction, at least 1. Infinite
        if no force is possible in some direction.
    worst_direction : (2 M,)
        Most difficult direction according to the second moment of the forces. The length of this
        vector is a unit of force.
    weakest_force : float
        Maximum force of the library in its weakest direction [mu m g]. The force is a local
        minimum, because the search may miss a smaller one. It neglects ramps between rotations, the
        closure of the motion, and the limits.
    weakest_direction : (2 M,)
        Direction of `weakest_force`. The direction is a unit of force.
    """

    condition: float
    worst_direction: np.ndarray
    weakest_force: float
    weakest_direction: np.ndarray


def manipulability(
    rig: Rig, position: np.ndarray, library: Library | None = None, seed: int = 0
) -> Manipulability:
    """Compute the measures of manipulability for parts at given positions.

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

    Ramps between rotations, the closure of the motion, and the limits of stroke, speed and
    acceleration are neglected. Directions must not be zero. Each direction is scaled to a unit of
    force, see `Manipulability`.
    """
    columns = columns_of(rig, position, library)
    direction = np.atleast_2d(np.asarray(direction, dtype=float))
    if direction.shape[1] != len(columns) or not np.all(np.any(direction, axis=1)):
        raise PlateError(
            f"direction has shape {direction.shape}, allowed: (D, {len(columns)}), nonzero"
        )
    return np.array([_force_along(columns, unit(row))[0] for row in direction])


def _force_along(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the maximum multiple of a direction (2 M,) that is in the hull, and the normal of the
    hull's face at this point."""
    rows, count = columns.shape
    dear = np.full(rows, DEAR)
    plan = least_time(columns, direction, np.ones(count), dear, dear)
    if np.max(np.abs(plan.miss)) > 1e-6:
        return 0.0, plan.price
    return 1 / plan.cost, plan.price


def _nearest_face(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Find a face of the hull with a locally minimum distance from 0. Return this distance and the
    direction.

    Each step searches along the normal of the last face. The search ends when the next face is not
    nearer to 0.
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
