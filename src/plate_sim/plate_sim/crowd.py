"""Friction of many discs in one step: as `friction.friction_step`, all discs at once.

The surface's velocity is a parabola through both ends and the middle of the step: long steps, which
many discs want, then err several times less.

Discs are columns: x, y [m] and u, v [m/s] in plate_home, each (P,), P a multiple of `LANES`, the
last ones unused copies. Loops without branches run on several discs per instruction.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from .friction import SPLIT  # numba does not see changes there: delete the cache then

LANES = 16
"""Discs are padded to a multiple of this: compiled loops then have no slow remainder."""

COARSE_STEP, COARSE_SPLIT = 2e-4, 8
"""From this step [s] on, pieces of a step in which the slip may vanish: a step so long errs more
elsewhere."""

TINY = 1e-200
"""Added to a squared slip [m2/s2], so that none is divided by 0."""

# No flag that forgives NaN or infinity: they are found, and reported.
FAST = {"contract", "reassoc", "arcp", "nsz"}


@njit(cache=True)
def sample_motion(times, pieces, steps, pose, twist):
    """Fill pose and twist (steps + 1, 3) from a cycle's knots (K + 1,) and powers (K, 6, 3)."""
    k, last = 0, len(times) - 2
    for row in range(steps + 1):
        t = times[-1] * row / steps
        while k < last and t >= times[k + 1]:
            k += 1
        h = t - times[k]
        for d in range(3):
            p, q = pieces[k, 5, d], 0.0
            for power in range(4, -1, -1):
                q = q * h + p
                p = p * h + pieces[k, power, d]
            pose[row, d], twist[row, d] = p, q


@njit(cache=True, fastmath=FAST, error_model="numpy")
def advance(discs, work, pose, twist, row, step):
    """Advance all discs by one step, in place; contacts come after.

    Parameters
    ----------
    discs : (5, P)
        x, y [m], u, v [m/s], mu g [m/s2].
    work : (12, P)
        Room to work in.
    pose, twist, row : (2 n + 1, 3), (2 n + 1, 3), int
        The plate's motion at the ends and middles of steps, and the row where the step starts.
    step : float
        [s].
    """
    x, y, u, v, limit, near = discs[0], discs[1], discs[2], discs[3], discs[4], work[9]
    ox, oy, ou, ov, ow = pose[row, 0], pose[row, 1], twist[row, 0], twist[row, 1], twist[row, 2]
    mu, mv, mw = twist[row + 1, 0], twist[row + 1, 1], twist[row + 1, 2]
    row += 2
    qx, qy, qu, qv, qw = pose[row, 0], pose[row, 1], twist[row, 0], twist[row, 1], twist[row, 2]
    # How far the velocity at the middle is off the mean of the ends
    bu, bv, bw = mu - 0.5 * (ou + qu), mv - 0.5 * (ov + qv), mw - 0.5 * (ow + qw)
    for i in range(len(x)):
        kick = limit[i] * step
        sx, sy = ou - ow * (y[i] - oy), ov + ow * (x[i] - ox)
        ex = qu - qw * (y[i] + step * v[i] - qy)
        ey = qv + qw * (x[i] + step * u[i] - qx)
        sx, sy, ex, ey = sx - u[i], sy - v[i], ex - u[i], ey - v[i]
        reach2 = 2 * kick**2 + 2 * ((ex - sx) ** 2 + (ey - sy) ** 2)
        # Where the slip may vanish within the step, nothing moves yet.
        free = 1.0 if min(sx * sx + sy * sy, ex * ex + ey * ey) > reach2 else 0.0
        near[i] = free
        dx = 0.5 * (sx + ex) + 2 / 3 * (bu - bw * (y[i] - oy))
        dy = 0.5 * (sy + ey) + 2 / 3 * (bv + bw * (x[i] - ox))
        share = free * kick / np.sqrt(dx * dx + dy * dy + TINY)
        half = 0.5 * step * share
        x[i] += free * step * u[i] + half * dx
        y[i] += free * step * v[i] + half * dy
        u[i] += share * dx
        v[i] += share * dy
    count = 0
    for i in range(len(x)):
        if near[i] == 0:
            near[count] = i
            count += 1
    if count:
        start, end, bulge = (ox, oy, ou, ov, ow), (qx, qy, qu, qv, qw), (bu, bv, bw)
        _advance_near(discs, work, count, start, end, bulge, step)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _advance_near(discs, work, count, start, end, bulge, step):
    """Advance the `count` discs listed in the last row of `work`, in pieces of the step."""
    x, y, u, v, limit, near = discs[0], discs[1], discs[2], discs[3], discs[4], work[9]
    pieces = SPLIT if step < COARSE_STEP else COARSE_SPLIT
    rows = (count + LANES - 1) // LANES * LANES
    px, py, pu, pv = work[0, :rows], work[1, :rows], work[2, :rows], work[3, :rows]
    tx, ty, gx, gy = work[4, :rows], work[5, :rows], work[6, :rows], work[7, :rows]
    kick = work[8, :rows]
    hx, hy = work[10, :rows], work[11, :rows]
    for row in range(rows):
        i = int(near[min(row, count - 1)])
        px[row], py[row], pu[row], pv[row] = 0.0, 0.0, u[i], v[i]
        tx[row] = start[2] - start[4] * (y[i] - start[1])
        ty[row] = start[3] + start[4] * (x[i] - start[0])
        gx[row] = (end[2] - end[4] * (y[i] + step * v[i] - end[1]) - tx[row]) / pieces
        gy[row] = (end[3] + end[4] * (x[i] + step * u[i] - end[0]) - ty[row]) / pieces
        hx[row] = 4 * (bulge[0] - bulge[2] * (y[i] - start[1]))
        hy[row] = 4 * (bulge[1] + bulge[2] * (x[i] - start[0]))
        kick[row] = limit[i] * step / pieces
    for piece in range(1, pieces + 1):
        share = piece / pieces
        bow = share * (1 - share)
        for row in range(rows):
            tx[row] += gx[row]
            ty[row] += gy[row]
            dx = tx[row] + bow * hx[row] - pu[row]
            dy = ty[row] + bow * hy[row] - pv[row]
            part = min(1.0, kick[row] / np.sqrt(dx * dx + dy * dy + TINY))
            px[row] += pu[row] + 0.5 * part * dx
            py[row] += pv[row] + 0.5 * part * dy
            pu[row] += part * dx
            pv[row] += part * dy
    for row in range(count):
        i = int(near[row])
        x[i] += step / pieces * px[row]
        y[i] += step / pieces * py[row]
        u[i], v[i] = pu[row], pv[row]


@njit(cache=True, fastmath=FAST | {"nnan"}, error_model="numpy")
def drift_apart(x, y, x0, y0, count):
    """Bound on how far [m] any two of `count` discs moved towards each other since (x0, y0)."""
    low_x = high_x = x[0] - x0[0]
    low_y = high_y = y[0] - y0[0]
    for i in range(count):
        dx, dy = x[i] - x0[i], y[i] - y0[i]
        low_x, high_x = min(low_x, dx), max(high_x, dx)
        low_y, high_y = min(low_y, dy), max(high_y, dy)
    return sqrt((high_x - low_x) ** 2 + (high_y - low_y) ** 2)
