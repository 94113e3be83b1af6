"""From a plate cycle to the motor table that is sent: faded in and out, and within the limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import motor_state, usage

from .limits import Fit, check_setpoints, fit

PERIOD_S = (0.01, 10.0)
"""Allowed length of a table [s]: one image is taken in each, so it is 0.1 to 100 Hz of sight."""

MAX_KNOTS = 2000
"""Knots of one cycle: more would take longer to work through than the cycle lasts."""

RESTART_NS = 1_000_000_000
"""A stamp this much older than the last means that the simulator or camera began anew [ns]."""

MIN_KNOTS = 48
"""Least knots per fade. With 48 and 8 harmonics the splines miss the exact fade by 1e-5 of the
pose and 2e-4 of the acceleration; pose, twist and acceleration stay continuous in any case."""

Correction = Callable[[PlateCycle], PlateCycle]
"""From the motion that the plate is to make to the one to command; linear."""


@dataclass(frozen=True)
class MotorTable:
    """What the motors do, from rest at home to rest at home.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the image it descends from.
    cycle : PlateCycle
        The plate's motion.
    q, qd, qdd : (k + 1, 4)
        Travel [m], speed and acceleration of the motors at `cycle.times`; quintic splines between.
    until : float
        From then on it is too old to be sent [s, steady clock].
    """

    stamp_ns: int
    cycle: PlateCycle
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    until: float = math.inf

    @classmethod
    def of(cls, rig: Rig, cycle: PlateCycle, stamp_ns: int) -> MotorTable:
        """Return the table of a plate cycle."""
        motors = motor_state(rig, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
        return cls(stamp_ns, cycle, *motors)

    @classmethod
    def rest(cls, rig: Rig, period: float, stamp_ns: int) -> MotorTable:
        """Return the table that keeps the plate at home."""
        return cls.of(rig, PlateCycle.rest(period), stamp_ns)

    def check_age(self, now: float) -> None:
        """Refuse to send it at `now` [s, steady clock] if it is too old.

        Raises
        ------
        CycleError
        """
        if now > self.until:
            raise CycleError(f"its motor table was {now - self.until:.2f} s too late to be sent")


def plays(cycles: int, hold_s: float, period: float) -> int:
    """Return how often a table is played, wanted `cycles` times, where `hold_s` [s] is the most."""
    return max(1, int(min(cycles, hold_s / period + 1e-9)))


def prepare(
    rig: Rig,
    cycle: PlateCycle,
    stamp_ns: int,
    repeats: int = 1,
    thermal_load: np.ndarray | float = 1.0,
    correction: Correction | None = None,
) -> tuple[MotorTable, Fit]:
    """Make the table that does what a plate cycle asks for, within the rig's limits.

    Parameters
    ----------
    repeats : int
        See `with_fades`.
    thermal_load : (4,) or float
        What the motors may take, see `usage`.
    correction : callable, optional
        What was learned of the plate. Wanted motion and command both keep the limits.

    Raises
    ------
    CycleError
        If the cycle is none that this plate could do.
    """
    if len(cycle.times) > MAX_KNOTS:
        raise CycleError(f"plate_cycle: {len(cycle.times)} knots, allowed: at most {MAX_KNOTS}")
    whole = with_fades(cycle, repeats)
    for period in (cycle.period, whole.period):
        if not PERIOD_S[0] <= period <= PERIOD_S[1]:
            fades = "" if whole is cycle else f" ({whole.period:g} s with fades)"
            raise CycleError(
                f"plate_cycle: period is {cycle.period:g} s{fades}, "
                f"allowed: {PERIOD_S[0]:g} to {PERIOD_S[1]:g} s"
            )
    fitted = fit(rig, whole, thermal_load)
    command = fitted.cycle
    if correction is not None:
        command, fitted = _corrected(rig, fitted, correction, thermal_load)
    made = MotorTable.of(rig, command, stamp_ns)
    check_setpoints(rig, command.times, made.q, made.qd, made.qdd)
    return made, fitted


def _corrected(
    rig: Rig, fitted: Fit, correction: Correction, thermal_load: np.ndarray | float
) -> tuple[PlateCycle, Fit]:
    """Return the command for a motion, both scaled until the command keeps the limits too."""
    # Motors carry what the plate does, not what it is commanded to do.
    moving = replace(rig.limits, force=np.inf, continuous_force=np.inf)
    shorter = fit(replace(rig, limits=moving, suspension=None), correction(fitted.cycle))
    if shorter.factor == 1:
        return shorter.cycle, fitted
    wanted = fitted.cycle.scaled(shorter.factor)
    used = usage(rig, wanted, thermal_load)
    return shorter.cycle, Fit(wanted, fitted.factor * shorter.factor, fitted.asked, used)


def check_order(last_ns: int | None, stamp_ns: int) -> None:
    """Refuse a cycle made from an older image than the last one accepted.

    The same stamp again is answered again: who asks twice has missed the answer. A step back by
    more than a second is a new beginning, not a late message.

    Raises
    ------
    CycleError
        Naming both stamps.
    """
    if last_ns is not None and last_ns - RESTART_NS <= stamp_ns < last_ns:
        raise CycleError(
            f"plate_cycle: stamp {stamp_ns / 1e9:.6f} s is older than the last, "
            f"{last_ns / 1e9:.6f} s, allowed: the same or newer"
        )


def with_fades(cycle: PlateCycle, repeats: int = 1) -> PlateCycle:
    """Return a motion that starts and ends at home, at rest.

    Parameters
    ----------
    cycle : PlateCycle
        Returned unchanged if it starts at rest. Any other is faded in over one period, played
        `repeats` times, and faded out over one, all in one table.
    repeats : int
        At least 1.
    """
    if cycle.starts_at_rest:
        return cycle
    times, pose, twist, accel = _faded_in(cycle)
    period = cycle.period
    # The fade out is the fade in of the motion played backwards, played backwards.
    back_times, back_pose, back_twist, back_accel = _faded_in(reversed_in_time(cycle))
    plays = [
        (
            (1 + i) * period + cycle.times[1:],
            cycle.knot_pose[1:],
            cycle.knot_twist[1:],
            cycle.knot_accel[1:],
        )
        for i in range(repeats)
    ]
    end = (2 + repeats) * period
    out = (end - back_times[-2::-1], back_pose[-2::-1], -back_twist[-2::-1], back_accel[-2::-1])
    parts = [(times, pose, twist, accel), *plays, out]
    return PlateCycle.from_knots(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def reversed_in_time(cycle: PlateCycle) -> PlateCycle:
    """Return the motion from its end to its start, in the same time."""
    return PlateCycle.from_knots(
        cycle.period - cycle.times[::-1],
        cycle.knot_pose[::-1],
        -cycle.knot_twist[::-1],
        cycle.knot_accel[::-1],
    )


def _faded_in(cycle: PlateCycle) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Knots of s(t/T) times the pose: times (n + 1,), pose, twist, accel (n + 1, 3).

    s(u) = 10 u^3 - 15 u^4 + 6 u^5 rises from 0 to 1 with no slope and no curvature at both ends.
    """
    pieces = -(-MIN_KNOTS // (len(cycle.times) - 1))  # rounded up
    steps = np.arange(pieces) / pieces
    times = (cycle.times[:-1, None] + np.diff(cycle.times)[:, None] * steps).ravel()
    times = np.append(times, cycle.period)
    pose, twist, accel = cycle.pose(times), cycle.twist(times), cycle.accel(times)
    u = (times / cycle.period)[:, None]
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds = 30 * u**2 * (1 - u) ** 2 / cycle.period
    dds = 60 * u * (1 - u) * (1 - 2 * u) / cycle.period**2
    return (
        times,
        s * pose,
        ds * pose + s * twist,
        dds * pose + 2 * ds * twist + s * accel,
    )
