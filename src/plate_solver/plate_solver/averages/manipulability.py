"""Manipulability of parts at given positions (section 3.3 of the paper).

A twist of the plate exerts friction of the magnitude mu m g on each part at rest. The unit forces
of all parts for one twist form a column of a matrix. The average forces of a motion are a mean of
the columns of its twists. This module evaluates the columns of a library of twists in two ways:

- The second moment of the columns describes the forces of random motions. The condition number is
  the square root of the ratio of the maximum to the minimum eigenvalue of this moment. In the
  direction of the eigenvector of the minimum eigenvalue, a force is the most difficult to produce.
- The convex hull of the columns contains the forces of all motions that combine the library's
  twists. The maximum force in a direction is the extent of the hull in this direction. A linear
  programme computes the minimum time that is needed for a unit of force. The maximum force is the
  reciprocal of this time.

A real cycle may produce less force, because the model neglects several effects. These effects are
the ramps between rotations, the closure of the motion, the limits, and the displacement of parts
within a cycle. A real cycle may also produce a few per cent more force, because it can rotate about
points between the centres of the library.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateError, Rig

from ..library import Library, min_time
from ..library.condition import columns_of, second_moment, unit

MISSING_FORCE_COST = 1e6
"""Cost of a unit of requested force that is not produced [cycles / (mu m g)]. This cost is higher
than the cost of any feasible force, so that every feasible force is produced."""

DESCENTS = 12
"""Maximum number of steps in a search for the nearest face of the hull. Each step leads to a nearer
face."""

STARTS = 8
"""Number of random start directions of the search for the nearest face of the hull. The most
difficult direction is an additional start direction."""


@dataclass(frozen=True)
class Manipulability:
    """Measures of how independently M parts can be pushed in different directions.

    The forces on all parts form one vector (2 M,): part 1 x, part 1 y, part 2 x, and so on. A unit
    of force is a vector whose mean square over the parts is one (mu m g)^2.

    Attributes
    ----------
    condition : float
        Ratio of the force in the easiest direction to the force in the most difficult direction, at
        least 1. Infinite if no force is possible in some direction.
    worst_direction : (2 M,)
        Most difficult direction according to the second moment of the forces. The length of this
        vector is a unit of force.
    weakest_force : float
        Maximum force of the library in its weakest direction [mu m g]. The value is a local
        minimum, because the search may miss a direction with a smaller force. The computation of
        this force neglects the ramps between rotations, the closure of the motion, and the limits
        of the rig.
    weakest_direction : (2 M,)
        Direction of `weakest_force`. The length of this vector is a unit of force.
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
        Positions of the parts, which are at rest [m, plate_home].
    library : Library, optional
        Rotations that the plate may use. Default: a grid of centres over the plate. If the distance
        of two parts is less than the spacing of the grid, the result indicates that they are hard
        to push independently.
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
    """Return the maximum force of the library [mu m g] in each of the D directions `direction` (D,
    2 M).

    The result neglects the ramps between rotations, the closure of the motion, and the limits of
    stroke, speed and acceleration. Directions must not be 0. Each direction is scaled to a unit of
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
    """Find the point at which the ray in the direction `direction` (2 M,) leaves the convex hull.
    Return the distance of this point from 0 as a multiple of the direction, and the normal of the
    hull's face at the point."""
    rows, count = columns.shape
    costs = np.full(rows, MISSING_FORCE_COST)
    plan = min_time(columns, direction, np.ones(count), costs)
    if np.max(np.abs(direction - columns @ plan.weights)) > 1e-6:
        return 0.0, plan.price
    return 1 / plan.cost, plan.price


def _nearest_face(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Search for the face of the convex hull with the minimum distance from 0. Return the distance
    and the direction. The result is a local minimum.

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
