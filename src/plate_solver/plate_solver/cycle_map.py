"""The cycle map: where parts are after one cycle, and how that depends on the plate's motion.

The plate's motion is sampled at the middles of n equal steps. In each step friction pulls a part's
velocity towards that of the surface, by at most mu g dt (implicit Coulomb step: slip and stick
alike). The derivatives are exact for this discrete map: one backward sweep per output.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit


@njit(cache=True, fastmath=True)
def end_state(
    position: np.ndarray,
    velocity: np.ndarray,
    pose: np.ndarray,
    twist: np.ndarray,
    dt: float,
    friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts' position and velocity (M, 2) after the sampled motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Parts at the start [m], [m/s], plate_home.
    pose, twist : (n, 3)
        Plate at the middles of the steps, plate_home.
    dt : float
        Length of a step [s].
    friction_accel : (M,)
        mu g of each part [m/s2].
    """
    p = position.copy()
    v = velocity.copy()
    for i in range(len(p)):
        bound = friction_accel[i] * dt
        px, py, vx, vy = p[i, 0], p[i, 1], v[i, 0], v[i, 1]
        for k in range(len(twist)):
            dx = twist[k, 0] - twist[k, 2] * (py - pose[k, 1]) - vx
            dy = twist[k, 1] + twist[k, 2] * (px - pose[k, 0]) - vy
            d = sqrt(dx * dx + dy * dy)
            share = 1.0 if d <= bound else bound / d
            vx += share * dx
            vy += share * dy
            px += dt * vx
            py += dt * vy
        p[i, 0], p[i, 1], v[i, 0], v[i, 1] = px, py, vx, vy
    return p, v


@njit(cache=True, fastmath=True)
def end_position_gradient(
    position: np.ndarray,
    velocity: np.ndarray,
    pose: np.ndarray,
    twist: np.ndarray,
    dt: float,
    friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return `end_state` and the derivatives of the end positions.

    Returns
    -------
    position, velocity : (M, 2)
        As `end_state`.
    by_twist : (2 M, n, 3)
        d end position / d twist; rows are part 1 x, part 1 y, part 2 x, ...
    by_pose : (2 M, n, 2)
        d end position / d plate position; the end position does not depend on theta itself.
    """
    count, n = len(position), len(twist)
    p = position.copy()
    v = velocity.copy()
    by_twist = np.empty((2 * count, n, 3))
    by_pose = np.empty((2 * count, n, 2))
    xx, xy, yy = np.empty(n), np.empty(n), np.empty(n)  # d velocity step / d surface velocity
    arm_x, arm_y = np.empty(n), np.empty(n)
    for i in range(count):
        bound = friction_accel[i] * dt
        px, py, vx, vy = p[i, 0], p[i, 1], v[i, 0], v[i, 1]
        for k in range(n):
            rx, ry = px - pose[k, 0], py - pose[k, 1]
            dx = twist[k, 0] - twist[k, 2] * ry - vx
            dy = twist[k, 1] + twist[k, 2] * rx - vy
            d = sqrt(dx * dx + dy * dy)
            arm_x[k], arm_y[k] = rx, ry
            if d <= bound:
                vx += dx
                vy += dy
                xx[k], xy[k], yy[k] = 1.0, 0.0, 1.0
            else:
                ux, uy, share = dx / d, dy / d, bound / d
                vx += bound * ux
                vy += bound * uy
                xx[k] = share * (1 - ux * ux)
                xy[k] = -share * ux * uy
                yy[k] = share * (1 - uy * uy)
            px += dt * vx
            py += dt * vy
        p[i, 0], p[i, 1], v[i, 0], v[i, 1] = px, py, vx, vy
        for axis in range(2):
            row = 2 * i + axis
            # Adjoint of position (a) and velocity (b) at the end of step k.
            ax, ay = 1.0 - axis, 1.0 * axis
            bx, by = 0.0, 0.0
            for back in range(n):
                k = n - 1 - back
                bx += dt * ax
                by += dt * ay
                gx = xx[k] * bx + xy[k] * by
                gy = xy[k] * bx + yy[k] * by
                bx -= gx
                by -= gy
                w = twist[k, 2]
                ax += w * gy
                ay -= w * gx
                by_twist[row, k, 0] = gx
                by_twist[row, k, 1] = gy
                by_twist[row, k, 2] = arm_x[k] * gy - arm_y[k] * gx
                by_pose[row, k, 0] = -w * gy
                by_pose[row, k, 1] = w * gx
    return p, v, by_twist, by_pose
