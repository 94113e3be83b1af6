"""Sinusoidal plate motions, equation (13) of the paper, as a linear family.

    u_i(t) = sum_j a_ij sin(j w t) + b_ij cos(j w t),   w = 2 pi / T

A free family has 2 N parameters for each degree of freedom. A family that starts at rest meets
u(0) = 0 and u'(0) = 0 for each, which leaves 2 N - 2, and its poses are measured from where it
starts: so the plate is at home, at rest and free of acceleration at the edge of each cycle, and any
cycle may follow any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from plate_core import PlateCycle
from plate_core.motion import PIECES

from ..limits import EQUAL_WEIGHT, Limits, limit_use

STEPS_PER_HARMONIC = 26
"""Steps of the sampled motion per period of the highest harmonic, at least."""

LONGEST_STEP = 0.4e-3
"""Longest step [s]: friction acts by first-order steps, which at 1 ms miss 10 % of a drift."""

KNOTS_PER_HARMONIC = 8
"""Knots of a finished cycle per period of the highest harmonic: quintics err below 1e-7 m."""


@dataclass(frozen=True)
class SinusoidBasis:
    """A linear family of closed motions: samples are matrices times coefficients.

    Attributes
    ----------
    period : float
        [s].
    steps : int
        Number n of equal steps; samples are at their middles.
    twist, pose, accel : (n, h)
        Basis of one degree of freedom. Coefficients are (h, 3), columns x, y, theta [m/s, rad/s].
    span : (2 N, h)
        Coefficients of sin 1..N and cos 1..N of equation (13), from the family's.
    times : (k + 1,)
        Knots of a finished cycle [s].
    knots : tuple of (k + 1, h)
        The same basis (pose, twist, accel) there.
    spline : (6 k, h)
        Powers of the time since the knot, as `PlateCycle.coefficients`.
    hull : (3 c, h)
        Control points of pose, twist and acceleration, as `PlateCycle.control_points`.
    """

    period: float
    steps: int
    twist: np.ndarray
    pose: np.ndarray
    accel: np.ndarray
    span: np.ndarray
    times: np.ndarray
    knots: tuple[np.ndarray, np.ndarray, np.ndarray]
    spline: np.ndarray
    hull: np.ndarray

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.period / self.steps

    @property
    def size(self) -> int:
        """Parameters for each degree of freedom."""
        return self.twist.shape[1]

    def cycle(self, coefficients: np.ndarray) -> PlateCycle:
        """Return the motion of coefficients (h, 3) as a plate cycle."""
        pose, twist, accel = (basis @ coefficients for basis in self.knots)
        spline = (self.spline @ coefficients).reshape(-1, 6, 3)
        for array in (pose, twist, accel):
            array[-1] = array[0]  # to the last bit
            array.setflags(write=False)
        return PlateCycle(self.times, pose, twist, accel, spline)


@lru_cache(maxsize=32)
def sinusoid_basis(number: int, period: float, at_rest: bool, steps: int = 0) -> SinusoidBasis:
    """Return the family with `number` harmonics; at_rest tells whether it starts at rest.

    `steps` is the number of samples; 0 takes enough to find a solution.
    """
    steps = steps or max(STEPS_PER_HARMONIC * max(number, 4), round(period / LONGEST_STEP))
    knots = KNOTS_PER_HARMONIC * max(number, 4)
    omega = 2 * np.pi / period
    j = np.arange(1, number + 1)
    span = np.eye(2 * number)
    if at_rest:
        rows = np.zeros((2, 2 * number))
        rows[0, number:] = 1  # u(0) = sum b_j
        rows[1, :number] = j / number  # u'(0) = w sum j a_j
        span = np.ascontiguousarray(np.linalg.svd(rows)[2][2:].T)

    def basis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        sin, cos = np.sin(omega * np.outer(t, j)), np.cos(omega * np.outer(t, j))
        offset = 1.0 if at_rest else 0.0
        pose = np.hstack([(offset - cos) / j, sin / j]) / omega
        twist = np.hstack([sin, cos])
        accel = np.hstack([cos * j, -sin * j]) * omega
        pose, twist, accel = (
            np.ascontiguousarray(matrix @ span) for matrix in (pose, twist, accel)
        )
        return pose, twist, accel

    pose, twist, accel = basis((np.arange(steps) + 0.5) / steps * period)
    times = np.arange(knots + 1) / knots * period
    times.setflags(write=False)
    ends = basis(times % period)
    # The spline is linear in the motion, so that of each coefficient alone gives all.
    splines = [
        PlateCycle.from_knots(times, *(np.outer(end[:, h], [1, 0, 0]) for end in ends))
        for h in range(span.shape[1])
    ]
    spline = np.stack([one.coefficients[:, :, 0].ravel() for one in splines], axis=1)
    pieces = 1 if number <= 2 else PIECES  # at 16 knots to a wave they come out 0.1 % too high
    hull = np.vstack(
        [
            np.stack([one.control_points(order, pieces)[:, 0] for one in splines], axis=1)
            for order in range(3)
        ]
    )
    return SinusoidBasis(period, steps, twist, pose, accel, span, times, ends, spline, hull)


class SinusoidFamily:
    """The motions of a basis at the full amplitude that the limits allow.

    Averaged forces do not depend on the scale, and the faster the plate the less the parts' own
    velocity matters: so the full amplitude is the best. Parameters (3 h,) are coefficients in units
    that make turns comparable to shifts.
    """

    def __init__(self, basis: SinusoidBasis, limits: Limits) -> None:
        self.basis = basis
        self._limits = limits
        self._scale = np.array([1.0, 1.0, 1 / limits.arm_m])
        self._dt = np.full(basis.steps, basis.dt)

    def coefficients(self, parameters: np.ndarray) -> np.ndarray:
        """Return coefficients (h, 3) of parameters (3 h,)."""
        return parameters.reshape(-1, 3) * self._scale

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of steps (n,) [s], and these."""
        coefficients = self.coefficients(parameters)
        return self.basis.pose @ coefficients, self.basis.twist @ coefficients, self._dt

    def pull_back(
        self,
        parameters: np.ndarray,
        by_pose: np.ndarray | None,
        by_twist: np.ndarray,
        by_dt: np.ndarray | None = None,
    ) -> np.ndarray:
        """Turn derivatives by pose (2, n, R) and twist (3, n, R) into ones (R, 3 h)."""
        jacobian = self.basis.twist.T @ by_twist  # (3, h, R)
        if by_pose is not None:
            jacobian[:2] += self.basis.pose.T @ by_pose
        jacobian *= self._scale[:, None, None]
        return np.ascontiguousarray(jacobian.transpose(2, 1, 0)).reshape(by_twist.shape[2], -1)

    def use(self, parameters: np.ndarray) -> float:
        """Return the greatest fraction of a limit that the samples use."""
        own, basis = self.coefficients(parameters), self.basis
        pose, twist, accel = basis.pose @ own, basis.twist @ own, basis.accel @ own
        return float(limit_use(pose, twist, accel, EQUAL_WEIGHT, self._limits, True))

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale to the full amplitude."""
        return parameters / max(self.use(parameters), 1e-300)

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return no errors: limits are kept by scaling."""
        return np.zeros(0)

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return no derivatives."""
        return np.zeros((0, len(parameters)))

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle."""
        return self.basis.cycle(self.coefficients(parameters))

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """Return random parameters at full amplitude."""
        coefficients = rng.normal(size=(self.basis.size, 3))
        coefficients[:, 2] /= self._limits.arm_m
        return SinusoidFamily.admissible(self, (coefficients / self._scale).ravel())
