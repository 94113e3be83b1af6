"""Averaged force map of sinusoidal motions: equations (3) to (5) with (13).

The mean of a smooth periodic function over n equal steps has an error of exp(-n b). b is the
distance between the real axis and the nearest singularity of the function. Here the singularities
are the complex times at which the slip of the part is zero. At a dip, the slip nearly vanishes and
b is small. Therefore dips are detected in the samples, and the error that each dip causes is
subtracted (near_zero_slip.hpp). If two dips are too close to be separated, the adaptive quadrature
of `mean_force` is used instead. The quadrature represents the slip by Taylor polynomials.

The slip of a part is an array `slip` (2 N + 1, 2): rows sin 1..N, cos 1..N, constant; columns x, y
[m/s].
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from .. import _kernels

STEPS_PER_HARMONIC = 64
"""Number of equal steps per harmonic. With this value, most random motions with N = 2 need at most
one correction."""

FEW_STEPS_PER_HARMONIC = 16
"""Number of equal steps per harmonic for a rough comparison of motions."""

PIECES_PER_HARMONIC = 8
"""Number of pieces of the period per harmonic in the adaptive quadrature."""

DEGREE = 10
"""Degree of the Taylor polynomials in the pieces of the adaptive quadrature. Their error in the
highest harmonic of the slip is (pi/8)^11 / 11! = 1e-12."""


class Rules(NamedTuple):
    """Sample points of the slip for N harmonics.

    Attributes
    ----------
    waves : (2 N, K)
        Rows sin 1..N, cos 1..N at equal steps of the period. The first `few` columns are the coarse
        grid; the usual grid follows.
    few : int
        Number of steps of the coarse grid.
    taylor : (D + 1, N)
        Taylor coefficients of each harmonic about the middle of a piece. The unit of time is the
        length of the piece. Even rows are factors of the harmonic's value at the middle. Odd rows
        are factors of the harmonic shifted by a quarter of its period.
    pieces : int
        Number of pieces of the period in the adaptive quadrature.
    """

    waves: np.ndarray
    few: int
    taylor: np.ndarray
    pieces: int


@lru_cache(maxsize=32)
def force_rules(number: int) -> Rules:
    """Return the sample points for `number` harmonics."""
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
    """Return the average forces (C, 2) [mu m g] of C cases. Each case has one motion and one part.

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
