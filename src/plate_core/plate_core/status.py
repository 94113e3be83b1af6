"""What a node says of itself: the levels of its diagnostics, and when an input counts as gone.

The rules, for all nodes. All times are of the steady clock, and freshness is judged by when a
message came, never by its stamp.

- OK: it works.
- WARN: it works, but not as well as it should: some messages refused, bad light, cycles too late.
- STALE: an input has been silent for longer than its timeout, so what the node tells is old.
- ERROR: input comes but cannot be used, or the task failed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum

__all__ = [
    "BACKLOG_S",
    "COMPILING",
    "INPUT_TIMEOUT_S",
    "STANDSTILL_S",
    "Finding",
    "Input",
    "Level",
    "Standstill",
    "standstill_limit",
    "used",
    "worst",
]

INPUT_TIMEOUT_S = 1.5
"""Silence of an input after which it counts as gone [s]: three of the longest usual cycles, and
short enough for a task to end within 2 s of the fault."""

STANDSTILL_S = 0.5
"""A process that does not run for longer stood still [s]: two of the longest usual cycles."""

BACKLOG_S = 0.6
"""Time after a standstill in which what had come meanwhile is handed out [s]."""

COMPILING = "compiling kernels"
"""What a node does that cannot answer yet, in words."""


class Level(IntEnum):
    """As in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @property
    def rank(self) -> int:
        """How bad it is: an error asks for more than silence does."""
        return (Level.OK, Level.WARN, Level.STALE, Level.ERROR).index(self)


@dataclass(frozen=True)
class Finding:
    """A level, and the one line that says why."""

    level: Level
    message: str


def worst(findings: Iterable[Finding | None], otherwise: str) -> Finding:
    """Put findings together: the worst level, and all messages, those of the worst first.

    Parameters
    ----------
    findings : iterable of Finding or None
        None where there is nothing to tell.
    otherwise : str
        What is said if there are none.
    """
    found = sorted((f for f in findings if f is not None), key=lambda f: -f.level.rank)
    if not found:
        return Finding(Level.OK, otherwise)
    return Finding(found[0].level, "; ".join(finding.message for finding in found))


@dataclass(frozen=True)
class Input:
    """What a node listens to.

    Attributes
    ----------
    what, topic : str
        What comes, and where: `image`, `image_raw`.
    question : str
        What to look at if nothing comes: `does the camera run?`
    timeout_s : float
        Longest silence [s].
    since : float
        When the node began to listen [s, steady clock].
    came : float or None
        When the last message came.
    """

    what: str
    topic: str
    question: str
    timeout_s: float
    since: float
    came: float | None = None

    def heard(self, now: float) -> Input:
        """Return it with a message that has come now."""
        return replace(self, came=now)

    def silence(self, now: float) -> float:
        """For how long nothing has come [s]."""
        return now - (self.since if self.came is None else self.came)

    def gone(self, now: float) -> Finding | None:
        """Say that it is silent for too long; None if it is not."""
        silence = self.silence(now)
        if silence <= self.timeout_s:
            return None
        how_long = f"for {silence:.1f} s" if self.came is not None else "yet"
        message = f"no {self.what} {how_long} on {self.topic}: {self.question}"
        return Finding(Level.STALE, message)


@dataclass(frozen=True)
class Standstill:
    """Whether this process has stood still: it was frozen, or the machine slept or was too busy.

    What came meanwhile looks fresh when the process runs again, but is old: the plate has come to
    rest, and the task may have ended. So for a moment nothing that comes may move the plate.

    Attributes
    ----------
    ran : float
        When the process ran last [s, steady clock].
    limit_s : float
        It stood still if it did not run for longer [s].
    over : float
        When the last standstill ended.
    length_s : float
        How long that was [s].
    """

    ran: float
    limit_s: float = STANDSTILL_S
    over: float = -math.inf
    length_s: float = 0.0

    def running(self, now: float) -> Standstill:
        """Return it after a look at the clock: to be called often, every 0.1 s or so."""
        away = now - self.ran
        if away > self.limit_s:
            return replace(self, ran=now, over=now, length_s=away)
        return replace(self, ran=now)

    def reason(self, who: str) -> str:
        """Say why what comes now is not used; "" if it may be."""
        if self.ran - self.over > BACKLOG_S:
            return ""
        return f"the {who} itself stood still for {self.length_s:.1f} s"


def standstill_limit(input_timeout_s: float) -> float:
    """Return `Standstill.limit_s` [s] of a node whose inputs have this timeout [s]: `STANDSTILL_S`
    of the usual one, and longer where time is simulated and nothing is late."""
    return input_timeout_s * STANDSTILL_S / INPUT_TIMEOUT_S


def used(what: str, count: int, refused: int, why: str) -> Finding | None:
    """Say that of `count` messages some were refused, and why the last was; None if none was."""
    if not refused:
        return None
    level = Level.ERROR if refused >= count else Level.WARN
    return Finding(level, f"{refused} of {count} {what} refused: {why}")
