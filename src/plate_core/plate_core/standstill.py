"""Detection of process stalls.

A process that was frozen, swapped out or blocked finds old requests in its queues when it resumes.
The senders of these requests may have given up, so the process must refuse the requests. A stall is
detected when the time between two successive calls of `Standstill.is_late` is too long.
"""

from __future__ import annotations

__all__ = ["Standstill"]

AFTER_S = 0.5
"""A request that is received within this time after a stall may have been sent during the stall
[s]."""


class Standstill:
    """Stall detector. The detector works only if `is_late` is called regularly.

    Parameters
    ----------
    max_s : float
        Maximum time between two calls of `is_late` [s]. A longer time counts as a stall.
    now : float
        Current time of the steady clock [s].
    """

    def __init__(self, max_s: float, now: float) -> None:
        self.max_s = max_s
        self._checked, self._until = now, now

    def is_late(self, now: float) -> bool:
        """Update the detector. Return whether a request that is received at `now` [s] may have
        waited during a stall."""
        if now - self._checked > self.max_s:
            self._until = now + AFTER_S
        self._checked = now
        return now < self._until
