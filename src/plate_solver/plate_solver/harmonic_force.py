"""The averaged force map of sinusoidal motions, compiled: equations (3) to (5) with (13).

Equal steps integrate a smooth periodic function with an error of exp(-n b), where b is how far its
nearest singularity lies from the real axis. Here the singularities are the complex times at which
the slip under the part is zero. At a dip, where the surface almost stands still, b is small: so the
samples are searched for dips, and what equal steps miss there is added in closed form (`dips`).
Where two dips are as good as one, panels are halved towards them instead.

At a part the motion is `slip` (2 N + 1, 2): rows sin 1..N, cos 1..N, constant; columns x, y [m/s].
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from .dips import excess, find_dips
from .force_map import FAR, NODES, WEIGHTS

STEPS_PER_HARMONIC = 64
"""Steps per harmonic: most random motions with N = 2 need one correction or none."""

FEW_STEPS_PER_HARMONIC = 16
"""Steps that tell good motions from bad ones, per harmonic."""

DEEPEST = 34
"""Halvings of the period at most: what is left of a jump is 1e-10 of it."""

FIRST_LEVEL = 4
"""Halvings of the period with which panels begin, for up to two harmonics."""

FEW, FIRST, ADAPTIVE, PANELS = 0, 1, -1, -2
"""Grids: few steps, the usual ones, those with dips corrected, and panels."""

TINY_SQUARE = 1e-24
"""Squared slip [m2/s2] below which the direction of friction is taken as none."""


class Rules(NamedTuple):
    """Sines and cosines at the nodes of all grids, for N harmonics: few arrays, as calls with many
    take longer than the sums.

    Attributes
    ----------
    waves : (2 N, K)
        Rows sin 1..N, cos 1..N. Equal steps: few, and the usual ones; then panels about t = 0, of
        length 2 pi / 2**level.
    shares : (K,)
        Weights of the nodes, as shares of the period.
    starts : (G + 1,)
        Column where each of the grids begins.
    first : int
        First level of panels.
    most : int
        Nodes of the finest grid.
    """

    waves: np.ndarray
    shares: np.ndarray
    starts: np.ndarray
    first: int
    most: int


@lru_cache(maxsize=32)
def rules(number: int) -> Rules:
    """Return the nodes for `number` harmonics."""
    counts = [steps * max(number, 2) for steps in (FEW_STEPS_PER_HARMONIC, STEPS_PER_HARMONIC)]
    times = [2 * pi * (np.arange(n) + 0.5) / n for n in counts]
    shares = [np.full(n, 1 / n) for n in counts]
    for level in range(DEEPEST + 1):
        times.append(pi * 0.5**level * NODES)
        shares.append(0.5**level * WEIGHTS / 2)
    angle = np.outer(np.arange(1, number + 1), np.concatenate(times))
    return Rules(
        np.vstack([np.sin(angle), np.cos(angle)]),
        np.concatenate(shares),
        np.cumsum([0, *map(len, times)]),
        FIRST_LEVEL + int(np.ceil(np.log2(max(number, 2) / 2))),
        counts[-1],
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def slip_at(
    coefficients: np.ndarray, x: float, y: float, vx: float, vy: float, slip: np.ndarray
) -> None:
    """Write the slip (2 N + 1, 2) under a part at a place, of a motion (2 N, 3) in plate_home."""
    rows = len(coefficients)
    for j in range(rows):
        slip[j, 0] = coefficients[j, 0] - y * coefficients[j, 2]
        slip[j, 1] = coefficients[j, 1] + x * coefficients[j, 2]
    slip[rows, 0], slip[rows, 1] = -vx, -vy


@njit(cache=True, fastmath=True, error_model="numpy")
def force_of(
    slip: np.ndarray, rule: Rules, grid: int, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float]:
    """Return the average force [mu m g] of a slip (2 N + 1, 2).

    Parameters
    ----------
    slip : (2 N + 1, 2)
        [m/s].
    grid : int
        Index of the equal steps; `ADAPTIVE` corrects the usual one for its dips.
    work : (5, n)
        Room for the samples.
    gradient : (3, 2 N) or (0, 0)
        Takes the derivatives by the slip's rows, unless it is empty: d f_x / d slip_x,
        d f_x / d slip_y = d f_y / d slip_x, d f_y / d slip_y [s/m].
    """
    if len(gradient):
        gradient[:] = 0.0
    if grid == PANELS:
        return _graded(slip, rule, work, gradient)
    if grid == ADAPTIVE:
        fx, fy, good = _corrected(slip, rule, work, gradient)
        return (fx, fy) if good else _graded(slip, rule, work, gradient)
    start, stop = rule.starts[grid], rule.starts[grid + 1]
    fx, fy = _sum(slip, rule.waves, rule.shares, start, stop, work)
    if len(gradient):
        _slopes(rule.waves, rule.shares, start, stop, work, gradient)
    return fx, fy


@njit(cache=True, fastmath=True, error_model="numpy")
def _corrected(
    slip: np.ndarray, rule: Rules, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float, bool]:
    """Sum over equal steps and take off what dips add; whether that holds. The derivatives are
    added to `gradient`."""
    start, stop = rule.starts[FIRST], rule.starts[FIRST + 1]
    n, half_rows = stop - start, len(rule.waves) // 2
    fx, fy = _sum(slip, rule.waves, rule.shares, start, stop, work)
    dips = find_dips(work[2], n, work[4])
    if len(gradient):
        _slopes(rule.waves, rule.shares, start, stop, work, gradient)
    good = True
    for dip in range(dips):
        k = start + int(work[4, dip])
        x, y, fine = excess(slip, complex(rule.waves[half_rows, k], rule.waves[0, k]), n, gradient)
        good = good and fine
        fx -= x
        fy -= y
    return fx, fy, good


@njit(cache=True, fastmath=True, error_model="numpy")
def _sum(
    slip: np.ndarray, waves: np.ndarray, shares: np.ndarray, start: int, stop: int, work: np.ndarray
) -> tuple[float, float]:
    """Sum the direction of slip over nodes; rows of `work`: slip x, y, its square, 1/its size."""
    n, rows = stop - start, len(slip) - 1
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    share = shares[start:stop]
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
        fx += share[k] * r * wx[k]
        fy += share[k] * r * wy[k]
    return fx, fy


@njit(cache=True, fastmath=True, error_model="numpy")
def _slopes(
    waves: np.ndarray,
    shares: np.ndarray,
    start: int,
    stop: int,
    work: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add the derivatives of `_sum` to `gradient`; overwrites `work`."""
    n = stop - start
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    share = shares[start:stop]
    for k in range(n):
        r = inverse[k]
        ux, uy = wx[k] * r, wy[k] * r
        g = share[k] * r if square[k] > TINY_SQUARE else 0.0
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


@njit(cache=True, fastmath=True, error_model="numpy")
def _graded(
    slip: np.ndarray, rule: Rules, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float]:
    """Integrate over panels that are halved towards the dips; gradient (3, 2 N), or (0, 0)."""
    if len(gradient):
        gradient[:] = 0.0
    rows = len(slip) - 1
    half_rows = rows // 2
    turned = np.empty_like(slip)
    local = np.empty((3, rows))
    depth = np.empty(DEEPEST + 2, np.int64)
    fx = fy = 0.0
    for first in range(2**rule.first):
        left = first * 0.5**rule.first  # of the period
        waiting = 1
        depth[0] = rule.first
        while waiting:
            level = depth[waiting - 1]
            width = 0.5**level
            middle = 2 * pi * (left + width / 2)
            for j in range(half_rows):
                s, c = sin((j + 1) * middle), cos((j + 1) * middle)
                for axis in range(2):
                    a, b = slip[j, axis], slip[half_rows + j, axis]
                    turned[j, axis] = a * c - b * s
                    turned[half_rows + j, axis] = a * s + b * c
            turned[rows, 0], turned[rows, 1] = slip[rows, 0], slip[rows, 1]
            grid = len(rule.starts) - 2 - DEEPEST + level
            start, stop = rule.starts[grid], rule.starts[grid + 1]
            px, py = _sum(turned, rule.waves, rule.shares, start, stop, work)
            if level < DEEPEST and not _is_far(turned, rule.waves, start, work[2], pi * width):
                depth[waiting - 1] = depth[waiting] = level + 1
                waiting += 1
                continue
            fx += px
            fy += py
            left += width
            waiting -= 1
            if len(gradient):
                local[:] = 0.0
                _slopes(rule.waves, rule.shares, start, stop, work, local)
                for j in range(half_rows):
                    s, c = sin((j + 1) * middle), cos((j + 1) * middle)
                    for row in range(3):
                        a, b = local[row, j], local[row, half_rows + j]
                        gradient[row, j] += a * c + b * s
                        gradient[row, half_rows + j] += b * c - a * s
    return fx, fy


@njit(cache=True, fastmath=True, error_model="numpy")
def _is_far(
    slip: np.ndarray, waves: np.ndarray, start: int, square: np.ndarray, half: float
) -> bool:
    """Whether all zeros of the slip are far from a panel of the given half length."""
    half_rows = len(waves) // 2
    near = FAR * half
    for k in range(len(NODES)):
        ax = ay = 0.0
        for j in range(half_rows):
            s = (j + 1) * waves[j, start + k]
            c = (j + 1) * waves[half_rows + j, start + k]
            ax += slip[j, 0] * c - slip[half_rows + j, 0] * s
            ay += slip[j, 1] * c - slip[half_rows + j, 1] * s
        if square[k] > TINY_SQUARE and square[k] < near * near * (ax * ax + ay * ay):
            return False
    return True


@njit(cache=True, fastmath=True, error_model="numpy")
def forces(
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
        `rules(N)`.
    """
    count = len(coefficients)
    force = np.empty((count, 2))
    slip = np.empty((coefficients.shape[1] + 1, 2))
    work, none = np.empty((5, rule.most)), np.empty((0, 0))
    for i in range(count):
        slip_at(
            coefficients[i], position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], slip
        )
        fx, fy, good = _corrected(slip, rule, work, none)
        if not good:
            fx, fy = _graded(slip, rule, work, none)
        force[i, 0], force[i, 1] = fx, fy
    return force
