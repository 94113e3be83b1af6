"""The cycle map of discs that turn: place, angle and how they depend on the plate's motion.

A disc is nine points that carry equal shares of its weight: one in the middle, eight on a ring of
3/4 of its radius. That gives it the moment of inertia m R^2/2 and the greatest frictional torque
2/3 mu m g R of a disc pressed evenly on the plate. In each step friction pulls every point's
velocity towards that of the surface, by at most mu g dt, as in `stick_slip`; the disc takes on the
mean of what its points gain, and of their moment. Where all stick it moves with the plate in one
step; the step goes down the gradient of a convex function by no more than its curvature allows, so
it never overshoots.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from plate_core.kernels import kernel

RING_POINTS = 8
"""Points on the ring: few enough to be quick; with the one in the middle they bear alike."""

RING_SHARE = 0.75
"""Radius of the ring over the disc's: with nine equal points both moments are a disc's."""


def _ring() -> np.ndarray:
    turn = 2 * pi * np.arange(RING_POINTS) / RING_POINTS
    ring = RING_SHARE * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.vstack([np.zeros((1, 2)), ring])


POINTS = _ring()
"""The points (9, 2) [radii]."""


@kernel(fastmath=True)
def end_disc(
    position: np.ndarray,
    velocity: np.ndarray,
    spin: np.ndarray,
    pose: np.ndarray,
    twist: np.ndarray,
    dt: np.ndarray,
    friction_accel: np.ndarray,
    points: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return position (M, 2) [m], velocity (M, 2) [m/s], turn (M,) [rad] and spin (M,) [rad/s] of
    discs after the sampled motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Centres at the start [m], [m/s], plate_home.
    spin : (M,)
        At the start [rad/s].
    pose, twist : (n, 3)
        Plate at the middles of the steps, plate_home.
    dt : (n,)
        Lengths of the steps [s].
    friction_accel : (M,)
        mu g [m/s2].
    points : (k, 2)
        Points of a disc [m], from its centre: `POINTS` times the radius.
    """
    p, v = position.copy(), velocity.copy()
    turn, c = np.zeros(len(p)), spin.copy()
    load = 1.0 / len(points)
    gyration = np.sum(points**2) * load
    for i in range(len(p)):
        px, py, vx, vy, w, angle = p[i, 0], p[i, 1], v[i, 0], v[i, 1], c[i], 0.0
        for k in range(len(twist)):
            spin_k, bound = twist[k, 2], friction_accel[i] * dt[k]
            sx = twist[k, 0] - spin_k * (py - pose[k, 1]) - vx
            sy = twist[k, 1] + spin_k * (px - pose[k, 0]) - vy
            gx, gy, gw = 0.0, 0.0, 0.0
            for j in range(len(points)):
                rx, ry = points[j, 0], points[j, 1]
                dx, dy = sx - (spin_k - w) * ry, sy + (spin_k - w) * rx
                d = sqrt(dx * dx + dy * dy)
                if d > bound:
                    dx *= bound / d
                    dy *= bound / d
                gx += dx
                gy += dy
                gw += rx * dy - ry * dx
            vx += load * gx
            vy += load * gy
            w += load * gw / gyration
            px += dt[k] * vx
            py += dt[k] * vy
            angle += dt[k] * w
        p[i, 0], p[i, 1], v[i, 0], v[i, 1], c[i], turn[i] = px, py, vx, vy, w, angle
    return p, v, turn, c


@kernel(fastmath=True)
def end_disc_gradient(
    position: np.ndarray,
    velocity: np.ndarray,
    spin: np.ndarray,
    pose: np.ndarray,
    twist: np.ndarray,
    dt: np.ndarray,
    friction_accel: np.ndarray,
    points: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of the end positions and turns, exact for the discrete map.

    Returns
    -------
    by_pose : (2, n, 3 M)
        Last x of all discs, then y of all, then turn of all.
    by_twist : (3, n, 3 M)
    by_dt : (n, 3 M)
    """
    count, n = len(position), len(twist)
    by_twist, by_pose = np.empty((3, n, 3 * count)), np.empty((2, n, 3 * count))
    by_dt = np.empty((n, 3 * count))
    load = 1.0 / len(points)
    gyration = np.sum(points**2) * load
    # Gain of (vx, vy, w) by slip (x, y, turning) of the centre: symmetric but for the last row's
    # 1/gyration.
    gain = np.empty((n, 6))
    arm = np.empty((n, 2))
    path = np.empty((n, 6))  # friction while it slips, and its moment; velocity and spin
    for i in range(count):
        px, py, vx, vy, w = position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], spin[i]
        for k in range(n):
            spin_k, bound = twist[k, 2], friction_accel[i] * dt[k]
            ax, ay = px - pose[k, 0], py - pose[k, 1]
            arm[k, 0], arm[k, 1] = ax, ay
            sx, sy = twist[k, 0] - spin_k * ay - vx, twist[k, 1] + spin_k * ax - vy
            gx, gy, gw = 0.0, 0.0, 0.0
            fx, fy, fw = 0.0, 0.0, 0.0
            xx, xy, yy, xw, yw, ww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(len(points)):
                rx, ry = points[j, 0], points[j, 1]
                dx, dy = sx - (spin_k - w) * ry, sy + (spin_k - w) * rx
                d = sqrt(dx * dx + dy * dy)
                jxx, jxy, jyy = 1.0, 0.0, 1.0
                if d > bound:
                    ux, uy, s = dx / d, dy / d, bound / d
                    jxx, jxy, jyy = s * (1 - ux * ux), -s * ux * uy, s * (1 - uy * uy)
                    dx, dy = bound * ux, bound * uy
                    fx += ux
                    fy += uy
                    fw += rx * uy - ry * ux
                gx += dx
                gy += dy
                gw += rx * dy - ry * dx
                jxw, jyw = jxy * rx - jxx * ry, jyy * rx - jxy * ry
                xx += jxx
                xy += jxy
                yy += jyy
                xw += jxw
                yw += jyw
                ww += rx * jyw - ry * jxw
            gain[k, 0], gain[k, 1], gain[k, 2] = load * xx, load * xy, load * yy
            gain[k, 3], gain[k, 4], gain[k, 5] = load * xw, load * yw, load * ww
            vx += load * gx
            vy += load * gy
            w += load * gw / gyration
            force = load * friction_accel[i]
            path[k, 0], path[k, 1], path[k, 2] = force * fx, force * fy, force * fw / gyration
            path[k, 3], path[k, 4], path[k, 5] = vx, vy, w
            px += dt[k] * vx
            py += dt[k] * vy
        for axis in range(3):
            row = axis * count + i
            # Adjoints of place, velocity, angle and spin at the end of step k.
            ax = 1.0 if axis == 0 else 0.0
            ay = 1.0 if axis == 1 else 0.0
            aw = 1.0 if axis == 2 else 0.0
            bx, by, bw = 0.0, 0.0, 0.0
            for back in range(n):
                k = n - 1 - back
                bx += dt[k] * ax
                by += dt[k] * ay
                bw += dt[k] * aw
                by_dt[k, row] = (
                    ax * path[k, 3] + ay * path[k, 4] + aw * path[k, 5]
                    + bx * path[k, 0] + by * path[k, 1] + bw * path[k, 2]
                )  # fmt: skip
                hw = bw / gyration
                gx = gain[k, 0] * bx + gain[k, 1] * by + gain[k, 3] * hw
                gy = gain[k, 1] * bx + gain[k, 2] * by + gain[k, 4] * hw
                gw = gain[k, 3] * bx + gain[k, 4] * by + gain[k, 5] * hw
                bx -= gx
                by -= gy
                bw -= gw
                s = twist[k, 2]
                ax += s * gy
                ay -= s * gx
                by_twist[0, k, row] = gx
                by_twist[1, k, row] = gy
                by_twist[2, k, row] = arm[k, 0] * gy - arm[k, 1] * gx + gw
                by_pose[0, k, row] = -s * gy
                by_pose[1, k, row] = s * gx
    return by_pose, by_twist, by_dt
