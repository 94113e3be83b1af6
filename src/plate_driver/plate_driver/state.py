"""What the driver says of itself: one word first, then the reason and what to do; and how bad."""

from __future__ import annotations

from collections.abc import Sequence

from plate_core.status import Finding, Level

from .setpoints import Statistics
from .transports import Condition, Report

__all__ = ["LOOK", "OFF", "UNANSWERED", "driver_state", "health"]

READY, CALIBRATING = "ready", "calibrating"
EMERGENCY, CUT, DISABLED = "emergency stop", "power cut", "disabled"
"""What a person has asked for, as the latch keeps it."""

LOOK = "look at the rig, then call enable"
OFF = "disabled: the motors are off; call enable"
UNCERTAIN = "error: the last stop was not acknowledged: cut the power by hand"
"""What driver_state says until the device has been heard again."""

UNANSWERED = "the device does not answer: cut the power by hand"
"""What a stop says that nobody has acknowledged."""

MANY_RETRIES = 50
"""Messages repeated in a second beyond which the line is worth a warning."""


def driver_state(
    lifecycle: str,
    latch: str,
    report: Report | None,
    calibrating: bool,
    unanswered: bool = False,
) -> str:
    """Return what driver_state says.

    Parameters
    ----------
    lifecycle : str
        `unconfigured`, `inactive`, `active` or `finalized`.
    latch : str
        Why the driver lets no cycles through; empty: it does.
    report : Report or None
        What the motors do; None: no transport is open.
    calibrating : bool
    unanswered : bool
        Whether the last stop was not acknowledged.
    """
    condition = Condition.GONE if report is None else report.condition
    if unanswered and condition is Condition.GONE:
        return UNCERTAIN
    if lifecycle != "active" or report is None:
        if condition is Condition.BRAKING:
            return f"{lifecycle}: braking"
        return f"{lifecycle}: {latch}; {LOOK}" if latch in (EMERGENCY, CUT) else lifecycle
    if condition is Condition.GONE:
        return f"error: {report.reason or 'the device does not answer'}"
    if condition is Condition.BRAKING:
        return f"braking: {latch or report.reason or 'stopped'}"
    if condition is Condition.OFF:
        return _off(latch, report.reason)
    if condition is Condition.ENABLING:
        return "enabling: the plate goes home"
    if latch:
        return f"braking: {latch}"
    return CALIBRATING if calibrating else READY


def _off(latch: str, reason: str) -> str:
    if latch in (EMERGENCY, CUT):
        return f"stopped: {latch}; {LOOK}"
    if reason not in ("", "stopped"):
        return f"stopped: {reason}; {LOOK}"
    return OFF if latch or not reason else f"stopped: before this driver began; {LOOK}"


def health(
    state: str,
    statistics: Statistics,
    retries: int,
    quiet_s: float | None,
    lasting: Sequence[str] = (),
) -> Finding:
    """Return how well the driver is, and why.

    Parameters
    ----------
    state : str
        What driver_state says.
    statistics : Statistics
        Of the last second.
    retries : int
        Messages that were repeated in it.
    quiet_s : float or None
        Time for which no cycle came [s], if the plate rests because of that.
    lasting : sequence of str
        What is wrong until somebody changes it.
    """
    word = state.partition(":")[0]
    if word in ("error", "stopped"):
        return Finding(Level.ERROR, state)
    if word not in (READY, CALIBRATING):
        return Finding(Level.WARN, "; ".join([state, *lasting]))
    if quiet_s is not None:
        quiet = f"no plate_cycle for {quiet_s:.1f} s, the plate rests"
        return Finding(Level.STALE, "; ".join([quiet, *lasting]))
    problems = (*statistics.problems, *lasting)
    if retries > MANY_RETRIES:
        problems = (*problems, f"{retries} messages were repeated: the line is bad")
    if problems:
        return Finding(Level.WARN, ", ".join(problems))
    return Finding(Level.OK, "all cycles as asked")
