"""Sequences of rotations as a parametrised family of closed motions, from rest to rest.

Rotation j has a constant twist u_j during its hold. A smooth ramp connects rotation j to the next
rotation. The acceleration limit a determines the length h of the ramp. A smooth correction over the
whole period T removes the gap between end and start. Therefore every sequence closes exactly:

    twist on a ramp   u_j + (u_{j+1} - u_j) x^2 (3 - 2 x),    x from 0 to 1,
    length            h = 1.5 (velocity change of the fastest corner) / a,
    pose              integral of the twist - gap y^3 (10 - 15 y + 6 y^2),    y = t/T.

The derivatives are exact. One backward pass over the knots computes the derivatives (sequence.hpp).

Knots of J rotations: knot 0 is the start at rest. Knots 2 j + 1 and 2 j + 2 are the start and the
end of rotation j (counted from 0). At knot 2 J + 1 the plate comes to rest. Knot 2 J + 2 is the end
of the period.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from plate_core import PlateCycle

from .. import _kernels
from ..limits import Limits

RAMP_STEPS = 8
"""Number of time steps per ramp during a search. A ramp is the transition from one rotation to the
next."""

MIN_STEPS = 6
"""Minimum number of time steps per hold during a search. A hold is the phase in which a rotation
has a constant twist."""

HOLD_STEP = 1e-3
"""Length of a time step in a hold that has the mean length of all holds [s]."""

RAMP_FRACTION = 0.95
"""Fraction of the acceleration limit that ramps may use. The remaining acceleration is for the
correction that closes the motion."""


class Sequences(NamedTuple):
    """Data of `RotationFamily` in the form that the C++ kernels use.

    Attributes
    ----------
    rotations : int
        Number of rotations J.
    scale : (3,)
        Twist of a rotation whose three speed parameters are 1 [m/s, m/s, rad/s].
    period, accel : float
        Length of the cycle [s] and peak acceleration of ramps [m/s2].
    loads : (m, 3)
        Limits of the motors' forces. Each row, multiplied by a plate acceleration, must not exceed
        the acceleration limit `accel`. Without a check of the forces, the array is empty.
    steps : (int, int)
        Number of equal steps in each ramp, and in each hold. No step crosses the end of a ramp or
        hold. Therefore the results depend on the parameters as smoothly as the friction model
        permits.
    limits : Limits
        Limits of the rig. The stroke is infinite if it is not checked.
    """

    rotations: int
    scale: np.ndarray
    period: float
    accel: float
    loads: np.ndarray
    steps: tuple[int, int]
    limits: Limits


class Run(NamedTuple):
    """Motion of a sequence.

    Attributes
    ----------
    parameters : (P,)
        Parameters of the sequence, as in `RotationFamily`.
    times : (K,)
        Times of the knots [s].
    knot_twist : (K, 3)
        Twists at the knots [m/s, m/s, rad/s].
    pose, twist, accel : (n, 3)
        Samples at the middles of the steps [m, m, rad; per s; per s2].
    dt : (n,)
        Lengths of the steps [s].
    knot_pose : (K, 3)
        Poses at the knots [m, m, rad] before the correction that closes the motion. The last one is
        the gap.
    """

    parameters: np.ndarray
    times: np.ndarray
    knot_twist: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    dt: np.ndarray
    knot_pose: np.ndarray


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
        self._last: Run | None = None
        # factors that convert x, y and theta to lengths [m]
        self._lengths = np.array([1.0, 1.0, limits.arm_m])
        hold_steps = max(MIN_STEPS, round(period / len(twists) / HOLD_STEP))
        stroke = limits.stroke_m if within_stroke else np.inf
        self.kernel_data = Sequences(
            len(twists),
            speed / self._lengths,
            period,
            RAMP_FRACTION * limits.accel,
            limits.accel * limits.loads[2] if limits.forceful else np.empty((0, 3)),
            steps or (RAMP_STEPS, hold_steps),
            limits._replace(stroke_m=stroke),
        )
        self._speed_parameters = (twists * self._lengths).ravel()

    def with_steps(self, steps: tuple[int, int]) -> RotationFamily:
        """Return the family with other numbers of steps per ramp and hold."""
        other = copy(self)
        other.kernel_data, other._last = self.kernel_data._replace(steps=steps), None
        return other

    def parameters(self, fraction: np.ndarray) -> np.ndarray:
        """Return the parameters for durations (J,) as fractions of the cycle. The remaining time is
        rest at the end."""
        total = float(np.sum(fraction))
        holds = np.append(fraction / max(1.0, total), max(0.0, 1.0 - total))
        holds /= 1 / self.kernel_data.rotations
        return self.admissible(np.concatenate([holds, self._speed_parameters]))

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of the steps, and the step lengths (n,)
        [s]."""
        run = self._run(parameters)
        return run.pose, run.twist, run.dt

    def pull_back(
        self, parameters: np.ndarray, by_pose: np.ndarray, by_twist: np.ndarray, by_dt: np.ndarray
    ) -> np.ndarray:
        """Convert derivatives of R results with respect to the samples to derivatives (R, P) with
        respect to the parameters.

        Parameters
        ----------
        parameters : (P,)
            Parameters of the sequence, as in `RotationFamily`.
        by_pose : (3, n, R), or (2, n, R) if the results do not depend on theta itself
        by_twist : (3, n, R)
        by_dt : (n, R)
        """
        return _kernels.pull_back(parameters, self.kernel_data, by_pose, by_twist, by_dt)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Return parameters with positive durations and a motion within the limits.

        The stroke limit is applied only if `within_stroke` is set.
        """
        self._last = Run(*_kernels.runnable(np.asarray(parameters, dtype=float), self.kernel_data))
        return self._last.parameters

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the additional errors (7,) [m], all with a negative sign: the gap between end and
        start of the sequence (3,), and the motors' travel beyond the stroke (4,)."""
        run = self._run(parameters)
        travel = run.pose @ self._limits.levers.T
        stroke = self._limits.stroke_m
        over = np.maximum(travel.max(axis=0) - stroke, 0) + np.minimum(
            travel.min(axis=0) + stroke, 0
        )
        return -np.concatenate([run.knot_pose[-1] * self._lengths, over])

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the negative derivatives (7, P) of the penalty."""
        levers = self._limits.levers
        gap = _kernels.gap_slopes(parameters, self.kernel_data) * self._lengths[:, None]
        pose = self._run(parameters).pose
        travel = pose @ levers.T
        beyond = [
            (k, motor)
            for motor in range(len(levers))
            for k in (np.argmax(travel[:, motor]), np.argmin(travel[:, motor]))
            if abs(travel[k, motor]) > self._limits.stroke_m
        ]
        if not beyond:
            return np.vstack([gap, np.zeros((len(levers), len(parameters)))])
        by_pose = np.zeros((3, len(pose), len(levers)))
        for k, motor in beyond:
            by_pose[:, k, motor] += levers[motor]
        nothing = np.zeros_like(by_pose)
        stroke = self.pull_back(parameters, by_pose, nothing, nothing[0])
        return np.vstack([gap, stroke])

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle, with knots at the ends of the ramps."""
        run = self._run(parameters)
        times, twist, pose = run.times, run.knot_twist, run.knot_pose
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

    def _run(self, parameters: np.ndarray) -> Run:
        """Return the motion of the parameters. The last result is cached for its parameter array.
        Therefore the array must not be modified in place."""
        if self._last is None or self._last.parameters is not parameters:
            run = Run(*_kernels.run_of(parameters, self.kernel_data))
            self._last = run._replace(parameters=parameters)
        return self._last
