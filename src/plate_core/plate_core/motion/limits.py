"""Peak values of a plate motion as fractions of the rig's limits.

The peaks are computed for the exact splines, not only for samples. Between two times with the
difference h, a curve deviates from its chord by at most h^2 max(c'') / 8. c'' is the magnitude of
its second derivative. Pieces of the curve that may contain a higher peak are cut until the bound
exceeds the peak by a relative error of at most 1e-6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..rig import Rig
from .cycle import PlateCycle, quintic_pieces
from .kinematics import motor_state

CERTAINTY = 1e-6
"""Maximum relative error by which a computed peak exceeds the exact peak [-]."""

CUTS = 8
"""Number of parts into which a piece that may contain a peak is cut. Each cut reduces the
difference between the upper bound and the peak to 1/64."""

MAX_PIECES = 4000
"""Maximum number of parts that are examined, in addition to the motion's pieces. If more parts are
needed, the search ends and returns its present upper bound, which is higher than the peak. Only
motions far beyond all limits need more parts. Most motions need about 20 parts."""

GAUSS_U, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(6)
"""Nodes and weights of Gauss-Legendre quadrature with 6 nodes. This quadrature is exact for
polynomials up to degree 11, and therefore for the square of a quintic."""

Curve = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function that returns values (n, j). The arguments of the function are the indices (n,) of
pieces, and times (n,) since the starts of these pieces [s]."""


@dataclass(frozen=True)
class CycleUsage:
    """Peak values of a motion, and their fractions of the rig's limits.

    Attributes
    ----------
    stroke_m, speed : float
        Maximum travel [m] and speed [m/s] of all motors.
    accel : float
        Maximum acceleration of the plate's corners [m/s2]. No point of the plate has a larger
        acceleration, because the magnitude of the acceleration is a convex function of the point.
    force : float
        Maximum force of all motors [N].
    thermal_load : (4,)
        Mean square force of each motor divided by its squared continuous force [-].
    worst : float
        Maximum of stroke, speed and acceleration, each as a fraction of its limit.
    overall : float
        Maximum of three values: `worst`, the force as a fraction of its limit, and the square root
        of the thermal load divided by its limit.
    """

    stroke_m: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    force: float = 0.0
    thermal_load: np.ndarray = field(default_factory=lambda: np.zeros(4))
    worst: float = 0.0
    overall: float = 0.0


def usage(rig: Rig, cycle: PlateCycle, thermal_load: np.ndarray | float = 1.0) -> CycleUsage:
    """Return the peaks of a plate cycle and its tail, and their fractions of the rig's limits.

    The motors follow the quintics through their states at the knots.

    Parameters
    ----------
    thermal_load : (4,) or float
        Allowed `CycleUsage.thermal_load` [-]. The allowed load can exceed 1 while the motors are
        cold.
    """
    limits, parts = rig.limits, cycle.parts
    steps = np.concatenate([np.diff(part.times) for part in parts])
    travel = np.concatenate([_motor_travel(rig, part) for part in parts])
    pushes = np.concatenate([motor_force(rig, part) for part in parts])
    moves = [travel, _pad_to_quintic(derivative(travel)), pushes]
    all_peaks = polynomial_peaks(np.concatenate(moves, axis=2), steps)
    stroke, speed, force = (float(np.max(peaks)) for peaks in np.split(all_peaks, 3))
    accel = _max_corner_acceleration(
        rig, np.concatenate([part.coefficients for part in parts]), steps
    )
    # The tail of the cycle may be executed or not. Therefore use the larger load of both cases.
    load = np.maximum(*(mean_square(pushes[:k], steps[:k]) for k in (len(cycle.times) - 1, None)))
    load = load / limits.continuous_force**2
    worst = max(stroke / limits.stroke_m, speed / limits.speed, accel / limits.accel)
    warmth = float(np.sqrt(np.max(load / thermal_load)))
    overall = max(worst, force / limits.force, warmth)
    return CycleUsage(stroke, speed, accel, force, load, worst, overall)


def _motor_travel(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Polynomial coefficients (k, 6, 4) of the motor travels, in powers of the time since the knot
    [m]."""
    motors = motor_state(rig, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    return quintic_pieces(cycle.times, *motors)


def motor_force(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Polynomial coefficients (k, 6, 4) of the motor forces, in powers of the time since the knot
    [N].

    The forces accelerate the plate's mass. If the rig file describes flexures, the forces also
    deflect the flexures. See `Rig.motor_loads`.
    """
    pose = cycle.coefficients
    return np.asarray(
        sum(
            _pad_to_quintic(derivative(pose, order)) @ load.T
            for order, load in enumerate(rig.motor_loads)
            if np.any(load)
        )
    )


def polynomial_peaks(
    coefficients: np.ndarray, steps: np.ndarray, enough: float = 0.0
) -> np.ndarray:
    """Return the maximum magnitudes (m,) of piecewise polynomials.

    The coefficients (k, d, m) are in ascending powers of the time since the start of each piece.
    `steps` (k,) are the lengths of the pieces [s]. Peaks below `enough` are computed only coarsely,
    so a result below `enough` may be too low.
    """
    count, powers, columns = coefficients.shape
    polynomials = coefficients.transpose(0, 2, 1).reshape(-1, powers, 1)
    steps = np.repeat(steps, columns)
    bend = _magnitude_bound(derivative(polynomials, 2), steps)[:, 0]
    column = np.tile(np.arange(columns), count)
    return _find_peaks(
        lambda piece, t: np.abs(_evaluate_polynomials(polynomials[piece], t)),
        bend,
        steps,
        column,
        enough,
    )


def mean_square(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the mean square (m,) over all pieces (k, 6, m). The result is exact up to rounding."""
    total = np.zeros(coefficients.shape[2])
    for u, weight in zip(GAUSS_U, GAUSS_WEIGHT, strict=True):
        value = _evaluate_polynomials(coefficients, steps * (1 + u) / 2)
        total += weight / 2 * np.sum(steps[:, None] * value**2, axis=0)
    return np.asarray(total / np.sum(steps))


def corner_accel(rig: Rig, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray) -> np.ndarray:
    """Magnitude (n, 4) [m/s2] of the acceleration of the plate's corners."""
    cos, sin = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
    x, y = rig.plate.corners.T
    arm_x, arm_y = cos * x - sin * y, sin * x + cos * y
    spin2, spin_rate = twist[:, 2:] ** 2, accel[:, 2:]
    ax = accel[:, :1] - spin_rate * arm_y - spin2 * arm_x
    ay = accel[:, 1:2] + spin_rate * arm_x - spin2 * arm_y
    return np.hypot(ax, ay)


def _max_corner_acceleration(rig: Rig, pose: np.ndarray, steps: np.ndarray) -> float:
    """Maximum acceleration of the plate's corners [m/s2]. `pose` (k, 6, 3) contains the polynomial
    coefficients of k pieces of the plate's pose. `steps` (k,) contains the lengths of the pieces
    [s].

    Let r be a corner in the plate's frame, R the rotation by theta, S = R r, w = theta', a the
    acceleration of the plate's centre, and J the rotation by 90 degrees. The corner has the
    acceleration A = a + w' J S - w^2 S. If abs is the magnitude, the second derivative of A is
    bounded by abs(A'') <= abs(a'') + abs(r) (abs(w''') + 4 abs(w w'') + 3 w'^2 + 6 w^2 abs(w') +
    w^4).
    """
    orders = [derivative(pose, order) for order in range(5)]
    w, w1, w2, w3 = (_magnitude_bound(order[:, :, 2:], steps)[:, 0] for order in orders[1:])
    radius = float(np.hypot(*rig.plate.half))
    turning = w3 + 4 * w * w2 + 3 * w1**2 + 6 * w**2 * w1 + w**4
    bend = np.hypot(*_magnitude_bound(orders[4][:, :, :2], steps).T) + radius * turning

    def corner_acceleration(piece: np.ndarray, t: np.ndarray) -> np.ndarray:
        return corner_accel(rig, *(_evaluate_polynomials(order[piece], t) for order in orders[:3]))

    return float(_find_peaks(corner_acceleration, bend, steps, np.zeros(len(steps), int))[0])


def _find_peaks(
    curve: Curve, bend: np.ndarray, steps: np.ndarray, group: np.ndarray, enough: float = 0.0
) -> np.ndarray:
    """Return the peak of each group of curves. `group` (k,) is the group of each piece.

    `bend` (k,) is an upper bound of the magnitude of each piece's second derivative. Between two
    times with the difference h, a piece deviates from its chord by at most h^2 bend/8. Pieces that
    may contain a higher peak are cut into `CUTS` parts. If a bound is not finite, all peaks are
    infinite.
    """
    low = np.zeros(int(np.max(group)) + 1)
    piece, start, length = np.arange(len(steps)), np.zeros(len(steps)), np.asarray(steps, float)
    spans = 1
    while True:
        t = start[:, None] + length[:, None] * np.arange(spans + 1) / spans
        value = np.max(curve(np.repeat(piece, spans + 1), t.ravel()), axis=1).reshape(t.shape)
        np.maximum.at(low, group[piece], np.max(value, axis=1))
        length = length / spans
        high = np.maximum(value[:, :-1], value[:, 1:]) + (bend[piece] * length**2 / 8)[:, None]
        if not np.all(np.isfinite(high)):
            return np.full(len(low), np.inf)
        seen = np.maximum(low[group[piece]] * (1 + CERTAINTY), enough)
        hiding, span = np.nonzero(high > seen[:, None])
        if not len(hiding):
            return np.asarray(low * (1 + CERTAINTY))
        if len(hiding) > MAX_PIECES + len(steps):
            np.maximum.at(low, group[piece], np.max(high, axis=1))
            return low
        piece = piece[hiding]
        start = t[hiding, span]
        length = length[hiding]
        spans = CUTS


def _evaluate_polynomials(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values (n, m) of polynomials (n, d, m) at the times t (n,) since the start of each
    polynomial."""
    value, t = coefficients[:, -1].copy(), t[:, None]
    for power in range(coefficients.shape[1] - 2, -1, -1):
        value *= t
        value += coefficients[:, power]
    return value


def derivative(coefficients: np.ndarray, order: int = 1) -> np.ndarray:
    """Return the coefficients (k, d - order, m) of the derivative of polynomial pieces (k, d, m).
    All coefficients are in ascending powers of time."""
    for _ in range(order):
        coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[:, None]
    return coefficients


def _pad_to_quintic(coefficients: np.ndarray) -> np.ndarray:
    return np.pad(coefficients, ((0, 0), (0, 6 - coefficients.shape[1]), (0, 0)))


def _magnitude_bound(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Upper bound (k, m) of the magnitude of each piece over its length."""
    powers = steps[:, None] ** np.arange(coefficients.shape[1])
    return np.asarray(np.einsum("kdm,kd->km", np.abs(coefficients), powers))
