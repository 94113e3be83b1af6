"""Two publishers of one topic are told apart by the numbers of their messages."""

from __future__ import annotations

from collections import deque

SEVERAL = 3
"""Messages out of order that show a second publisher: one that was started again causes one."""

WITHIN_S = 3.0
"""Time in which these come [s]."""


class Turns:
    """Looks whether messages of one topic come from two publishers in turn.

    Each publisher numbers its own messages upwards, so a number that is not above the last one is
    of another publisher.
    """

    def __init__(self) -> None:
        self._last = self._ours = -1
        self._back = deque[float](maxlen=SEVERAL)

    def came(self, number: int | None, now: float) -> bool:
        """Take in a message's number, None where the middleware has none, and when it came [s].

        Returns whether it follows on another one of the publisher that was heard first, or of one
        that has taken its place: a single message of a stranger does not.
        """
        if number is None:
            return True
        if number <= self._last:
            self._back.append(now)
        follows = self._last < 0 or number - 1 in (self._ours, self._last)
        self._last = number
        if follows:
            self._ours = number
        return follows

    def several(self, now: float) -> bool:
        """Whether two publishers have taken turns just now [s]."""
        return len(self._back) == SEVERAL and now - self._back[0] < WITHIN_S
