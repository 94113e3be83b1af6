"""Utilisation of the rig's limits by a sampled motion (1: exactly at the limit).

The plate has the position c, the rotation matrix R and the spin w. When the plate is at home, a
motor acts at the point p in the direction e. The vector r is a corner of the plate, rotated by R.
The motor has the force f, a linear function of pose, twist and acceleration. The utilisation is the
maximum of these ratios over all samples, motors and corners:

    travel        abs(e . (c + R p - p)) / stroke
    speed         abs(e . (c' + w x R p)) / speed limit
    acceleration  length of (c'' + w' x r - w^2 r) / acceleration limit
    force         abs(f) / peak force, with the motor's force f per pose, twist and acceleration
    heat          root mean square of f / continuous force

The solvers of both methods (rotations and sinusoids) use this module. The check is implemented in
C++, because a search calls it at every step. `plate_core.motion.usage` does the same check for a
whole cycle. A test compares the two results.

The solvers use these fractions of the limits. The limits of a search are `SEARCH_USE` times the
limits of the rig.

    name          value   limits     meaning
    CYCLE_USE     0.999   rig        maximum utilisation of a finished cycle, by control points
    SEARCH_USE    0.98    rig        maximum utilisation at the samples of a search's result
    PENALTY_USE   0.95    search     sinusoids: a higher utilisation counts as an error
    DESCENT_USE   1.3     search     sinusoids: maximum utilisation in the descents from all starts
    FINAL_USE     1       search     sinusoids: maximum utilisation in the final corrections
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import PIECES

from . import _kernels

SEARCH_USE: float = _kernels.SEARCH_USE
"""Fraction of the rig's limits that a search may use. The fraction is below 1 because the samples
of a search may slightly miss a peak."""

HEADROOM = 1.1
"""If the motors can accelerate the plate by at least this factor times the acceleration limit in
the rig file, the force and the heat of the motors are not checked. The factor covers two errors of
`motor_reach`. Because of the plate's spin, the peak force can be 2 % higher than `motor_reach`
assumes (test_motors.py). The RMS force, which determines the heat, can be 3 % higher than
`motor_reach` assumes (test_weak_motors.py)."""

CYCLE_USE: float = _kernels.CYCLE_USE
"""Largest permitted utilisation of any rig limit by a finished cycle (1: exactly at the limit). The
utilisation is computed from the control points of the cycle."""

EQUAL_WEIGHT = np.ones(1)
"""Argument `weight` of `limit_use` for samples with equal time steps."""


class Limits(NamedTuple):
    """The rig's limits, or a fraction of them, in the form that the C++ kernels use.

    Attributes
    ----------
    motors : (4, 2, 2)
        Point of application [m] and direction of each motor.
    half : (2,)
        Half side lengths of the plate [m].
    stroke_m, speed, accel : float
        Limits of the motors' stroke [m] and speed [m/s], and of the acceleration of any point of
        the plate [m/s2].
    arm_m : float
        Characteristic length that converts theta to a displacement. The searches use this length to
        scale the parameters of a motion.
    levers : (4, 3)
        Derivative of each motor's travel [m] with respect to the pose [m, m, rad], at home.
    loads : (3, 4, 3)
        Force of each motor per unit of pose, of twist and of acceleration, divided by the motor's
        peak force.
    heat : float
        Peak force divided by continuous force.
    forceful : bool
        Whether force or heat of the motors can limit a motion. If False, force and heat are not
        checked.
    """

    motors: np.ndarray
    half: np.ndarray
    stroke_m: float
    speed: float
    accel: float
    arm_m: float
    levers: np.ndarray
    loads: np.ndarray
    heat: float
    forceful: bool

    @classmethod
    def of(cls, rig: Rig, fraction: float = SEARCH_USE) -> Limits:
        """Return the limits of a rig, multiplied by `fraction`."""
        limits = rig.limits
        weak = rig.motor_reach.accel < HEADROOM * limits.accel
        return cls(
            np.array([[m.point, m.direction] for m in rig.motors], dtype=float),
            np.asarray(rig.plate.half, dtype=float),
            fraction * limits.stroke_m,
            fraction * limits.speed,
            fraction * limits.accel,
            float(np.hypot(*rig.plate.half)) * 0.6,
            rig.motor_levers,
            rig.motor_loads / (fraction * limits.force),
            limits.force / limits.continuous_force,
            rig.suspension is not None or weak,
        )


def limit_use(
    pose: np.ndarray, twist: np.ndarray, accel: np.ndarray, weight: np.ndarray, limits: Limits,
    linear: bool,
) -> float:  # fmt: skip
    """Return the largest utilisation of any rig limit by samples (n, 3) of a motion. 1 means that
    the motion is exactly at the limit.

    With the control points of a spline motion, the result is an upper bound, as in
    `plate_core.motion.usage`. With `linear`, the motors' travel and the corners' positions are
    linearised in theta. Searches set `linear`. The result then grows with the amplitude, even if a
    motion is far beyond the limits.

    Parameters
    ----------
    weight : (m,)
        Duration represented by each sample, for the motors' heat. The weights repeat after m
        samples. The motion is assumed to repeat continuously.
    """
    return float(limit_uses(pose[None], twist[None], accel[None], weight, limits, linear)[0])


def limit_uses(
    pose: np.ndarray, twist: np.ndarray, accel: np.ndarray, weight: np.ndarray, limits: Limits,
    linear: bool,
) -> np.ndarray:  # fmt: skip
    """Return the result of `limit_use` (N,) for each of N motions. The samples have the shape (N,
    n, 3)."""
    return _kernels.limit_use(pose, twist, accel, weight, limits, linear)


def within_limits(
    cycle: PlateCycle, full: Limits, resting: Callable[[], PlateCycle] | None = None
) -> PlateCycle:
    """Return a cycle whose control points are within the full limits.

    A cycle that exceeds the limits is interpolated towards the cycle that `resting` returns. Both
    cycles have the same knot times. Without `resting`, the cycle is interpolated towards rest,
    which scales the cycle down.
    """
    used = _use(cycle, full)
    if used <= CYCLE_USE:
        return cycle
    rest = cycle.scaled(0.0) if resting is None else resting()
    rest_use = _use(rest, full)
    if not rest_use <= CYCLE_USE:
        raise CycleError(
            "the plate cannot stop within the rig's limits from its state at the cycle's start: "
            f"fraction of the limits that the stop uses is {rest_use:.3g}, allowed: 0 to "
            f"{CYCLE_USE:g}"
        )
    # four rounds suffice, because the utilisation of the limits is nearly linear in `fraction`
    for _ in range(4):
        fraction = max((0.9995 * CYCLE_USE - rest_use) / (used - rest_use), 0.0)
        times, *states = cycle.knots
        nearer = [b + fraction * (a - b) for a, b in zip(states, rest.knots[1:], strict=True)]
        cycle = PlateCycle.from_knots(times, *nearer)
        used = _use(cycle, full)
        if used <= CYCLE_USE:
            break
    return cycle


def _use(cycle: PlateCycle, full: Limits) -> float:
    """Return the largest utilisation of any rig limit by a cycle's control points. 1 means that the
    cycle is exactly at the limit.

    The heat of the motors is computed for the cycle, for the cycle with its tail, and for the tail
    only. The function returns the largest of the three values. The tail has a separate value
    because the next cycle may begin with the tail.
    """
    used = 0.0
    both = cycle.parts
    for parts in (both,) if len(both) == 1 else (both[:1], both, both[1:]):
        pose, twist, accel = (
            np.vstack(
                [
                    *(part.control_points(order, PIECES) for part in parts),
                    # the state at the end may differ from the state at the start
                    parts[-1].state(-1)[order],
                ]
            )
            for order in range(3)
        )
        steps = np.repeat(np.concatenate([np.diff(part.times) for part in parts]), 5 * PIECES)
        durations = np.append(steps, 0.0)
        durations[5::5] += steps[::5]
        used = max(used, limit_use(pose, twist, accel, durations, full, False))
    return used
