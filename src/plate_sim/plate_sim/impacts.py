"""What happens where two discs touch, or a disc and a wall: impulses and the end of overlaps.

Two that touch while they close in meet an impulse that turns the closing speed c into -e c, e the
restitution, and rubs: it takes up to mu_c times itself off the speed along the rims, and never
turns that around. Both parts take it up equally, so momentum is kept; energy is lost or kept, as
e <= 1. Discs do not spin here: a rub changes their course only. The moment of the touch within
the step is found, and the impulse acts from there: a pair alone has no error from the step. What
overlap a crowd leaves is ended by moving its parts apart, without speed.
"""

from __future__ import annotations

from math import copysign, sqrt

import numpy as np
from numba import njit

SWEEPS = 12
"""Gauss-Seidel passes over the touching pairs of one step, at most."""

OVERLAP = 1e-5
"""Overlap [m] that ends the passes: a hundredth of a pixel."""

MARGIN = 0.02
"""Pairs apart by less than this share of the radius take part in the passes: others may push
them into each other."""

ROUNDING = 1e-12
"""Share of a squared distance that is none: discs at rest side by side do not touch each step."""


@njit(cache=True, error_model="numpy")
def separate(discs, count, radius, pairs, found, hits, edge, walls, bounce, rub, step):
    """End closing speeds and overlaps, in place.

    Parameters
    ----------
    discs, count : (4, P), int
        x, y [m], u, v [m/s] in plate_home of the first `count` columns.
    pairs, found : (C, 2), int
        Close pairs: the first rows.
    hits : (C, 2)
        Room to work in.
    edge, walls : (10,), bool
        The plate at the end of the step, as `push_off` takes it, and whether it has walls.
    bounce, rub : float
        Restitution and friction coefficient.
    step : float
        [s].
    """
    x, y, u, v = discs[0], discs[1], discs[2], discs[3]
    size2 = 4 * radius * radius
    bounds = (radius, bounce, rub, step)
    touched, pushed = 0, np.inf
    for sweep in range(SWEEPS):
        if pushed > 0.5 * MARGIN * radius:
            touched, pushed = _close(x, y, radius, pairs, found, hits), 0.0
        deepest = 0.0
        for k in range(touched):
            # Forth and back: pushes then travel both ways through a crowd.
            row = k if sweep % 2 == 0 else touched - 1 - k
            i, j = hits[row, 0], hits[row, 1]
            dx, dy = x[i] - x[j], y[i] - y[j]
            lack = size2 - (dx * dx + dy * dy)
            if lack <= ROUNDING * size2:
                continue
            jx, jy, px, py = _meet(dx, dy, lack, u[i] - u[j], v[i] - v[j], bounds)
            x[i] += px
            y[i] += py
            u[i] += jx
            v[i] += jy
            x[j] -= px
            y[j] -= py
            u[j] -= jx
            v[j] -= jy
            deepest = max(deepest, lack / (4 * radius))
            pushed = max(pushed, abs(px), abs(py))
        if walls:
            deepest = max(deepest, push_off(discs, count, radius, edge, bounce, rub, step))
        if deepest <= OVERLAP:
            break


@njit(cache=True, error_model="numpy")
def _close(x, y, radius, pairs, found, hits):
    """List the pairs close to touching in `hits`; returns how many."""
    reach2, touched = ((2 + MARGIN) * radius) ** 2, 0
    for k in range(found):
        i, j = pairs[k, 0], pairs[k, 1]
        dx, dy = x[i] - x[j], y[i] - y[j]
        # No branch: whether a pair is close cannot be foretold.
        hits[touched, 0], hits[touched, 1] = i, j
        touched += dx * dx + dy * dy < reach2
    return touched


@njit(cache=True, inline="always", error_model="numpy")
def _meet(dx, dy, lack, wx, wy, bounds):
    """Let two discs meet that are (dx, dy) [m] apart and move at (wx, wy) [m/s] to each other.

    `lack` is by how much their squared distance is too small [m2]; `bounds` are the radius,
    restitution, friction, and the step [s]. Returns how the speed and the place of the first
    change.
    """
    radius, bounce, rub, step = bounds
    # They touched tau ago: |d - tau w| = 2 r
    ahead = -(wx * dx + wy * dy)
    reach = ahead + sqrt(ahead * ahead + (wx * wx + wy * wy) * lack)
    if ahead <= 0 or lack > step * reach:
        return _part(dx, dy, wx, wy, bounds)
    tau = lack / reach
    nx, ny = (dx - tau * wx) / (2 * radius), (dy - tau * wy) / (2 * radius)
    jx, jy = _impulse(nx, ny, wx, wy, bounce, rub)
    return jx, jy, tau * jx, tau * jy


@njit(cache=True, inline="always", error_model="numpy")
def _impulse(nx, ny, wx, wy, bounce, rub):
    """How the speed of the first of two discs changes; the normal n points at it."""
    closing = -(wx * nx + wy * ny)
    hit = 0.5 * (1 + bounce) * closing
    across = wy * nx - wx * ny
    drag = -copysign(min(rub * hit, 0.5 * abs(across)), across)
    return hit * nx - drag * ny, hit * ny + drag * nx


@njit(cache=True, error_model="numpy")
def _part(dx, dy, wx, wy, bounds):
    """As `_meet`, for two that part already, or overlap since before the step."""
    radius, bounce, rub, step = bounds
    distance = sqrt(dx * dx + dy * dy)
    left = radius - 0.5 * distance
    # Two centres in one point have no line; any direction will do.
    nx, ny = (dx / distance, dy / distance) if distance > 0 else (1.0, 0.0)
    if wx * nx + wy * ny >= 0:
        return 0.0, 0.0, left * nx, left * ny
    ex, ey = dx - step * wx, dy - step * wy
    far = sqrt(ex * ex + ey * ey)
    nx, ny = ex / far, ey / far
    jx, jy = _impulse(nx, ny, wx, wy, bounce, rub)
    left = max(0.0, left - step * (jx * nx + jy * ny))
    return jx, jy, step * jx + left * nx, step * jy + left * ny


@njit(cache=True, error_model="numpy")
def push_off(discs, count, radius, edge, bounce, rub, step):
    """Let discs meet the walls; returns the deepest overlap [m] before.

    `edge` holds the plate's pose x, y [m], theta [rad], its velocity [m/s, m/s, rad/s], the half
    sides [m], and the cosine and sine of theta. Walls are the plate's: they move with it, and are
    not moved by parts.
    """
    x, y = discs[0], discs[1]
    ox, oy, c, s = edge[0], edge[1], edge[8], edge[9]
    reach_x, reach_y = edge[6] - radius, edge[7] - radius
    if _beyond(x, y, count, ox, oy, c, s, reach_x, reach_y) <= 0:
        return 0.0
    deepest = 0.0
    for i in range(count):
        rx, ry = x[i] - ox, y[i] - oy
        along, side = c * rx + s * ry, c * ry - s * rx
        deep_x, deep_y = abs(along) - reach_x, abs(side) - reach_y
        if deep_x > 0:
            sign = 1.0 if along > 0 else -1.0
            _meet_wall(discs, i, deep_x, sign * c, sign * s, radius, edge, bounce, rub, step)
            deepest = max(deepest, deep_x)
        if deep_y > 0:
            sign = 1.0 if side > 0 else -1.0
            _meet_wall(discs, i, deep_y, -sign * s, sign * c, radius, edge, bounce, rub, step)
            deepest = max(deepest, deep_y)
    return deepest


@njit(cache=True, fastmath={"nsz", "nnan"}, error_model="numpy")
def _beyond(x, y, count, ox, oy, c, s, reach_x, reach_y):
    """Greatest distance [m] of a centre beyond its reach from (ox, oy); negative inside."""
    worst = -np.inf
    for i in range(count):
        rx, ry = x[i] - ox, y[i] - oy
        worst = max(worst, abs(c * rx + s * ry) - reach_x, abs(c * ry - s * rx) - reach_y)
    return worst


@njit(cache=True, error_model="numpy")
def _meet_wall(discs, i, depth, nx, ny, radius, edge, bounce, rub, step):
    """Let a disc meet the wall with the outward normal (nx, ny), `depth` [m] in it."""
    # Relative to the wall where the rim touches it
    qx, qy = discs[0, i] + radius * nx - edge[0], discs[1, i] + radius * ny - edge[1]
    wx, wy = discs[2, i] - (edge[3] - edge[5] * qy), discs[3, i] - (edge[4] + edge[5] * qx)
    closing = wx * nx + wy * ny
    left = depth
    if closing > 0:
        hit = (1 + bounce) * closing
        across = wy * nx - wx * ny
        drag = min(rub * hit, abs(across))
        drag = -drag if across > 0 else drag
        jx, jy = -hit * nx - drag * ny, -hit * ny + drag * nx
        tau = min(depth / closing, step)
        discs[2, i] += jx
        discs[3, i] += jy
        discs[0, i] += tau * jx
        discs[1, i] += tau * jy
        left -= tau * hit
    if left > 0:
        discs[0, i] -= left * nx
        discs[1, i] -= left * ny
