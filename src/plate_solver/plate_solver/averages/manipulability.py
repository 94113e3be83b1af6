"""What a plate can do with parts where they are (section 3.3 of the paper).

The average forces on parts at rest are a mean of unit forces, one column of a library for each
twist that the plate goes through. Instead of piping random motions through the force map, we look
at all columns at once:

- their second moment is how far random motions reach: the root of its greatest over its least
  eigenvalue is the condition number, the least eigenvector the direction that is hardest to push;
- their convex hull is what any mix of them does. The force of the library in a direction is how far
  the hull reaches that way: 1 over the least time in which a linear programme does a unit of it.

That force is no promise, and no bound from below on what a real cycle gives: time for ramps,
closure of the motion, and the limits of stroke, speed and acceleration are left out, and so is how
far parts move within a cycle. Nor is it quite a bound from above: rotations between those of the
library add some per cent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateError, Rig

from ..library import Library, least_time
from ..library.condition import columns_of, second_moment, unit

DEAR = 1e6
"""Price of a unit of force that is missed [cycles / (mu m g)]: what costs that is out of reach."""

DESCENTS = 12
"""Steps from one face of the hull to a nearer one, at most."""

STARTS = 8
"""Random directions from which the nearest face is looked for, besides the hardest one."""


@dataclass(frozen=True)
class Manipulability:
    """How well parts can be pushed one by one, M parts.

    Forces on all parts are one vector (2 M,): part 1 x, part 1 y, part 2 x, ... A unit of force has
    a mean square over the parts of one (mu m g)^2.

    Attributes
    ----------
    condition : float
        How much easier the easiest direction is than the hardest: 1 at best; infinite where some
        direction is out of reach.
    worst_direction : (2 M,)
        Direction of the hardest force, by the second moment; a unit of force.
    weakest_force : float
        Force [mu m g] of the library in the direction where it is least, of those looked at: the
        search for it may miss a weaker one. Ramps, closure and limits are left out.
    weakest_direction : (2 M,)
        That direction; a unit of force.
    """

    condition: float
    worst_direction: np.ndarray
    weakest_force: float
    weakest_direction: np.ndarray


def manipulability(
    rig: Rig, position: np.ndarray, library: Library | None = None, seed: int = 0
) -> Manipulability:
    """Tell how well parts at given places can be pushed one by one.

    Parameters
    ----------
    rig : Rig
    position : (M, 2)
        Parts at rest [m], plate_home.
    library : Library, optional
        Rotations that the plate may do; a grid of centres over the plate if left out. Two parts
        that are nearer to each other than its centres are hard to tell apart.
    seed : int
        Of the directions from which the weakest is looked for.
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
    """Return the greatest force [mu m g] in each direction (D, 2 M) that the library can give.

    Ramps between rotations, closure, and the limits of stroke, speed and acceleration are left out.

    Directions of any length, not zero, are meant as a unit of force; see `Manipulability`.
    """
    columns = columns_of(rig, position, library)
    direction = np.atleast_2d(np.asarray(direction, dtype=float))
    if direction.shape[1] != len(columns) or not np.all(np.any(direction, axis=1)):
        raise PlateError(
            f"direction has shape {direction.shape}, allowed: (D, {len(columns)}), not zero"
        )
    return np.array([_force_along(columns, unit(row))[0] for row in direction])


def _force_along(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Return how many times a direction (2 M,) lies in the hull, and the face's normal there."""
    rows, count = columns.shape
    dear = np.full(rows, DEAR)
    plan = least_time(columns, direction, np.ones(count), dear, dear)
    if np.max(np.abs(plan.miss)) > 1e-6:
        return 0.0, plan.price
    return 1 / plan.cost, plan.price


def _nearest_face(columns: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """Go from face to face of the hull, each time along the last one's normal: ever nearer."""
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
