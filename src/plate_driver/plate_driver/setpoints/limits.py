"""Check of motions against the rig's limits of stroke, speed, acceleration, force and heat.
`scale_to_limits` scales a whole cycle down until it is within the limits. `check_setpoints` checks
the final motor setpoints and refuses setpoints beyond the limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import (
    CycleUsage,
    derivative,
    polynomial_peaks,
    quintic_pieces,
    usage,
)

TARGET = 0.999
"""Target usage of the worst limit by a scaled cycle [-]. The value is below 1 because of the errors
of the search and of rounding."""

CLOSE_ENOUGH = 0.99
"""Minimum usage of the worst limit at which the search for a scaling factor ends [-]."""

ROUNDS = 60
"""Maximum number of scaling factors that are tried. Most cycles need one or two factors. Even poses
of 1e100 m need only about ten factors."""

ROUNDING = 3e-6
"""Accepted relative violation of a limit. Computed peaks are up to 1e-6 too high, and the solvers
have rounding errors."""

HOME_TOLERANCE = 2e-5
"""Maximum deviation of a motor from home at the start and end of a table [m], per metre of distance
between the plate's centre and the farthest motor (at least 1 m). The tolerance of the speed [m/s]
is 100 times this value. Both tolerances are those of `PlateCycle.starts_at_rest`, converted to the
motors."""


@dataclass(frozen=True)
class ScaledCycle:
    """A cycle within the rig's limits, and its scaling.

    Attributes
    ----------
    cycle : PlateCycle
        The requested motion with all amplitudes multiplied by `factor`. The period is unchanged.
    factor : float
        1 if the requested cycle was within the limits.
    requested, usage : CycleUsage
        Usage of the limits by the requested cycle, and by the returned cycle.
    """

    cycle: PlateCycle
    factor: float
    requested: CycleUsage
    usage: CycleUsage

    @property
    def summary(self) -> str:
        """Text with the scaling factor and the requested peaks."""
        return (
            f"the cycle is scaled by {self.factor:.3g}, because its peaks are "
            f"{self.requested.overall:.3g} times the limits ({self.requested.stroke_m * 1e3:.3g} "
            f"mm, {self.requested.speed:.3g} m/s, {self.requested.accel:.3g} m/s2, "
            f"{self.requested.force:.3g} N)"
        )


def scale_to_limits(
    rig: Rig, cycle: PlateCycle, thermal_load: np.ndarray | float = 1.0
) -> ScaledCycle:
    """Scale a whole cycle down until it exceeds no limit of the rig.

    The cycle is scaled and not clipped. Friction forces depend on the direction of the surface's
    motion, and clipping the peaks would change this direction.

    Parameters
    ----------
    thermal_load : (4,) or float
        Allowed thermal load of the motors, see `usage`.

    Raises
    ------
    CycleError
        If the cycle's peaks are too large to compute, or the cycle exceeds the limits with every
        factor.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        requested = usage(rig, cycle, thermal_load)
        if not np.isfinite(requested.overall):
            raise CycleError(
                "plate_cycle: its speed or acceleration is too large to compute, "
                f"allowed: {limits_text(rig)}"
            )
        if requested.overall <= 1 + ROUNDING:
            return ScaledCycle(cycle, 1.0, requested, requested)
        return _find_scale(rig, cycle, requested, thermal_load)


def _find_scale(
    rig: Rig, cycle: PlateCycle, requested: CycleUsage, thermal_load: np.ndarray | float
) -> ScaledCycle:
    """Find the largest factor with which the cycle is within the limits.

    The peaks are not exactly proportional to the factor, because rotation adds a quadratic term.
    The search finds the root of log(worst/TARGET) as a function of log(factor), between a factor
    that is too large and a factor that fits. The search uses secant steps, and bisection in every
    third trial.
    """
    large, large_worst = 1.0, requested.overall
    small: ScaledCycle | None = None
    factor = TARGET / requested.overall
    for trial in range(ROUNDS):
        scaled = cycle.scaled(factor)
        used = usage(rig, scaled, thermal_load)
        if used.overall <= TARGET * (1 + ROUNDING):
            small = ScaledCycle(scaled, factor, requested, used)
            if used.overall >= CLOSE_ENOUGH or small.factor >= CLOSE_ENOUGH * large:
                return small
        else:
            large, large_worst = factor, used.overall
        factor = _next_factor(large, large_worst, small, secant=trial % 3 != 2)
    if small is None:
        raise CycleError(
            f"plate_cycle: its peaks are {requested.overall:.3g} times the rig's limits, and it "
            f"cannot be scaled, allowed: {limits_text(rig)}"
        )
    return small


def _next_factor(
    large: float, large_worst: float, small: ScaledCycle | None, secant: bool
) -> float:
    if small is None or small.usage.overall <= 0:
        return large * TARGET / large_worst * 0.999
    low, high = np.log(small.factor), np.log(large)
    if not secant:
        return float(np.exp((low + high) / 2))
    below, above = np.log(small.usage.overall / TARGET), np.log(large_worst / TARGET)
    # Choose a factor slightly below the root, so that the next trial is probably within the limits
    # and ends the search.
    fraction = -below / (above - below)
    return float(np.exp(low + fraction * (high - low)) * 0.998)


def excess_text(rig: Rig, used: CycleUsage, thermal_load: np.ndarray | float = 1.0) -> str:
    """Return a text with the name, value and allowed value of the limit that a motion exceeds by
    the largest factor.

    Parameters
    ----------
    thermal_load : (4,) or float
        Allowed thermal load of the motors, see `usage`.
    """
    limits, allowed = rig.limits, np.broadcast_to(thermal_load, 4)
    warmest = int(np.argmax(used.thermal_load / allowed))
    mean, max_force = limits.continuous_force * np.sqrt(
        [used.thermal_load[warmest], allowed[warmest]]
    )
    name, value, limit, unit = max(
        ("stroke", used.stroke_m, limits.stroke_m, "m"),
        ("speed", used.speed, limits.speed, "m/s"),
        ("acceleration", used.accel, limits.accel, "m/s2"),
        ("peak force", used.force, limits.force, "N"),
        ("mean force at the motors' temperature", mean, max_force, "N"),
        key=lambda row: row[1] / row[2],
    )
    return f"{name} is {value:.4g} {unit}, allowed: {limit:.4g} {unit}"


def check_setpoints(
    rig: Rig,
    times: np.ndarray,
    q: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
    start: tuple[np.ndarray, np.ndarray] | None = None,
) -> None:
    """Refuse motor setpoints that exceed the rig's limits or have wrong end states.

    This is the last check before setpoints are sent to the motors. The check is independent of the
    computation of the setpoints.

    Parameters
    ----------
    times : (k + 1,)
        Times of the setpoints [s], increasing from 0. A time can occur twice if its setpoints are
        equal.
    q, qd, qdd : (k + 1, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of the motors, with quintic interpolation.
    start : (4,) and (4,), optional
        Required initial travel [m] and speed [m/s]. Default: rest at home. The required final state
        is always rest at home.

    Raises
    ------
    CycleError
        If a check fails. The text states the motor, the value and the allowed value.
    """
    if not all(np.all(np.isfinite(values)) for values in (times, q, qd, qdd)):
        raise CycleError("motor setpoints: a value is not finite")
    once = np.append(True, np.diff(times) != 0)
    repeated = np.flatnonzero(~once)
    if any(np.any(values[repeated] != values[repeated - 1]) for values in (q, qd, qdd)):
        raise CycleError("motor setpoints: two setpoints for the same time differ")
    times, q, qd, qdd = times[once], q[once], qd[once], qdd[once]
    if times[0] != 0 or np.any(np.diff(times) < 0):
        raise CycleError("motor setpoints: times must start at 0 and increase")
    home = HOME_TOLERANCE * max(1.0, *(float(np.hypot(*motor.point)) for motor in rig.motors))
    travel, steps = quintic_pieces(times, q, qd, qdd), np.diff(times)
    first_q, first_qd = (0.0, 0.0) if start is None else start
    ends_q, ends_qd = np.abs([q[0] - first_q, q[-1]]), np.abs([qd[0] - first_qd, qd[-1]])
    where = "at rest" if start is None else "error at the start or at rest"
    peaks = polynomial_peaks(travel, steps, rig.limits.stroke_m)
    fast = polynomial_peaks(derivative(travel), steps, rig.limits.speed)
    for number, motor in enumerate(rig.motors):
        for quantity, unit, value, limit in (
            ("travel", "m", peaks[number], rig.limits.stroke_m),
            ("speed", "m/s", fast[number], rig.limits.speed),
            (f"travel {where}", "m", np.max(ends_q[:, number]), home),
            (f"speed {where}", "m/s", np.max(ends_qd[:, number]), 100 * home),
        ):
            if not value <= limit * (1 + ROUNDING):
                raise CycleError(
                    f"{motor.name}: {quantity} is {value:.6g} {unit}, allowed: {limit:g} {unit}"
                )


def limits_text(rig: Rig) -> str:
    """Return the rig's limits for a message."""
    return (
        f"{rig.limits.stroke_m * 1e3:g} mm of stroke, {rig.limits.speed:g} m/s, "
        f"{rig.limits.accel:g} m/s2, {rig.limits.force:g} N of force "
        f"({rig.limits.continuous_force:g} N continuously)"
    )
