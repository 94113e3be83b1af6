"""The cycle map and the averaged map over unequal steps, as sequences of rotations have them.

As `cycle_map`, with the derivatives by the steps' lengths too: steps end where rotations end, so
there is no sample that a rotation's edge could pass, and searches do not stumble over one.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

TINY_SQUARE = 1e-24
"""Squared slip [m2/s2] below which the direction of friction is taken as none."""


@njit(cache=True, fastmath=True)
def end_positions(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the parts' positions (M, 2) after the motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Parts at the start [m], [m/s], plate_home.
    pose, twist : (n, 3)
        Plate at the middles of the steps, plate_home.
    dt : (n,)
        Lengths of the steps [s].
    friction_accel : (M,)
        mu g of each part [m/s2].
    """
    p = position.copy()
    for i in range(len(p)):
        px, py, vx, vy = p[i, 0], p[i, 1], velocity[i, 0], velocity[i, 1]
        for k in range(len(twist)):
            dx = twist[k, 0] - twist[k, 2] * (py - pose[k, 1]) - vx
            dy = twist[k, 1] + twist[k, 2] * (px - pose[k, 0]) - vy
            d = sqrt(dx * dx + dy * dy)
            bound = friction_accel[i] * dt[k]
            share = 1.0 if d <= bound else bound / d
            vx += share * dx
            vy += share * dy
            px += dt[k] * vx
            py += dt[k] * vy
        p[i, 0], p[i, 1] = px, py
    return p


@njit(cache=True, fastmath=True)
def end_position_slopes(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the derivatives of `end_positions`: rows are part 1 x, part 1 y, part 2 x, ...

    Returns
    -------
    by_pose, by_twist : (2 M, n, 3)
    by_dt : (2 M, n)
    """
    count, n = len(position), len(twist)
    by_twist, by_pose = np.empty((2 * count, n, 3)), np.zeros((2 * count, n, 3))
    by_dt = np.empty((2 * count, n))
    path = np.empty((n, 9))  # arm, d velocity step / d slip, friction while it slips, velocity
    for i in range(count):
        px, py, vx, vy = position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1]
        for k in range(n):
            rx, ry = px - pose[k, 0], py - pose[k, 1]
            dx = twist[k, 0] - twist[k, 2] * ry - vx
            dy = twist[k, 1] + twist[k, 2] * rx - vy
            d = sqrt(dx * dx + dy * dy)
            bound = friction_accel[i] * dt[k]
            row = path[k]
            row[0], row[1] = rx, ry
            if d <= bound:
                vx += dx
                vy += dy
                row[2], row[3], row[4], row[5], row[6] = 1.0, 0.0, 1.0, 0.0, 0.0
            else:
                a, b, share = dx / d, dy / d, bound / d
                vx += bound * a
                vy += bound * b
                row[2], row[3], row[4] = share * (1 - a * a), -share * a * b, share * (1 - b * b)
                row[5], row[6] = friction_accel[i] * a, friction_accel[i] * b
            row[7], row[8] = vx, vy
            px += dt[k] * vx
            py += dt[k] * vy
        for axis in range(2):
            r = 2 * i + axis
            # Adjoint of position (a) and velocity (b) at the end of step k.
            ax, ay = 1.0 - axis, 1.0 * axis
            bx, by = 0.0, 0.0
            for back in range(n):
                k = n - 1 - back
                row = path[k]
                bx += dt[k] * ax
                by += dt[k] * ay
                by_dt[r, k] = ax * row[7] + ay * row[8] + bx * row[5] + by * row[6]
                gx = row[2] * bx + row[3] * by
                gy = row[3] * bx + row[4] * by
                bx -= gx
                by -= gy
                w = twist[k, 2]
                ax += w * gy
                ay -= w * gx
                by_twist[r, k, 0], by_twist[r, k, 1] = gx, gy
                by_twist[r, k, 2] = row[0] * gy - row[1] * gx
                by_pose[r, k, 0], by_pose[r, k, 1] = -w * gy, w * gx
    return by_pose, by_twist, by_dt


@njit(cache=True, fastmath=True)
def mean_forces(
    position: np.ndarray, velocity: np.ndarray, twist: np.ndarray, dt: np.ndarray
) -> np.ndarray:
    """Return force x, force y [mu m g] and curl [mu m g / m] of each part, (M, 3): (5), (11)."""
    total = dt.sum()
    mean = np.zeros((len(position), 3))
    for i in range(len(position)):
        fx = fy = curl = 0.0
        for k in range(len(twist)):
            dx = twist[k, 0] - twist[k, 2] * position[i, 1] - velocity[i, 0]
            dy = twist[k, 1] + twist[k, 2] * position[i, 0] - velocity[i, 1]
            square = dx * dx + dy * dy
            share = dt[k] / sqrt(square) if square > TINY_SQUARE else 0.0
            fx += share * dx
            fy += share * dy
            curl += share * twist[k, 2]
        mean[i, 0], mean[i, 1], mean[i, 2] = fx / total, fy / total, curl / total
    return mean
