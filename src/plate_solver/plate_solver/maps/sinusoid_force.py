"""The averaged force map of sinusoidal motions, compiled: equations (3) to (5) with (13).

Equal steps integrate a smooth periodic function with an error of exp(-n b), where b is how far its
nearest singularity lies from the real axis. Here the singularities are the complex times at which
the slip under the part is zero. At a dip, where the surface almost stands still, b is small: so the
samples are searched for dips, and what equal steps miss there is added in closed form
(`near_zero_slip`). Where two dips are as good as one, the adaptive quadrature of `mean_force` takes
over, on Taylor polynomials of the slip.

At a part the motion is `slip` (2 N + 1, 2): rows sin 1..N, cos 1..N, constant; columns x, y [m/s].
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, factorial, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from plate_core.kernels import constant, kernel

from .mean_force import TINY_SQUARE, mean_direction
from .near_zero_slip import excess, find_dips

STEPS_PER_HARMONIC = 64
"""Steps per harmonic: most random motions with N = 2 need one correction or none."""

FEW_STEPS_PER_HARMONIC = 16
"""Steps that tell good motions from bad ones, per harmonic."""

PIECES_PER_HARMONIC, DEGREE = 8, 10
"""Pieces of the period for the adaptive quadrature, per harmonic, and the degree of the polynomials
there: the slip of the highest harmonic errs by (pi/8)^11 / 11! = 1e-12."""

FEW, USUAL, ADAPTIVE, PANELS = map(constant, (0, 1, -1, -2))
"""Grids: few equal steps, the usual ones, those with dips corrected, and adaptive panels."""


class Rules(NamedTuple):
    """Where the slip of N harmonics is looked at.

    Attributes
    ----------
    waves : (2 N, K)
        Rows sin 1..N, cos 1..N at equal steps: a few for the period, then the usual ones.
    few : int
        How many the few are.
    taylor : (D + 1, N)
        Powers of time about the middle of a piece, in pieces, from sin and cos there.
    pieces : int
        Of the period, for the adaptive quadrature.
    """

    waves: np.ndarray
    few: int
    taylor: np.ndarray
    pieces: int


_mean_direction = mean_direction(DEGREE)


@lru_cache(maxsize=32)
def force_rules(number: int) -> Rules:
    """Return the nodes for `number` harmonics."""
    counts = [steps * max(number, 2) for steps in (FEW_STEPS_PER_HARMONIC, STEPS_PER_HARMONIC)]
    times = np.concatenate([2 * pi * (np.arange(n) + 0.5) / n for n in counts])
    order, pieces = np.arange(1, number + 1), PIECES_PER_HARMONIC * max(number, 2)
    angle = np.outer(order, times)
    power = np.arange(DEGREE + 1)
    sign = np.where(power % 4 < 2, 1.0, -1.0)
    taylor = (2 * pi * order / pieces) ** power[:, None] * (sign / [*map(factorial, power)])[
        :, None
    ]
    return Rules(np.vstack([np.sin(angle), np.cos(angle)]), counts[0], taylor, pieces)


@kernel()
def nodes_of(rule: Rules, grid: int) -> tuple[int, int]:
    """Return where the equal steps of a grid begin and end in `waves`."""
    return (0, rule.few) if grid == FEW else (rule.few, rule.waves.shape[1])


@kernel(fastmath=True, error_model="numpy")
def slip_at(
    coefficients: np.ndarray, x: float, y: float, vx: float, vy: float, slip: np.ndarray
) -> None:
    """Write the slip (2 N + 1, 2) under a part at a place, of a motion (2 N, 3) in plate_home."""
    rows = len(coefficients)
    for j in range(rows):
        slip[j, 0] = coefficients[j, 0] - y * coefficients[j, 2]
        slip[j, 1] = coefficients[j, 1] + x * coefficients[j, 2]
    slip[rows, 0], slip[rows, 1] = -vx, -vy


@kernel(fastmath=True, error_model="numpy")
def force_of(
    slip: np.ndarray, rule: Rules, grid: int, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float]:
    """Return the average force [mu m g] of a slip (2 N + 1, 2).

    Parameters
    ----------
    slip : (2 N + 1, 2)
        [m/s].
    grid : int
        `FEW`, `USUAL`, `ADAPTIVE` (the usual one corrected for its dips), or `PANELS`.
    work : (5, K)
        Takes the samples.
    gradient : (3, 2 N) or (0, 0)
        Takes the derivatives by the slip's rows, unless it is empty: d f_x / d slip_x,
        d f_x / d slip_y = d f_y / d slip_x, d f_y / d slip_y [s/m].
    """
    if len(gradient):
        gradient[:] = 0.0
    if grid == PANELS:
        return _by_panels(slip, rule, gradient)
    if grid == ADAPTIVE:
        fx, fy, good = _corrected(slip, rule, work, gradient)
        return (fx, fy) if good else _by_panels(slip, rule, gradient)
    start, stop = nodes_of(rule, grid)
    fx, fy = _sum(slip, rule.waves, start, stop, work)
    if len(gradient):
        _slopes(rule.waves, start, stop, work, gradient)
    return fx, fy


@kernel(fastmath=True, error_model="numpy")
def _corrected(
    slip: np.ndarray, rule: Rules, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float, bool]:
    """Sum over equal steps and take off what dips add; whether that holds. The derivatives are
    added to `gradient`."""
    start, stop = nodes_of(rule, USUAL)
    n, half_rows = stop - start, len(rule.waves) // 2
    fx, fy = _sum(slip, rule.waves, start, stop, work)
    dips = find_dips(work[2], n, work[4])
    if len(gradient):
        _slopes(rule.waves, start, stop, work, gradient)
    good = True
    for dip in range(dips):
        k = start + int(work[4, dip])
        x, y, fine = excess(slip, complex(rule.waves[half_rows, k], rule.waves[0, k]), n, gradient)
        good = good and fine
        fx -= x
        fy -= y
    return fx, fy, good


@kernel(fastmath=True, error_model="numpy")
def _sum(
    slip: np.ndarray, waves: np.ndarray, start: int, stop: int, work: np.ndarray
) -> tuple[float, float]:
    """Sum the direction of slip over nodes; rows of `work`: slip x, y, its square, 1/its size."""
    n, rows = stop - start, len(slip) - 1
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    ax, ay = slip[rows, 0], slip[rows, 1]
    for k in range(n):
        wx[k], wy[k] = ax, ay
    for j in range(rows):
        wave = waves[j, start:stop]
        ax, ay = slip[j, 0], slip[j, 1]
        for k in range(n):
            wx[k] += ax * wave[k]
            wy[k] += ay * wave[k]
    fx = fy = 0.0
    for k in range(n):
        d = wx[k] * wx[k] + wy[k] * wy[k]
        square[k] = d
        r = 1 / sqrt(max(d, TINY_SQUARE))
        inverse[k] = r
        fx += r * wx[k]
        fy += r * wy[k]
    return fx / n, fy / n


@kernel(fastmath=True, error_model="numpy")
def _slopes(
    waves: np.ndarray, start: int, stop: int, work: np.ndarray, gradient: np.ndarray
) -> None:
    """Add the derivatives of `_sum` to `gradient`; overwrites `work`."""
    n = stop - start
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    for k in range(n):
        r = inverse[k]
        ux, uy = wx[k] * r, wy[k] * r
        g = r / n if square[k] > TINY_SQUARE else 0.0
        wx[k], wy[k], square[k] = g * uy * uy, -g * ux * uy, g * ux * ux
    for j in range(len(waves)):
        wave = waves[j, start:stop]
        xx = xy = yy = 0.0
        for k in range(n):
            xx += wx[k] * wave[k]
            xy += wy[k] * wave[k]
            yy += square[k] * wave[k]
        gradient[0, j] += xx
        gradient[1, j] += xy
        gradient[2, j] += yy


@kernel(fastmath=True, error_model="numpy")
def _by_panels(slip: np.ndarray, rule: Rules, gradient: np.ndarray) -> tuple[float, float]:
    """Integrate by the adaptive quadrature, piece by piece; gradient (3, 2 N), or (0, 0)."""
    degrees, number = rule.taylor.shape
    sloped = len(gradient) > 0
    if sloped:
        gradient[:] = 0.0
    power = np.empty((degrees, 2))
    local = np.zeros((3, degrees)) if sloped else np.zeros((0, 0))
    fx = fy = 0.0
    for piece in range(rule.pieces):
        middle = 2 * pi * (piece + 0.5) / rule.pieces
        power[:] = 0.0
        power[0, 0], power[0, 1] = slip[2 * number, 0], slip[2 * number, 1]
        for j in range(number):
            s, c = sin((j + 1) * middle), cos((j + 1) * middle)
            for axis in range(2):
                a, b = slip[j, axis], slip[number + j, axis]
                here, rate = a * s + b * c, a * c - b * s
                for m in range(degrees):
                    power[m, axis] += rule.taylor[m, j] * (rate if m % 2 else here)
        local[:] = 0.0
        px, py = _mean_direction(power, -0.5, local)
        fx += px / rule.pieces
        fy += py / rule.pieces
        for j in range(number if sloped else 0):
            s, c = sin((j + 1) * middle), cos((j + 1) * middle)
            for row in range(3):
                here = rate = 0.0
                for m in range(degrees):
                    if m % 2:
                        rate += rule.taylor[m, j] * local[row, m]
                    else:
                        here += rule.taylor[m, j] * local[row, m]
                gradient[row, j] += (here * s + rate * c) / rule.pieces
                gradient[row, number + j] += (here * c - rate * s) / rule.pieces
    return fx, fy


@kernel(fastmath=True, error_model="numpy")
def sinusoid_forces(
    coefficients: np.ndarray, position: np.ndarray, velocity: np.ndarray, rule: Rules
) -> np.ndarray:
    """Return the average forces (C, 2) [mu m g] of C cases: one motion and one part each.

    Parameters
    ----------
    coefficients : (C, 2 N, 3)
        Rows sin 1..N, cos 1..N of equation (13) [m/s, m/s, rad/s].
    position, velocity : (C, 2)
        [m], [m/s], plate_home.
    rule : Rules
        `force_rules(N)`.
    """
    count = len(coefficients)
    force = np.empty((count, 2))
    slip = np.empty((coefficients.shape[1] + 1, 2))
    work, none = np.empty((5, rule.waves.shape[1])), np.empty((0, 0))
    for i in range(count):
        slip_at(
            coefficients[i], position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], slip
        )
        fx, fy, good = _corrected(slip, rule, work, none)
        if not good:
            fx, fy = _by_panels(slip, rule, none)
        force[i, 0], force[i, 1] = fx, fy
    return force
