"""Determines when the planner publishes its next request to the solver if the camera is
free-running. This module does not use ROS.

One request is due per cycle, `answer_s` before the cycle ends. The inputs are the cycle starts that
the driver reports. The output is the time until the next request.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .estimation import SNAP

__all__ = ["RequestSchedule"]


class RequestSchedule:
    """Computes the time of the planner's next request to the solver from the reported cycle starts.

    Parameters
    ----------
    answer_s : float
        Time by which a request must precede the end of the running cycle [s].
    period : float
        Length of a cycle [s] that is assumed until a cycle start is reported.
    """

    def __init__(self, answer_s: float, period: float) -> None:
        self._answer_s = answer_s
        self._begin, self._cycle = -np.inf, PlateCycle.rest(period)
        self._due = False

    def record_start(self, cycle: PlateCycle, begin: float) -> bool:
        """Record that the plate began a cycle at the time `begin` [s, in the time of the image
        stamps].

        Return True if this report of a cycle start is new. A repeated report must not delay the
        request. A report counts as repeated if its cycle has the same knots as the cycle of the
        last report, and if 0 <= begin - last begin < SNAP T. T is the length of the cycle.
        """
        repeats = 0 <= begin - self._begin < SNAP * cycle.period
        if repeats and np.array_equal(cycle.knot_pose, self._cycle.knot_pose):
            return False
        self._begin, self._cycle = begin, cycle
        return True

    def wait_s(self, arrival: float) -> float:
        """Mark a request as pending. Return the time until the request must be published [s]. The
        time is zero or negative if the request is already late.

        `arrival` is the arrival time of the last report [s, in the time of the image stamps]. With
        the length T of the cycle and its start `begin`, the result is max(T - answer_s, 0) -
        max(arrival - begin, 0).
        """
        self._due = True
        wait = max(self._cycle.period - self._answer_s, 0.0)
        return wait - max(arrival - self._begin, 0.0)

    def take_due(self) -> bool:
        """Return whether a request is pending. After this call, no request is pending."""
        due, self._due = self._due, False
        return due
