"""Sinusoidal motions that press against the rig's limits: for steering on the cycle map.

On the cycle map amplitude matters, and scaling a motion down to its limits would undo what a step
has gained. So a motion may exceed the limits a little on the way, each excess is an error of its
own, and only what is left in the end is scaled away.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core.kernels import kernel

from ..limits import Limits
from .basis import SinusoidBasis, SinusoidFamily

EXCESS_M = 2e-3
"""An excess of a whole limit counts as a displacement error of so much [m]."""

AIM = 0.95
"""Fraction of a limit above which there is excess: what is found ends a little higher."""

LOOKS_PER_HARMONIC = 8
"""Instants per period of the highest harmonic at which limits are looked at."""


class LimitedSinusoids(SinusoidFamily):
    """`SinusoidFamily` that may exceed limits by a factor of `most`, at a price.

    Parameters
    ----------
    basis : SinusoidBasis
    limits : Limits
    most : float
        1 keeps the limits.
    """

    def __init__(self, basis: SinusoidBasis, limits: Limits, most: float) -> None:
        super().__init__(basis, limits)
        self._most = most
        every = max(1, basis.steps // (LOOKS_PER_HARMONIC * (basis.size // 2 + 1)))
        self._looks = tuple(
            np.ascontiguousarray(matrix[::every])
            for matrix in (basis.pose, basis.twist, basis.accel)
        )

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale down what exceeds the limits by more than `most`."""
        return parameters * min(1.0, self._most / max(self.use(parameters), 1e-300))

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return the excess over the limits (K,) [m], where there is any."""
        return -EXCESS_M * self._excess(parameters)[0]

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (K, P) of minus `penalty`."""
        slopes = self._excess(parameters)[1] * (EXCESS_M * self._scale)
        return slopes.reshape(len(slopes), parameters.size)

    def _excess(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose, twist, accel = self._looks
        own, limits = self.coefficients(parameters), self._limits
        value, slope = excess(own, pose, twist, accel, limits)
        if limits.forceful:
            more = force_excess(own, pose, twist, accel, limits)
            value, slope = np.concatenate([value, more[0]]), np.concatenate([slope, more[1]])
        return value, slope


@kernel()
def excess(
    coefficients: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray,
    limits: Limits,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return by how much motors and corners exceed `AIM` of their limits, and the slopes.

    Parameters
    ----------
    coefficients : (h, 3)
    pose, twist, accel : (n, h)
        Basis of one degree of freedom at the instants looked at.
    limits : Limits

    Returns
    -------
    value : (K,)
        Excess as a fraction of the limit, positive.
    slope : (K, h, 3)
        Its derivative by the coefficients.
    """
    size, rows = pose.shape[1], limits.levers
    value, slope = np.empty(len(pose) * 12), np.empty((len(pose) * 12, size, 3))
    found = 0
    x, v, a = pose @ coefficients, twist @ coefficients, accel @ coefficients
    for k in range(len(pose)):
        for i in range(len(rows)):
            for order in range(2):
                state = v[k] if order else x[k]
                q = rows[i, 0] * state[0] + rows[i, 1] * state[1] + rows[i, 2] * state[2]
                limit = limits.speed if order else limits.stroke_m
                used = abs(q) / limit
                if used > AIM:
                    sign = 1.0 if q > 0 else -1.0
                    for h in range(size):
                        each = sign * (twist[k, h] if order else pose[k, h]) / limit
                        for d in range(3):
                            slope[found, h, d] = each * rows[i, d]
                    value[found] = used - AIM
                    found += 1
        spin = v[k, 2]
        for corner in range(4):
            cx = limits.half[0] if corner & 1 else -limits.half[0]
            cy = limits.half[1] if corner & 2 else -limits.half[1]
            ax = a[k, 0] - a[k, 2] * cy - spin * spin * cx
            ay = a[k, 1] + a[k, 2] * cx - spin * spin * cy
            size_a = sqrt(ax * ax + ay * ay)
            if size_a > AIM * limits.accel:
                ux, uy = ax / size_a / limits.accel, ay / size_a / limits.accel
                turn, rate = uy * cx - ux * cy, -2 * spin * (ux * cx + uy * cy)
                for h in range(size):
                    slope[found, h, 0] = ux * accel[k, h]
                    slope[found, h, 1] = uy * accel[k, h]
                    slope[found, h, 2] = turn * accel[k, h] + rate * twist[k, h]
                value[found] = size_a / limits.accel - AIM
                found += 1
    return value[:found].copy(), slope[:found].copy()


@kernel()
def force_excess(
    coefficients: np.ndarray, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray,
    limits: Limits,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the same as `excess` of motors' peak forces, and of their root mean squares."""
    size, looks = pose.shape[1], len(pose)
    motors = limits.loads.shape[1]
    value, slope = np.empty((looks + 1) * motors), np.empty(((looks + 1) * motors, size, 3))
    found = 0
    x, v, a = pose @ coefficients, twist @ coefficients, accel @ coefficients
    for i in range(motors):
        on_pose, on_twist, on_accel = limits.loads[0, i], limits.loads[1, i], limits.loads[2, i]
        square, by_own = 0.0, np.zeros((size, 3))
        for k in range(looks):
            force = 0.0
            for d in range(3):
                force += on_pose[d] * x[k, d] + on_twist[d] * v[k, d] + on_accel[d] * a[k, d]
            square += force * force / looks
            over = abs(force) > AIM
            for h in range(size):
                for d in range(3):
                    each = on_pose[d] * pose[k, h] + on_twist[d] * twist[k, h]
                    each += on_accel[d] * accel[k, h]
                    by_own[h, d] += force * each / looks
                    if over:
                        slope[found, h, d] = each if force > 0 else -each
            if over:
                value[found] = abs(force) - AIM
                found += 1
        heat = limits.heat * sqrt(square)
        if heat > AIM:
            slope[found] = limits.heat * limits.heat / heat * by_own
            value[found] = heat - AIM
            found += 1
    return value[:found].copy(), slope[:found].copy()
