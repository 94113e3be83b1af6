"""A step in which nothing turns and the plate accelerates much more than friction can: in one go.

The slip of a disc that does not turn, on a plate that does not, is one vector; friction is mu g
along it. Up to where it is least and from there on it is taken to change evenly: the mean of its
direction along a straight line is known, also close by its zero. So a slip that reverses on a line
is followed exactly, one that turns quickly to second order, and none needs a shorter step.
"""

from __future__ import annotations

from math import log, sqrt

from plate_core.kernels import inner_kernel

from ..plate.pieces import TWIST_X, TWIST_Y

FAST = 2.0
"""Least change of the slip in a step, over what friction takes off, at both ends of the step."""

BENT = 0.9
"""Least cosine of the angle between both."""

ROUNDS, CLOSE = 8, 1e-4
"""Corrections of a mean direction, at most, until it changes by less: each makes its error smaller
by friction's share of the slip's change."""

THIN = 1e-5
"""A line whose distance from zero is a smaller share of its length goes through zero."""


@inner_kernel
def reversal(plate, fall_x, fall_y, static, dv, vx, vy):
    """Step a disc at a velocity of vx, vy [m/s].

    Parameters
    ----------
    plate : (3, 6)
        Samples of the plate's motion (`pieces.sample`) at the step's start, middle and end.
    fall_x, fall_y : float
        What gravity gives along the plate [m/s].
    static, dv : float
        What static and dynamic friction can give [m/s].

    Returns
    -------
    fits : bool
        Whether the slip changes fast enough.
    mean_x, mean_y, vx, vy : float
        Mean velocity in the step, and velocity at its end [m/s].
    """
    # The slip without friction: s + a t + b t^2, t from 0 to 1
    sx, sy = plate[0, TWIST_X] - vx, plate[0, TWIST_Y] - vy
    mx, my = plate[1, TWIST_X] - vx - 0.5 * fall_x, plate[1, TWIST_Y] - vy - 0.5 * fall_y
    ex, ey = plate[2, TWIST_X] - vx - fall_x, plate[2, TWIST_Y] - vy - fall_y
    ax, ay = 4 * mx - ex - 3 * sx, 4 * my - ey - 3 * sy
    bx, by = 2 * (sx + ex) - 4 * mx, 2 * (sy + ey) - 4 * my
    zx, zy = ax + 2 * bx, ay + 2 * by
    a2, z2, least = ax * ax + ay * ay, zx * zx + zy * zy, (FAST * static) ** 2
    product = ax * zx + ay * zy
    if not (min(a2, z2) > least and product > 0 and product * product > BENT * BENT * a2 * z2):
        return False, vx, vy, vx, vy
    s2 = sx * sx + sy * sy
    t, nx, ny, wx, wy = 0.0, 0.0, 0.0, sx, sy
    if s2 > 0 and sx * ax + sy * ay < 0:
        size = 1 / sqrt(s2)
        nx, ny = size * sx, size * sy
        for _ in range(ROUNDS):
            before = t
            rx, ry = ax + t * bx - dv * nx, ay + t * by - dv * ny
            t = min(max(-(sx * rx + sy * ry) / (rx * rx + ry * ry), 0.0), 1.0)
            wx, wy = sx + t * rx, sy + t * ry
            nx, ny = heading(sx, sy, wx, wy, nx, ny)
            if abs(t - before) <= CLOSE:
                break
    # Velocity where the slip is least, and from there on
    ux, uy = vx + t * (fall_x + dv * nx), vy + t * (fall_y + dv * ny)
    left = 1 - t
    gx, gy = left * (ax + (1 + t) * bx), left * (ay + (1 + t) * by)
    kick, size = left * dv, sqrt(gx * gx + gy * gy)
    px, py = (gx / size, gy / size) if size > 0 else (0.0, 0.0)
    for _ in range(ROUNDS if left > 0 else 0):
        qx, qy = px, py
        px, py = heading(wx, wy, wx + gx - kick * px, wy + gy - kick * py, px, py)
        if abs(px - qx) + abs(py - qy) <= CLOSE:
            break
    ox, oy = ux + left * fall_x + kick * px, uy + left * fall_y + kick * py
    return (
        True, 0.5 * (t * (vx + ux) + left * (ux + ox)), 0.5 * (t * (vy + uy) + left * (uy + oy)),
        ox, oy,
    )  # fmt: skip


@inner_kernel
def heading(ax, ay, bx, by, nx, ny):
    """Mean of the direction of all points on the line from a to b; n where they are one."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    if length2 <= 0:
        return nx, ny
    scale = 1 / sqrt(length2)
    dx, dy = scale * dx, scale * dy
    a, b = sqrt(ax * ax + ay * ay), sqrt(bx * bx + by * by)
    across = ax * dy - ay * dx
    mean = scale * (b - a)
    if across * across <= THIN * THIN * length2:
        return mean * dx, mean * dy
    # asinh of both ends' places along the line over their distance from it
    start, end = ax * dx + ay * dy, bx * dx + by * dy
    far = (end + b) * (a - start) / (across * across) if start < 0 < end else 0.0
    if start >= 0:
        far = (end + b) / (start + a)
    elif end <= 0:
        far = (a - start) / (b - end)
    side = scale * across * log(far)
    return mean * dx + side * dy, mean * dy - side * dx
