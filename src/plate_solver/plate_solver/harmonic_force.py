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
    """Sines and cosines at the nodes, for N harmonics.

    Attributes
    ----------
    grids : tuple of (2 N, n)
        Equal steps: few, and the usual ones; rows sin 1..N, cos 1..N.
    shares : tuple of (n,)
        Their weights 1/n.
    panels : (levels, 2 N, 8)
        The same at the nodes of a panel about t = 0, of length 2 pi / 2**level.
    first : int
        First level of panels.
    """

    grids: tuple[np.ndarray, ...]
    shares: tuple[np.ndarray, ...]
    panels: np.ndarray
    first: int


@lru_cache(maxsize=32)
def rules(number: int) -> Rules:
    """Return the nodes for `number` harmonics."""

    def table(t: np.ndarray) -> np.ndarray:
        angle = np.outer(np.arange(1, number + 1), t)
        return np.ascontiguousarray(np.vstack([np.sin(angle), np.cos(angle)]))

    counts = [steps * max(number, 2) for steps in (FEW_STEPS_PER_HARMONIC, STEPS_PER_HARMONIC)]
    return Rules(
        tuple(table(2 * pi * (np.arange(n) + 0.5) / n) for n in counts),
        tuple(np.full(n, 1 / n) for n in counts),
        np.array([table(pi * 0.5**level * NODES) for level in range(DEEPEST + 1)]),
        FIRST_LEVEL + int(np.ceil(np.log2(max(number, 2) / 2))),
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
        Index of `rule.grids`; `ADAPTIVE` corrects the usual one for its dips.
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
        fx, fy, good = _corrected(slip, rule.grids[FIRST], rule.shares[FIRST], work, gradient)
        return (fx, fy) if good else _graded(slip, rule, work, gradient)
    fx, fy = _sum(slip, rule.grids[grid], rule.shares[grid], work)
    if len(gradient):
        _slopes(rule.grids[grid], rule.shares[grid], work, gradient)
    return fx, fy


@njit(cache=True, fastmath=True, error_model="numpy")
def _corrected(
    slip: np.ndarray, grid: np.ndarray, share: np.ndarray, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float, bool]:
    """Sum over equal steps and take off what dips add; whether that holds. The derivatives are
    added to `gradient`."""
    n = len(share)
    fx, fy = _sum(slip, grid, share, work)
    dips = find_dips(work[2], n, work[4])
    if len(gradient):
        _slopes(grid, share, work, gradient)
    good = True
    for dip in range(dips):
        k = int(work[4, dip])
        start = complex(grid[len(grid) // 2, k], grid[0, k])
        x, y, fine = excess(slip, start, n, gradient)
        good = good and fine
        fx -= x
        fy -= y
    return fx, fy, good


@njit(cache=True, fastmath=True, error_model="numpy")
def _sum(
    slip: np.ndarray, grid: np.ndarray, share: np.ndarray, work: np.ndarray
) -> tuple[float, float]:
    """Sum the direction of slip; rows of `work` become slip x, y, its square, 1/its size."""
    n, rows = len(share), len(slip) - 1
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    ax, ay = slip[rows, 0], slip[rows, 1]
    for k in range(n):
        wx[k], wy[k] = ax, ay
    for j in range(rows):
        ax, ay = slip[j, 0], slip[j, 1]
        for k in range(n):
            wx[k] += ax * grid[j, k]
            wy[k] += ay * grid[j, k]
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
def _slopes(grid: np.ndarray, share: np.ndarray, work: np.ndarray, gradient: np.ndarray) -> None:
    """Add the derivatives of `_sum` to `gradient`; overwrites `work`."""
    n = len(share)
    wx, wy, square, inverse = work[0], work[1], work[2], work[3]
    for k in range(n):
        r = inverse[k]
        ux, uy = wx[k] * r, wy[k] * r
        g = share[k] * r if square[k] > TINY_SQUARE else 0.0
        wx[k], wy[k], square[k] = g * uy * uy, -g * ux * uy, g * ux * ux
    for j in range(len(grid)):
        xx = xy = yy = 0.0
        for k in range(n):
            xx += wx[k] * grid[j, k]
            xy += wy[k] * grid[j, k]
            yy += square[k] * grid[j, k]
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
    share = np.empty(len(NODES))
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
            for n in range(len(NODES)):
                share[n] = width * WEIGHTS[n] / 2
            px, py = _sum(turned, rule.panels[level], share, work)
            if level < DEEPEST and not _is_far(turned, rule.panels[level], work[2], pi * width):
                depth[waiting - 1] = depth[waiting] = level + 1
                waiting += 1
                continue
            fx += px
            fy += py
            left += width
            waiting -= 1
            if len(gradient):
                local[:] = 0.0
                _slopes(rule.panels[level], share, work, local)
                for j in range(half_rows):
                    s, c = sin((j + 1) * middle), cos((j + 1) * middle)
                    for row in range(3):
                        a, b = local[row, j], local[row, half_rows + j]
                        gradient[row, j] += a * c + b * s
                        gradient[row, half_rows + j] += b * c - a * s
    return fx, fy


@njit(cache=True, fastmath=True, error_model="numpy")
def _is_far(slip: np.ndarray, grid: np.ndarray, square: np.ndarray, half: float) -> bool:
    """Whether all zeros of the slip are far from a panel of the given half length."""
    half_rows = len(grid) // 2
    near = FAR * half
    for k in range(len(NODES)):
        ax = ay = 0.0
        for j in range(half_rows):
            s, c = (j + 1) * grid[j, k], (j + 1) * grid[half_rows + j, k]
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
    grid, share = rule.grids[FIRST], rule.shares[FIRST]
    work, none = np.empty((5, len(share))), np.empty((0, 0))
    for i in range(count):
        slip_at(
            coefficients[i], position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], slip
        )
        fx, fy, good = _corrected(slip, grid, share, work, none)
        if not good:
            fx, fy = _graded(slip, rule, work, none)
        force[i, 0], force[i, 1] = fx, fy
    return force
