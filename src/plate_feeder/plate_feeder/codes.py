"""Codes in the replies of the feeder to a robot. Replies over ROS and over TCP contain the same
codes."""

from __future__ import annotations

from enum import IntEnum


class Code(IntEnum):
    """2xx: the command was executed. 4xx: the request must be changed. 5xx: the feeder cannot
    execute the request at present."""

    DONE = 200
    BAD_LINE = 400
    UNKNOWN_COMMAND = 404
    BUSY = 409
    NOT_RESERVED = 410
    BAD_ARGUMENT = 422
    TOO_MANY = 429
    CANCELED = 499
    FAULT = 500
    SILENT = 502
    STOPPED = 503
    NO_PART = 504
    HOPPER_EMPTY = 507
    NOT_PURGED = 508

    @property
    def done(self) -> bool:
        """Whether the code states that the request was fulfilled."""
        return self < 300
