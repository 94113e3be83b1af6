"""Sinusoidal motions that press against the rig's limits: for steering on the cycle map.

On the cycle map amplitude matters, and scaling a motion down to its limits would undo what a step
has gained. So a motion may exceed the limits a little on the way, each excess is an error of its
own, and only what is left in the end is scaled away.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from .harmonics import Harmonics
from .sinusoid_family import SinusoidFamily
from .solution import Bounds

EXCESS_M = 2e-3
"""An excess of a whole limit counts as a displacement error of so much [m]."""

AIM = 0.95
"""Share of a limit above which there is excess: what is found ends a little higher."""

LOOKS_PER_HARMONIC = 8
"""Instants per period of the highest harmonic at which limits are looked at."""


class LimitedSinusoids(SinusoidFamily):
    """`SinusoidFamily` that may exceed limits by a factor of `room`, at a price.

    Parameters
    ----------
    basis : Harmonics
    bounds : Bounds
    room : float
        1 keeps the limits.
    """

    def __init__(self, basis: Harmonics, bounds: Bounds, room: float) -> None:
        super().__init__(basis, bounds)
        self._room = room
        every = max(1, basis.steps // (LOOKS_PER_HARMONIC * (basis.size // 2 + 1)))
        self._looks = tuple(
            np.ascontiguousarray(matrix[::every])
            for matrix in (basis.pose, basis.twist, basis.accel)
        )

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale down what exceeds the limits by more than `room`."""
        coefficients, basis = self.coefficients(parameters), self.basis
        share = self._bounds.share(
            basis.pose @ coefficients, basis.twist @ coefficients, basis.accel @ coefficients
        )
        return parameters * min(1.0, self._room / max(share, 1e-300))

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the excess over the limits (K,) [m], where there is any."""
        return -EXCESS_M * self._excess(parameters)[0]

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (K, P) of minus `penalty`."""
        slopes = self._excess(parameters)[1] * (EXCESS_M * self._scale)
        return slopes.reshape(len(slopes), parameters.size)

    def _excess(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        bounds = self._bounds
        limits = np.array([bounds.stroke_m, bounds.speed, bounds.accel])
        pose, twist, accel = self._looks
        return excess(
            self.coefficients(parameters), pose, twist, accel, bounds.motor_rows, bounds.half,
            limits,
        )  # fmt: skip


@njit(cache=True)
def excess(
    coefficients: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray,
    rows: np.ndarray, half: np.ndarray, limits: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return by how much motors and corners exceed `AIM` of their limits, and the slopes.

    Parameters
    ----------
    coefficients : (h, 3)
    pose, twist, accel : (n, h)
        Basis of one degree of freedom at the instants looked at.
    rows : (4, 3)
        Motor travel per pose.
    half : (2,)
        Half sides of the plate [m].
    limits : (3,)
        Stroke [m], speed [m/s], acceleration [m/s2].

    Returns
    -------
    value : (K,)
        Excess as a share of the limit, positive.
    slope : (K, h, 3)
        Its derivative by the coefficients.
    """
    size = pose.shape[1]
    value, slope = np.empty(len(pose) * 12), np.empty((len(pose) * 12, size, 3))
    found = 0
    x, v, a = pose @ coefficients, twist @ coefficients, accel @ coefficients
    for k in range(len(pose)):
        for i in range(len(rows)):
            for order in range(2):
                state = v[k] if order else x[k]
                q = rows[i, 0] * state[0] + rows[i, 1] * state[1] + rows[i, 2] * state[2]
                share = abs(q) / limits[order]
                if share > AIM:
                    sign = 1.0 if q > 0 else -1.0
                    for h in range(size):
                        each = sign * (twist[k, h] if order else pose[k, h]) / limits[order]
                        for d in range(3):
                            slope[found, h, d] = each * rows[i, d]
                    value[found] = share - AIM
                    found += 1
        spin = v[k, 2]
        for corner in range(4):
            cx = half[0] if corner & 1 else -half[0]
            cy = half[1] if corner & 2 else -half[1]
            ax = a[k, 0] - a[k, 2] * cy - spin * spin * cx
            ay = a[k, 1] + a[k, 2] * cx - spin * spin * cy
            size_a = sqrt(ax * ax + ay * ay)
            if size_a > AIM * limits[2]:
                ux, uy = ax / size_a / limits[2], ay / size_a / limits[2]
                turn, rate = uy * cx - ux * cy, -2 * spin * (ux * cx + uy * cy)
                for h in range(size):
                    slope[found, h, 0] = ux * accel[k, h]
                    slope[found, h, 1] = uy * accel[k, h]
                    slope[found, h, 2] = turn * accel[k, h] + rate * twist[k, h]
                value[found] = size_a / limits[2] - AIM
                found += 1
    return value[:found].copy(), slope[:found].copy()
