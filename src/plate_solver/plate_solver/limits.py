"""How much of the rig's limits a sampled motion uses: the one check that both methods make.

In C++, as a search asks it at every step; `plate_core.motion.usage` says the same of a whole
cycle, and a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import PIECES
from plate_core.rig import motor_levers, motor_reach

from . import _kernels

MARGIN: float = _kernels.MARGIN
"""Fraction of the limits that a search uses: its samples may miss a peak by a little."""

HEADROOM = 1.1
"""Motors that could give so many times the acceleration that the rig file allows never lack force
nor get hot, so they are not looked at: the plate's spin takes up to 2 % more of them than
`motor_reach` counts, and heat up to 3 % more (test_motors.py, test_weak_motors.py)."""

CERTAIN: float = _kernels.CERTAIN
"""Fraction of the limits that a finished cycle uses at most, by its control points."""

EQUAL_WEIGHT = np.ones(1)
"""Weights of samples at equal steps."""


class Limits(NamedTuple):
    """The rig's limits, or a fraction of them, in the form that kernels take.

    Attributes
    ----------
    motors : (4, 2, 2)
        Where each pushes [m], and its direction.
    half : (2,)
        Half sides of the plate [m].
    stroke_m, speed, accel : float
        Of motors [m], [m/s], and of any point of the plate [m/s2].
    arm_m : float
        Length that turns theta into a travel of its usual effect: scales the parameters.
    levers : (4, 3)
        Travel of each motor by the pose, linearised at home.
    loads : (3, 4, 3)
        Force of each motor for pose, twist and acceleration, over its peak force.
    heat : float
        Peak force over continuous force.
    forceful : bool
        Whether motors may lack force or get hot where all else is within limits.
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
    def of(cls, rig: Rig, fraction: float = MARGIN) -> Limits:
        """Take a fraction of a rig's limits."""
        limits = rig.limits
        weak = motor_reach(rig).accel < HEADROOM * limits.accel
        return cls(
            np.array([[m.point, m.direction] for m in rig.motors], dtype=float),
            np.asarray(rig.plate.half, dtype=float),
            fraction * limits.stroke_m,
            fraction * limits.speed,
            fraction * limits.accel,
            float(np.hypot(*rig.plate.half)) * 0.6,
            motor_levers(rig),
            rig.motor_loads / (fraction * limits.force),
            limits.force / limits.continuous_force,
            rig.suspension is not None or weak,
        )


def limit_use(
    pose: np.ndarray, twist: np.ndarray, accel: np.ndarray, weight: np.ndarray, limits: Limits,
    linear: bool,
) -> float:  # fmt: skip
    """Return the greatest fraction of a limit that samples (n, 3) of a motion use.

    With the control points of a spline motion it is a bound, as in `plate_core.motion.usage`.
    Searches take it `linear` in theta, so that the scale of a motion far beyond the limits
    still counts.

    Parameters
    ----------
    weight : (m,)
        Time that each sample stands for, over and over again from the first to the last: for the
        motors' heat, as if the motion were played continuously.
    """
    return _kernels.limit_use(pose, twist, accel, weight, limits, linear)


def within_limits(
    cycle: PlateCycle, full: Limits, resting: Callable[[], PlateCycle] | None = None
) -> PlateCycle:
    """Return the cycle, brought nearer to another one of the same knots, which `resting` makes, as
    far as its control points exceed the full limits. Default: the cycle at rest."""
    used = _use(cycle, full)
    if used <= CERTAIN:
        return cycle
    rest = cycle.scaled(0.0) if resting is None else resting()
    least = _use(rest, full)
    if not least <= CERTAIN:
        raise CycleError(
            f"the plate takes {least:.3g} times its limits to rest from where the cycle begins, "
            f"allowed: {CERTAIN:g}"
        )
    for _ in range(4):  # turning enters with its square: nearly linear in the share
        share = max((0.9995 * CERTAIN - least) / (used - least), 0.0)
        times, *states = cycle.knots
        nearer = [b + share * (a - b) for a, b in zip(states, rest.knots[1:], strict=True)]
        cycle = PlateCycle.from_knots(times, *nearer)
        used = _use(cycle, full)
        if used <= CERTAIN:
            break
    return cycle


def _use(cycle: PlateCycle, full: Limits) -> float:
    """Return the greatest fraction of a limit that the control points of a motion use; its heat is
    that of the cycle, of both cycle and tail, or of the tail, with which the next one may begin:
    whichever is most."""
    used = 0.0
    both = cycle.parts
    for parts in (both,) if len(both) == 1 else (both[:1], both, both[1:]):
        pose, twist, accel = (
            np.vstack(
                [
                    *(part.control_points(order, PIECES) for part in parts),
                    parts[-1].state(-1)[order],  # the end need not be as the start
                ]
            )
            for order in range(3)
        )
        steps = np.repeat(np.concatenate([np.diff(part.times) for part in parts]), 5 * PIECES)
        share = np.append(steps, 0.0)
        share[5::5] += steps[::5]
        used = max(used, limit_use(pose, twist, accel, share, full, False))
    return used
