"""A process that stood still, and what waited meanwhile to be done.

Frozen, swapped out or held up, it finds on waking what others have asked of it long ago; who asked
has given up, or does something else by now.
"""

from __future__ import annotations

__all__ = ["Standstill"]

AFTER_S = 0.5
"""What comes so soon after a standstill was asked before its end [s]."""


class Standstill:
    """Notices standstills, if it is asked often.

    Parameters
    ----------
    longest_s : float
        A longer time between two looks is a standstill [s].
    now : float
        By the steady clock [s].
    """

    def __init__(self, longest_s: float, now: float) -> None:
        self.longest_s = longest_s
        self._looked, self._until = now, now

    def is_late(self, now: float) -> bool:
        """Look: whether what comes now may have waited for the end of a standstill."""
        if now - self._looked > self.longest_s:
            self._until = now + AFTER_S
        self._looked = now
        return now < self._until
