"""Keep a motion within what the rig can do: scale it down as a whole, or refuse it."""

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
"""Fraction of the worst limit that a scaled cycle uses: the rest is for the search and rounding."""

CLOSE_ENOUGH = 0.99
"""A scaled cycle that uses this fraction or more of the worst limit is not scaled up again."""

ROUNDS = 60
"""Trials of a factor: most cycles need one or two, absurd ones (poses of 1e100 m) some ten."""

ROUNDING = 3e-6
"""Excess that is none: peaks come out up to 1e-6 too high, and solvers round too."""

HOME_TOLERANCE = 2e-5
"""How far a motor may be from home where a table begins and ends [m], for each metre from the
plate's centre to the farthest motor, at least one; the speed may be off by 100 times as much.
That is what `PlateCycle.starts_at_rest` allows, at the motors."""


@dataclass(frozen=True)
class Fit:
    """A cycle that the rig can follow, and how it came to be.

    Attributes
    ----------
    cycle : PlateCycle
        The motion asked for, all amplitudes times `factor`, in the same time.
    factor : float
        1 if the cycle was within the limits as it came.
    asked, usage : CycleUsage
        Peaks of the cycle as it came, and of the one returned.
    """

    cycle: PlateCycle
    factor: float
    asked: CycleUsage
    usage: CycleUsage

    @property
    def summary(self) -> str:
        """By how much it was scaled down, and why."""
        return (
            f"cycle scaled by {self.factor:.3g}: it used {self.asked.overall:.3g} times the limits "
            f"({self.asked.stroke_m * 1e3:.3g} mm, {self.asked.speed:.3g} m/s, "
            f"{self.asked.accel:.3g} m/s2, {self.asked.force:.3g} N)"
        )


def fit(rig: Rig, cycle: PlateCycle, thermal_load: np.ndarray | float = 1.0) -> Fit:
    """Scale a cycle down, as a whole, until no limit of the rig is exceeded.

    Scaling keeps the directions of the surface's motion, and those alone decide friction;
    clipping the peaks would make another motion with other forces.

    Parameters
    ----------
    thermal_load : (4,) or float
        What the motors may take, see `usage`.

    Raises
    ------
    CycleError
        If the cycle's peaks are too large to compute, or no factor makes it fit.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        asked = usage(rig, cycle, thermal_load)
        if not np.isfinite(asked.overall):
            raise CycleError(
                "plate_cycle: its speed or acceleration is too large to compute, "
                f"allowed: {limits_text(rig)}"
            )
        if asked.overall <= 1 + ROUNDING:
            return Fit(cycle, 1.0, asked, asked)
        return _scaled(rig, cycle, asked, thermal_load)


def _scaled(
    rig: Rig, cycle: PlateCycle, asked: CycleUsage, thermal_load: np.ndarray | float
) -> Fit:
    """Search the largest factor that fits.

    Peaks are not quite proportional to the factor (turning adds its square), so this is a search
    for the root of log(worst/TARGET) over log(factor), between a factor too large and one that
    fits: secant steps, halvings where those do not help.
    """
    large, large_worst = 1.0, asked.overall
    small: Fit | None = None
    factor = TARGET / asked.overall
    for trial in range(ROUNDS):
        scaled = cycle.scaled(factor)
        used = usage(rig, scaled, thermal_load)
        if used.overall <= TARGET * (1 + ROUNDING):
            small = Fit(scaled, factor, asked, used)
            if used.overall >= CLOSE_ENOUGH or small.factor >= CLOSE_ENOUGH * large:
                return small
        else:
            large, large_worst = factor, used.overall
        factor = _next_factor(large, large_worst, small, secant=trial % 3 != 2)
    if small is None:
        raise CycleError(
            f"plate_cycle: uses {asked.overall:.3g} times the rig's limits and cannot be scaled, "
            f"allowed: {limits_text(rig)}"
        )
    return small


def _next_factor(large: float, large_worst: float, small: Fit | None, secant: bool) -> float:
    if small is None or small.usage.overall <= 0:
        return large * TARGET / large_worst * 0.999
    low, high = np.log(small.factor), np.log(large)
    if not secant:
        return float(np.exp((low + high) / 2))
    below, above = np.log(small.usage.overall / TARGET), np.log(large_worst / TARGET)
    # A little below the root: the next trial then most likely fits, and ends the search.
    fraction = -below / (above - below)
    return float(np.exp(low + fraction * (high - low)) * 0.998)


def excess(rig: Rig, used: CycleUsage, thermal_load: np.ndarray | float = 1.0) -> str:
    """Say which limit a motion exceeds most: its name, its value and what is allowed.

    Parameters
    ----------
    thermal_load : (4,) or float
        What the motors may take, see `usage`.
    """
    limits, allowed = rig.limits, np.broadcast_to(thermal_load, 4)
    warmest = int(np.argmax(used.thermal_load / allowed))
    mean, most = limits.continuous_force * np.sqrt([used.thermal_load[warmest], allowed[warmest]])
    name, value, limit, unit = max(
        ("stroke", used.stroke_m, limits.stroke_m, "m"),
        ("speed", used.speed, limits.speed, "m/s"),
        ("acceleration", used.accel, limits.accel, "m/s2"),
        ("peak force", used.force, limits.force, "N"),
        ("mean force of motors so warm", mean, most, "N"),
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
    """Refuse motor setpoints beyond the rig's limits, or that begin or end elsewhere than allowed.

    The last look before the motors: it knows nothing of how the setpoints were made.

    Parameters
    ----------
    times : (k + 1,)
        [s], rising from 0; one may be given twice, with the same setpoints.
    q, qd, qdd : (k + 1, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of the motors; quintics between.
    start : (4,) and (4,), optional
        Travel [m] and speed [m/s] with which they must begin; missing: at rest at home, as they
        must end.

    Raises
    ------
    CycleError
        Naming the motor, its value and what is allowed.
    """
    if not all(np.all(np.isfinite(values)) for values in (times, q, qd, qdd)):
        raise CycleError("motor setpoints: a value is not finite")
    once = np.append(True, np.diff(times) != 0)
    again = np.flatnonzero(~once)
    if any(np.any(values[again] != values[again - 1]) for values in (q, qd, qdd)):
        raise CycleError("motor setpoints: those given twice for one time differ")
    times, q, qd, qdd = times[once], q[once], qd[once], qdd[once]
    if times[0] != 0 or np.any(np.diff(times) < 0):
        raise CycleError("motor setpoints: times must start at 0 and rise")
    home = HOME_TOLERANCE * max(1.0, *(float(np.hypot(*motor.point)) for motor in rig.motors))
    travel, steps = quintic_pieces(times, q, qd, qdd), np.diff(times)
    first_q, first_qd = (0.0, 0.0) if start is None else start
    ends_q, ends_qd = np.abs([q[0] - first_q, q[-1]]), np.abs([qd[0] - first_qd, qd[-1]])
    where = "at rest" if start is None else "off its start, or at rest,"
    far = polynomial_peaks(travel, steps, rig.limits.stroke_m)
    fast = polynomial_peaks(derivative(travel), steps, rig.limits.speed)
    for number, motor in enumerate(rig.motors):
        for what, unit, value, limit in (
            ("travel", "m", far[number], rig.limits.stroke_m),
            ("speed", "m/s", fast[number], rig.limits.speed),
            (f"travel {where}", "m", np.max(ends_q[:, number]), home),
            (f"speed {where}", "m/s", np.max(ends_qd[:, number]), 100 * home),
        ):
            if not value <= limit * (1 + ROUNDING):
                raise CycleError(
                    f"{motor.name}: {what} is {value:.6g} {unit}, allowed: {limit:g} {unit}"
                )


def limits_text(rig: Rig) -> str:
    """Return the rig's limits for a message."""
    return (
        f"{rig.limits.stroke_m * 1e3:g} mm of stroke, {rig.limits.speed:g} m/s, "
        f"{rig.limits.accel:g} m/s2, {rig.limits.force:g} N of force "
        f"({rig.limits.continuous_force:g} N continuously)"
    )
