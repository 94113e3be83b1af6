"""Detection of a second publisher on a topic, by the sequence numbers of the messages."""

from __future__ import annotations

from collections import deque

SEVERAL = 3
"""Number of out-of-order messages that indicate a second publisher. A restart of one publisher
causes only one."""

WITHIN_S = 3.0
"""Time within which `SEVERAL` out-of-order messages indicate a second publisher [s]."""

LOST, SILENCE_S = 5, 1.0
"""The first value is the maximum step between two sequence numbers of the accepted publisher [-].
The second is the time without its messages after which another publisher may replace it [s]."""


class Turns:
    """Checks whether the messages of one topic come from two publishers.

    The sequence numbers of one publisher increase. A number that is not greater than the last one
    therefore comes from another publisher.
    """

    def __init__(self) -> None:
        self._last = self._ours = -1
        self._ours_at = 0.0
        self._back = deque[float](maxlen=SEVERAL)

    def came(self, number: int | None, now: float) -> bool:
        """Record a message by its sequence number and its arrival time `now` [s].

        `number` is None if the middleware provides no sequence numbers.

        Returns whether the message comes from the accepted publisher. The publisher of the first
        message is accepted. Another publisher replaces it after it sent no messages for
        `SILENCE_S`.
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
        """Whether messages of two publishers arrived recently, at the time `now` [s]."""
        return len(self._back) == SEVERAL and now - self._back[0] < WITHIN_S
