"""Which motor tables the device refuses to play."""

from __future__ import annotations

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import CycleUsage, usage

SLACK = 1.02
"""Share of a limit at which a table is refused: its peaks are bounds, up to 1 % too high."""

PERIOD = (0.01, 10.0)
"""Allowed length of a table [s]: one image is taken in each."""


def check_table(rig: Rig, cycle: PlateCycle, running: PlateCycle) -> CycleUsage:
    """Return a table's use of the rig's limits.

    Raises
    ------
    CycleError
        If it starts neither at rest at home nor as the running one ends, exceeds a limit, or is too
        short or too long.
    """
    if not PERIOD[0] <= cycle.period <= PERIOD[1]:
        raise CycleError(f"period is {cycle.period:g} s, allowed: {PERIOD[0]:g} to {PERIOD[1]:g} s")
    if not (cycle.starts_at_rest or cycle.follows(running)):
        raise CycleError(
            "table begins off home or moving, or came too late, allowed: at rest at home, or as "
            "the running one ends"
        )
    peaks = usage(rig, cycle)
    if not peaks.worst <= SLACK:
        raise CycleError(
            f"table needs {1e3 * peaks.stroke_m:.4g} mm, {peaks.speed:.4g} m/s and "
            f"{peaks.accel:.4g} m/s2, allowed: {1e3 * rig.limits.stroke_m:g} mm, "
            f"{rig.limits.speed:g} m/s and {rig.limits.accel:g} m/s2"
        )
    tail = cycle.tail
    if tail is not None and not PERIOD[0] <= tail.period <= PERIOD[1]:
        raise CycleError(f"tail is {tail.period:g} s, allowed: {PERIOD[0]:g} to {PERIOD[1]:g} s")
    return peaks
