"""The averaged force map of sinusoidal motions: equations (3) to (5) with (13).

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
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from .. import _kernels

STEPS_PER_HARMONIC = 64
"""Steps per harmonic: most random motions with N = 2 need one correction or none."""

FEW_STEPS_PER_HARMONIC = 16
"""Steps that tell good motions from bad ones, per harmonic."""

PIECES_PER_HARMONIC, DEGREE = 8, 10
"""Pieces of the period for the adaptive quadrature, per harmonic, and the degree of the polynomials
there: the slip of the highest harmonic errs by (pi/8)^11 / 11! = 1e-12."""

FEW, USUAL, ADAPTIVE, PANELS = 0, 1, -1, -2
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
    """Write the slip (2 N + 1, 2) under a part at a place, of a motion (2 N, 3) in plate_home."""
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
        `FEW`, `USUAL`, `ADAPTIVE` (the usual one corrected for its dips), or `PANELS`.
    work : (5, K)
        Takes the samples.
    gradient : (3, 2 N) or (0, 0)
        Takes the derivatives by the slip's rows, unless it is empty: d f_x / d slip_x,
        d f_x / d slip_y = d f_y / d slip_x, d f_y / d slip_y [s/m].
    """
    return _kernels.force_of(slip, rule, grid, work, gradient)


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
    return _kernels.sinusoid_forces(coefficients, position, velocity, rule)
