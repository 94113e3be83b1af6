"""What the driver says of itself: what the motors do, why, and what to do; and how bad it is."""

from __future__ import annotations

from collections.abc import Sequence

from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.status import Finding, Level

from .setpoints import Statistics
from .transports import Condition, Latch, Report

__all__ = ["AT_REST", "LOOK", "OFF", "UNANSWERED", "driver_status", "health"]

PERSONS = (DriverReason.EMERGENCY_STOP, DriverReason.POWER_CUT)
"""Stops by a person who saw a danger."""

LOOK = "look at the rig, then call enable"
OFF = "disabled: the motors are off; call enable"
UNCERTAIN = "error: the last stop was not acknowledged: cut the power by hand"
"""What is said until the device has been heard again."""

UNANSWERED = "the device does not answer: cut the power by hand"
"""What a stop says that nobody has acknowledged."""

AT_REST = "the plate rests: no task runs"

MANY_RETRIES = 50
"""Messages repeated in a second beyond which the line is worth a warning."""


def driver_status(
    active: bool, latch: Latch, report: Report | None, calibrating: bool
) -> DriverStatus:
    """Return what the motors do, and why they are not ready.

    Parameters
    ----------
    active : bool
        Whether the lifecycle node is.
    latch : Latch
        Why the driver lets no cycles through.
    report : Report or None
        What the motors do; None: no transport is open, the node is not configured.
    calibrating : bool
    """

    def status(
        state: DriverState, text: str, reason: DriverReason = DriverReason.NONE
    ) -> DriverStatus:
        return DriverStatus(state, reason, text, latch.enabled_ns)

    asked = latch.reason
    condition = Condition.GONE if report is None else report.condition
    if latch.unanswered and condition is Condition.GONE:
        return status(DriverState.ERROR, UNCERTAIN, DriverReason.STOP_UNANSWERED)
    known = Report(condition) if report is None else report
    # Ready, with the latch closed: it has not noticed the stop yet, or the enable is not over.
    stopping = condition is Condition.READY and bool(asked) and not latch.enabling
    if condition is Condition.BRAKING or (active and stopping):
        why = asked or known.reason
        text = f"braking: {asked.words if asked else known.text or 'stopped'}"
        return status(DriverState.BRAKING, text, why)
    if report is None or not active:
        state = DriverState.UNCONFIGURED if report is None else DriverState.INACTIVE
        text = state.name.lower()
        if asked in PERSONS:
            return status(state, f"{text}: {asked.words}; {LOOK}", asked)
        return status(state, text)
    if condition is Condition.GONE:
        return status(DriverState.ERROR, f"error: {known.text}", known.reason)
    if condition is Condition.OFF:
        if asked in PERSONS:
            return status(DriverState.STOPPED, f"stopped: {asked.words}; {LOOK}", asked)
        if known.reason not in (DriverReason.NONE, DriverReason.EARLIER_STOP):
            return status(DriverState.STOPPED, f"stopped: {known.text}; {LOOK}", known.reason)
        if asked or not known.reason:
            return status(DriverState.DISABLED, OFF, asked)
        text = f"stopped: while this driver was not connected; {LOOK}"
        return status(DriverState.STOPPED, text, known.reason)
    if condition is Condition.ENABLING or latch.enabling:
        return status(DriverState.ENABLING, "enabling: the plate goes home")
    if calibrating:
        return status(DriverState.CALIBRATING, "calibrating")
    return status(DriverState.READY, "ready")


def health(
    status: DriverStatus,
    statistics: Statistics,
    retries: int,
    quiet_s: float | None,
    task: bool,
    lasting: Sequence[str] = (),
    unplayed: str = "",
) -> Finding:
    """Return how well the driver is, and why.

    Parameters
    ----------
    status : DriverStatus
    statistics : Statistics
        Of the last second.
    retries : int
        Messages that were repeated in this second.
    quiet_s : float or None
        Time since the last cycle [s], if the plate rests for lack of cycles; otherwise None.
    task : bool
        Whether a task runs. Without a task rest is normal.
    lasting : sequence of str
        Faults that last until somebody corrects them.
    unplayed : str
        Why the motors have not played any sent cycle for long; otherwise empty.
    """
    if status.state in (DriverState.ERROR, DriverState.STOPPED):
        return Finding(Level.ERROR, status.text)
    if status.state not in (DriverState.READY, DriverState.CALIBRATING):
        return Finding(Level.WARN, "; ".join([status.text, *lasting]))
    if quiet_s is not None and task:
        quiet = f"no plate_cycle for {quiet_s:.1f} s, the plate rests"
        return Finding(Level.STALE, "; ".join([quiet, *lasting]))
    if unplayed:
        return Finding(Level.STALE, "; ".join([unplayed, *lasting]))
    problems = (*statistics.problems, *lasting)
    if retries > MANY_RETRIES:
        problems = (*problems, f"{retries} messages were repeated: the line is bad")
    if problems:
        return Finding(Level.WARN, ", ".join(problems))
    return Finding(Level.OK, "all cycles as requested" if quiet_s is None else AT_REST)
