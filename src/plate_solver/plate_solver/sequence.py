"""A sequence of rotations as one closed motion in time, from rest to rest.

Rotation j is held at a constant twist for a time and joined to the next by a smooth ramp (a cubic
in the twist) as short as the acceleration allows. What is then still missing to a closed motion is
taken out by a small smooth bump over the whole cycle, so every sequence closes exactly.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

RAMP_PEAK = 1.5
"""Peak of a cubic ramp's acceleration over its mean."""


@njit(cache=True, fastmath=True)
def timeline(
    holds: np.ndarray, speed: np.ndarray, twists: np.ndarray, half: np.ndarray,
    period: float, accel: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return knot times (2 J + 3,) [s] and twists there (2 J + 3, 3).

    Parameters
    ----------
    holds : (J + 1,)
        Relative lengths of the J holds and of the rest at the end; they fill the period.
    speed : (J,)
        Signed speeds of the fastest corner [m/s].
    twists : (J, 3)
        Unit twists, see `unit_twists`.
    half : (2,)
        Half sides [m].
    accel : float
        Acceleration that a ramp may have [m/s2].
    """
    count = len(speed)
    ramp = np.zeros(count + 1)
    before = np.zeros(3)
    total = 0.0
    for j in range(count + 1):
        after = twists[j] * speed[j] if j < count else np.zeros(3)
        d0, d1, d2 = after[0] - before[0], after[1] - before[1], after[2] - before[2]
        most = 0.0
        for sx in (-half[0], half[0]):
            for sy in (-half[1], half[1]):
                most = max(most, (d0 - d2 * sy) ** 2 + (d1 + d2 * sx) ** 2)
        ramp[j] = RAMP_PEAK * sqrt(most) / accel
        total += ramp[j]
        before = after
    # Ramps that do not fit are made shorter by going slower: all speeds by the same factor.
    factor = min(1.0, 0.98 * period / total) if total > 0 else 1.0
    scale = (period - factor * total) / holds.sum()
    times = np.zeros(2 * count + 3)
    knots = np.zeros((2 * count + 3, 3))
    t = 0.0
    for j in range(count):
        t += factor * ramp[j]
        times[2 * j + 1] = t
        t += scale * holds[j]
        times[2 * j + 2] = t
        for c in range(3):
            knots[2 * j + 1, c] = factor * speed[j] * twists[j, c]
            knots[2 * j + 2, c] = knots[2 * j + 1, c]
    times[2 * count + 1] = t + factor * ramp[count]
    times[2 * count + 2] = period
    return times, knots


@njit(cache=True, fastmath=True)
def knot_poses(times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the pose (K, 3) at every knot before the motion is closed."""
    pose = np.zeros_like(knots)
    for k in range(1, len(times)):
        h = times[k] - times[k - 1]
        for c in range(3):
            pose[k, c] = pose[k - 1, c] + 0.5 * h * (knots[k - 1, c] + knots[k, c])
    return pose


@njit(cache=True, fastmath=True)
def motion(
    times: np.ndarray, knots: np.ndarray, steps: int, pose: np.ndarray, twist: np.ndarray,
    accel: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Fill pose, twist and acceleration (n, 3) at the middles of `steps` equal steps.

    Returns the gap (3,) that had to be closed.
    """
    period = times[-1]
    corners = knot_poses(times, knots)
    gap = corners[-1].copy()
    k = 0
    for i in range(steps):
        t = (i + 0.5) * period / steps
        while k < len(times) - 2 and times[k + 1] <= t:
            k += 1
        h = times[k + 1] - times[k]
        x = (t - times[k]) / h if h > 0 else 0.0
        y = t / period
        bump = y**3 * (10 - 15 * y + 6 * y * y)
        bump_rate = 30 * y * y * (1 - y) ** 2 / period
        bump_accel = 60 * y * (1 - y) * (1 - 2 * y) / period**2
        for c in range(3):
            u, d = knots[k, c], knots[k + 1, c] - knots[k, c]
            z = corners[k, c] + h * (u * x + d * (x**3 - 0.5 * x**4))
            pose[i, c] = z - gap[c] * bump
            twist[i, c] = u + d * x * x * (3 - 2 * x) - gap[c] * bump_rate
            accel[i, c] = (d * 6 * x * (1 - x) / h if h > 0 else 0.0) - gap[c] * bump_accel
    return gap


@njit(cache=True, fastmath=True)
def motion_slopes(
    holds: np.ndarray, speed: np.ndarray, twists: np.ndarray, half: np.ndarray,
    period: float, accel: float, steps: int, step: float, hold_scale: float, speed_scale: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return derivatives of twist (P, n, 3), of position (P, n, 2), and of the gap (P, 3).

    By forward differences of `step` in each parameter, in units of its scale.
    """
    count = len(speed)
    size = 2 * count + 1
    base_pose, base_twist = np.zeros((steps, 3)), np.zeros((steps, 3))
    work = np.zeros((steps, 3))
    times, knots = timeline(holds, speed, twists, half, period, accel)
    base_gap = motion(times, knots, steps, base_pose, base_twist, work)
    by_twist = np.zeros((size, steps, 3))
    by_pose = np.zeros((size, steps, 2))
    by_gap = np.zeros((size, 3))
    pose, twist = np.zeros((steps, 3)), np.zeros((steps, 3))
    for p in range(size):
        new_holds, new_speed = holds.copy(), speed.copy()
        if p <= count:
            new_holds[p] += step * hold_scale
        else:
            new_speed[p - count - 1] += step * speed_scale
        times, knots = timeline(new_holds, new_speed, twists, half, period, accel)
        gap = motion(times, knots, steps, pose, twist, work)
        for i in range(steps):
            for c in range(3):
                by_twist[p, i, c] = (twist[i, c] - base_twist[i, c]) / step
            by_pose[p, i, 0] = (pose[i, 0] - base_pose[i, 0]) / step
            by_pose[p, i, 1] = (pose[i, 1] - base_pose[i, 1]) / step
        by_gap[p] = (gap - base_gap) / step
    return by_twist, by_pose, by_gap
