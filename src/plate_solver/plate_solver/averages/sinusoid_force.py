"""Averaged force map of sinusoidal motions: equations (3) to (5) with (13).

If the mean of a smooth periodic function is computed from n equal steps, its error is about exp(-n
b). b is the distance of the function's nearest singularity from the real axis, in the plane of
complex times. For the friction on a part, the singularities are the complex times at which the slip
of the part is 0.

At a real time at which the slip nearly vanishes (a dip), b is small. Therefore, dips are detected
in the samples, and the error that each dip causes is subtracted (near_zero_slip.hpp). If two dips
are too close to each other, the adaptive quadrature of `mean_force` is used instead. The adaptive
quadrature represents the slip by Taylor polynomials.

The slip of a part is described by an array `slip` (2 N + 1, 2) of coefficients [m/s]. The rows
belong to sin 1..N, cos 1..N and the constant. The columns are x and y.
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from .. import _kernels

STEPS_PER_HARMONIC = 64
"""Number of equal time steps per harmonic of the motion. With this value, most random motions with
N = 2 harmonics need at most one correction for a dip."""

FEW_STEPS_PER_HARMONIC = 16
"""Number of equal time steps per harmonic of the motion, for a rough comparison of motions."""

PIECES_PER_HARMONIC = 8
"""Number of pieces into which the adaptive quadrature divides the period, per harmonic of the
motion."""

DEGREE = 10
"""Degree of the Taylor polynomials in the pieces of the adaptive quadrature. Their error in the
highest harmonic of the slip is (pi/8)^11 / 11! = 1e-12."""


class Rules(NamedTuple):
    """Values of the harmonics at the sample points, for motions with N harmonics.

    Attributes
    ----------
    waves : (2 N, K)
        Values of sin 1..N and cos 1..N (rows) at equal steps of the period (columns). The first
        `few` columns are a coarse grid, and the other columns are the usual grid.
    few : int
        Number of steps of the coarse grid.
    taylor : (D + 1, N)
        Taylor coefficients of each harmonic about the middle of a piece. The unit of time is the
        length of the piece. Coefficients in even rows are multiplied by the value of the harmonic
        at the middle. Coefficients in odd rows are multiplied by the value of the harmonic that is
        shifted by a quarter of its period.
    pieces : int
        Number of pieces of the period in the adaptive quadrature.
    """

    waves: np.ndarray
    few: int
    taylor: np.ndarray
    pieces: int


@lru_cache(maxsize=32)
def force_rules(number: int) -> Rules:
    """Return the values at the sample points for motions with `number` harmonics."""
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


def sinusoid_forces(
    coefficients: np.ndarray, position: np.ndarray, velocity: np.ndarray, rule: Rules
) -> np.ndarray:
    """Return the average forces (C, 2) [mu m g] for C cases. Each case is a combination of one
    motion and one part.

    Parameters
    ----------
    coefficients : (C, 2 N, 3)
        Coefficients of sin 1..N and cos 1..N (rows) in equation (13) [m/s, m/s, rad/s].
    position, velocity : (C, 2)
        Positions [m] and velocities [m/s] of the parts, in plate_home.
    rule : Rules
        `force_rules(N)`.
    """
    return _kernels.sinusoid_forces(coefficients, position, velocity, rule)
