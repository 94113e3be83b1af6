"""Conversion of a plate cycle to a motor table, which the driver sends to the motors. A periodic
motion that does not start at rest is faded in and out. The motion is scaled down to the rig's
limits if necessary, and corrected if the rig is calibrated. `plate_core.motion` converts the
plate's states at the knots to travel, speed and acceleration of the motors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import motor_state, usage

from .limits import ScaledCycle, check_setpoints, excess_text, scale_to_limits

PERIOD_S = (0.01, 10.0)
"""Allowed length of a table and of its tail [s]. One image is taken per table, so the image rate is
0.1 to 100 Hz."""

MAX_KNOTS = 2000
"""Maximum number of knots of one cycle. Processing more knots would take longer than the cycle
itself."""

RESTART_NS = 1_000_000_000
"""A stamp that is older than the last stamp by this time shows a restart of the simulator or the
camera [ns]."""

MIN_KNOTS = 48
"""Minimum number of knots per fade. With 48 knots and 8 harmonics, the error of the splines is 1e-5
of the pose and 2e-4 of the acceleration. Pose, twist and acceleration are continuous with any
number of knots."""

Correction = Callable[[PlateCycle], PlateCycle]
"""Linear map from the requested motion of the plate to the commanded motion."""


@dataclass(frozen=True)
class MotorTable:
    """Motor setpoints of a cycle. The motion begins at rest at home, or in the final state of
    another table's cycle. The motion ends at rest at home.

    A table with a tail is played once. At the end of its cycle, the next table starts if it begins
    in exactly the final state of the cycle. Otherwise the tail brings the plate to rest. A table
    without a tail begins and ends at rest, and can be repeated.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the image from which the cycle is derived.
    cycle : PlateCycle
        The plate's motion.
    q, qd, qdd : (k + 1, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of the motors at `times`, with quintic
        interpolation.
    until : float
        Time after which the table is too old to be sent [s, steady clock].
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
        _, *states = cycle.knots
        return cls(stamp_ns, cycle, *motor_state(rig, *states))

    @classmethod
    def rest(cls, rig: Rig, period: float, stamp_ns: int) -> MotorTable:
        """Return the table that keeps the plate at home."""
        return cls.of(rig, PlateCycle.rest(period), stamp_ns)

    @property
    def times(self) -> np.ndarray:
        """Times (k + 1,) of the knots [s]. If the table has a tail, the end time of the cycle
        occurs twice."""
        return self.cycle.knots[0]

    @property
    def length(self) -> float:
        """Duration [s] until the motors rest, if the table is played once and no other table
        follows."""
        return sum(part.period for part in self.cycle.parts)

    @property
    def tail(self) -> MotorTable | None:
        """Table that is played after the cycle if no other table follows. None if the cycle has no
        tail."""
        if self.cycle.tail is None:
            return None
        k = len(self.cycle.times)
        return replace(self, cycle=self.cycle.tail, q=self.q[k:], qd=self.qd[k:], qdd=self.qdd[k:])

    def check_age(self, now: float) -> None:
        """Check that the table may still be sent at `now` [s, steady clock].

        Raises
        ------
        CycleError
            If the table is too old to be sent.
        """
        if now > self.until:
            raise CycleError(f"the motor table was ready {now - self.until:.2f} s too late")


def plays(cycles: int, hold_s: float, period: float) -> int:
    """Return the number of plays of a table: at most `cycles`, with a total duration of at most
    `hold_s` [s], and at least 1."""
    return max(1, int(min(cycles, hold_s / period + 1e-9)))


def prepare(
    rig: Rig,
    cycle: PlateCycle,
    stamp_ns: int,
    repeats: int = 1,
    thermal_load: np.ndarray | float = 1.0,
    correction: Correction | None = None,
    before: Sequence[PlateCycle] = (),
) -> tuple[MotorTable, ScaledCycle]:
    """Convert a plate cycle to a motor table within the rig's limits.

    If a cycle from rest exceeds the limits, the whole cycle is scaled down with its tail. A cycle
    that begins in motion cannot be scaled, because it must begin in the final state of the previous
    cycle.

    Parameters
    ----------
    repeats : int
        See `add_fades`.
    thermal_load : (4,) or float
        Allowed thermal load of the motors, see `usage`.
    correction : callable, optional
        Correction by a calibration. The function keeps both the requested motion and the corrected
        command within the limits. If a cycle ends in motion, its correction would depend on the
        next cycle, which is unknown. Therefore such a cycle is played with its tail as one motion
        from rest to rest.
    before : sequence of PlateCycle, optional
        The cycles that may be playing, the oldest first. A cycle that begins in motion may continue
        any of these cycles. Default: the plate rests.

    Raises
    ------
    CycleError
        If the plate cannot execute the cycle. An error is also raised if the cycle begins in
        motion, and either exceeds a limit or does not continue a cycle of `before`.
    """
    if len(cycle.knots[0]) > MAX_KNOTS:
        count = len(cycle.knots[0])
        raise CycleError(f"plate_cycle: {count} knots, allowed: at most {MAX_KNOTS}")
    running = None
    if not (cycle.starts_at_rest or (cycle.tail is None and cycle.closes)):
        running = _find_continued_cycle(cycle, before, correction)
        playable = _start_at_end_of(cycle, running)
    elif cycle.tail is None:
        playable = add_fades(cycle, repeats)
    else:
        playable = cycle if correction is None else unspliced(cycle)
    lengths = [(cycle.period, "period"), (playable.period, "period")]
    if playable.tail is not None:
        lengths.append((playable.tail.period, "tail"))
    for length, name in lengths:
        if not PERIOD_S[0] <= length <= PERIOD_S[1]:
            fades = f" ({playable.period:g} s with fades)" if playable.period > cycle.period else ""
            value = f"{length:g} s" if name == "tail" else f"{cycle.period:g} s{fades}"
            raise CycleError(
                f"plate_cycle: {name} is {value}, allowed: {PERIOD_S[0]:g} to {PERIOD_S[1]:g} s"
            )
    scaled = scale_to_limits(rig, playable, thermal_load)
    if scaled.factor < 1 and not playable.starts_at_rest:
        raise CycleError(
            f"plate_cycle: {excess_text(rig, scaled.requested, thermal_load)}; the cycle begins in "
            "motion, so it cannot be scaled down. The plate comes to rest; cycles from rest can "
            "be scaled down"
        )
    command = scaled.cycle
    if correction is not None:
        command, scaled = _correct_command(rig, scaled, correction, thermal_load)
    made = MotorTable.of(rig, command, stamp_ns)
    start = None
    if running is not None:
        q, qd, _ = motor_state(rig, *running.state(-1)[:, None])
        start = q[0], qd[0]
    check_setpoints(rig, made.times, made.q, made.qd, made.qdd, start)
    return made, scaled


def _find_continued_cycle(
    cycle: PlateCycle, before: Sequence[PlateCycle], correction: Correction | None
) -> PlateCycle:
    """Return the newest cycle of `before` whose end state is the first state of a cycle that begins
    in motion.

    Raises
    ------
    CycleError
        If the cycle does not continue a cycle of `before`, or must not begin in motion.
    """
    if cycle.tail is None:
        raise CycleError(
            "plate_cycle: begins in motion and has no tail, allowed: a cycle that begins at rest, "
            "ends in its initial state, or has a tail"
        )
    if correction is not None:
        raise CycleError(
            "plate_cycle: begins in motion, but a calibration requires a cycle that begins at rest"
        )
    running = next((earlier for earlier in reversed(before) if cycle.follows(earlier)), None)
    if running is None:
        end = before[-1].state(-1) if before else np.zeros((3, 3))
        pose, twist, accel = np.max(np.abs(cycle.state(0) - end), axis=1)
        where = "the final state of the last cycle" if before else "rest"
        raise CycleError(
            f"plate_cycle: begins in motion, and its first state differs from {where} by "
            f"{pose:.3g} in pose [m, rad], {twist:.3g} in velocity [m/s, rad/s] and {accel:.3g} in "
            "acceleration [m/s2, rad/s2], allowed: the same state, or rest"
        )
    return running


def _start_at_end_of(cycle: PlateCycle, running: PlateCycle) -> PlateCycle:
    """Return a cycle with its first state replaced by the end state of `running`."""
    times, *states = cycle.knots
    exact = [
        np.concatenate([end[None], state[1:]])
        for end, state in zip(running.state(-1), states, strict=True)
    ]
    return PlateCycle.from_knots(times, *exact)


def unspliced(cycle: PlateCycle) -> PlateCycle:
    """Return a cycle from rest and its tail as one motion without a splice."""
    times, *states = cycle.knots
    once = np.append(True, np.diff(times) > 0)
    return PlateCycle.from_knots(times[once], *(state[once] for state in states))


def _correct_command(
    rig: Rig, scaled: ScaledCycle, correction: Correction, thermal_load: np.ndarray | float
) -> tuple[PlateCycle, ScaledCycle]:
    """Return the corrected command, and the requested motion of the plate. Both motions are scaled
    down until the command is also within the limits."""
    # Forces are not checked, because they depend on the actual motion and not on the command.
    moving = replace(rig.limits, force=np.inf, continuous_force=np.inf)
    shorter = scale_to_limits(
        replace(rig, limits=moving, suspension=None), correction(scaled.cycle)
    )
    if shorter.factor == 1:
        return shorter.cycle, scaled
    smaller = scaled.cycle.scaled(shorter.factor)
    used = usage(rig, smaller, thermal_load)
    return shorter.cycle, ScaledCycle(
        smaller, scaled.factor * shorter.factor, scaled.requested, used
    )


def check_order(last_ns: int | None, stamp_ns: int) -> None:
    """Refuse a cycle whose image is older than the image of the last accepted cycle.

    The same stamp is accepted again, because the sender may not have received the result. A larger
    step back, of more than a second, is accepted. A restart causes such a step, not a late message.

    Raises
    ------
    CycleError
        If the stamp is older than the last stamp. The text states both stamps.
    """
    if last_ns is not None and last_ns - RESTART_NS <= stamp_ns < last_ns:
        raise CycleError(
            f"plate_cycle: stamp is {stamp_ns / 1e9:.6f} s, which is older than the last, "
            f"{last_ns / 1e9:.6f} s, allowed: the same or newer"
        )


def add_fades(cycle: PlateCycle, repeats: int = 1) -> PlateCycle:
    """Return a motion that starts and ends at home, at rest.

    Parameters
    ----------
    cycle : PlateCycle
        A cycle that starts at rest is returned unchanged. Any other cycle is faded in over one
        period, played `repeats` times, and faded out over one period.
    repeats : int
        Number of plays between the fades, at least 1.
    """
    if cycle.starts_at_rest:
        return cycle
    times, pose, twist, accel = _fade_in(cycle)
    period = cycle.period
    # The fade-out is computed in three steps: reverse the cycle in time, compute the fade-in of the
    # result, and reverse the fade-in in time.
    back_times, back_pose, back_twist, back_accel = _fade_in(reverse_time(cycle))
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


def reverse_time(cycle: PlateCycle) -> PlateCycle:
    """Return the motion reversed in time."""
    return PlateCycle.from_knots(
        cycle.period - cycle.times[::-1],
        cycle.knot_pose[::-1],
        -cycle.knot_twist[::-1],
        cycle.knot_accel[::-1],
    )


def _fade_in(cycle: PlateCycle) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the knots of s(t/T) times the pose: times (n + 1,), and pose, twist, accel (n + 1, 3).

    s(u) = 10 u^3 - 15 u^4 + 6 u^5 rises from 0 to 1. The first two derivatives of s are 0 at both
    ends.
    """
    pieces = -(-MIN_KNOTS // (len(cycle.times) - 1))  # the quotient is rounded up
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
