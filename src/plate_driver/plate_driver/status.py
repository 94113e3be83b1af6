"""Content of `driver_status` and of the driver's diagnostics. The inputs are the latch, the report
of the transport and the statistics. The outputs are the state of the motors, its reason, the
recommended action and a severity level."""

from __future__ import annotations

from collections.abc import Sequence

from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.status import Finding, Level

from .setpoints import Statistics
from .transports import Condition, Latch, Report

__all__ = ["AT_REST", "CHECK_RIG", "OFF", "UNANSWERED", "driver_status", "health"]

PERSONS = (DriverReason.EMERGENCY_STOP, DriverReason.POWER_CUT)
"""Reasons of stops that a person has requested because of a danger."""

CHECK_RIG = "look at the rig, then call enable"
OFF = "disabled: the motors are off; call enable"
UNCERTAIN = "error: the last stop was not acknowledged; cut the power by hand"
"""Text of the status after a stop that the device has not acknowledged. This text remains until a
message of the device arrives again."""

UNANSWERED = "the device does not answer: cut the power by hand"
"""Reply to a stop that the device has not acknowledged."""

AT_REST = "the plate rests: no task runs"

MANY_RETRIES = 50
"""Number of repeated messages per second above which a warning about the line is given."""


def driver_status(
    active: bool, latch: Latch, report: Report | None, calibrating: bool
) -> DriverStatus:
    """Return the state of the motors and, if they are not ready, the reason.

    Parameters
    ----------
    active : bool
        Whether the lifecycle node is active.
    latch : Latch
        Latch that blocks cycles after a stop, and stores the reason of the stop.
    report : Report or None
        Report of the transport. None if no transport is open, because the node is not configured.
    calibrating : bool
    """

    def status(
        state: DriverState, text: str, reason: DriverReason = DriverReason.NONE
    ) -> DriverStatus:
        return DriverStatus(state, reason, text, latch.enabled_ns)

    requested = latch.reason
    condition = Condition.GONE if report is None else report.condition
    if latch.unanswered and condition is Condition.GONE:
        return status(DriverState.ERROR, UNCERTAIN, DriverReason.STOP_UNANSWERED)
    current = Report(condition) if report is None else report
    # The motors can be ready although a stop is active. In this case, the transport has not
    # processed the stop yet, or an enable is still in progress.
    stopping = condition is Condition.READY and bool(requested) and not latch.enabling
    if condition is Condition.BRAKING or (active and stopping):
        why = requested or current.reason
        text = f"braking: {requested.text if requested else current.text or 'stopped'}"
        return status(DriverState.BRAKING, text, why)
    if report is None or not active:
        state = DriverState.UNCONFIGURED if report is None else DriverState.INACTIVE
        text = state.name.lower()
        if requested in PERSONS:
            return status(state, f"{text}: {requested.text}; {CHECK_RIG}", requested)
        return status(state, text)
    if condition is Condition.GONE:
        return status(DriverState.ERROR, f"error: {current.text}", current.reason)
    if condition is Condition.OFF:
        if requested in PERSONS:
            return status(DriverState.STOPPED, f"stopped: {requested.text}; {CHECK_RIG}", requested)
        if current.reason not in (DriverReason.NONE, DriverReason.EARLIER_STOP):
            return status(
                DriverState.STOPPED, f"stopped: {current.text}; {CHECK_RIG}", current.reason
            )
        if requested or not current.reason:
            return status(DriverState.DISABLED, OFF, requested)
        text = f"stopped while this driver was not connected; {CHECK_RIG}"
        return status(DriverState.STOPPED, text, current.reason)
    if condition is Condition.ENABLING or latch.enabling:
        return status(DriverState.ENABLING, "enabling: the plate moves to home")
    if calibrating:
        return status(DriverState.CALIBRATING, "calibrating")
    return status(DriverState.READY, "ready")


def health(
    status: DriverStatus,
    statistics: Statistics,
    retries: int,
    idle_s: float | None,
    task: bool,
    lasting: Sequence[str] = (),
    unplayed: str = "",
) -> Finding:
    """Return the severity level of the driver's state, and its reason.

    Parameters
    ----------
    status : DriverStatus
    statistics : Statistics
        Statistics of the last second.
    retries : int
        Number of messages that were repeated in the last second.
    idle_s : float or None
        Time since the last cycle [s] if the plate rests because no cycle arrives, otherwise None.
    task : bool
        Whether a task runs. If no task runs, no warning is given about a plate at rest.
    lasting : sequence of str
        Faults that persist until a person corrects them.
    unplayed : str
        Reason why the motors have not played a sent cycle for a long time. Empty if they play.
    """
    if status.state in (DriverState.ERROR, DriverState.STOPPED):
        return Finding(Level.ERROR, status.text)
    if status.state not in (DriverState.READY, DriverState.CALIBRATING):
        return Finding(Level.WARN, "; ".join([status.text, *lasting]))
    if idle_s is not None and task:
        text = f"no plate_cycle for {idle_s:.1f} s, the plate rests"
        return Finding(Level.STALE, "; ".join([text, *lasting]))
    if unplayed:
        return Finding(Level.STALE, "; ".join([unplayed, *lasting]))
    problems = (*statistics.problems, *lasting)
    if retries > MANY_RETRIES:
        problems = (*problems, f"{retries} messages were repeated, so the serial line is bad")
    if problems:
        return Finding(Level.WARN, ", ".join(problems))
    return Finding(Level.OK, "all cycles as requested" if idle_s is None else AT_REST)
