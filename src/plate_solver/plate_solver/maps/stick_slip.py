"""The cycle map: where parts are after one cycle, and how that depends on the plate's motion.

The plate's motion is sampled at the middles of steps, equal or not. In each step friction pulls a
part's velocity towards that of the surface, by at most mu g dt (implicit Coulomb step: slip and
stick alike). The derivatives are exact for this discrete map: one backward sweep per output. Steps
may end where a rotation ends: so no sample is passed by a rotation's edge, and searches do not
stumble over one.

Parts are innermost: their square roots overlap.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core import PlateCycle
from plate_core.kernels import SAME_ROUNDING, kernel

PREDICTION_STEP = 0.1e-3
"""Step for predicting what a finished cycle does [s]: it is done once, so it may be fine."""

TINY = 1e-300
"""Keeps 0/0 away."""


def after(
    cycle: PlateCycle,
    position: np.ndarray,
    velocity: np.ndarray,
    friction_accel: float | np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the state (M, 2) [m], [m/s] of parts after a cycle, in steps of `PREDICTION_STEP`."""
    friction_accel = np.array(np.broadcast_to(friction_accel, len(position)), dtype=float)
    return end_state(position, velocity, *finely_sampled(cycle), friction_accel)


def finely_sampled(cycle: PlateCycle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pose and twist (n, 3) at the middles of steps of `PREDICTION_STEP`, and these (n,)."""
    steps = max(1, round(cycle.period / PREDICTION_STEP))
    t = (np.arange(steps) + 0.5) * (cycle.period / steps)
    return cycle.pose(t), cycle.twist(t), np.full(steps, cycle.period / steps)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def end_state(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the parts' position and velocity (M, 2) after the sampled motion.

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
    count = len(position)
    px, py = position[:, 0].copy(), position[:, 1].copy()
    vx, vy = velocity[:, 0].copy(), velocity[:, 1].copy()
    for k in range(len(twist)):
        u, v, w, h = twist[k, 0], twist[k, 1], twist[k, 2], dt[k]
        x, y = pose[k, 0], pose[k, 1]
        for i in range(count):
            dx = u - w * (py[i] - y) - vx[i]
            dy = v + w * (px[i] - x) - vy[i]
            bound = friction_accel[i] * h
            gain = bound / (max(sqrt(dx * dx + dy * dy), bound) + TINY)
            vx[i] += gain * dx
            vy[i] += gain * dy
            px[i] += h * vx[i]
            py[i] += h * vy[i]
    return np.column_stack((px, py)), np.column_stack((vx, vy))


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def end_state_gradient(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray, coast: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the derivatives of the positions of `end_state`: x of all parts, then y of all; or of
    where the parts would be if they kept their last velocity for `coast` [s].

    Returns
    -------
    by_pose : (2, n, 2 M)
        By the plate's x and y; the positions do not depend on theta itself.
    by_twist : (3, n, 2 M)
    by_dt : (n, 2 M)
    """
    count, n = len(position), len(twist)
    px, py = position[:, 0].copy(), position[:, 1].copy()
    vx, vy = velocity[:, 0].copy(), velocity[:, 1].copy()
    arm_x, arm_y = np.empty((n, count)), np.empty((n, count))
    # d velocity step / d slip; friction while it slips; velocity
    xx, xy, yy = np.empty((n, count)), np.empty((n, count)), np.empty((n, count))
    fx, fy = np.empty((n, count)), np.empty((n, count))
    after_x, after_y = np.empty((n, count)), np.empty((n, count))
    for k in range(n):
        u, v, w, h = twist[k, 0], twist[k, 1], twist[k, 2], dt[k]
        x, y = pose[k, 0], pose[k, 1]
        for i in range(count):
            rx, ry = px[i] - x, py[i] - y
            dx, dy = u - w * ry - vx[i], v + w * rx - vy[i]
            arm_x[k, i], arm_y[k, i] = rx, ry
            bound, d = friction_accel[i] * h, sqrt(dx * dx + dy * dy)
            inverse = 1 / (max(d, bound) + TINY)
            gain, slips = bound * inverse, d > bound
            a, b = dx * inverse, dy * inverse  # unit vector of a slip
            xx[k, i] = gain * (1 - a * a) if slips else 1.0
            xy[k, i] = -gain * a * b if slips else 0.0
            yy[k, i] = gain * (1 - b * b) if slips else 1.0
            fx[k, i] = friction_accel[i] * a if slips else 0.0
            fy[k, i] = friction_accel[i] * b if slips else 0.0
            vx[i] += gain * dx
            vy[i] += gain * dy
            after_x[k, i], after_y[k, i] = vx[i], vy[i]
            px[i] += h * vx[i]
            py[i] += h * vy[i]
    by_pose, by_twist = np.empty((2, n, 2 * count)), np.empty((3, n, 2 * count))
    by_dt = np.empty((n, 2 * count))
    ax, ay, bx, by = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for axis in range(2):
        first = axis * count
        # Adjoints of position (a) and velocity (b) at the end of step k.
        ax[:], ay[:] = 1.0 - axis, 1.0 * axis
        bx[:], by[:] = coast * ax, coast * ay
        for back in range(n):
            k = n - 1 - back
            h, w = dt[k], twist[k, 2]
            for i in range(count):
                cx, cy = bx[i] + h * ax[i], by[i] + h * ay[i]
                by_dt[k, first + i] = (
                    ax[i] * after_x[k, i] + ay[i] * after_y[k, i]
                    + cx * fx[k, i] + cy * fy[k, i]
                )  # fmt: skip
                gx = xx[k, i] * cx + xy[k, i] * cy
                gy = xy[k, i] * cx + yy[k, i] * cy
                bx[i], by[i] = cx - gx, cy - gy
                ax[i] += w * gy
                ay[i] -= w * gx
                by_twist[0, k, first + i] = gx
                by_twist[1, k, first + i] = gy
                by_twist[2, k, first + i] = arm_x[k, i] * gy - arm_y[k, i] * gx
                by_pose[0, k, first + i] = -w * gy
                by_pose[1, k, first + i] = w * gx
    return by_pose, by_twist, by_dt
