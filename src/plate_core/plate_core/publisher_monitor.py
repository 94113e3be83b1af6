"""Detection of a second publisher on a topic, by the sequence numbers of the messages."""

from __future__ import annotations

from collections import deque

SEVERAL = 3
"""Number of out-of-order messages that indicate a second publisher. A restart of one publisher
causes only one out-of-order message."""

WITHIN_S = 3.0
"""Time within which `SEVERAL` out-of-order messages indicate a second publisher [s]."""

LOST = 5
"""Maximum difference between two successive sequence numbers of the accepted publisher [-]."""
TIMEOUT_S = 1.0
"""Time without messages of the accepted publisher after which another publisher may replace it
[s]."""


class PublisherMonitor:
    """Detector of a second publisher on one topic.

    The sequence numbers of one publisher increase. If a number is not greater than the last number,
    there is another publisher, or the publisher has restarted.
    """

    def __init__(self) -> None:
        self._last = self._accepted = -1
        self._accepted_at = 0.0
        self._back = deque[float](maxlen=SEVERAL)

    def accepts(self, number: int | None, now: float) -> bool:
        """Record a message by its sequence number and its arrival time `now` [s].

        `number` is None if the middleware provides no sequence numbers.

        Return whether the message comes from the accepted publisher. At first, this is the
        publisher of the first message. If the accepted publisher sends no messages for `TIMEOUT_S`,
        another publisher replaces it.
        """
        if number is None:
            return True
        if number <= self._last:
            self._back.append(now)
        replaced = number - 1 == self._last and now - self._accepted_at > TIMEOUT_S
        follows = self._last < 0 or 0 < number - self._accepted <= LOST or replaced
        self._last = number
        if follows:
            self._accepted, self._accepted_at = number, now
        return follows

    def has_two(self, now: float) -> bool:
        """Whether messages of two publishers arrived recently, at the time `now` [s]."""
        return len(self._back) == SEVERAL and now - self._back[0] < WITHIN_S
