"""Method B's inversion (section 3.2.3), compiled from end to end: damped Gauss-Newton.

Scale and shift in time leave the averaged forces of parts at rest unchanged. Steps of least norm
are orthogonal to both, so none is wasted on them; the scale is spent on the limits: motions are
kept at full amplitude, where the parts' own velocities matter least.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from .harmonic_force import Rules, force_of, slip_at
from .solution import peaks

FIRST_DAMPING, WARM_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-4, 1e-9, 1e2
"""In units of the mean squared row of the Jacobian; the second where a solution is near."""

STALL_STEPS, STALL_SHARE = 6, 0.7
"""A search is given up where so many steps leave more than this share of the squared error."""
SWEEPS, ORTHOGONAL = 12, 1e-6
"""Rounds of rotations at most, and the cosine at which rows count as orthogonal: a condition number
to six digits."""


class Waves(NamedTuple):
    """What averages need of a family of motions with N harmonics.

    Attributes
    ----------
    rule : Rules
        Nodes of the averages.
    span : (2 N, h)
        Coefficients of sin 1..N, cos 1..N from the family's.
    scale : (3,)
        Coefficients from parameters, columns x, y, theta.
    """

    rule: Rules
    span: np.ndarray
    scale: np.ndarray


class Motions(NamedTuple):
    """What the search knows of a family of motions, in plain numbers.

    Attributes
    ----------
    waves : Waves
    pose, twist, accel : (n, h)
        Samples of the family, for the limits.
    motor_rows : (4, 3)
    half : (2,)
    most : (3,)
        Stroke [m], speed [m/s], acceleration [m/s2]; as in `Bounds`.
    """

    waves: Waves
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    motor_rows: np.ndarray
    half: np.ndarray
    most: np.ndarray


@njit(cache=True, fastmath=True, error_model="numpy")
def product(basis: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return a basis (n, h) times coefficients (h, 3): a library takes longer to call than this."""
    samples = np.empty((len(basis), 3))
    for k in range(len(basis)):
        x = y = turn = 0.0
        for h in range(len(own)):
            share = basis[k, h]
            x += share * own[h, 0]
            y += share * own[h, 1]
            turn += share * own[h, 2]
        samples[k, 0], samples[k, 1], samples[k, 2] = x, y, turn
    return samples


@njit(cache=True, fastmath=True, error_model="numpy")
def full_amplitude(theta: np.ndarray, motions: Motions) -> np.ndarray:
    """Scale parameters (3 h,) so that the samples just reach the first of the limits."""
    own = theta.reshape(-1, 3) * motions.waves.scale
    stroke, speed, peak = peaks(
        product(motions.pose, own), product(motions.twist, own), product(motions.accel, own),
        motions.motor_rows, motions.half,
    )  # fmt: skip
    share = max(stroke / motions.most[0], speed / motions.most[1], peak / motions.most[2])
    return theta / share if share > 0 else theta


class Desk(NamedTuple):
    """Room to write on: coefficients (2 N, 3), slip (2 N + 1, 2), samples, slopes (3, 2 N)."""

    coefficients: np.ndarray
    slip: np.ndarray
    work: np.ndarray
    gradient: np.ndarray
    none: np.ndarray


@njit(cache=True)
def desk_for(waves: Waves, work: np.ndarray) -> Desk:
    """Return the room that `force_error` needs; work (5, n): for the nodes of the finest grid."""
    rows = len(waves.span)
    return Desk(
        np.empty((rows, 3)),
        np.empty((rows + 1, 2)),
        work,
        np.empty((3, rows)),
        np.empty((0, 0)),
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _combine(waves: Waves, theta: np.ndarray, coefficients: np.ndarray) -> None:
    span, scale = waves.span, waves.scale
    rows, own = span.shape
    for j in range(rows):
        a = b = c = 0.0
        for h in range(own):
            share = span[j, h]
            a += share * theta[3 * h]
            b += share * theta[3 * h + 1]
            c += share * theta[3 * h + 2]
        coefficients[j, 0] = a * scale[0]
        coefficients[j, 1] = b * scale[1]
        coefficients[j, 2] = c * scale[2]


@njit(cache=True, fastmath=True, error_model="numpy")
def force_error(
    theta: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    waves: Waves,
    grid: int,
    error: np.ndarray,
    jacobian: np.ndarray,
    desk: Desk,
) -> float:
    """Write request minus average force (2 M,), and d force / d theta (2 M, 3 h) unless it is
    (0, 0); return the squared error. `grid` as in `force_of`."""
    rule, span, scale = waves
    rows, own = span.shape
    coefficients, slip, work, gradient, none = desk
    _combine(waves, theta, coefficients)
    cost = 0.0
    count = len(position)
    for i in range(count):
        x, y = position[i, 0], position[i, 1]
        slip_at(coefficients, x, y, velocity[i, 0], velocity[i, 1], slip)
        fx, fy = force_of(slip, rule, grid, work, gradient if len(jacobian) else none)
        error[2 * i], error[2 * i + 1] = force[i, 0] - fx, force[i, 1] - fy
        cost += error[2 * i] ** 2 + error[2 * i + 1] ** 2
        if not len(jacobian):
            continue
        for h in range(own):
            xx = xy = yy = 0.0
            for j in range(rows):
                share = span[j, h]
                xx += gradient[0, j] * share
                xy += gradient[1, j] * share
                yy += gradient[2, j] * share
            for axis in range(2):
                gx, gy = (xx, xy) if axis == 0 else (xy, yy)
                row = 2 * i + axis
                jacobian[row, 3 * h] = gx * scale[0]
                jacobian[row, 3 * h + 1] = gy * scale[1]
                jacobian[row, 3 * h + 2] = (x * gy - y * gx) * scale[2]
    return cost


@njit(cache=True, fastmath=True, error_model="numpy")
def least_step(jacobian: np.ndarray, error: np.ndarray, damping: float, step: np.ndarray) -> None:
    """Write the damped step of least norm: J' (J J' + damping mean(diag) 1)^-1 error."""
    rows, columns = jacobian.shape
    lower = np.empty((rows, rows))
    trace = 0.0
    for i in range(rows):
        for j in range(i + 1):
            total = 0.0
            for c in range(columns):
                total += jacobian[i, c] * jacobian[j, c]
            lower[i, j] = total
        trace += lower[i, i]
    more = damping * trace / rows + 1e-300
    weights = error.copy()
    for i in range(rows):  # Cholesky, and forward substitution
        lower[i, i] += more
        for j in range(i + 1):
            total = lower[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = sqrt(max(total, 1e-300)) if i == j else total / lower[j, j]
        for k in range(i):
            weights[i] -= lower[i, k] * weights[k]
        weights[i] /= lower[i, i]
    for i in range(rows - 1, -1, -1):
        for k in range(i + 1, rows):
            weights[i] -= lower[k, i] * weights[k]
        weights[i] /= lower[i, i]
    for c in range(columns):
        step[c] = 0.0
        for i in range(rows):
            step[c] += weights[i] * jacobian[i, c]


@njit(cache=True, error_model="numpy")
def condition_of(jacobian: np.ndarray) -> float:
    """Return the condition number (infinite where rank is lost), by Jacobi's rotations of rows."""
    rows = jacobian.copy()
    count, columns = rows.shape
    for _ in range(SWEEPS):
        turned = False
        for i in range(count):
            for j in range(i):
                a = b = c = 0.0
                for k in range(columns):
                    a += rows[i, k] * rows[i, k]
                    b += rows[j, k] * rows[j, k]
                    c += rows[i, k] * rows[j, k]
                if abs(c) <= ORTHOGONAL * sqrt(a * b):
                    continue
                turned = True
                half = (b - a) / (2 * c)
                tangent = (1.0 if half >= 0 else -1.0) / (abs(half) + sqrt(1 + half * half))
                cosine = 1 / sqrt(1 + tangent * tangent)
                sine = cosine * tangent
                for k in range(columns):
                    first, second = rows[i, k], rows[j, k]
                    rows[i, k] = cosine * first - sine * second
                    rows[j, k] = sine * first + cosine * second
        if not turned:
            break
    least, most = np.inf, 0.0
    for i in range(count):
        square = 0.0
        for k in range(columns):
            square += rows[i, k] * rows[i, k]
        least, most = min(least, square), max(most, square)
    return sqrt(most / least) if least > 1e-30 * most else np.inf


@njit(cache=True, fastmath=True, error_model="numpy")
def descend(
    theta: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    grid: int,
    tolerance: float,
    iterations: int,
    damping: float,
    desk: Desk,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Correct a motion until its forces are as asked.

    Returns
    -------
    theta, error, jacobian, iterations
        Parameters (3 h,), request minus force (2 M,), its derivative, steps.
    """
    moving, waves = bool(np.any(velocity != 0.0)), motions.waves
    size, rows = len(theta), 2 * len(position)
    if moving:  # else the scale does not matter
        theta = full_amplitude(theta, motions)
    error, other = np.empty(rows), np.empty(rows)
    jacobian, slopes = np.empty((rows, size)), np.empty((rows, size))
    step = np.zeros(size)
    history = np.empty(iterations + 1)
    cost, done, trial = np.inf, 0, theta
    while True:
        trial_cost = force_error(trial, position, velocity, force, waves, grid, other, slopes, desk)
        if trial_cost < cost:
            damping = max(damping / 8, LEAST_DAMPING) if cost < np.inf else damping
            theta, cost = trial, trial_cost
            error, other = other, error
            jacobian, slopes = slopes, jacobian
        else:
            damping *= 6
        history[done] = cost
        stalled = done >= STALL_STEPS and cost > STALL_SHARE * history[done - STALL_STEPS]
        if done == iterations or stalled or damping > MOST_DAMPING:
            break
        if np.max(np.abs(error)) <= tolerance:
            break
        done += 1
        least_step(jacobian, error, damping, step)
        trial = theta + step
        if moving:
            trial = full_amplitude(trial, motions)
    return theta, error, jacobian, done
