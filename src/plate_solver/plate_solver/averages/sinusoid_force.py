"""Averaged force map of sinusoidal motions: equations (3) to (5) with (13).

The mean over n equal steps of a smooth periodic function has an error of exp(-n b), where b is the
distance of its nearest singularity from the real axis. Here the singularities are the complex times
at which the slip under the part is zero. At a dip, where the slip nearly vanishes, b is small.
Therefore dips are detected in the samples, and the error at each dip is subtracted
(`near_zero_slip`). If two dips are too close to be separated, the adaptive quadrature of
`mean_force` is used instead, with Taylor polynomials of the slip.

The motion under a part is `slip` (2 N + 1, 2): rows sin 1..N, cos 1..N, constant; columns x, y
[m/s].
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from .. import _kernels

STEPS_PER_HARMONIC = 64
"""Number of equal steps per harmonic. Most random motions with N = 2 then need at most one
correction."""

FEW_STEPS_PER_HARMONIC = 16
"""Number of equal steps per harmonic for a rough comparison of motions."""

PIECES_PER_HARMONIC, DEGREE = 8, 10
"""Number of pieces of the period per harmonic for the adaptive quadrature, and degree of the Taylor
polynomials in them. The slip's error in the highest harmonic is (pi/8)^11 / 11! = 1e-12."""

FEW, USUAL, ADAPTIVE, PANELS = 0, 1, -1, -2
"""Quadratures: few equal steps; the usual number of equal steps; the usual number with a correction
at dips; and adaptive panels."""


class Rules(NamedTuple):
    """Nodes for the slip of N harmonics.

    Attributes
    ----------
    waves : (2 N, K)
        Rows sin 1..N, cos 1..N at equal steps of the period: `few` steps, then the usual number.
    few : int
        Number of steps of the grid `FEW`.
    taylor : (D + 1, N)
        Taylor coefficients of each harmonic about the middle of a piece, with the piece as unit of
        time: factors of its value there (even rows) and of its quadrature component (odd rows).
    pieces : int
        Number of pieces of the period for the adaptive quadrature.
    """

    waves: np.ndarray
    few: int
    taylor: np.ndarray
    pieces: int


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


def slip_at(
    coefficients: np.ndarray, x: float, y: float, vx: float, vy: float, slip: np.ndarray
) -> None:
    """Write the slip (2 N + 1, 2) under a part at (x, y) with velocity (vx, vy), for a motion
    (2 N, 3) in plate_home."""
    _kernels.slip_at(coefficients, x, y, vx, vy, slip)


def force_of(
    slip: np.ndarray, rule: Rules, grid: int, work: np.ndarray, gradient: np.ndarray
) -> tuple[float, float]:
    """Return the average force [mu m g] of a slip (2 N + 1, 2).

    Parameters
    ----------
    slip : (2 N + 1, 2)
        [m/s].
    grid : int
        `FEW`, `USUAL`, `ADAPTIVE` or `PANELS`.
    work : (5, K)
        Buffer for the samples.
    gradient : (3, 2 N) or (0, 0)
        Result unless it is empty: derivatives with respect to the slip's rows, d f_x / d slip_x,
        d f_x / d slip_y = d f_y / d slip_x, d f_y / d slip_y [s/m].
    """
    return _kernels.force_of(slip, rule, grid, work, gradient)


def sinusoid_forces(
    coefficients: np.ndarray, position: np.ndarray, velocity: np.ndarray, rule: Rules
) -> np.ndarray:
    """Return the average forces (C, 2) [mu m g] of C cases with one motion and one part each.

    Parameters
    ----------
    coefficients : (C, 2 N, 3)
        Rows sin 1..N, cos 1..N of equation (13) [m/s, m/s, rad/s].
    position, velocity : (C, 2)
        [m], [m/s], plate_home.
    rule : Rules
        `force_rules(N)`.
    """
    return _kernels.sinusoid_forces(coefficients, position, velocity, rule)
