"""The paper's closed form of the force map, on triangular waves: equations (19) to (21).

The sines of (13) are replaced by triangular waves, so between their kinks the slip is linear in
time, p + q s with s from 0 to 1, and its direction has an integral in closed form. The kinks divide
the period into 8 intervals for N = 2, 16 for N = 3, and so on; they are generated. Nothing here is
used to solve: `bench` shows what the approximation costs, and what it saves.
"""

from __future__ import annotations

from functools import lru_cache
from math import asinh, hypot

import numpy as np

from plate_core.kernels import kernel

STRAIGHT = 1e-12
"""Part of a slip across its own change, relative to it, below which the surface reverses at once;
and change of slip, relative to it, below which there is none."""


def triangle_sine(phase: np.ndarray) -> np.ndarray:
    """Return s*(t), the triangular wave of unit height that follows the sine."""
    share = np.mod(phase / (2 * np.pi) + 0.25, 1.0)
    return 1 - 4 * np.abs(share - 0.5)


@lru_cache(maxsize=16)
def intervals(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the kinks' basis (K + 1, 2 N), rows sin 1..N, cos 1..N, and shares (K,) of the period.

    The waves are linear between one kink and the next.
    """
    whole = 4 * int(np.lcm.reduce(np.arange(1, number + 1)))  # of which all kinks are multiples
    ticks = {tick * whole // (4 * j) for j in range(1, number + 1) for tick in range(4 * j + 1)}
    kinks = np.array(sorted(ticks)) / whole
    phase = 2 * np.pi * np.outer(kinks, np.arange(1, number + 1))
    return np.hstack([triangle_sine(phase), triangle_sine(phase + np.pi / 2)]), np.diff(kinks)


@kernel(error_model="numpy")
def triangular_forces(
    coefficients: np.ndarray, position: np.ndarray, kinks: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """Return average forces (C, 2) [mu m g] of C cases: one motion and one part at rest each.

    Parameters
    ----------
    coefficients : (C, 2 N, 3)
        Rows sin 1..N, cos 1..N of equation (13) [m/s, m/s, rad/s].
    position : (C, 2)
        [m], plate_home.
    kinks, shares : (K + 1, 2 N), (K,)
        `intervals(N)`.
    """
    force = np.zeros((len(coefficients), 2))
    for i in range(len(coefficients)):
        x, y = position[i, 0], position[i, 1]
        px = py = 0.0
        for k in range(len(kinks)):
            qx = qy = 0.0
            for j in range(kinks.shape[1]):
                spin = coefficients[i, j, 2]
                qx += kinks[k, j] * (coefficients[i, j, 0] - y * spin)
                qy += kinks[k, j] * (coefficients[i, j, 1] + x * spin)
            if k > 0:
                fx, fy = _between(px, py, qx, qy)
                force[i, 0] += shares[k - 1] * fx
                force[i, 1] += shares[k - 1] * fy
            px, py = qx, qy
    return force


@kernel(error_model="numpy")
def _between(px: float, py: float, qx: float, qy: float) -> tuple[float, float]:
    """Return the mean direction of a slip that goes straight from p to q: equation (20).

    Along the change the direction's integral is the difference of sizes, across it the logarithm,
    here as asinh, which loses no digits.
    """
    first, last = hypot(px, py), hypot(qx, qy)
    dx, dy = qx - px, qy - py
    change = hypot(dx, dy)
    if change <= STRAIGHT * (first + last):
        return (px / first, py / first) if first > 0 else (0.0, 0.0)
    ex, ey = dx / change, dy / change
    along_p, along_q = ex * px + ey * py, ex * qx + ey * qy
    across = ex * py - ey * px
    mean_along = (last - first) / change
    mean_across = 0.0
    if abs(across) > STRAIGHT * change:
        size = abs(across)
        mean_across = across * (asinh(along_q / size) - asinh(along_p / size)) / change
    return ex * mean_along - ey * mean_across, ey * mean_along + ex * mean_across
