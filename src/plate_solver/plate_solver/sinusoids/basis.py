"""Sinusoidal plate motions (equation (13) of the paper) as a linear family.

    u_i(t) = sum_j a_ij sin(j w t) + b_ij cos(j w t),   w = 2 pi / T

Without constraints, a family has 2 N parameters per degree of freedom. A family that starts at rest
satisfies u(0) = 0 and u'(0) = 0, which leaves 2 N - 2 parameters. The poses of this family are
relative to the pose at the start. Therefore the plate is at home, at rest and without acceleration
at both ends of a cycle. Any cycle of this family can follow any other one.

A family with a free end has three more functions per degree of freedom. These functions describe
the final state of the cycle and the tail, which leads from this state to rest. A cycle that begins
in motion is the sum of two motions: the tail of the previous cycle and a motion of the family.

The same coefficients a can be executed several times in succession. Each execution is a play. B a
is the motion of the basis, E a is the state at its end, and S p is the motion from a state p to
rest. The plate's motion in play k is

    u_k = B a + S p_k,    p_0 given,    p_k = E a  for k > 0,

This equation holds because the motion S p comes to rest within one play. Therefore the motions of
all plays are linear in the coefficients a.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from plate_core import PlateCycle
from plate_core.motion import quintic_pieces

from ..limits import EQUAL_WEIGHT, Limits, limit_use

STEPS_PER_HARMONIC = 26
"""Minimum number of samples per period of the highest harmonic."""

MAX_STEP = 0.4e-3
"""Maximum step [s]. The friction model is integrated by first-order steps. Steps of 1 ms would
cause a drift error of 10 %."""

TAIL_S = 0.05
"""Duration of the quintic polynomial from any state to rest [s]. The quintic polynomial from rest
to any final state has the same duration."""

TAIL_PERIOD_S = 0.1
"""Length of a tail, including the rest at its end [s]. In this time, the solver can compute the
result for the image that is taken at the start of the tail."""

END_UNITS = np.array([TAIL_S / 1.875, 1.0, 5.0625 / TAIL_S])
"""Units of the final state in a search: pose [m], velocity [m/s], acceleration [m/s2]. The units
determine only the relative size of the steps of the search. A quintic from rest to one unit of pose
has a maximum speed of 1 m/s (15/8 pose/TAIL_S). A quintic to one unit of velocity also has a
maximum speed of 1 m/s. A quintic to one unit of acceleration has a maximum speed of 0.34 m/s (0.068
acceleration TAIL_S). The maximum accelerations of these three quintics are 3.1, 3.9 and 5.1 m/s,
each divided by TAIL_S."""

CHECKS_PER_HARMONIC = 8
"""Number of instants per period of the highest harmonic at which the limits are checked."""

TAIL_CHECKS = 12
"""Number of instants in a tail at which the limits are checked."""

KNOTS_PER_HARMONIC = 8
"""Number of knots of a finished cycle per period of the highest harmonic. The error of the quintics
is below 1e-7 m."""

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Matrices of pose, twist and acceleration."""


@dataclass(frozen=True)
class SinusoidBasis:
    """A linear family of closed motions. The samples of a motion are the product of matrices and
    coefficients.

    Attributes
    ----------
    period : float
        Total length of all plays [s].
    steps : int
        Number n of equal steps of all plays. Samples are taken at the middles of the steps.
    twist, pose, accel : (n, h)
        Basis of one degree of freedom. Coefficients are an array (h, 3) with columns x, y, theta
        [m/s, rad/s].
    span : (2 N, h)
        Matrix that converts the family's coefficients to the coefficients of sin 1..N and cos 1..N
        in equation (13).
    times : (k + 1,)
        Knots of a finished cycle [s]. The finished cycle is the first play.
    knots : tuple of (k + 1, h)
        Basis (pose, twist, acceleration) at the knots.
    spline : (6 k, h)
        Coefficients of the polynomials between the knots, as `PlateCycle.coefficients`. The
        variable is the time since the last knot.
    free_end : bool
        Whether motions may end in any state. Motions that end in any state have a tail.
    checks : tuple of (l, h)
        Basis (pose, twist, acceleration) at the instants at which limits are checked, including the
        instants of the tail.
    settling : tuple of (n, 3)
        Pose, twist and acceleration at the middles of the steps, while the plate comes to rest.
        Column 1 is the motion from an initial pose of 1 m, column 2 from an initial velocity of 1
        m/s, and column 3 from an initial acceleration of 1 m/s2.
    settling_knots, settling_checks : tuple of (k + 1, 3), (l, 3)
        The same columns as in `settling`, at the knots and at the instants at which limits are
        checked.
    """

    period: float
    steps: int
    twist: np.ndarray
    pose: np.ndarray
    accel: np.ndarray
    span: np.ndarray
    times: np.ndarray
    knots: Matrices
    spline: np.ndarray
    free_end: bool
    checks: Matrices
    settling: Matrices
    settling_knots: Matrices
    settling_checks: Matrices

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.period / self.steps

    @cached_property
    def inverse(self) -> np.ndarray:
        """Least squares matrix (h, n). The matrix converts twists at the middles of the steps to
        coefficients."""
        return np.linalg.pinv(self.twist)

    @property
    def size(self) -> int:
        """Number of parameters per degree of freedom."""
        return self.twist.shape[1]

    def cycle(self, coefficients: np.ndarray, plate: np.ndarray | None = None) -> PlateCycle:
        """Return the motion of coefficients (h, 3) as a plate cycle.

        The motion begins in the plate state (3, 3). Default: at rest. The cycle has a tail if it
        begins in motion or has a free end.
        """
        states = [basis @ coefficients for basis in self.knots]
        spline = (self.spline @ coefficients).reshape(-1, 6, 3)
        if plate is not None:
            more = [matrix @ plate for matrix in self.settling_knots]
            spline = spline + quintic_pieces(self.times, *more)
            states = [state + settling for state, settling in zip(states, more, strict=True)]
            for state, first in zip(states, plate, strict=True):
                state[0] = first  # remove the rounding error of the initial state
        for state in states:
            if not self.free_end:
                state[-1] = state[0] if plate is None else 0
        tail = None
        if self.free_end or (plate is not None and np.any(plate)):
            end = np.stack([state[-1] for state in states])
            tail = PlateCycle.stopping(end, TAIL_S, TAIL_PERIOD_S)
        pose, twist, accel = states
        return PlateCycle(self.times, pose, twist, accel, spline, tail)

    def cycles(self, coefficients: np.ndarray) -> list[PlateCycle]:
        """Return the cycles of N sets of coefficients (N, h, 3), from rest to rest."""
        states = [basis @ coefficients for basis in self.knots]
        for state in states:
            state[:, -1] = state[:, 0]
        splines = (self.spline @ coefficients).reshape(len(coefficients), -1, 6, 3)
        columns = zip(*states, splines, strict=True)
        return [
            PlateCycle(self.times, pose, twist, accel, spline)
            for pose, twist, accel, spline in columns
        ]


def settling(t: np.ndarray) -> Matrices:
    """Return pose, twist and acceleration (n, 3) of the plate at times t (n,) [s] while it comes to
    rest. The columns are the same as in `SinusoidBasis.settling`."""
    edge = np.stack([np.eye(3), np.zeros((3, 3))], axis=1)
    powers, before_rest = quintic_pieces(np.array([0.0, TAIL_S]), *edge)[0], t < TAIL_S
    pose, twist, accel = (
        np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyder(powers, order)).T
        * before_rest[:, None]
        for order in range(3)
    )
    return pose, twist, accel


@lru_cache(maxsize=32)
def sinusoid_basis(
    number: int, period: float, at_rest: bool, steps: int = 0, free_end: bool = False,
    knots_per_harmonic: int = KNOTS_PER_HARMONIC, plays: int = 1,
) -> SinusoidBasis:  # fmt: skip
    """Return the family with `number` harmonics.

    If `at_rest`, motions start at rest. If `free_end`, motions may end in any state and have a
    tail. `steps` is the number of samples per play. 0 selects the number automatically. `plays` is
    the number of consecutive plays that samples and limit checks cover. A number above 1 requires
    `at_rest`.
    """
    steps = steps or max(STEPS_PER_HARMONIC * max(number, 4), round(period / MAX_STEP))
    knots = knots_per_harmonic * max(number, 4)
    omega = 2 * np.pi / period
    j = np.arange(1, number + 1)
    span = np.eye(2 * number)
    if at_rest:
        rows = np.zeros((2, 2 * number))
        rows[0, number:] = 1  # u(0) = sum b_j
        rows[1, :number] = j / number  # u'(0) = w sum j a_j
        span = np.ascontiguousarray(np.linalg.svd(rows)[2][2:].T)

    def basis(t: np.ndarray) -> Matrices:
        sin, cos = np.sin(omega * np.outer(t, j)), np.cos(omega * np.outer(t, j))
        offset = 1.0 if at_rest else 0.0
        pose = np.hstack([(offset - cos) / j, sin / j]) / omega
        twist = np.hstack([sin, cos])
        accel = np.hstack([cos * j, -sin * j]) * omega
        inside = (t <= period)[:, None]
        matrices = [matrix @ span * inside for matrix in (pose, twist, accel)]
        if free_end:  # the last TAIL_S seconds of the motion are a tail, reversed in time
            before = (t < period)[:, None]
            sign, back = np.where(before, [1.0, -1.0, 1.0], 1.0), np.where(before, -1.0, 1.0)
            settled = settling(np.abs(period - t))
            matrices = [
                np.hstack([matrix, END_UNITS * sign * factor * settled_row])
                for matrix, settled_row, factor in zip(
                    matrices, settled, (1.0, back, 1.0), strict=True
                )
            ]
        pose, twist, accel = (np.ascontiguousarray(matrix) for matrix in matrices)
        return pose, twist, accel

    t = (np.arange(steps) + 0.5) / steps * period
    pose, twist, accel = basis(t)
    times = np.arange(knots + 1) / knots * period
    times.setflags(write=False)
    ends = basis(times if free_end else times % period)
    checks = t[:: max(1, steps // (CHECKS_PER_HARMONIC * number))]
    if free_end:
        checks = np.append(checks, period + TAIL_S * (np.arange(TAIL_CHECKS) + 0.5) / TAIL_CHECKS)
    # The spline of a motion is a linear function of the coefficients. Therefore `spline` contains
    # one spline per coefficient.
    spline = quintic_pieces(times, *ends).reshape(-1, ends[0].shape[1])
    basis_of_play = SinusoidBasis(
        period, steps, twist, pose, accel, span, times, ends, spline, free_end, basis(checks),
        settling(t), settling(times), settling(checks),
    )  # fmt: skip
    return basis_of_play if plays == 1 else repeated(basis_of_play, plays)


def repeated(basis: SinusoidBasis, plays: int) -> SinusoidBasis:
    """Return the basis of `plays` consecutive plays of the motions of `basis`."""
    end, more = np.stack([knots[-1] for knots in basis.knots]), plays - 1
    inner = len(basis.checks[0]) - TAIL_CHECKS * basis.free_end

    def again(matrices: Matrices, settled: Matrices, inner: int) -> Matrices:
        first, second, third = (
            np.vstack([a[:inner], np.tile((a + b @ end)[:inner], (more, 1)), a[inner:]])
            for a, b in zip(matrices, settled, strict=True)
        )
        return first, second, third

    def once(matrices: Matrices, inner: int) -> Matrices:
        first, second, third = (
            np.pad(a[:inner], ((0, more * inner + len(a) - inner), (0, 0))) for a in matrices
        )
        return first, second, third

    pose, twist, accel = again((basis.pose, basis.twist, basis.accel), basis.settling, basis.steps)
    return replace(
        basis, period=plays * basis.period, steps=plays * basis.steps, pose=pose, twist=twist,
        accel=accel, checks=again(basis.checks, basis.settling_checks, inner),
        settling=once(basis.settling, basis.steps),
        settling_checks=once(basis.settling_checks, inner),
    )  # fmt: skip


class SinusoidFamily:
    """The motions of a basis, for one rig and one initial state of the plate.

    Parameters (3 h,) are scaled coefficients. The scale makes rotations comparable to translations.

    Parameters
    ----------
    basis : SinusoidBasis
    limits : Limits
    plate : (3, 3), optional
        Initial state of the plate, as `PlateCycle.state`. Such motions require a basis of motions
        that start at rest. Default: the initial state of the basis motions.
    """

    def __init__(
        self, basis: SinusoidBasis, limits: Limits, plate: np.ndarray | None = None
    ) -> None:
        self.basis, self.plate = basis, plate
        self._limits = limits
        self._scale = np.array([1.0, 1.0, 1 / limits.arm_m])
        self._dt = np.full(basis.steps, basis.dt)

    def coefficients(self, parameters: np.ndarray) -> np.ndarray:
        """Return coefficients (h, 3) for parameters (3 h,)."""
        return parameters.reshape(-1, 3) * self._scale

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of the steps, and the step lengths (n,)
        [s]."""
        coefficients, basis = self.coefficients(parameters), self.basis
        pose, twist = basis.pose @ coefficients, basis.twist @ coefficients
        if self.plate is not None:
            pose = pose + basis.settling[0] @ self.plate
            twist = twist + basis.settling[1] @ self.plate
        return pose, twist, self._dt

    def pull_back(self, by_twist: np.ndarray, by_pose: np.ndarray | None = None) -> np.ndarray:
        """Convert derivatives with respect to twist (3, n, R) and pose (2, n, R) to derivatives
        (R, 3 h) with respect to the parameters."""
        jacobian = self.basis.twist.T @ by_twist  # (3, h, R)
        if by_pose is not None:
            jacobian[:2] += self.basis.pose.T @ by_pose
        jacobian *= self._scale[:, None, None]
        return np.ascontiguousarray(jacobian.transpose(2, 1, 0)).reshape(by_twist.shape[2], -1)

    def use(self, parameters: np.ndarray) -> float:
        """Return the largest utilisation of any rig limit by the samples (1: at the limit). The
        motion from the initial state `plate` to rest is not included."""
        coefficients, basis = self.coefficients(parameters), self.basis
        pose = basis.pose @ coefficients
        twist = basis.twist @ coefficients
        accel = basis.accel @ coefficients
        return limit_use(pose, twist, accel, EQUAL_WEIGHT, self._limits, True)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale parameters to the largest amplitude that the limits allow.

        Averaged forces do not depend on the amplitude. The error from the parts' velocities
        decreases with the speed of the plate. Therefore the largest amplitude is the best.
        """
        return parameters / max(self.use(parameters), 1e-300)

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle."""
        return self.basis.cycle(self.coefficients(parameters), self.plate)

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """Return random parameters at the largest amplitude."""
        coefficients = rng.normal(size=(self.basis.size, 3))
        coefficients[:, 2] /= self._limits.arm_m
        return self.admissible((coefficients / self._scale).ravel())

    def nearest(self, twist: np.ndarray) -> np.ndarray:
        """Return the parameters whose twists are closest to the sampled twists (n, 3), by least
        squares."""
        if self.plate is not None:
            twist = twist - self.basis.settling[1] @ self.plate
        return (self.basis.inverse @ twist / self._scale).ravel()
