"""What a node says of itself: the levels of its diagnostics, and when an input counts as gone.

The rules, for all nodes. All times are of the steady clock, and freshness is judged by when a
message came, never by its stamp.

- OK: it works.
- WARN: it works, but not as well as it should: some messages refused, bad light, cycles too late.
- STALE: an input has been silent for longer than its timeout, so what the node tells is old.
- ERROR: input comes but cannot be used, or the task failed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum

__all__ = [
    "INPUT_TIMEOUT_S",
    "MOST_AGE_S",
    "Finding",
    "Input",
    "Level",
    "age_limit",
    "used",
    "worst",
]

INPUT_TIMEOUT_S = 1.5
"""Silence of an input after which it counts as gone [s]: three of the longest usual cycles, and
short enough for a task to end within 2 s of the fault."""

LATENCY_S, MOST_AGE_S = 0.2, 0.6
"""What vision, planner and solver may take on a slow computer, and the greatest age of an image
that a moving cycle answers, unless a period is longer [s]."""


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


def age_limit(period: float) -> float:
    """Return how old the image may be that a moving cycle of this period [s] answers [s]."""
    return min(2 * period + LATENCY_S, max(MOST_AGE_S, period + LATENCY_S))


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


def used(what: str, count: int, refused: int, why: str) -> Finding | None:
    """Say that of `count` messages some were refused, and why the last was; None if none was."""
    if not refused:
        return None
    level = Level.ERROR if refused >= count else Level.WARN
    return Finding(level, f"{refused} of {count} {what} refused: {why}")
