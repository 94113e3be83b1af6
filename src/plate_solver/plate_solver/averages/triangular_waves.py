"""Closed form of the force map for triangular waves: equations (19) to (21) of the paper.

Triangular waves replace the sines of equation (13). Between their kinks the slip is linear in time,
p + q s with s from 0 to 1, so the integral of its direction has a closed form. There are 8
intervals between kinks for N = 2, 16 for N = 3, and so on. No solver uses this map. `bench`
compares the error and the speed of this map with the error and the speed of the exact map.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .. import _kernels


def triangle_sine(phase: np.ndarray) -> np.ndarray:
    """Return s*(t), the triangular wave of unit height in phase with the sine."""
    share = np.mod(phase / (2 * np.pi) + 0.25, 1.0)
    return 1 - 4 * np.abs(share - 0.5)


@lru_cache(maxsize=16)
def intervals(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of the waves at their kinks (K + 1, 2 N), and the lengths (K,) of the
    intervals as fractions of the period. The columns are sin 1..N, cos 1..N.

    The waves are linear between consecutive kinks.
    """
    whole = 4 * int(np.lcm.reduce(np.arange(1, number + 1)))  # all kinks are multiples of 1/whole
    ticks = {tick * whole // (4 * j) for j in range(1, number + 1) for tick in range(4 * j + 1)}
    kinks = np.array(sorted(ticks)) / whole
    phase = 2 * np.pi * np.outer(kinks, np.arange(1, number + 1))
    return np.hstack([triangle_sine(phase), triangle_sine(phase + np.pi / 2)]), np.diff(kinks)


def triangular_forces(
    coefficients: np.ndarray, position: np.ndarray, kinks: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """Return average forces (C, 2) [mu m g] of C cases. Each case has one motion and one part at
    rest.

    Parameters
    ----------
    coefficients : (C, 2 N, 3)
        Rows sin 1..N, cos 1..N of equation (13) [m/s, m/s, rad/s].
    position : (C, 2)
        [m], plate_home.
    kinks, shares : (K + 1, 2 N), (K,)
        `intervals(N)`.
    """
    return _kernels.triangular_forces(coefficients, position, kinks, shares)
