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

STILL = 0.01
"""A slip below this share of mu g times the step is none: as little comes from the plate's turning
while the part moves, at up to 20 rad/s in steps of 1 ms."""

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
def advance(discs, work, pose, twist, row, step, pull, ratio):
    """Advance all discs by one step, in place, but for the `fall`; contacts come after.

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
    pull, ratio : (2,), float
        Acceleration without friction [m/s2], and static over dynamic friction.
    """
    x, y, u, v, limit, near = discs[0], discs[1], discs[2], discs[3], discs[4], work[9]
    # In a frame that falls with the pull from rest, friction alone acts.
    fall_u, fall_v = step * pull[0], step * pull[1]
    ox, oy, ou, ov, ow = pose[row, 0], pose[row, 1], twist[row, 0], twist[row, 1], twist[row, 2]
    mu, mv = twist[row + 1, 0] - 0.5 * fall_u, twist[row + 1, 1] - 0.5 * fall_v
    mw = twist[row + 1, 2]
    row += 2
    qx, qy, qw = pose[row, 0], pose[row, 1], twist[row, 2]
    qu, qv = twist[row, 0] - fall_u, twist[row, 1] - fall_v
    # How far the velocity at the middle is off the mean of the ends
    bu, bv, bw = mu - 0.5 * (ou + qu), mv - 0.5 * (ov + qv), mw - 0.5 * (ow + qw)
    grip2, moved = ratio * ratio, 0.0
    for i in range(len(x)):
        kick = limit[i] * step
        kick2 = kick * kick
        sx, sy = ou - ow * (y[i] - oy), ov + ow * (x[i] - ox)
        ex = qu - qw * (y[i] + step * v[i] - qy)
        ey = qv + qw * (x[i] + step * u[i] - qx)
        sx, sy, ex, ey = sx - u[i], sy - v[i], ex - u[i], ey - v[i]
        gx, gy = ex - sx, ey - sy
        change2, slip2 = gx * gx + gy * gy, sx * sx + sy * sy
        # Where the slip may vanish within the step, nothing moves yet.
        free = 1.0 if min(slip2, ex * ex + ey * ey) > 2 * kick2 + 0.5 * change2 else 0.0
        hx, hy = bu - bw * (y[i] - oy), bv + bw * (x[i] - ox)
        # The surface's rate is greatest at an end of the step: (g + 4 h) or (g - 4 h) / step.
        rate2 = change2 + 16 * (hx * hx + hy * hy) + 8 * abs(gx * hx + gy * hy)
        excess = max(rate2 - grip2 * kick2, slip2 - STILL**2 * kick2)
        held = (1.0 if excess <= 0 else 0.0) * (1 - free)
        goes = free + held
        near[i] = goes
        moved += goes
        dx, dy = 0.5 * (sx + ex) + 2 / 3 * hx, 0.5 * (sy + ey) + 2 / 3 * hy
        share = free * kick / np.sqrt(dx * dx + dy * dy + TINY)
        half, on = (0.5 * share + held) * step, goes * step
        x[i] += on * u[i] + half * dx
        y[i] += on * v[i] + half * dy
        u[i] += share * dx + held * ex
        v[i] += share * dy + held * ey
    count = 0
    if moved < len(x):
        for i in range(len(x)):
            waits = near[i] == 0
            near[count] = i
            count += waits
    if count:
        start, end, bulge = (ox, oy, ou, ov, ow), (qx, qy, qu, qv, qw), (bu, bv, bw)
        if ratio > 1:
            _advance_held(discs, work, count, start, end, bulge, step, ratio)
        else:
            _advance_near(discs, work, count, start, end, bulge, step)


@njit(cache=True)
def fall(discs, pull, step):
    """Leave the frame of `advance`, which fell with `pull` (2,) [m/s2] for one step [s]."""
    for d in range(2):
        discs[d] += 0.5 * step * step * pull[d]
        discs[2 + d] += step * pull[d]


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


@njit(cache=True, error_model="numpy")
def _advance_held(discs, work, count, start, end, bulge, step, ratio):
    """As `_advance_near`, where it takes `ratio` times the friction to come loose."""
    pieces = SPLIT if step < COARSE_STEP else COARSE_SPLIT
    for row in range(count):
        i = int(work[9, row])
        px, py, pu, pv, limit = discs[0, i], discs[1, i], discs[2, i], discs[3, i], discs[4, i]
        sx, sy = start[2] - start[4] * (py - start[1]), start[3] + start[4] * (px - start[0])
        gx = end[2] - end[4] * (py + step * pv - end[1]) - sx
        gy = end[3] + end[4] * (px + step * pu - end[0]) - sy
        hx, hy = (
            4 * (bulge[0] - bulge[2] * (py - start[1])),
            4 * (bulge[1] + bulge[2] * (px - start[0])),
        )
        kick, still, piece = limit * step / pieces, STILL * limit * step, step / pieces
        tx, ty = sx, sy
        for k in range(1, pieces + 1):
            share = k / pieces
            nx, ny = sx + share * (gx + (1 - share) * hx), sy + share * (gy + (1 - share) * hy)
            wx, wy = tx - pu, ty - pv
            if _vanishes(wx, wy, nx - tx, ny - ty, kick, still, ratio):
                part = 1.0
            else:
                part = min(1.0, kick / sqrt((nx - pu) ** 2 + (ny - pv) ** 2 + TINY))
            du, dv = part * (nx - pu), part * (ny - pv)
            px += piece * (pu + 0.5 * du)
            py += piece * (pv + 0.5 * dv)
            pu += du
            pv += dv
            tx, ty = nx, ny
        discs[0, i], discs[1, i], discs[2, i], discs[3, i] = px, py, pu, pv


@njit(cache=True, error_model="numpy")
def _vanishes(wx, wy, ax, ay, kick, still, ratio):
    """Whether a slip (wx, wy) vanishes while the surface changes by (ax, ay), and friction holds.

    A slip below `still` [m/s] counts as none. Sliding friction takes `kick` off it.
    """
    if ax * ax + ay * ay > (ratio * kick) ** 2:
        return False
    slip = sqrt(wx * wx + wy * wy)
    if slip <= still:
        return True
    cx, cy = ax - kick * wx / slip, ay - kick * wy / slip
    change2 = cx * cx + cy * cy
    when = min(1.0, max(0.0, -(wx * cx + wy * cy) / (change2 + TINY)))
    return (wx + when * cx) ** 2 + (wy + when * cy) ** 2 <= still * still


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
