"""How much of the rig's limits a motion uses: on its exact splines, not on samples.

Between two times h apart a curve is within h^2 max |c''| / 8 of its chord; pieces that can still
hide a peak are cut until it is bounded to 1e-6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..rig import Rig
from .cycle import PlateCycle, quintic_pieces
from .kinematics import motor_state

CERTAINTY = 1e-6
"""A peak comes out too high by this fraction of its value at most."""

CUTS = 8
"""Pieces that may hide a peak are cut in so many: the bound's gap is 1/64 then."""

MOST_PIECES = 4000
"""More parts than this, beyond the motion's own pieces, are not examined: the bound so far is the
answer, too high for a motion far beyond any limit. Others take some 20."""

GAUSS_U, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(6)
"""Exact for polynomials up to degree 11: for the square of a quintic."""

Curve = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(piece (n,), time since its start (n,) [s]) to values (n, j)."""


@dataclass(frozen=True)
class CycleUsage:
    """Peaks of a motion, and what they are of the rig's limits.

    Attributes
    ----------
    stroke_m, speed : float
        Of the motor that moves most [m] and fastest [m/s].
    accel : float
        Of the plate's corners [m/s2], so of any point of the plate: it is convex in the point.
    force : float
        Of the motor that pushes hardest [N].
    thermal_load : (4,)
        Mean square force of each motor over that of its continuous force [-].
    worst : float
        Greatest of stroke, speed and acceleration as a fraction of its limit.
    overall : float
        The same with force, and with the root of the thermal load over what is allowed of it.
    """

    stroke_m: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    force: float = 0.0
    thermal_load: np.ndarray = field(default_factory=lambda: np.zeros(4))
    worst: float = 0.0
    overall: float = 0.0


def usage(rig: Rig, cycle: PlateCycle, thermal_load: np.ndarray | float = 1.0) -> CycleUsage:
    """Return what a plate cycle and its tail use, the motors on the quintics through the knots.

    Parameters
    ----------
    thermal_load : (4,) or float
        What is allowed of `CycleUsage.thermal_load`; more than 1 for motors that are cold.
    """
    limits, parts = rig.limits, cycle.parts
    steps = np.concatenate([np.diff(part.times) for part in parts])
    travel = np.concatenate([_travel(rig, part) for part in parts])
    pushes = np.concatenate([motor_force(rig, part) for part in parts])
    moves = [travel, _padded(derivative(travel)), pushes]
    each = polynomial_peaks(np.concatenate(moves, axis=2), steps)
    stroke, speed, force = (float(np.max(most)) for most in np.split(each, 3))
    accel = max(_corner_peak(rig, part) for part in parts)
    # The tail is played once, or not at all.
    load = np.maximum(*(mean_square(pushes[:k], steps[:k]) for k in (len(cycle.times) - 1, None)))
    load = load / limits.continuous_force**2
    worst = max(stroke / limits.stroke_m, speed / limits.speed, accel / limits.accel)
    warmth = float(np.sqrt(np.max(load / thermal_load)))
    overall = max(worst, force / limits.force, warmth)
    return CycleUsage(stroke, speed, accel, force, load, worst, overall)


def _travel(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Powers (k, 6, 4) of the time since the knot of the motors' travels [m]."""
    motors = motor_state(rig, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    return quintic_pieces(cycle.times, *motors)


def motor_force(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Powers (k, 6, 4) of the time since the knot of the motors' forces [N].

    They carry the plate's mass and, where the rig file tells of flexures, stretch those:
    see `Rig.motor_loads`.
    """
    pose = cycle.coefficients
    return np.asarray(
        sum(
            _padded(derivative(pose, order)) @ load.T
            for order, load in enumerate(rig.motor_loads)
            if np.any(load)
        )
    )


def polynomial_peaks(
    coefficients: np.ndarray, steps: np.ndarray, enough: float = 0.0
) -> np.ndarray:
    """Greatest magnitudes (m,) of pieces (k, d, m) in powers of time, over their lengths [s].

    Below `enough` they are not searched for closely: such a one may come out too low.
    """
    count, powers, columns = coefficients.shape
    each = coefficients.transpose(0, 2, 1).reshape(-1, powers, 1)
    steps = np.repeat(steps, columns)
    bend = _largest(derivative(each, 2), steps)[:, 0]
    column = np.tile(np.arange(columns), count)
    return _peaks(lambda piece, t: np.abs(_at(each[piece], t)), bend, steps, column, enough)


def mean_square(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Mean square (m,) over all pieces (k, 6, m), exact but for rounding."""
    total = np.zeros(coefficients.shape[2])
    for u, weight in zip(GAUSS_U, GAUSS_WEIGHT, strict=True):
        value = _at(coefficients, steps * (1 + u) / 2)
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


def _corner_peak(rig: Rig, cycle: PlateCycle) -> float:
    """Greatest acceleration of the plate's corners [m/s2].

    With S = R r, J the quarter turn, w = theta': A = a + w' J S - w^2 S, and so
    |A''| <= |a''| + |r| (|w'''| + 4 |w w''| + 3 w'^2 + 6 w^2 |w'| + w^4).
    """
    steps = np.diff(cycle.times)
    pose = cycle.coefficients
    orders = [derivative(pose, order) for order in range(5)]
    w, w1, w2, w3 = (_largest(order[:, :, 2:], steps)[:, 0] for order in orders[1:])
    radius = float(np.hypot(*rig.plate.half))
    turning = w3 + 4 * w * w2 + 3 * w1**2 + 6 * w**2 * w1 + w**4
    bend = np.hypot(*_largest(orders[4][:, :, :2], steps).T) + radius * turning

    def curve(piece: np.ndarray, t: np.ndarray) -> np.ndarray:
        return corner_accel(rig, *(_at(order[piece], t) for order in orders[:3]))

    return float(_peaks(curve, bend, steps, np.zeros(len(steps), int))[0])


def _peaks(
    curve: Curve, bend: np.ndarray, steps: np.ndarray, group: np.ndarray, enough: float = 0.0
) -> np.ndarray:
    """Return the peak of each group of curves; `group` (k,) tells which one a piece belongs to.

    Their vectors bend by at most `bend` (k,), the second derivative: between two times h apart a
    curve is within h^2 bend/8 of its chord. Pieces that can still hide a peak are cut in `CUTS`.
    What cannot be computed is infinite.
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
        if len(hiding) > MOST_PIECES + len(steps):
            np.maximum.at(low, group[piece], np.max(high, axis=1))
            return low
        piece, start, length, spans = piece[hiding], t[hiding, span], length[hiding], CUTS


def _at(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values (n, m) of polynomials (n, d, m) at times t (n,) since their start."""
    value = coefficients[:, -1]
    for power in range(coefficients.shape[1] - 2, -1, -1):
        value = value * t[:, None] + coefficients[:, power]
    return np.asarray(value)


def derivative(coefficients: np.ndarray, order: int = 1) -> np.ndarray:
    """Return the derivative (k, d - order, m) of pieces (k, d, m) in powers of time."""
    for _ in range(order):
        coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[:, None]
    return coefficients


def _padded(coefficients: np.ndarray) -> np.ndarray:
    return np.pad(coefficients, ((0, 0), (0, 6 - coefficients.shape[1]), (0, 0)))


def _largest(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Bound (k, m) of the magnitude of pieces over their lengths."""
    powers = steps[:, None] ** np.arange(coefficients.shape[1])
    return np.asarray(np.einsum("kdm,kd->km", np.abs(coefficients), powers))
