"""What kind of request it is: all that a solver asks of its numbers, in one pass."""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

import numpy as np
from numba import njit

FARTHEST_M = 1e3
"""Places of parts [m] beyond this are mistakes."""

FASTEST_MPS = 1e3
"""Velocities of parts [m/s] beyond this are mistakes."""


class Traits(NamedTuple):
    """What kind of request it is, found in one pass.

    Attributes
    ----------
    sound : bool
        Whether all values are allowed.
    moving, curled, slack : bool
        Whether parts move, curls are asked for, forces have a tolerance.
    within : bool
        Whether no force is within all tolerances.
    loaded : float
        Force [mu m g] asked of the most loaded part, all its slack used.
    """

    sound: bool
    moving: bool
    curled: bool
    slack: bool
    within: bool
    loaded: float


@njit(cache=True)
def find_traits(
    position: np.ndarray,
    force: np.ndarray,
    velocity: np.ndarray,
    curl: np.ndarray,
    tolerance: np.ndarray,
) -> tuple[bool, bool, bool, bool, bool, float]:
    """Return the `Traits` of a request."""
    sound = within = True
    moving = curled = slack = False
    loaded = 0.0
    for i in range(len(force)):
        curled |= not np.isnan(curl[i])
        sound &= not np.isinf(curl[i])
        least = 0.0
        for axis in range(2):
            wanted, free = abs(force[i, axis]), tolerance[i, axis]
            sound &= abs(position[i, axis]) <= FARTHEST_M
            sound &= abs(velocity[i, axis]) <= FASTEST_MPS
            sound &= wanted < np.inf and free >= 0
            moving |= velocity[i, axis] != 0
            slack |= free != 0
            within &= wanted <= free
            least = hypot(least, max(wanted - free, 0.0))
        loaded = max(loaded, least)
    return sound, moving, curled, slack, within, loaded
