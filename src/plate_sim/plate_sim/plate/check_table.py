"""Check of motor tables by the simulated device. A table is refused if its start state is wrong, if
it exceeds a limit of the rig, or if its length is not allowed."""

from __future__ import annotations

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import CycleUsage, usage

SLACK = 1.02
"""Maximum value in an accepted motor table, as a fraction of the rig's limit. The fraction is above
1, because the computed peaks of a table are upper bounds that are up to 1 % too high."""

PERIOD = (0.01, 10.0)
"""Allowed range of the length of a motor table [s]. The simulator takes one image per table."""


def check_table(rig: Rig, cycle: PlateCycle, running: PlateCycle) -> CycleUsage:
    """Check a motor table, and return its peak values.

    Raises
    ------
    CycleError
        If the table exceeds a limit, or is too short or too long. Also if the table starts neither
        at rest at home nor in the end state of the running table.
    """
    if not PERIOD[0] <= cycle.period <= PERIOD[1]:
        raise CycleError(f"period is {cycle.period:g} s, allowed: {PERIOD[0]:g} to {PERIOD[1]:g} s")
    if not (cycle.starts_at_rest or cycle.follows(running)):
        raise CycleError(
            "table begins away from home or in motion, or arrived too late, allowed: a start at "
            "rest at home, or in the end state of the running table"
        )
    peaks = usage(rig, cycle)
    if not peaks.worst <= SLACK:
        raise CycleError(
            f"peaks of the table are {1e3 * peaks.stroke_m:.4g} mm, {peaks.speed:.4g} m/s and "
            f"{peaks.accel:.4g} m/s2, allowed: {1e3 * rig.limits.stroke_m:g} mm, "
            f"{rig.limits.speed:g} m/s and {rig.limits.accel:g} m/s2"
        )
    tail = cycle.tail
    if tail is not None and not PERIOD[0] <= tail.period <= PERIOD[1]:
        raise CycleError(f"tail is {tail.period:g} s, allowed: {PERIOD[0]:g} to {PERIOD[1]:g} s")
    return peaks
