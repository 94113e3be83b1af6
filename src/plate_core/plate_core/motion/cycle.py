"""The plate's motion during one cycle, as a quintic spline.

A `PlateCycle` stores knots with pose, twist and acceleration in plate_home and interpolates them
with quintic polynomials. A cycle can have a tail, a motion that brings the plate to rest if no
other cycle follows. `control_points` bounds the spline and its derivatives by Bezier control
points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import comb, perm

import numpy as np

from ..errors import CycleError

REST_TOLERANCE = np.array([1e-6, 1e-6, 1e-5])
"""Tolerance of the pose at rest at home [m, m, rad]. The tolerance of the twist [m/s, m/s, rad/s]
is 100 times this value. The tolerance of the acceleration [m/s2, m/s2, rad/s2] is 10 000 times this
value."""

FACTORS = [np.array([[perm(k, n)] for k in range(n, 6)], dtype=float) for n in range(3)]
"""Factors of a quintic's coefficients in its n-th derivative."""

PIECES = 4
"""Number of pieces into which each knot interval is cut to compute bounds of the peak values. For a
sine wave with 6 knots per period, the bound is 0.2 % too high. With 3 knots per period, it is 1 %
too high."""


@dataclass(frozen=True)
class PlateCycle:
    """One motion of the plate in plate_home: knots, and quintic splines between them.

    The spline interpolates pose, twist and acceleration at every knot, so its acceleration is
    continuous. The motion ends in its initial state, at rest at home, or in another state. If the
    motion ends in another state, the cycle has a tail. The tail is a motion to rest, which is
    played if no following cycle begins in the final state.

    Attributes
    ----------
    times : (k + 1,)
        Knot times [s], from 0 to the period.
    knot_pose, knot_twist, knot_accel : (k + 1, 3)
        x, y, theta [m, m, rad], and their first and second time derivatives.
    tail : PlateCycle or None
        Motion from the state of the last knot to rest at home. None: no tail.
    """

    times: np.ndarray
    knot_pose: np.ndarray
    knot_twist: np.ndarray
    knot_accel: np.ndarray
    _coefficients: np.ndarray  # (k, 6, 3): coefficients of the powers of the time since the knot
    tail: PlateCycle | None = None

    def __post_init__(self) -> None:
        states = self.knot_pose, self.knot_twist, self.knot_accel
        for array in (self.times, *states, self._coefficients):
            array.setflags(write=False)

    @property
    def period(self) -> float:
        """Length of the cycle without its tail [s]."""
        return float(self.times[-1])

    @property
    def parts(self) -> tuple[PlateCycle, ...]:
        """All motions of the cycle: the cycle itself and its tail, if it has one."""
        return (self,) if self.tail is None else (self, self.tail)

    @property
    def knots(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Arguments of `from_knots`: times, pose, twist and accel of the cycle's knots, followed by
        those of the tail's knots."""
        if self.tail is None:
            return self.times, self.knot_pose, self.knot_twist, self.knot_accel
        times, *states = self.tail.knots
        knot_states = self.knot_pose, self.knot_twist, self.knot_accel
        pose, twist, accel = (
            np.concatenate(pair) for pair in zip(knot_states, states, strict=True)
        )
        return np.concatenate([self.times, self.period + times]), pose, twist, accel

    def state(self, knot: int) -> np.ndarray:
        """Pose, twist and acceleration (3, 3) at the knot with this index."""
        return np.stack([self.knot_pose[knot], self.knot_twist[knot], self.knot_accel[knot]])

    @property
    def coefficients(self) -> np.ndarray:
        """Polynomial coefficients (k, 6, 3) of each knot interval, in ascending powers of the time
        since its first knot [m, m, rad]."""
        return self._coefficients

    @property
    def starts_at_rest(self) -> bool:
        """Whether the plate is at rest at home at the start of the cycle."""
        return is_rest(self.state(0))

    @property
    def closes(self) -> bool:
        """Whether the cycle ends in its initial state, so that it can be repeated."""
        return is_rest(self.state(0) - self.state(-1))

    def follows(self, before: PlateCycle) -> bool:
        """Whether the cycle begins in the final state of the cycle `before`."""
        return is_rest(self.state(0) - before.state(-1))

    @property
    def moves(self) -> bool:
        """Whether the plate moves. False for a cycle at rest at home."""
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
                f"time is {t[(t < -slack) | (t > self.period + slack) | ~np.isfinite(t)][0]:g} s, "
                f"allowed: 0 to {self.period:g} s (the period)"
            )
        return evaluate_pieces(self.times, self._coefficients, np.clip(t, 0, self.period), order)

    def control_points(self, order: int, pieces: int = PIECES) -> np.ndarray:
        """Return the Bezier control points of the cycle without its tail. See `control_points`."""
        return control_points(self.times, self._coefficients, order, pieces)

    @classmethod
    def from_knots(
        cls, times: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray
    ) -> PlateCycle:
        """Build a cycle from knots. The last knot must be equal to the first knot, or be at rest at
        home.

        Parameters
        ----------
        times : (k + 1,)
            Increasing knot times [s], starting at 0. At most one time occurs twice. At this time
            the cycle ends and its tail begins.
        pose, twist, accel : (k + 1, 3)
            State of the plate at the knots [m, m, rad; per s; per s2].

        Raises
        ------
        CycleError
            If the times do not increase from 0, a value is not finite or too large for the
            computation, or the motion ends neither in its initial state nor at rest.
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
        twice = np.flatnonzero(np.diff(times) == 0) + 1
        rises = np.all(np.diff(np.delete(times, twice)) > 0)
        inside = len(twice) == 0 or 1 < twice[0] < len(times) - 1
        if not (
            np.all(np.isfinite(times)) and times[0] == 0 and rises and len(twice) < 2 and inside
        ):
            raise CycleError(
                "knot times must be finite, start at 0 and increase; one time between them can "
                "occur twice, where the tail begins"
            )
        if len(twice):
            k = int(twice[0])
            if any(np.any(state[k] != state[k - 1]) for state in states):
                raise CycleError(
                    f"the two knots at {times[k]:g} s have different states, allowed: equal ones"
                )
            tail = cls._close_motion(
                times[k:] - times[k], [state[k:] for state in states], at_rest=True
            )
            return replace(cls._build(times[:k], [state[:k] for state in states]), tail=tail)
        return cls._close_motion(times, states)

    @classmethod
    def _close_motion(
        cls, times: np.ndarray, states: list[np.ndarray], at_rest: bool = False
    ) -> PlateCycle:
        """Return a motion whose last state equals exactly its first state or the state at rest. If
        `at_rest` is True, the motion must end at rest."""
        gap = [float(np.max(np.abs(state[-1] - state[0]))) for state in states]
        size = [1e-6 + 1e-6 * float(np.max(np.abs(state))) for state in states]
        closes = gap[0] <= size[0] and gap[1] <= 1e2 * size[1] and gap[2] <= 1e4 * size[2]
        rests = is_rest(np.stack([state[-1] for state in states]))
        if at_rest and not rests:
            raise CycleError("motion is not closed: its tail does not end at rest at home")
        if not (closes or rests):
            raise CycleError(
                f"motion is not closed: end and start differ by {gap[0]:.3g} m or rad in pose, "
                f"{gap[1]:.3g} m/s or rad/s in twist, {gap[2]:.3g} m/s2 or rad/s2 in acceleration"
            )
        for state in states:
            state[-1] = state[0] if closes and not at_rest else 0
        return cls._build(times, states)

    @classmethod
    def _build(cls, times: np.ndarray, states: list[np.ndarray]) -> PlateCycle:
        pose, twist, accel = states
        with np.errstate(all="ignore"):
            coefficients = quintic_pieces(times, pose, twist, accel)
        if not np.all(np.isfinite(coefficients)):
            raise CycleError(
                "the knots have too large values or too short intervals to compute a motion"
            )
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
            Derivatives at the same times. By default, the derivatives of the periodic quintic
            spline through the poses are used.

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

        def append_first(samples: np.ndarray) -> np.ndarray:
            samples = np.asarray(samples, dtype=float)
            return np.vstack([samples, samples[:1]])

        if twist is None or accel is None:
            derivatives = _periodic_derivatives(period, pose)
            twist = derivatives[0] if twist is None else twist
            accel = derivatives[1] if accel is None else accel
        return cls.from_knots(times, append_first(pose), append_first(twist), append_first(accel))

    @classmethod
    def rest(cls, period: float) -> PlateCycle:
        """Return a cycle at rest at home."""
        return cls.from_samples(period, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))

    def scaled(self, factor: float) -> PlateCycle:
        """Return the motion with all amplitudes multiplied by `factor` and unchanged times."""
        times, *states = self.knots
        return PlateCycle.from_knots(times, *(factor * state for state in states))

    @classmethod
    def stopping(cls, state: np.ndarray, duration_s: float, period: float = 0.0) -> PlateCycle:
        """Return a motion that stops the plate.

        A single quintic leads from `state` (3, 3), in the form of `PlateCycle.state`, to rest at
        home within `duration_s` [s]. If `period` [s] is longer, the plate rests until its end.
        """
        times = [0.0, duration_s, period][: 2 + (period > duration_s)]
        knots = [np.vstack([row, np.zeros((len(times) - 1, 3))]) for row in state]
        return cls._close_motion(np.array(times), knots, at_rest=True)


def is_rest(state: np.ndarray) -> bool:
    """Whether pose, twist and acceleration (3, 3) are zero within the tolerances of rest at
    home."""
    return bool(np.all(np.abs(state) <= REST_TOLERANCE * np.array([[1.0], [100.0], [1e4]])))


@lru_cache
def _bezier_matrix(pieces: int) -> np.ndarray:
    """Matrix (5 pieces, 6) from the coefficients of a quintic in powers of u in [0, 1] to its
    Bezier control points, piece by piece.

    In piece j, u = (j + v)/pieces with v in [0, 1]. The control points of the power v**m are
    binom(i, m)/binom(5, m), i = 0..5. The last point (i = 5) of a piece is omitted, because it is
    the first point of the next piece.
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


def control_points(
    times: np.ndarray, coefficients: np.ndarray, order: int, pieces: int = PIECES
) -> np.ndarray:
    """Return Bezier control points of a spline. The convex hull of these points contains the
    spline.

    Parameters
    ----------
    times : (k + 1,)
        Knot times [s].
    coefficients : (k, 6, m)
        Polynomial coefficients in ascending powers of the time since the knot.
    order : int
        0: control points of the spline. 1 and 2: control points of its derivatives.
    pieces : int
        Number of equal pieces into which every knot interval is cut. The distance between the
        points and the curve decreases with 1/pieces**2.

    Returns
    -------
    (k * pieces * 5, m)
        Points in order of time, at the same times for all orders. The last point of each piece is
        omitted, because it equals the first point of the next piece.
    """
    for _ in range(order):
        coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[:, None]
    degree, columns = coefficients.shape[1:]
    scaled = coefficients * np.diff(times)[:, None, None] ** np.arange(degree)[:, None]
    return np.asarray((_bezier_matrix(pieces)[:, :degree] @ scaled).reshape(-1, columns))


def quintic_pieces(
    times: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray
) -> np.ndarray:
    """Coefficients (k, 6, 3) of the quintics that interpolate pose, twist and acceleration at both
    ends of each knot interval, in ascending powers of the time since its first knot."""
    h = np.diff(times)[:, None]
    p, v, a = pose[:-1], twist[:-1], accel[:-1]
    # The Taylor polynomial about the left end of an interval has errors at the right end: of the
    # pose (dp), twist (dv) and acceleration (da). The errors are multiplied by powers of h to have
    # the unit of the pose.
    dp = pose[1:] - p - h * v - 0.5 * h**2 * a
    dv = (twist[1:] - v - h * a) * h
    da = (accel[1:] - a) * h**2
    c3 = (10 * dp - 4 * dv + 0.5 * da) / h**3
    c4 = (-15 * dp + 7 * dv - da) / h**4
    c5 = (6 * dp - 3 * dv + 0.5 * da) / h**5
    return np.stack([p, v, 0.5 * a, c3, c4, c5], axis=1)


def evaluate_pieces(times: np.ndarray, pieces: np.ndarray, t: np.ndarray, order: int) -> np.ndarray:
    """Value or derivative (n, 3) of a piecewise polynomial at times t (n,).

    scipy's PPoly gives bitwise equal results. PPoly is not used here, because every node would then
    load large parts of scipy.

    Parameters
    ----------
    times : (k + 1,) array
        Knots, increasing.
    pieces : (k, 6, 3) array
        See `quintic_pieces`.
    t : (n,) array
        Times [s]. For times outside the knots, the nearest piece is extrapolated.
    order : int
        Order of the derivative. 0 is the value itself.
    """
    index = np.searchsorted(times[1:-1], t, "right")
    pieces = pieces[index, order:] * FACTORS[order]
    powers = np.ones(pieces.shape[:2])
    powers[:, 1:] = (t - times[index])[:, None]
    pieces *= np.multiply.accumulate(powers, axis=1, out=powers)[..., None]
    return np.asarray(np.add.reduce(pieces, axis=1, initial=0.0))


def _periodic_derivatives(period: float, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative (n, 3) of the periodic quintic spline through n samples.

    At equally spaced knots, the quintic B-spline has the values (1, 26, 66, 26, 1)/120, the slopes
    (1, 10, 0, -10, -1)/24 and the curvatures (1, 2, -6, 2, 1)/6 (de Boor, A Practical Guide to
    Splines, chapter IX). The sampled spline and its derivatives are therefore cyclic convolutions
    of these values with the same spline coefficients. The Fourier transform converts convolutions
    into products, so the derivatives follow from the samples by a division.
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
