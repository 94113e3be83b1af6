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

from .harmonic_force import ADAPTIVE, FEW, FIRST, Rules, force_of, slip_at
from .solution import peaks

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-9, 1e2
"""In units of the mean squared row of the Jacobian."""

STALL_STEPS, STALL_SHARE = 6, 0.7
"""A search is given up where so many steps leave more than this share of the squared error."""

FEW_CANDIDATES = 12
"""Random motions that are tried at the parts' places for each first guess: a few microseconds."""


class Motions(NamedTuple):
    """What the search knows of a family of motions with N harmonics, in plain numbers.

    Attributes
    ----------
    rule : Rules
        Nodes of the averages.
    span : (2 N, h)
        Coefficients of sin 1..N, cos 1..N from the family's.
    scale : (3,)
        Coefficients from parameters, columns x, y, theta.
    pose, twist, accel : (n, h)
        Samples of the family, for the limits.
    motor_rows : (4, 3)
    half : (2,)
    most : (3,)
        Stroke [m], speed [m/s], acceleration [m/s2]; as in `Bounds`.
    """

    rule: Rules
    span: np.ndarray
    scale: np.ndarray
    pose: np.ndarray
    twist: np.ndarray
    accel: np.ndarray
    motor_rows: np.ndarray
    half: np.ndarray
    most: np.ndarray


@njit(cache=True, fastmath=True, error_model="numpy")
def full_amplitude(theta: np.ndarray, motions: Motions) -> np.ndarray:
    """Scale parameters (3 h,) so that the samples just reach the first of the limits."""
    own = theta.reshape(-1, 3) * motions.scale
    stroke, speed, peak = peaks(
        motions.pose @ own, motions.twist @ own, motions.accel @ own,
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
def desk_for(motions: Motions) -> Desk:
    """Return the room that `force_error` needs."""
    rows = len(motions.span)
    return Desk(
        np.empty((rows, 3)),
        np.empty((rows + 1, 2)),
        np.empty((5, len(motions.rule.shares[-1]))),
        np.empty((3, rows)),
        np.empty((0, 0)),
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _combine(motions: Motions, theta: np.ndarray, coefficients: np.ndarray) -> None:
    rows, own = motions.span.shape
    for j in range(rows):
        a = b = c = 0.0
        for h in range(own):
            share = motions.span[j, h]
            a += share * theta[3 * h]
            b += share * theta[3 * h + 1]
            c += share * theta[3 * h + 2]
        coefficients[j, 0] = a * motions.scale[0]
        coefficients[j, 1] = b * motions.scale[1]
        coefficients[j, 2] = c * motions.scale[2]


@njit(cache=True, fastmath=True, error_model="numpy")
def force_error(
    theta: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    grid: int,
    error: np.ndarray,
    jacobian: np.ndarray,
    desk: Desk,
) -> float:
    """Write request minus average force (2 M,), and d force / d theta (2 M, 3 h) unless it is
    (0, 0); return the squared error. `grid` as in `force_of`."""
    rule = motions.rule
    rows, own = motions.span.shape
    coefficients, slip, work, gradient, none = desk
    _combine(motions, theta, coefficients)
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
                share = motions.span[j, h]
                xx += gradient[0, j] * share
                xy += gradient[1, j] * share
                yy += gradient[2, j] * share
            for axis in range(2):
                gx, gy = (xx, xy) if axis == 0 else (xy, yy)
                row = jacobian[2 * i + axis]
                row[3 * h] = gx * motions.scale[0]
                row[3 * h + 1] = gy * motions.scale[1]
                row[3 * h + 2] = (x * gy - y * gx) * motions.scale[2]
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
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Correct a motion until its forces are as asked.

    Returns
    -------
    theta, error, jacobian, iterations
        Parameters (3 h,), request minus force (2 M,), its derivative, steps.
    """
    moving = bool(np.any(velocity != 0.0))
    size, rows = len(theta), 2 * len(position)
    if moving:  # else the scale does not matter
        theta = full_amplitude(theta, motions)
    error, other = np.empty(rows), np.empty(rows)
    jacobian, slopes = np.empty((rows, size)), np.empty((rows, size))
    step = np.zeros(size)
    history = np.empty(iterations + 1)
    desk = desk_for(motions)
    cost, damping, done, trial = np.inf, FIRST_DAMPING, 0, theta
    while True:
        trial_cost = force_error(
            trial, position, velocity, force, motions, grid, other, slopes, desk
        )
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


@njit(cache=True, fastmath=True, error_model="numpy")
def search(
    firsts: np.ndarray,
    pool: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
    tolerance: float,
    iterations: int,
    tries: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Try starts until one leads to the forces asked for; keep the best.

    Parameters
    ----------
    firsts : (F, 3 h)
        Starts that are tried first, as they are.
    pool : (S, 3 h)
        Random motions: each further start is the best of the next `FEW_CANDIDATES`, forwards and
        backwards, at the parts' places.

    Returns
    -------
    theta, error, jacobian, iterations, tries
        As `descend`, at full amplitude; iterations of all tries together.
    """
    best_cost = np.inf
    best = (pool[0], np.empty(0), np.empty((0, 0)))
    total, turn = 0, 0
    for tried in range(tries):
        if tried < len(firsts):
            start = firsts[tried]
        else:
            start = _most_like(pool, turn, position, velocity, force, motions)
            turn = (turn + FEW_CANDIDATES) % len(pool)
        theta, most = start, iterations
        for grid in (FIRST, ADAPTIVE):
            theta, error, jacobian, done = descend(
                theta, position, velocity, force, motions, grid, tolerance / 3, most
            )
            total += done
            cost, worst = np.sum(error * error), np.max(np.abs(error))
            # Equal steps may miss a dip: what looks good, or is the best so far, is looked at.
            if worst > tolerance and cost >= best_cost:
                break
            if worst > 30 * tolerance:
                most = 0
        if cost < best_cost:
            best_cost, best = cost, (theta, error, jacobian)
        if np.max(np.abs(best[1])) <= tolerance:
            tries = tried + 1
            break
    return full_amplitude(best[0], motions), best[1], best[2], total, tries


@njit(cache=True, fastmath=True, error_model="numpy")
def _most_like(
    starts: np.ndarray,
    first: int,
    position: np.ndarray,
    velocity: np.ndarray,
    force: np.ndarray,
    motions: Motions,
) -> np.ndarray:
    """Return the next start, or its opposite, whose forces are nearest to those asked."""
    error, none = np.empty(2 * len(position)), np.empty((0, 0))
    desk = desk_for(motions)
    asked = np.sum(force * force)
    least, index, sign = np.inf, first, 1.0
    moving = bool(np.any(velocity != 0.0))
    for i in range(first, min(first + FEW_CANDIDATES, len(starts))):
        theta = full_amplitude(starts[i], motions) if moving else starts[i]
        cost = force_error(theta, position, velocity, force, motions, FEW, error, none, desk)
        if cost < least:
            least, index, sign = cost, i, 1.0
        along = 0.0
        for k in range(len(error)):
            along += error[k] * force[k // 2, k % 2]
        # |f - e|: with g = f - error the force got, |f + g|^2 = |f - g|^2 + 4 f.g
        opposite = cost + 4 * (asked - along)
        if opposite < least:
            least, index, sign = opposite, i, -1.0
    return sign * starts[index]
