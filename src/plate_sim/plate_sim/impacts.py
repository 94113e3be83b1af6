"""What happens where two discs touch, or a disc and a wall: impulses and the end of overlaps.

Two that touch while they close in meet an impulse that turns the closing speed c into -e c, e the
restitution, and rubs: it takes up to mu_c times itself off the speed along the rims, and never
turns that around. Both parts take it up equally, so momentum is kept; energy is lost or kept, as
e <= 1. Discs do not spin here: a rub changes their course only. The moment of the touch within
the step is found, and the impulse acts from there: a pair alone has no error from the step. What
overlap a crowd leaves is ended by moving its parts apart, without speed.
"""

from __future__ import annotations

from math import cos, sin, sqrt

from numba import njit

SWEEPS = 12
"""Gauss-Seidel passes over the touching pairs of one step, at most."""

OVERLAP = 1e-5
"""Overlap [m] that ends the passes: a hundredth of a pixel."""

MARGIN = 0.02
"""Pairs apart by less than this share of the radius take part in the passes: others may push
them into each other."""


@njit(cache=True)
def touching(x, y, radius, pairs, found, hits):
    """List the pairs that take part in passes; returns how many, and the least distance [m]."""
    count, least2 = 0, 1e300
    reach2 = ((2 + MARGIN) * radius) ** 2
    for k in range(found):
        dx, dy = x[pairs[k, 0]] - x[pairs[k, 1]], y[pairs[k, 0]] - y[pairs[k, 1]]
        distance2 = dx * dx + dy * dy
        least2 = min(least2, distance2)
        if distance2 < reach2:
            hits[count] = k
            count += 1
    return count, sqrt(least2)


@njit(cache=True, error_model="numpy")
def separate(discs, count, radius, pairs, found, hits, touched, edge, walls, bounce, rub, step):
    """End closing speeds and overlaps, in place.

    Parameters
    ----------
    discs, count : (4, P), int
        x, y [m], u, v [m/s] in plate_home of the first `count` columns.
    pairs, found : (C, 2), int
        Close pairs: the first rows.
    hits, touched : (C,), int
        Pairs to look at: the first `touched` of `hits` are rows of `pairs`. Looked up again when
        parts are pushed far.
    edge, walls : (8,), bool
        The plate at the end of the step, as `push_off` takes it, and whether it has walls.
    bounce, rub : float
        Restitution and friction coefficient.
    step : float
        [s].
    """
    pushed = 0.0
    size2 = 4 * radius * radius
    for sweep in range(SWEEPS):
        deepest = 0.0
        for k in range(touched):
            # Forth and back: pushes then travel both ways through a crowd.
            row = hits[k] if sweep % 2 == 0 else hits[touched - 1 - k]
            i, j = pairs[row, 0], pairs[row, 1]
            dx, dy = discs[0, i] - discs[0, j], discs[1, i] - discs[1, j]
            distance2 = dx * dx + dy * dy
            if distance2 >= size2:
                continue
            wx, wy = discs[2, i] - discs[2, j], discs[3, i] - discs[3, j]
            depth, jx, jy, px, py = _meet(dx, dy, distance2, wx, wy, radius, bounce, rub, step)
            discs[0, i] += px
            discs[1, i] += py
            discs[2, i] += jx
            discs[3, i] += jy
            discs[0, j] -= px
            discs[1, j] -= py
            discs[2, j] -= jx
            discs[3, j] -= jy
            deepest = max(deepest, depth)
            pushed = max(pushed, abs(px), abs(py))
        if walls:
            deepest = max(deepest, push_off(discs, count, radius, edge, bounce, rub, step))
        if pushed > 0.5 * MARGIN * radius:
            touched, _ = touching(discs[0], discs[1], radius, pairs, found, hits)
            pushed = 0.0
        elif deepest <= OVERLAP:
            break


@njit(cache=True, inline="always", error_model="numpy")
def _meet(dx, dy, distance2, wx, wy, radius, bounce, rub, step):
    """Let two discs meet that are (dx, dy) [m] apart and move at (wx, wy) [m/s] to each other.

    Returns their overlap [m], and how the speed and the place of the first change.
    """
    distance = sqrt(distance2)
    depth = 2 * radius - distance
    ahead = -(dx * wx + dy * wy)
    jx = jy = px = py = 0.0
    if ahead > 0:
        # When they touched: |d - tau w| = 2 r
        w2 = wx * wx + wy * wy
        root = sqrt(ahead * ahead + w2 * depth * (2 * radius + distance))
        tau = min((root - ahead) / w2, step)
        cx, cy = dx - tau * wx, dy - tau * wy
        far = sqrt(cx * cx + cy * cy)
        nx, ny = (cx / far, cy / far) if far > 0 else (1.0, 0.0)
        closing = -(wx * nx + wy * ny)
        hit = max(0.0, 0.5 * (1 + bounce) * closing)
        across = wy * nx - wx * ny
        drag = min(rub * hit, 0.5 * abs(across))
        drag = -drag if across > 0 else drag
        jx, jy = hit * nx - drag * ny, hit * ny + drag * nx
        px, py = tau * jx, tau * jy
        dx, dy = dx + 2 * px, dy + 2 * py
        distance = sqrt(dx * dx + dy * dy)
    left = 0.5 * (2 * radius - distance)
    if left > 0:
        # Two centres in one point have no line; any direction will do.
        nx, ny = (dx / distance, dy / distance) if distance > 0 else (1.0, 0.0)
        px, py = px + left * nx, py + left * ny
    return depth, jx, jy, px, py


@njit(cache=True, error_model="numpy")
def push_off(discs, count, radius, edge, bounce, rub, step):
    """Let discs meet the walls; returns the deepest overlap [m] before.

    `edge` holds the plate's pose x, y [m], theta [rad], its velocity [m/s, m/s, rad/s], and the
    half sides [m]. Walls are the plate's: they move with it, and are not moved by parts.
    """
    c, s = cos(edge[2]), sin(edge[2])
    deepest = 0.0
    x, y, u, v = discs[0], discs[1], discs[2], discs[3]
    for i in range(count):
        rx, ry = x[i] - edge[0], y[i] - edge[1]
        along, side = c * rx + s * ry, c * ry - s * rx
        for axis in range(2):
            place = along if axis == 0 else side
            depth = abs(place) - (edge[6 + axis] - radius)
            if depth <= 0:
                continue
            deepest = max(deepest, depth)
            sign = 1.0 if place > 0 else -1.0
            nx, ny = (sign * c, sign * s) if axis == 0 else (-sign * s, sign * c)
            # Relative to the wall where the rim touches it
            qx, qy = x[i] + radius * nx - edge[0], y[i] + radius * ny - edge[1]
            wx, wy = u[i] - (edge[3] - edge[5] * qy), v[i] - (edge[4] + edge[5] * qx)
            closing = wx * nx + wy * ny
            shift = 0.0
            if closing > 0:
                hit = (1 + bounce) * closing
                across = wy * nx - wx * ny
                drag = min(rub * hit, abs(across))
                drag = -drag if across > 0 else drag
                jx, jy = -hit * nx - drag * ny, -hit * ny + drag * nx
                tau = min(depth / closing, step)
                u[i] += jx
                v[i] += jy
                x[i] += tau * jx
                y[i] += tau * jy
                shift = -tau * (jx * nx + jy * ny)
            left = depth - shift
            if left > 0:
                x[i] -= left * nx
                y[i] -= left * ny
    return deepest
