"""Time of the planner's answer if the camera is free-running, without ROS."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .estimation import SNAP

__all__ = ["AnswerSchedule"]


class AnswerSchedule:
    """Derives from the reported cycle starts when to answer: some time before the cycle ends.

    Parameters
    ----------
    answer_s : float
        Time before the end of a cycle at which it is answered [s].
    period : float
        Assumed length of a cycle until the first one is reported [s].
    """

    def __init__(self, answer_s: float, period: float) -> None:
        self._answer_s = answer_s
        self._begin, self._cycle = -np.inf, PlateCycle.rest(period)
        self._due = False

    def is_new(self, cycle: PlateCycle, begin: float) -> bool:
        """Record that the plate began a cycle at `begin` [s, the time of the stamps]. Return False
        if this start was recorded before: a repeated report must not delay the answer."""
        repeats = 0 <= begin - self._begin < SNAP * cycle.period
        if repeats and np.array_equal(cycle.knot_pose, self._cycle.knot_pose):
            return False
        self._begin, self._cycle = begin, cycle
        return True

    def wait_s(self, arrival: float) -> float:
        """Return the time from now until the answer [s], and expect this answer.

        `arrival` is the time at which the last start was reported [s, the time of the stamps].
        """
        self._due = True
        wait = max(self._cycle.period - self._answer_s, 0.0)
        return wait - max(arrival - self._begin, 0.0)

    def take_due(self) -> bool:
        """Return whether an answer was due, and expect no further one."""
        due, self._due = self._due, False
        return due
