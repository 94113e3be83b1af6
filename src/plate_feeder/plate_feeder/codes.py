"""Reply codes of the feeder: one table for ROS and TCP."""

from __future__ import annotations

from enum import IntEnum


class Code(IntEnum):
    """2xx: done. 4xx: the request must be changed. 5xx: the feeder cannot do it at present."""

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
        """Whether the request was fulfilled."""
        return self < 300


MEANINGS = {
    Code.DONE: "done; the rest of the line is the result",
    Code.BAD_LINE: "the line is too long, not complete in time, or not plain text",
    Code.UNKNOWN_COMMAND: "there is no such command",
    Code.BUSY: "another command waits, a part is reserved by another client, or the plate is "
    "being purged",
    Code.NOT_RESERVED: "the part is not reserved (any more)",
    Code.BAD_ARGUMENT: "an argument is wrong, or does not fit the recipe or the plate",
    Code.TOO_MANY: "too many clients, or too many commands wait",
    Code.CANCELED: "the command was canceled",
    Code.FAULT: "an error of the feeder itself: see its log",
    Code.SILENT: "the planner sends no status, or did not start in time",
    Code.STOPPED: "the plate was stopped, the task has failed, or the feeder is not active",
    Code.NO_PART: "no part was ready in time",
    Code.HOPPER_EMPTY: "no part is left, and the hopper is empty",
    Code.NOT_PURGED: "there is no chute, or parts are left after the time",
}
"""Meaning of each code, as in docs/guide/feeder.md."""
