"""Where two rigid parts touch: discs and convex polygons, in the plane.

A contact manifold is an array (9,): how many points it has, 0 to 2; the unit normal from the
second part to the first; x, y [m] of each point, midway in the overlap; and the overlap's depth [m]
at each. Convex polygons touch along the side that separates them most (separating axes: Gottschalk,
Lin and Manocha 1996), with the other's nearest side clipped to it.
"""

from __future__ import annotations

from math import inf, sqrt

from plate_core.kernels import inner_kernel

COUNT, NORMAL, POINTS, DEPTHS, SIZE = 0, 1, 3, 7, 9
"""Columns of a contact manifold."""

X, Y, OUT_X, OUT_Y, OPEN = 0, 1, 2, 3, 4
"""Columns of a corner: its place, the outward normal of the side that begins there, and whether
that side is part of the rim, not one at which another piece of the part begins."""

PREFER = 1e-6
"""The second part's side is taken for the flat one only if it separates by so much more [m]."""


@inner_kernel
def _one_point(contact, nx, ny, px, py, depth):
    contact[COUNT], contact[NORMAL], contact[NORMAL + 1] = 1, nx, ny
    contact[POINTS], contact[POINTS + 1], contact[DEPTHS] = px, py, depth


@inner_kernel
def disc_polygon(cx, cy, radius, corners, contact):
    """Set the manifold of a disc, the first part, and a convex polygon with corners (k, 5)."""
    contact[COUNT] = 0
    most, side = -inf, -1
    for k in range(len(corners)):
        x, y = cx - corners[k, X], cy - corners[k, Y]
        apart = corners[k, OUT_X] * x + corners[k, OUT_Y] * y
        if apart >= radius or (apart > 0 and corners[k, OPEN] == 0):
            return
        if apart > most and corners[k, OPEN] != 0:
            most, side = apart, k
    if side < 0:
        return
    nx, ny = corners[side, OUT_X], corners[side, OUT_Y]
    if most > 0:
        # Nearest to the side, or to one of its ends
        a, b = side, (side + 1) % len(corners)
        along = (corners[a, X] - cx) * ny - (corners[a, Y] - cy) * nx
        beyond = (cx - corners[b, X]) * ny - (cy - corners[b, Y]) * nx
        if along < 0 or beyond < 0:
            k = a if along < 0 else b
            x, y = cx - corners[k, X], cy - corners[k, Y]
            most = sqrt(x * x + y * y)
            if most >= radius:
                return
            nx, ny = x / most, y / most
    depth = radius - most
    arm = radius - 0.5 * depth
    _one_point(contact, nx, ny, cx - arm * nx, cy - arm * ny, depth)


@inner_kernel
def polygon_polygon(first, second, contact):
    """Set the manifold of two convex polygons with corners (k, 5)."""
    contact[COUNT] = 0
    gap1, side1 = _separation(first, second)
    if gap1 >= 0:
        return
    gap2, side2 = _separation(second, first)
    if gap2 >= 0 or (side1 < 0 and side2 < 0):
        return
    if side2 < 0 or (side1 >= 0 and gap1 + PREFER >= gap2):
        _clip(first, side1, second, contact)
        contact[NORMAL], contact[NORMAL + 1] = -contact[NORMAL], -contact[NORMAL + 1]
    else:
        _clip(second, side2, first, contact)


@inner_kernel
def _separation(flat, other):
    """Most that an open side of `flat` separates the two, and that side; 0 if any side does."""
    most, side = -inf, -1
    for k in range(len(flat)):
        nx, ny = flat[k, OUT_X], flat[k, OUT_Y]
        least = inf
        for i in range(len(other)):
            apart = nx * (other[i, X] - flat[k, X]) + ny * (other[i, Y] - flat[k, Y])
            least = min(least, apart)
        if least >= 0:
            return 0.0, k
        if least > most and flat[k, OPEN] != 0:
            most, side = least, k
    return most, side


@inner_kernel
def _clip(flat, side, other, contact):
    """Set the manifold of a side of `flat` with `other`; its normal points to `other`."""
    nx, ny = flat[side, OUT_X], flat[side, OUT_Y]
    # The other's side that faces it most
    facing, k = inf, 0
    for i in range(len(other)):
        cosine = nx * other[i, OUT_X] + ny * other[i, OUT_Y]
        if cosine < facing:
            facing, k = cosine, i
    end = (side + 1) % len(flat)
    x0, y0 = flat[side, X], flat[side, Y]
    tx, ty = -ny, nx
    length = tx * (flat[end, X] - x0) + ty * (flat[end, Y] - y0)
    j = (k + 1) % len(other)
    # Along and out of the flat side
    s0 = tx * (other[k, X] - x0) + ty * (other[k, Y] - y0)
    d0 = nx * (other[k, X] - x0) + ny * (other[k, Y] - y0)
    s1 = tx * (other[j, X] - x0) + ty * (other[j, Y] - y0)
    d1 = nx * (other[j, X] - x0) + ny * (other[j, Y] - y0)
    contact[NORMAL], contact[NORMAL + 1] = nx, ny
    count = 0
    for end in range(2):
        s, d = (s0, d0) if end == 0 else (s1, d1)
        bound = min(max(s, 0.0), length)
        if bound != s:
            if s0 == s1 or not (min(s0, s1) <= bound <= max(s0, s1)):
                continue
            d = d0 + (d1 - d0) * (bound - s0) / (s1 - s0)
            s = bound
        if d < 0:
            at = POINTS + 2 * count
            contact[at] = x0 + s * tx + 0.5 * d * nx
            contact[at + 1] = y0 + s * ty + 0.5 * d * ny
            contact[DEPTHS + count] = -d
            count += 1
    contact[COUNT] = count
    if count == 0:  # the other's nearest side passes by a corner; its deepest corner does not
        for i in range(len(other)):
            d = nx * (other[i, X] - x0) + ny * (other[i, Y] - y0)
            if -d > (contact[DEPTHS] if contact[COUNT] else 0.0):
                _one_point(
                    contact, nx, ny, other[i, X] - 0.5 * d * nx, other[i, Y] - 0.5 * d * ny, -d
                )


@inner_kernel
def polygon_wall(rim, wall_x, wall_y, nx, ny, contact):
    """Set the manifold of corners (n, 5) with a wall through a point, whose inward normal is n."""
    contact[COUNT], contact[NORMAL], contact[NORMAL + 1] = 0, nx, ny
    contact[DEPTHS] = contact[DEPTHS + 1] = 0.0
    for i in range(len(rim)):
        depth = nx * (wall_x - rim[i, X]) + ny * (wall_y - rim[i, Y])
        if depth <= 0:
            continue
        # The two deepest
        at = -1
        if contact[COUNT] < 2:
            at = int(contact[COUNT])
            contact[COUNT] += 1
        else:
            shallow = 0 if contact[DEPTHS] < contact[DEPTHS + 1] else 1
            if depth > contact[DEPTHS + shallow]:
                at = shallow
        if at >= 0:
            contact[POINTS + 2 * at] = rim[i, X] + 0.5 * depth * nx
            contact[POINTS + 2 * at + 1] = rim[i, Y] + 0.5 * depth * ny
            contact[DEPTHS + at] = depth


@inner_kernel
def place_corners(corners, x, y, cosine, sine, placed):
    """Set corners (n, 5) of a part in plate_home from those in its axes."""
    for i in range(len(corners)):
        a, b, u, v = corners[i, X], corners[i, Y], corners[i, OUT_X], corners[i, OUT_Y]
        placed[i, X], placed[i, Y] = x + cosine * a - sine * b, y + sine * a + cosine * b
        placed[i, OUT_X], placed[i, OUT_Y] = cosine * u - sine * v, sine * u + cosine * v
        placed[i, OPEN] = corners[i, OPEN]
