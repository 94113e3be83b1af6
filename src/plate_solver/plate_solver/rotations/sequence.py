"""A sequence of rotations as one closed motion in time, from rest to rest.

Rotation j is held at a constant twist for a time and joined to the next by a smooth ramp (a cubic
in the twist) as short as the acceleration allows, or as long as blending asks. What is then still
missing to a closed motion is taken out by a smooth bump over the whole cycle, so every sequence
closes exactly. The derivatives are exact: one backward pass over the knots.

Knots of J rotations: 0 at rest; 2 j + 1 and 2 j + 2 begin and end rotation j (from 0); 2 J + 1 at
rest; 2 J + 2 the end of the period.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

RAMP_PEAK = 1.5
"""Peak of a cubic ramp's acceleration over its mean."""


@kernel(fastmath=SAME_ROUNDING)
def ramps(
    twists: np.ndarray, half: np.ndarray, loads: np.ndarray, accel: float, least: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths (J + 1,) [s] of the ramps and their derivatives (J + 1, 3).

    Parameters
    ----------
    twists : (J, 3)
        Twist of each rotation; rest comes before the first and after the last.
    half : (2,)
        Half sides [m].
    loads : (m, 3)
        Of what else has a limit, such as motors' forces: rows whose product with the plate's
        acceleration is kept below `accel` too.
    accel : float
        Peak acceleration of the fastest corner [m/s2].
    least : float
        Least length of a ramp [s].

    Returns
    -------
    length : (J + 1,)
    slope : (J + 1, 3)
        By the change of twist; the rotation after the ramp adds, the one before it takes away.
    """
    count = len(twists)
    length = np.zeros(count + 1)
    slope = np.zeros((count + 1, 3))
    for j in range(count + 1):
        d = np.zeros(3)
        if j < count:
            d += twists[j]
        if j > 0:
            d -= twists[j - 1]
        most, at_x, at_y = -1.0, 0.0, 0.0
        for x in (-half[0], half[0]):
            for y in (-half[1], half[1]):
                square = (d[0] - d[2] * y) ** 2 + (d[1] + d[2] * x) ** 2
                if square > most:
                    most, at_x, at_y = square, x, y
        change, which = sqrt(most), -1
        for i in range(len(loads)):
            load = abs(loads[i, 0] * d[0] + loads[i, 1] * d[1] + loads[i, 2] * d[2])
            if load > change:
                change, which = load, i
        length[j] = RAMP_PEAK * change / accel
        if length[j] < least:
            length[j] = least
        elif which >= 0:
            row = loads[which]
            way = 1.0 if row[0] * d[0] + row[1] * d[1] + row[2] * d[2] > 0 else -1.0
            for c in range(3):
                slope[j, c] = RAMP_PEAK / accel * way * row[c]
        elif change > 0:
            gx, gy = (d[0] - d[2] * at_y) / change, (d[1] + d[2] * at_x) / change
            slope[j, 0] = RAMP_PEAK / accel * gx
            slope[j, 1] = RAMP_PEAK / accel * gy
            slope[j, 2] = RAMP_PEAK / accel * (gy * at_x - gx * at_y)
    return length, slope


@kernel(fastmath=SAME_ROUNDING)
def timeline(
    holds: np.ndarray, twists: np.ndarray, ramp: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return knot times (2 J + 3,) [s] and twists there (2 J + 3, 3).

    `holds` (J + 1,) are the relative lengths of the J rotations and of the rest at the end: they
    fill what the ramps leave of the period.
    """
    count = len(twists)
    scale = (period - ramp.sum()) / holds.sum()
    times = np.zeros(2 * count + 3)
    knots = np.zeros((2 * count + 3, 3))
    t = 0.0
    for j in range(count):
        t += ramp[j]
        times[2 * j + 1] = t
        t += scale * holds[j]
        times[2 * j + 2] = t
        knots[2 * j + 1] = twists[j]
        knots[2 * j + 2] = twists[j]
    times[2 * count + 1] = t + ramp[count]
    times[2 * count + 2] = period
    return times, knots


@kernel(fastmath=SAME_ROUNDING)
def knot_poses(times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the pose (K, 3) at every knot before the motion is closed."""
    pose = np.zeros_like(knots)
    for k in range(1, len(times)):
        h = times[k] - times[k - 1]
        for c in range(3):
            pose[k, c] = pose[k - 1, c] + 0.5 * h * (knots[k - 1, c] + knots[k, c])
    return pose


@kernel(fastmath=SAME_ROUNDING)
def motion(
    times: np.ndarray, knots: np.ndarray, counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return pose, twist, acceleration (n, 3) at the middles of steps, and the steps (n,) [s].

    Every ramp is cut into `counts[0]` equal steps, every hold into `counts[1]`: as steps end where
    segments end, what follows from them is as smooth in the parameters as the friction allows.
    Last comes the gap (3,) that had to be closed.
    """
    segments, period = len(times) - 1, times[-1]
    steps = (segments // 2) * (counts[0] + counts[1])
    pose, twist, accel = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 3))
    dt = np.empty(steps)
    corners = knot_poses(times, knots)
    gap = corners[-1].copy()
    i = 0
    for k in range(segments):
        h, count = times[k + 1] - times[k], counts[k % 2]
        for part in range(count):
            x = (part + 0.5) / count
            y = (times[k] + h * x) / period
            bump = y**3 * (10 - 15 * y + 6 * y * y)
            bump_rate = 30 * y * y * (1 - y) ** 2 / period
            bump_accel = 60 * y * (1 - y) * (1 - 2 * y) / period**2
            bend = 6 * x * (1 - x) / h if h > 0 else 0.0
            for c in range(3):
                u, d = knots[k, c], knots[k + 1, c] - knots[k, c]
                z = corners[k, c] + h * (u * x + d * (x**3 - 0.5 * x**4))
                pose[i, c] = z - gap[c] * bump
                twist[i, c] = u + d * x * x * (3 - 2 * x) - gap[c] * bump_rate
                accel[i, c] = d * bend - gap[c] * bump_accel
            dt[i] = h / count
            i += 1
    return pose, twist, accel, dt, gap


@kernel(fastmath=SAME_ROUNDING)
def pull_back(
    times: np.ndarray, knots: np.ndarray, counts: tuple[int, int],
    by_pose: np.ndarray, by_twist: np.ndarray, by_dt: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Turn derivatives by what `motion` returns into ones by the knots.

    Parameters
    ----------
    times, knots : (K,), (K, 3)
    by_pose : (3, n, R), or (2, n, R) where nothing depends on theta itself
    by_twist : (3, n, R)
    by_dt : (n, R)

    Returns
    -------
    by_time : (R, K)
    by_knot : (R, K, 3)
    """
    rows, segments, period = by_dt.shape[1], len(times) - 1, times[-1]
    by_time, by_knot = np.zeros((rows, segments + 1)), np.zeros((rows, segments + 1, 3))
    by_corner = np.zeros((rows, segments + 1, 3))
    gap = knot_poses(times, knots)[-1]
    posed = len(by_pose)
    i = 0
    for k in range(segments):
        h, count = times[k + 1] - times[k], counts[k % 2]
        for part in range(count):
            x = (part + 0.5) / count
            y = (times[k] + h * x) / period
            bump = y**3 * (10 - 15 * y + 6 * y * y)
            bump_rate = 30 * y * y * (1 - y) ** 2 / period
            bump_accel = 60 * y * (1 - y) * (1 - 2 * y) / period**2
            s, rise = x * x * (3 - 2 * x), x**3 - 0.5 * x**4
            for r in range(rows):
                by_h, by_t = by_dt[i, r] / count, 0.0
                for c in range(3):
                    g, q = by_twist[c, i, r], by_pose[c, i, r] if c < posed else 0.0
                    by_knot[r, k, c] += g * (1 - s) + q * h * (x - rise)
                    by_knot[r, k + 1, c] += g * s + q * h * rise
                    by_h += q * (knots[k, c] * x + (knots[k + 1, c] - knots[k, c]) * rise)
                    by_t -= gap[c] * (q * bump_rate + g * bump_accel)
                    by_corner[r, k, c] += q
                    by_corner[r, segments, c] -= q * bump + g * bump_rate
                by_time[r, k] += by_t * (1 - x) - by_h
                by_time[r, k + 1] += by_t * x + by_h
            i += 1
    corners_back(times, knots, by_corner, by_time, by_knot)
    return by_time, by_knot


@kernel(fastmath=SAME_ROUNDING)
def corners_back(
    times: np.ndarray, knots: np.ndarray, by_corner: np.ndarray, by_time: np.ndarray,
    by_knot: np.ndarray,
) -> None:  # fmt: skip
    """Add what comes through `knot_poses`."""
    for r in range(len(by_corner)):
        for c in range(3):
            total = 0.0
            for k in range(len(times) - 1, 0, -1):
                total += by_corner[r, k, c]
                mean, h = 0.5 * (knots[k - 1, c] + knots[k, c]), times[k] - times[k - 1]
                by_knot[r, k - 1, c] += 0.5 * h * total
                by_knot[r, k, c] += 0.5 * h * total
                by_time[r, k] += mean * total
                by_time[r, k - 1] -= mean * total


@kernel(fastmath=SAME_ROUNDING)
def gap_back(times: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives (3, K), (3, K, 3) of the gap by the knots."""
    by_time, by_knot = np.zeros((3, len(times))), np.zeros((3, len(times), 3))
    by_corner = np.zeros((3, len(times), 3))
    for c in range(3):
        by_corner[c, -1, c] = 1.0
    corners_back(times, knots, by_corner, by_time, by_knot)
    return by_time, by_knot


@kernel(fastmath=SAME_ROUNDING)
def timeline_back(
    holds: np.ndarray, ramp: np.ndarray, slope: np.ndarray, period: float,
    by_time: np.ndarray, by_knot: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Turn derivatives by the knots of `timeline` into ones by holds (R, J + 1), twists (R, J, 3).

    `ramp` and `slope` are those of `ramps`.
    """
    rows, count = len(by_time), len(ramp) - 1
    total = holds.sum()
    scale = (period - ramp.sum()) / total
    by_hold, by_twist = np.zeros((rows, count + 1)), np.zeros((rows, count, 3))
    by_ramp = np.zeros(count + 1)
    for r in range(rows):
        after, shared = 0.0, 0.0  # derivative by the length of a segment: all knots behind it
        for k in range(2 * count + 1, -1, -1):
            after += by_time[r, k + 1]
            if k % 2:
                by_hold[r, k // 2] = scale * after
                shared += holds[k // 2] / total * after
            else:
                by_ramp[k // 2] = after
        for j in range(count + 1):
            by_hold[r, j] -= scale * shared
            for c in range(3):
                change = (by_ramp[j] - shared) * slope[j, c]
                if j < count:
                    by_twist[r, j, c] += (
                        change + by_knot[r, 2 * j + 1, c] + by_knot[r, 2 * j + 2, c]
                    )
                if j > 0:
                    by_twist[r, j - 1, c] -= change
    return by_hold, by_twist
