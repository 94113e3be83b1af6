"""Two publishers of one topic are told apart by the numbers of their messages."""

from __future__ import annotations

from collections import deque

SEVERAL = 3
"""Messages out of order that show a second publisher: one that was started again causes one."""

WITHIN_S = 3.0
"""Time in which these come [s]."""

LOST, SILENCE_S = 5, 1.0
"""Of one publisher so many messages in a row may be lost; another one takes its place when it has
been silent for longer [s]."""


class Turns:
    """Looks whether messages of one topic come from two publishers in turn.

    Each publisher numbers its own messages upwards, so a number that is not above the last one is
    of another publisher.
    """

    def __init__(self) -> None:
        self._last = self._ours = -1
        self._ours_at = 0.0
        self._back = deque[float](maxlen=SEVERAL)

    def came(self, number: int | None, now: float) -> bool:
        """Take in a message's number, None where the middleware has none, and when it came [s].

        Returns whether it follows on those of the publisher that was heard first, or of one that
        took its place after a silence: what a stranger sends in between does not.
        """
        if number is None:
            return True
        if number <= self._last:
            self._back.append(now)
        replaced = number - 1 == self._last and now - self._ours_at > SILENCE_S
        follows = self._last < 0 or 0 < number - self._ours <= LOST or replaced
        self._last = number
        if follows:
            self._ours, self._ours_at = number, now
        return follows

    def several(self, now: float) -> bool:
        """Whether two publishers have taken turns just now [s]."""
        return len(self._back) == SEVERAL and now - self._back[0] < WITHIN_S
