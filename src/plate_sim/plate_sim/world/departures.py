"""Counts of parts that have left the plate, by side and by class."""

from __future__ import annotations

from collections import Counter

import numpy as np

from plate_core import Rig, part_class
from plate_core.tasks import Side

from .state import WorldState

OVER_EDGE_M = 0.03
"""A part counts as having left the plate over a side if it was outside this side, or at most this
distance inside it [m]. The side is that of the plate at home. The distance is necessary because the
plate moves."""


def left_over_side(side: Side, position: np.ndarray, rig: Rig) -> np.ndarray:
    """Return for each part that left the plate whether it left over the side `side` (M,).
    `position` (M, 2) [m, plate_home] contains the positions at which the parts left."""
    sign = np.array([side.x, side.y])
    return np.asarray(np.any(sign * position > rig.plate.half - OVER_EDGE_M, axis=1))


class Departures:
    """Counts the parts that leave the plate. Parts that the hand or the robot removes are not
    counted.

    Parameters
    ----------
    rig : Rig
    chute : Side or None
        Side of the plate at which the task's chute is located.

    Attributes
    ----------
    dropped : int
        Number of parts that left the plate but not over the chute. Parts that are still in the
        state are not counted.
    discharged : Counter of str
        Number of parts that left the plate over the chute, by class. Parts that are still in the
        state are not counted.
    """

    def __init__(self, rig: Rig, chute: Side | None) -> None:
        self._rig, self._chute = rig, chute
        self.dropped, self.discharged = 0, Counter[str]()

    def count(self, state: WorldState, left: np.ndarray) -> tuple[int, Counter[str]]:
        """Count those parts of the state for which the mask `left` (M,) is True. Return the number
        of parts that did not leave over the chute, and the numbers of parts that left over the
        chute, by class."""
        if self._chute is None:
            return int(np.count_nonzero(left)), Counter()
        over = left_over_side(self._chute, state.position, self._rig)
        labels = Counter(part_class(state.ids[k]) for k in np.flatnonzero(left & over))
        return int(np.count_nonzero(left & ~over)), labels

    def forget(self, state: WorldState, left: np.ndarray) -> None:
        """Add those parts of the state for which the mask `left` (M,) is True to the counts. The
        caller then removes these parts from the state."""
        dropped, discharged = self.count(state, left)
        self.dropped, self.discharged = self.dropped + dropped, self.discharged + discharged
