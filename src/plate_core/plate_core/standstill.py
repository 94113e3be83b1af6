"""Detection of process stalls.

A process that was frozen, swapped out or blocked finds old requests in its queues when it resumes.
Their senders may have given up, so these requests must be refused. A stall is detected when two
successive calls of `Standstill.is_late` are too far apart in time.
"""

from __future__ import annotations

__all__ = ["Standstill"]

AFTER_S = 0.5
"""Time after a stall [s]. A request that is received within this time may have been sent during the
stall."""


class Standstill:
    """Stall detector. It works only if `is_late` is called regularly.

    Parameters
    ----------
    longest_s : float
        Maximum time between two calls [s]. A longer time is a stall.
    now : float
        Current time of the steady clock [s].
    """

    def __init__(self, longest_s: float, now: float) -> None:
        self.longest_s = longest_s
        self._checked, self._until = now, now

    def is_late(self, now: float) -> bool:
        """Update the detector. Return whether a request received at `now` [s] may be an old one
        that waited during a stall."""
        if now - self._checked > self.longest_s:
            self._until = now + AFTER_S
        self._checked = now
        return now < self._until
