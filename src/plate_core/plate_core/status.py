"""Diagnostics of a node: levels, and input timeouts.

The following levels apply to all nodes. All times are times of the steady clock. The age of a
message is measured from its arrival, never from its stamp.

- OK: the node works without faults.
- WARN: the node works with a fault, for example poor light, late cycles, or some refused messages.
- STALE: an input has timed out, so the node's output is old.
- ERROR: the node receives input but cannot use it, or the task failed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import IntEnum

__all__ = [
    "INPUT_TIMEOUT_S",
    "MAX_AGE_S",
    "Finding",
    "Input",
    "Level",
    "age_limit",
    "combined",
    "used",
]

INPUT_TIMEOUT_S = 1.5
"""Default input timeout [s]. The timeout is three times the longest usual cycle. A task with this
timeout ends within 2 s after a fault."""

LATENCY_S = 0.2
"""Maximum computation time of vision, planner and solver on a slow computer [s]."""
MAX_AGE_S = 0.6
"""Maximum age of the image from which a short cycle is computed [s]. `age_limit` applies it."""


class Level(IntEnum):
    """Level of a node's diagnostics, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @property
    def rank(self) -> int:
        """Severity, 0 to 3. ERROR is more severe than STALE."""
        return (Level.OK, Level.WARN, Level.STALE, Level.ERROR).index(self)


@dataclass(frozen=True)
class Finding:
    """A level, and its reason as one line of text."""

    level: Level
    message: str


def age_limit(period: float) -> float:
    """Return the maximum age [s] of an image. If the image is older, no moving cycle with this
    period [s] is computed from it."""
    return min(2 * period + LATENCY_S, max(MAX_AGE_S, period + LATENCY_S))


def combined(findings: Iterable[Finding | None], otherwise: str) -> Finding:
    """Combine several findings into one. The result has the most severe level, and all messages in
    order of severity.

    Parameters
    ----------
    findings : iterable of Finding or None
        Elements that are None are ignored.
    otherwise : str
        Message with the level OK if there are no findings.
    """
    found = sorted((f for f in findings if f is not None), key=lambda f: -f.level.rank)
    if not found:
        return Finding(Level.OK, otherwise)
    return Finding(found[0].level, "; ".join(finding.message for finding in found))


@dataclass(frozen=True)
class Input:
    """An input of a node, and the arrival time of its last message.

    Attributes
    ----------
    what, topic : str
        Name of the data and its topic, such as `image` and `image_raw`.
    advice : str
        Advice for the user if no message arrives, such as `check that the camera runs`.
    timeout_s : float
        Maximum time without a message [s].
    since : float
        Time of the subscription [s, steady clock].
    arrival : float or None
        Arrival time of the last message [s, steady clock]. None if no message has arrived.
    """

    what: str
    topic: str
    advice: str
    timeout_s: float
    since: float
    arrival: float | None = None

    def received(self, now: float) -> Input:
        """Return a copy of the input that records a message at the time `now` [s]."""
        return replace(self, arrival=now)

    def age(self, now: float) -> float:
        """Time since the last message, or since the subscription if no message has arrived [s]."""
        return now - (self.since if self.arrival is None else self.arrival)

    def timeout_finding(self, now: float) -> Finding | None:
        """Return a STALE finding if the input has timed out, otherwise None."""
        age = self.age(now)
        if age <= self.timeout_s:
            return None
        how_long = f"for {age:.1f} s" if self.arrival is not None else "yet"
        message = f"no {self.what} {how_long} on {self.topic}; {self.advice}"
        return Finding(Level.STALE, message)


def used(what: str, count: int, refused: int, why: str) -> Finding | None:
    """Return a finding on refused messages: `refused` of `count` messages were refused, the last
    one for the reason `why`.

    The level is ERROR if all messages were refused, otherwise WARN. Return None if no message was
    refused.
    """
    if not refused:
        return None
    level = Level.ERROR if refused >= count else Level.WARN
    return Finding(level, f"{refused} of {count} {what} refused: {why}")
