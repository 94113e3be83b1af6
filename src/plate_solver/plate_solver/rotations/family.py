"""Sequences of rotations as a parametrised family of motions.

The parameters are the durations and twists of the rotations. The family computes the sampled
motion, its derivatives with respect to the parameters, the violations of limits, and the finished
cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import PlateCycle

from .. import _kernels
from ..limits import Limits
from .sequence import knot_poses, motion

RAMP_STEPS = 8
"""Number of time steps per ramp during a search. A ramp is the transition from one rotation to the
next."""

MIN_STEPS = 6
"""Minimum number of time steps per hold during a search. A hold is the phase in which a rotation
has a constant twist."""

HOLD_STEP = 1e-3
"""Length of a time step in a hold that has the mean length of all holds [s]."""

RAMP_PART = 0.95
"""Fraction of the acceleration limit that ramps may use. The remaining acceleration is for the
correction that closes the motion."""

UNLIMITED_M = 1e9
"""Stroke limit that disables the check of the stroke [m]."""


class Sequences(NamedTuple):
    """Data of `RotationFamily` for J rotations, in the form that the C++ kernels use.

    Attributes
    ----------
    basis : (J, F, 3)
        Twist j is the product of its F parameters and basis j.
    hold_scale : float
        Relative duration of a rotation whose duration parameter is 1.
    period, accel : float
        Length of the cycle [s] and peak acceleration of ramps [m/s2].
    loads : (m, 3)
        Limits of the motors' forces. Each row, multiplied by a plate acceleration, must not exceed
        the acceleration limit `accel`. Without a check of the forces, the array is empty.
    steps : (int, int)
        Number of steps in each ramp, and number of steps in each hold.
    limits : Limits
        Limits of the rig. The stroke is `UNLIMITED_M` if it is not checked.
    """

    basis: np.ndarray
    hold_scale: float
    period: float
    accel: float
    loads: np.ndarray
    steps: tuple[int, int]
    limits: Limits


Line = tuple[np.ndarray, np.ndarray]
Moved = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def line_of(theta: np.ndarray, family: Sequences) -> Line:
    """Return the knot times and the twists at the knots. The module `sequence` describes the
    knots."""
    return _kernels.line_of(theta, family)


def runnable(theta: np.ndarray, family: Sequences) -> tuple[np.ndarray, Line, Moved]:
    """Make the parameters admissible. Return the admissible parameters, and the knots and samples
    of the motion. Admissible parameters have positive durations and a motion within the limits."""
    return _kernels.runnable(theta, family)


class RotationFamily:
    """Sequences of J rotations in a given order.

    The parameters are the J + 1 relative durations in units of 1/J, and the three components of
    each twist in units of the usual speed. The last duration is the rest at the end. In a search, a
    violation of the stroke limit adds a penalty to the errors. If `within_stroke` is set, all
    admissible parameters keep the stroke limit.
    """

    def __init__(
        self,
        twists: np.ndarray,
        limits: Limits,
        period: float,
        speed: float,
        steps: tuple[int, int] | None = None,
        within_stroke: bool = False,
    ) -> None:
        self._limits = limits
        self.period = period
        # the last parameters, with the knots and samples of their motion
        self._known: tuple[np.ndarray, Line, Moved] | None = None
        # factors that convert x, y and theta to lengths [m]
        self._lengths = np.array([1.0, 1.0, limits.arm_m])
        hold_steps = max(MIN_STEPS, round(period / len(twists) / HOLD_STEP))
        stroke = limits.stroke_m if within_stroke else UNLIMITED_M
        self.plain = Sequences(
            np.repeat(np.diag(speed / self._lengths)[None], len(twists), axis=0),
            1 / len(twists),
            period,
            RAMP_PART * limits.accel,
            limits.accel * limits.loads[2] if limits.forceful else np.empty((0, 3)),
            steps or (RAMP_STEPS, hold_steps),
            limits._replace(stroke_m=stroke),
        )
        self._speed_parameters = (twists * self._lengths).ravel()

    @property
    def count(self) -> int:
        """Number of rotations J."""
        return len(self.plain.basis)

    def finer(self, steps: tuple[int, int] | int) -> RotationFamily:
        """Return the family with other numbers of steps per ramp and hold. An integer `steps`
        multiplies the present numbers of steps."""
        if isinstance(steps, int):
            steps = self.plain.steps[0] * steps, self.plain.steps[1] * steps
        other = object.__new__(RotationFamily)
        other.__dict__.update(self.__dict__, plain=self.plain._replace(steps=steps), _known=None)
        return other

    def parameters(self, fraction: np.ndarray) -> np.ndarray:
        """Return the parameters for durations (J,) as fractions of the cycle. The remaining time is
        rest at the end."""
        total = float(np.sum(fraction))
        holds = np.append(fraction / max(1.0, total), max(0.0, 1.0 - total)) / self.plain.hold_scale
        return self.admissible(np.concatenate([holds, self._speed_parameters]))

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of the steps, and the step lengths (n,) [s].

        The result is cached for the parameter array. Therefore the array must not be modified in
        place.
        """
        line, moved = self._timeline(parameters), self._motion(parameters)
        self._known = parameters, line, moved
        pose, twist, _, dt, _ = moved
        return pose, twist, dt

    def pull_back(
        self, parameters: np.ndarray, by_pose: np.ndarray, by_twist: np.ndarray, by_dt: np.ndarray
    ) -> np.ndarray:
        """Convert derivatives of R results with respect to the samples to derivatives (R, P) with
        respect to the parameters.

        Parameters
        ----------
        parameters : (P,)
        by_pose : (3, n, R), or (2, n, R) if the results do not depend on theta itself
        by_twist : (3, n, R)
        by_dt : (n, R)
        """
        return _kernels.pull_back(parameters, self.plain, by_pose, by_twist, by_dt)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Return parameters with positive durations and a motion within the limits.

        The stroke limit is applied only if `within_stroke` is set.
        """
        self._known = runnable(np.asarray(parameters, dtype=float), self.plain)
        return self._known[0]

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the additional errors (7,) [m], all with a negative sign: the gap between end and
        start of the sequence (3,), and the motors' travel beyond the stroke (4,)."""
        pose, _, _, _, gap = self._motion(parameters)
        travel = pose @ self._limits.levers.T
        stroke = self._limits.stroke_m
        over = np.maximum(travel.max(axis=0) - stroke, 0) + np.minimum(
            travel.min(axis=0) + stroke, 0
        )
        return -np.concatenate([gap * self._lengths, over])

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the negative derivatives (7, P) of the penalty."""
        rows = self._limits.levers
        gap = _kernels.gap_slopes(parameters, self.plain) * self._lengths[:, None]
        pose = self._motion(parameters)[0]
        travel = pose @ rows.T
        by_pose = np.zeros((3, len(pose), len(rows)))
        for i, row in enumerate(rows):
            for k in (np.argmax(travel[:, i]), np.argmin(travel[:, i])):
                if abs(travel[k, i]) > self._limits.stroke_m:
                    by_pose[:, k, i] += row
        nothing = np.zeros_like(by_pose)
        stroke = self.pull_back(parameters, by_pose, nothing, nothing[0])
        return np.vstack([gap, stroke])

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle, with knots at the ends of the ramps."""
        times, twist = self._timeline(parameters)
        pose = knot_poses(times, twist)
        period, y = times[-1], times / times[-1]
        shape = np.column_stack(
            [
                y**3 * (10 - 15 * y + 6 * y**2),
                30 * y**2 * (1 - y) ** 2 / period,
                60 * y * (1 - y) * (1 - 2 * y) / period**2,
            ]
        )
        bump = shape[:, :, None] * pose[-1]
        keep = np.append(np.diff(times) > 1e-7, True)
        keep[0] = True
        return PlateCycle.from_knots(
            times[keep], (pose - bump[:, 0])[keep], (twist - bump[:, 1])[keep], -bump[keep, 2]
        )

    def _timeline(self, parameters: np.ndarray) -> Line:
        if self._known is not None and self._known[0] is parameters:
            return self._known[1]
        return line_of(parameters, self.plain)

    def _motion(self, parameters: np.ndarray) -> Moved:
        if self._known is not None and self._known[0] is parameters:
            return self._known[2]
        return motion(*self._timeline(parameters), self.plain.steps)
