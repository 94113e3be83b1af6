"""Counts of parts that have left the plate, by side and by class."""

from __future__ import annotations

from collections import Counter

import numpy as np

from plate_core import Rig, part_class
from plate_core.tasks import Side

from .state import WorldState

OVER_EDGE_M = 0.03
"""Maximum distance of a lost part from a side, inside the plate [m]. Within it, the part counts as
having left over this side. The distance is measured from the part's last position. The distance
covers the motion of the plate."""


def went_over(side: Side, position: np.ndarray, rig: Rig) -> np.ndarray:
    """Return whether parts that left at positions (M, 2) [m, plate_home] left over a side."""
    sign = np.array([side.x, side.y])
    return np.asarray(np.any(sign * position > rig.plate.half - OVER_EDGE_M, axis=1))


class Departures:
    """Counts of parts that left the plate. Parts that were removed by hand or by the robot are not
    counted.

    Parameters
    ----------
    rig : Rig
    chute : Side or None
        Side of the plate with the task's chute.

    Attributes
    ----------
    dropped : int
        Number of forgotten parts that did not leave over the chute.
    chuted : Counter of str
        Number of forgotten parts that left over the chute, by class.
    """

    def __init__(self, rig: Rig, chute: Side | None) -> None:
        self._rig, self._chute = rig, chute
        self.dropped, self.chuted = 0, Counter[str]()

    def count(self, state: WorldState, left: np.ndarray) -> tuple[int, Counter[str]]:
        """Return the number of parts of `left` (M,) bool that did not leave over the chute. Also
        return the numbers of parts that left over the chute, by class."""
        if self._chute is None:
            return int(np.count_nonzero(left)), Counter()
        over = went_over(self._chute, state.position, self._rig)
        labels = Counter(part_class(state.ids[k]) for k in np.flatnonzero(left & over))
        return int(np.count_nonzero(left & ~over)), labels

    def forget(self, state: WorldState, left: np.ndarray) -> None:
        """Add parts (M,) bool to the counts before they are forgotten."""
        dropped, chuted = self.count(state, left)
        self.dropped, self.chuted = self.dropped + dropped, self.chuted + chuted
