"""Counts of parts that have left the plate, by side and by class."""

from __future__ import annotations

from collections import Counter

import numpy as np

from plate_core import Rig, part_class
from plate_core.tasks import Side

from .state import WorldState

OVER_EDGE_M = 0.03
"""A part that left the plate counts as having left over a side if its last position is at most this
distance inside the side at home [m]. The distance is necessary because the plate moves."""


def went_over(side: Side, position: np.ndarray, rig: Rig) -> np.ndarray:
    """Return for each part whether it left over the side (M,). `position` contains the positions at
    which the parts left (M, 2) [m, plate_home]."""
    sign = np.array([side.x, side.y])
    return np.asarray(np.any(sign * position > rig.plate.half - OVER_EDGE_M, axis=1))


class Departures:
    """Counts of the parts that left the plate. Parts that the hand or the robot removed are not
    counted.

    Parameters
    ----------
    rig : Rig
    chute : Side or None
        Side of the plate with the task's chute.

    Attributes
    ----------
    dropped : int
        Number of parts that did not leave over the chute, without the parts that are still in the
        state.
    chuted : Counter of str
        Number of parts that left over the chute, by class, without the parts that are still in the
        state.
    """

    def __init__(self, rig: Rig, chute: Side | None) -> None:
        self._rig, self._chute = rig, chute
        self.dropped, self.chuted = 0, Counter[str]()

    def count(self, state: WorldState, left: np.ndarray) -> tuple[int, Counter[str]]:
        """Count the parts of the mask `left` (M,). Return the number of parts that did not leave
        over the chute, and the numbers of parts that left over the chute, by class."""
        if self._chute is None:
            return int(np.count_nonzero(left)), Counter()
        over = went_over(self._chute, state.position, self._rig)
        labels = Counter(part_class(state.ids[k]) for k in np.flatnonzero(left & over))
        return int(np.count_nonzero(left & ~over)), labels

    def forget(self, state: WorldState, left: np.ndarray) -> None:
        """Add the parts of the mask `left` (M,) to the counts. Afterwards the caller removes them
        from the state."""
        dropped, chuted = self.count(state, left)
        self.dropped, self.chuted = self.dropped + dropped, self.chuted + chuted
