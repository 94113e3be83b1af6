"""What the driver says of itself: one word first, then the reason and what to do; and how bad."""

from __future__ import annotations

from enum import IntEnum

from .record import Record
from .transport import Condition, Report

READY, CALIBRATING = "ready", "calibrating"
EMERGENCY = "stopped: emergency stop; look at the rig, then call enable"
CUT = "stopped: power cut; look at the rig, then call enable"
DISABLED = "disabled: the motors are off; call enable"

UNANSWERED = "the device does not answer: cut the power by hand"
"""What a stop says that nobody has acknowledged."""

MANY_RETRIES = 50
"""Messages repeated in a second beyond which the line is worth a warning."""


class Level(IntEnum):
    """Of a diagnostic status."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def driver_state(lifecycle: str, latch: str, report: Report | None, calibrating: bool) -> str:
    """Return what driver_state says.

    Parameters
    ----------
    lifecycle : str
        `unconfigured`, `inactive`, `active` or `finalized`.
    latch : str
        Why the driver lets no cycles through; empty: it does.
    report : Report or None
        What the motors do; None: no transport is open.
    """
    if lifecycle != "active" or report is None:
        word, _, reason = latch.partition(": ")
        return f"{lifecycle}: {reason}" if word == "stopped" else lifecycle
    if report.condition is Condition.GONE:
        return f"error: {report.reason or 'the device does not answer'}"
    if report.condition is Condition.BRAKING:
        return f"braking: {latch.partition(': ')[2] or report.reason or 'stopped'}"
    if report.condition is Condition.OFF:
        return _off(latch, report.reason)
    if report.condition is Condition.ENABLING:
        return "enabling: the plate goes home"
    if latch:
        return "braking: the device has not acknowledged the stop"
    return CALIBRATING if calibrating else READY


def _off(latch: str, reason: str) -> str:
    if latch.startswith("stopped") or reason in ("", "stopped"):
        if latch:
            return latch
        if not reason:
            return DISABLED
        return "stopped: before this driver began; look at the rig, then call enable"
    return f"stopped: {reason}; look at the rig, then call enable"


def health(state: str, record: Record, retries: int, quiet_s: float | None) -> tuple[Level, str]:
    """Return how well the driver is, and why.

    Parameters
    ----------
    state : str
        What driver_state says.
    record : Record
        Of the last second.
    retries : int
        Messages that were repeated in it.
    quiet_s : float or None
        Time for which no cycle came [s], if the plate rests because of that.
    """
    word = state.partition(":")[0]
    if word in ("error", "stopped"):
        return Level.ERROR, state
    if word not in (READY, CALIBRATING):
        return Level.WARN, state
    if quiet_s is not None:
        return Level.STALE, f"no plate_cycle for {quiet_s:.1f} s, the plate rests"
    troubles = record.troubles
    if retries > MANY_RETRIES:
        troubles = (*troubles, f"{retries} messages were repeated: the line is bad")
    if troubles:
        return Level.WARN, ", ".join(troubles)
    return Level.OK, "all cycles as asked"
