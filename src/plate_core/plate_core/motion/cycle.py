"""PlateCycle: one closed period of the plate's motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CycleError

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

REST_TOLERANCE = np.array([1e-6, 1e-6, 1e-5])
"""Pose [m, m, rad], twist and acceleration below this (times 1, 1/s, 1/s2 and 100) are rest."""

PIECES = 4
"""Pieces of a knot interval when bounding its peaks: with 6 knots to a sine wave they come out
0.2 % too high, with 3 knots 1 %."""


@dataclass(frozen=True)
class PlateCycle:
    """One closed motion of the plate in plate_home: knots, and quintic splines between them.

    The spline takes on pose, twist and acceleration at every knot, so it has a continuous
    acceleration; it is closed by construction: the last knot is the first.

    Attributes
    ----------
    times : (k + 1,)
        Knot times [s], from 0 to the period.
    knot_pose, knot_twist, knot_accel : (k + 1, 3)
        x, y, theta: [m, m, rad] and their first and second derivatives in time.
    """

    times: np.ndarray
    knot_pose: np.ndarray
    knot_twist: np.ndarray
    knot_accel: np.ndarray
    _coefficients: np.ndarray  # (k, 6, 3), powers of the time since the knot

    @property
    def period(self) -> float:
        """Length of one cycle [s]."""
        return float(self.times[-1])

    @property
    def coefficients(self) -> np.ndarray:
        """Powers (k, 6, 3) of the time since the knot, per knot interval [m, m, rad]."""
        return self._coefficients

    @property
    def starts_at_rest(self) -> bool:
        """Whether the plate is at home and at rest where the cycle begins and ends."""
        return bool(
            np.all(np.abs(self.knot_pose[0]) <= REST_TOLERANCE)
            and np.all(np.abs(self.knot_twist[0]) <= 100 * REST_TOLERANCE)
            and np.all(np.abs(self.knot_accel[0]) <= 1e4 * REST_TOLERANCE)
        )

    @property
    def moves(self) -> bool:
        """Whether the plate does anything but rest at home."""
        return any(np.any(k) for k in (self.knot_pose, self.knot_twist, self.knot_accel))

    def pose(self, t: np.ndarray | float) -> np.ndarray:
        """Pose (n, 3) [m, m, rad] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 0)

    def twist(self, t: np.ndarray | float) -> np.ndarray:
        """Twist (n, 3) [m/s, m/s, rad/s] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 1)

    def accel(self, t: np.ndarray | float) -> np.ndarray:
        """Acceleration (n, 3) [m/s2, m/s2, rad/s2] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 2)

    def _evaluate(self, t: np.ndarray | float, order: int) -> np.ndarray:
        t = np.atleast_1d(np.asarray(t, dtype=float))
        slack = 1e-9 * self.period
        if t.size and not (np.min(t) >= -slack and np.max(t) <= self.period + slack):
            raise CycleError(
                f"time {t[(t < -slack) | (t > self.period + slack) | ~np.isfinite(t)][0]:g} s, "
                f"allowed: 0 to the period, {self.period:g} s"
            )
        return np.asarray(self._splines[order](np.clip(t, 0, self.period)))

    @cached_property
    def _splines(self) -> tuple[PPoly, PPoly, PPoly]:
        """Pose, twist and acceleration as piecewise polynomials."""
        from scipy.interpolate import PPoly  # here: the command that stops must not wait for it

        pose = PPoly(self._coefficients.transpose(1, 0, 2)[::-1], self.times)
        return pose, pose.derivative(), pose.derivative(2)

    def control_points(self, order: int, pieces: int = PIECES) -> np.ndarray:
        """Bezier control points of the motion: a curve never leaves their hull.

        Parameters
        ----------
        order : int
            0: pose, 1: twist, 2: acceleration.
        pieces : int
            Equal pieces into which every knot interval is cut first; the points come closer to
            the curve as 1/pieces**2.

        Returns
        -------
        (k * pieces * 5, 3)
            In order of time, for all orders at the same times. A piece's last point is the next
            one's first, and is left out.
        """
        c = self._coefficients
        for _ in range(order):
            c = c[:, 1:] * np.arange(1, c.shape[1])[:, None]
        degree = c.shape[1]
        scaled = c * np.diff(self.times)[:, None, None] ** np.arange(degree)[:, None]
        return np.asarray((_bezier(pieces)[:, :degree] @ scaled).reshape(-1, 3))

    @classmethod
    def from_knots(
        cls, times: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray
    ) -> PlateCycle:
        """Build a cycle from knots; the last must equal the first.

        Parameters
        ----------
        times : (k + 1,)
            Knot times [s], rising, the first 0.
        pose, twist, accel : (k + 1, 3)
            State of the plate at the knots.

        Raises
        ------
        CycleError
            If times do not rise from 0, a value is not finite or too large to compute with, or the
            motion does not close.
        """
        times = np.array(times, dtype=float)
        states = [np.array(a, dtype=float) for a in (pose, twist, accel)]
        if times.ndim != 1 or len(times) < 2:
            raise CycleError(f"cycle has {times.size} knots, allowed: at least 2")
        for name, state in zip(("pose", "twist", "accel"), states, strict=True):
            if state.shape != (len(times), 3):
                raise CycleError(f"{name} has shape {state.shape}, allowed: ({len(times)}, 3)")
            if not np.all(np.isfinite(state)):
                raise CycleError(f"{name} has values that are not finite")
        if not np.all(np.isfinite(times)) or times[0] != 0 or np.any(np.diff(times) <= 0):
            raise CycleError("knot times must be finite, start at 0 and rise")
        gap = [float(np.max(np.abs(state[-1] - state[0]))) for state in states]
        size = [1e-6 + 1e-6 * float(np.max(np.abs(state))) for state in states]
        if gap[0] > size[0] or gap[1] > 1e2 * size[1] or gap[2] > 1e4 * size[2]:
            raise CycleError(
                f"motion does not close: end and start differ by {gap[0]:.3g} m or rad in pose, "
                f"{gap[1]:.3g} in twist, {gap[2]:.3g} in acceleration"
            )
        for state in states:
            state[-1] = state[0]
        for array in (times, *states):
            array.setflags(write=False)
        pose, twist, accel = states
        with np.errstate(all="ignore"):
            coefficients = quintic_pieces(times, pose, twist, accel)
        if not np.all(np.isfinite(coefficients)):
            raise CycleError("knots are too large, or too close in time, to compute a motion")
        return cls(times, pose, twist, accel, coefficients)

    @classmethod
    def from_samples(
        cls,
        period: float,
        pose: np.ndarray,
        twist: np.ndarray | None = None,
        accel: np.ndarray | None = None,
    ) -> PlateCycle:
        """Build a cycle from equally spaced periodic samples.

        Parameters
        ----------
        period : float
            Length of the cycle [s].
        pose : (n, 3)
            Poses [m, m, rad] at t = 0, period/n, 2 period/n, ...
        twist, accel : (n, 3), optional
            Derivatives at the same times; where missing, those of the periodic quintic
            interpolating spline.

        Raises
        ------
        CycleError
            If the period is not positive, a shape is wrong, or a value is not finite.
        """
        pose = np.asarray(pose, dtype=float)
        if not (np.isfinite(period) and period > 0):
            raise CycleError(f"period is {period!r} s, allowed: a positive number")
        if pose.ndim != 2 or pose.shape[1] != 3 or not len(pose):
            raise CycleError(f"pose has shape {pose.shape}, allowed: (n, 3) with n at least 1")
        if not np.all(np.isfinite(pose)):
            raise CycleError("pose has values that are not finite")
        times = np.linspace(0, period, len(pose) + 1)

        def close(samples: np.ndarray) -> np.ndarray:
            samples = np.asarray(samples, dtype=float)
            return np.vstack([samples, samples[:1]])

        if twist is None or accel is None:
            derivatives = _periodic_derivatives(period, pose)
            twist = derivatives[0] if twist is None else twist
            accel = derivatives[1] if accel is None else accel
        return cls.from_knots(times, close(pose), close(twist), close(accel))

    @classmethod
    def rest(cls, period: float) -> PlateCycle:
        """Return the cycle of a plate that stays at home."""
        return cls.from_samples(period, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))

    def scaled(self, factor: float) -> PlateCycle:
        """Return the same motion with all amplitudes times `factor`, in the same time."""
        return PlateCycle.from_knots(
            self.times, factor * self.knot_pose, factor * self.knot_twist, factor * self.knot_accel
        )


@lru_cache
def _bezier(pieces: int) -> np.ndarray:
    """Quintic Bezier points (5 pieces, 6) of the powers of u in [0, 1], piece by piece.

    In piece j, u = (j + v)/pieces; the points of v**m are binom(i, m)/binom(5, m), i = 0..5.
    """
    rows = [
        [
            sum(
                comb(n, m) * (j / pieces) ** (n - m) / pieces**m * comb(i, m) / comb(5, m)
                for m in range(n + 1)
            )
            for n in range(6)
        ]
        for j in range(pieces)
        for i in range(5)
    ]
    return np.array(rows)


def quintic_pieces(
    times: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray
) -> np.ndarray:
    """Coefficients (k, 6, 3) of the quintic that takes on both ends' value and derivatives."""
    h = np.diff(times)[:, None]
    p, v, a = pose[:-1], twist[:-1], accel[:-1]
    # What the left end's Taylor polynomial misses at the right end, in units of position.
    dp = pose[1:] - p - h * v - 0.5 * h**2 * a
    dv = (twist[1:] - v - h * a) * h
    da = (accel[1:] - a) * h**2
    c3 = (10 * dp - 4 * dv + 0.5 * da) / h**3
    c4 = (-15 * dp + 7 * dv - da) / h**4
    c5 = (6 * dp - 3 * dv + 0.5 * da) / h**5
    return np.stack([p, v, 0.5 * a, c3, c4, c5], axis=1)


def _periodic_derivatives(period: float, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative (n, 3) of the periodic quintic spline through n samples.

    At equally spaced knots the quintic B-spline has the values (1, 26, 66, 26, 1)/120, the slopes
    (1, 10, 0, -10, -1)/24 and the curvatures (1, 2, -6, 2, 1)/6 (de Boor, A Practical Guide to
    Splines, chapter IX), so sampled spline and derivatives are cyclic convolutions of one set of
    coefficients: a quotient in frequency.
    """
    step = period / len(pose)
    w = 2 * np.pi * np.fft.rfftfreq(len(pose))[:, None]
    spectrum = np.fft.rfft(pose, axis=0) / ((66 + 52 * np.cos(w) + 2 * np.cos(2 * w)) / 120)
    slope = 1j * (20 * np.sin(w) + 2 * np.sin(2 * w)) / (24 * step)
    bend = (-6 + 4 * np.cos(w) + 2 * np.cos(2 * w)) / (6 * step**2)
    return (
        np.fft.irfft(slope * spectrum, len(pose), axis=0),
        np.fft.irfft(bend * spectrum, len(pose), axis=0),
    )
