"""Sequences of rotations on the averaged map, compiled from end to end: damped Gauss-Newton.

The derivatives are those of `sequence` and `stepped_map`, taken together: what a step of the motion
does to all forces goes straight to the knots of its segment.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from .harmonic_fit import least_step
from .least_squares import FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING
from .sequence import corners_back, knot_poses, motion, ramps, timeline, timeline_back
from .solution import peaks
from .stepped_map import TINY_SQUARE, mean_forces

SHORTEST, FASTEST = 0.02, 2.5
"""Least length of a rotation and greatest speed, in units of their usual values."""

MOST_RAMPS = 0.9
"""Greatest share of the period that ramps may take."""

STALL_STEPS, STALL_SHARE = 10, 0.9
"""A search is given up where so many steps leave more than this share of the squared error: sooner,
and forces are missed that can be had."""


class Sequences(NamedTuple):
    """A family of sequences of J rotations in plain numbers; see `RotationFamily`.

    Attributes
    ----------
    basis : (J, F, 3)
        Twist j is its F parameters times basis j.
    hold_scale : float
        Length of a rotation from its parameter.
    period, accel, blend : float
        [s], peak acceleration of ramps [m/s2], least ramp [s].
    steps : (int, int)
        Of a ramp and of a hold.
    motor_rows, half : (4, 3), (2,)
    most : (3,)
        Stroke [m] (infinite if it is not counted), speed [m/s], acceleration [m/s2].
    """

    basis: np.ndarray
    hold_scale: float
    period: float
    accel: float
    blend: float
    steps: tuple[int, int]
    motor_rows: np.ndarray
    half: np.ndarray
    most: np.ndarray


Line = tuple[np.ndarray, np.ndarray]
Moved = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@njit(cache=True, fastmath=True, error_model="numpy")
def split(theta: np.ndarray, family: Sequences) -> tuple[np.ndarray, np.ndarray]:
    """Return holds (J + 1,) and twists (J, 3) of parameters."""
    count, own = family.basis.shape[:2]
    twists = np.zeros((count, 3))
    for j in range(count):
        for q in range(own):
            value = theta[count + 1 + j * own + q]
            for c in range(3):
                twists[j, c] += value * family.basis[j, q, c]
    return theta[: count + 1] * family.hold_scale, twists


@njit(cache=True, fastmath=True)
def line_of(theta: np.ndarray, family: Sequences) -> Line:
    """Return knot times and twists there, as `timeline`."""
    holds, twists = split(theta, family)
    ramp, _ = ramps(twists, family.half, family.accel, family.blend)
    return timeline(holds, twists, ramp, family.period)


@njit(cache=True, fastmath=True)
def admissible(theta: np.ndarray, family: Sequences) -> tuple[np.ndarray, Line, Moved]:
    """Keep lengths positive, and the motion within the limits; return its knots and samples."""
    theta = theta.copy()
    count, own = family.basis.shape[:2]
    for j in range(count + 1):
        theta[j] = max(theta[j], SHORTEST)
    speeds = theta[count + 1 :]
    for j in range(count):
        size = sqrt(np.sum(speeds[j * own : (j + 1) * own] ** 2))
        speeds[j * own : (j + 1) * own] /= max(size / FASTEST, 1.0)
    for _ in range(8):
        ramp, _ = ramps(split(theta, family)[1], family.half, family.accel, family.blend)
        share = ramp.sum() / (MOST_RAMPS * family.period)
        if share > 1:
            speeds /= 1.001 * share
        line = line_of(theta, family)
        moved = motion(line[0], line[1], family.steps)
        stroke, speed, peak = peaks(moved[0], moved[1], moved[2], family.motor_rows, family.half)
        share = max(stroke / family.most[0], speed / family.most[1], peak / family.most[2])
        if share <= 1:
            return theta, line, moved
        speeds /= 1.01 * share
    line = line_of(theta, family)
    return theta, line, motion(line[0], line[1], family.steps)


@njit(cache=True, fastmath=True, error_model="numpy")
def slopes(
    theta: np.ndarray,
    family: Sequences,
    line: Line,
    position: np.ndarray,
    velocity: np.ndarray,
    asked: np.ndarray,
) -> np.ndarray:
    """Return the derivatives (R, P) of `mean_forces`, of the R rows `asked` (3 M,) bool only."""
    times, knots = line
    count, segments, period = len(position), len(times) - 1, times[-1]
    turning = bool(np.any(asked[2::3]))
    gap = knot_poses(times, knots)[-1]
    by_time, by_knot = np.zeros((3 * count, segments + 1)), np.zeros((3 * count, segments + 1, 3))
    by_corner = np.zeros((3 * count, segments + 1, 3))
    size = (8 if turning else 5) * count
    value, way = np.zeros((8, count)), np.zeros((3, count))
    flat, weight, total = value.reshape(-1), np.empty(5), np.empty((5, size))
    for k in range(segments):
        h, parts = times[k + 1] - times[k], family.steps[k % 2]
        total[:] = 0.0
        way[:] = 0.0
        for part in range(parts):
            x = (part + 0.5) / parts
            y = (times[k] + h * x) / period
            s, rate = x * x * (3 - 2 * x), 30 * y * y * (1 - y) ** 2 / period
            bend = 60 * y * (1 - y) * (1 - 2 * y) / period**2
            weight[0], weight[1], weight[2] = 1 - s, s, rate
            weight[3], weight[4] = bend * (1 - x), bend * x
            u = knots[k, 0] * (1 - s) + knots[k + 1, 0] * s - gap[0] * rate
            v = knots[k, 1] * (1 - s) + knots[k + 1, 1] * s - gap[1] * rate
            spin = knots[k, 2] * (1 - s) + knots[k + 1, 2] * s - gap[2] * rate
            _directions(u, v, spin, position, velocity, h / (parts * period), turning, value, way)
            for w in range(5):
                for i in range(size):
                    total[w, i] += weight[w] * flat[i]
        _to_knots(k, parts, period, gap, total, way, turning, by_time, by_knot, by_corner)
    corners_back(times, knots, by_corner, by_time, by_knot)
    holds, twists = split(theta, family)
    ramp, slope = ramps(twists, family.half, family.accel, family.blend)
    by_hold, by_twist = timeline_back(
        holds, ramp, slope, family.period, by_time[asked], by_knot[asked]
    )
    number, own = family.basis.shape[:2]
    jacobian = np.empty((len(by_hold), len(theta)))
    for r in range(len(by_hold)):
        for j in range(number + 1):
            jacobian[r, j] = by_hold[r, j] * family.hold_scale
        for j in range(number):
            for q in range(own):
                along = 0.0
                for c in range(3):
                    along += by_twist[r, j, c] * family.basis[j, q, c]
                jacobian[r, number + 1 + j * own + q] = along
    return jacobian


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _directions(
    u: float, v: float, spin: float, position: np.ndarray, velocity: np.ndarray, share: float,
    turning: bool, value: np.ndarray, way: np.ndarray,
) -> None:  # fmt: skip
    """Write the derivatives of each part's force and curl by a twist, in a step that lasts `share`
    of the period; add force and curl to `way` (3, M).

    Rows of `value`: force x by u and v, force y by v, both by spin; curl by u, v, spin.
    """
    for i in range(len(position)):
        x, y = position[i, 0], position[i, 1]
        dx, dy = u - spin * y - velocity[i, 0], v + spin * x - velocity[i, 1]
        square = dx * dx + dy * dy
        inverse = 1 / sqrt(max(square, TINY_SQUARE))
        a, b = dx * inverse, dy * inverse
        own = share * inverse if square > TINY_SQUARE else 0.0
        xx, xy, yy = own * (1 - a * a), -own * a * b, own * (1 - b * b)
        value[0, i], value[1, i], value[2, i] = xx, xy, yy
        value[3, i], value[4, i] = x * xy - y * xx, x * yy - y * xy
        way[0, i] += a
        way[1, i] += b
        if turning:
            curl = spin * inverse
            gx, gy = -own * a * curl, -own * b * curl
            value[5, i], value[6, i], value[7, i] = gx, gy, x * gy - y * gx + own
            way[2, i] += curl


@njit(cache=True, fastmath=True, error_model="numpy")
def _to_knots(
    k: int, parts: int, period: float, gap: np.ndarray, total: np.ndarray, way: np.ndarray,
    turning: bool, by_time: np.ndarray, by_knot: np.ndarray, by_corner: np.ndarray,
) -> None:  # fmt: skip
    """Add what the steps of segment k do, weighted by where in it they are, to its knots."""
    count, last = way.shape[1], by_time.shape[1] - 1
    for i in range(count):
        for axis in range(3 if turning else 2):
            r = 3 * i + axis
            longer = way[axis, i] / (parts * period)
            by_time[r, k] -= longer
            by_time[r, k + 1] += longer
            for c in range(3):
                if axis == 2:
                    row = 5 + c
                elif c == 2:
                    row = 3 + axis
                else:
                    row = axis + c
                at = row * count + i
                by_knot[r, k, c] += total[0, at]
                by_knot[r, k + 1, c] += total[1, at]
                by_corner[r, last, c] -= total[2, at]
                by_time[r, k] -= gap[c] * total[3, at]
                by_time[r, k + 1] -= gap[c] * total[4, at]


@njit(cache=True, fastmath=True, error_model="numpy")
def descend(
    theta: np.ndarray,
    family: Sequences,
    position: np.ndarray,
    velocity: np.ndarray,
    wanted: np.ndarray,
    asked: np.ndarray,
    scale: np.ndarray,
    tolerance: float,
    iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Correct a sequence until its average forces are as asked, as `least_squares.fit` does.

    Parameters
    ----------
    theta : (P,)
        Start.
    position, velocity : (M, 2)
    wanted, asked : (3 M,)
        Force x, y [mu m g] and curl of each part; which of them.
    scale : (3 M,)
        Makes errors of them.

    Returns
    -------
    theta, error (R,), jacobian (R, P), iterations
        The Jacobian is that of minus the errors.
    """
    rows, units = wanted[asked], scale[asked]
    theta, line, moved = admissible(theta, family)
    error = (rows - mean_forces(position, velocity, moved[1], moved[3]).ravel()[asked]) * units
    jacobian = units.reshape(-1, 1) * slopes(theta, family, line, position, velocity, asked)
    cost, damping, done = np.sum(error * error), FIRST_DAMPING, 0
    step, history = np.empty(len(theta)), np.empty(iterations + 1)
    while np.max(np.abs(error)) > tolerance and done < iterations:
        history[done] = cost
        if done >= STALL_STEPS and cost > STALL_SHARE * history[done - STALL_STEPS]:
            break
        done += 1
        least_step(jacobian, error, damping, step)
        trial, line, moved = admissible(theta + step, family)
        other = (rows - mean_forces(position, velocity, moved[1], moved[3]).ravel()[asked]) * units
        if np.sum(other * other) < cost:
            theta, error, cost = trial, other, np.sum(other * other)
            jacobian = units.reshape(-1, 1) * slopes(theta, family, line, position, velocity, asked)
            damping = max(damping / 3, LEAST_DAMPING)
        else:
            damping *= 4
            if damping > MOST_DAMPING:
                break
    return theta, error, jacobian, done
