"""The plate's exact motion for compiled code: the quintic pieces of a cycle in one table, and the
only evaluation of the plate's pose, twist and acceleration that integrators use.

The surface under a part at P has the velocity v_s = O' + theta' x (P - O), equation (2) of the
paper; its rate along the part's path is O'' + theta'' x (P - O) + theta' x (v - O').

On a tilted plate the judge (`friction.point_events`) works in a frame that falls freely down the
tilt from the start of each cycle: there nothing pulls, and the plate's acceleration is O'' less
gravity along the plate. Slips are the same in both.

A table (K, 24) has a row per piece between two knots: times of its start and end [s]; six powers
of the time since its start of x, y [m] and theta [rad], each; what a riding part can feel (see
`ride_bound`); whether theta changes anywhere; and whether the end of the cycle is its start. One
array, as compiled calls take few arguments quickly.
"""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np

from plate_core import PlateCycle
from plate_core.kernels import inner_kernel, kernel

from .motion import PlateMotion

START, END, X, Y, THETA, RIDE, TURNS, WRAPS, WIDTH = 0, 1, 2, 8, 14, 20, 22, 23, 24
"""Columns of a table."""

POSE_X, POSE_Y, POSE_THETA, TWIST_X, TWIST_Y, TWIST_THETA, SAMPLE = 0, 1, 2, 3, 4, 5, 6
"""Columns of a sample of the plate's motion: pose [m, m, rad] and twist [m/s, m/s, rad/s]."""

STRAIGHT = 1e-11
"""A motion is on a line if it accelerates across it by no more than this share: rounding."""


def tabulate(
    cycle: PlateCycle | PlateMotion, gravity: tuple[float, float] | np.ndarray = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Return a cycle's table (K, 24), and its scales (8,).

    Scales are bounds of the rates: of O' [m/s2], theta' [rad/s2], O'' [m/s3] and
    theta'' [rad/s3]; the direction (2,) of the line on which the plate accelerates, 0 if there is
    none; and gravity along the plate (2,) [m/s2].
    """
    closed = isinstance(cycle, PlateCycle)
    return _tabulate(cycle.times, cycle.coefficients, float(gravity[0]), float(gravity[1]), closed)


@kernel(error_model="numpy")
def _tabulate(times, pieces, gravity_x, gravity_y, closed):
    table, scales = np.empty((len(pieces), WIDTH)), np.zeros(8)
    turns = 0.0
    for k in range(len(pieces)):
        row, c, t = table[k], pieces[k], times[k]
        row[START], row[END] = t, times[k + 1]
        for i in range(6):
            row[X + i], row[Y + i], row[THETA + i] = c[i, 0], c[i, 1], c[i, 2]
            if c[i, 2] != 0:
                turns = 1.0
        for i, fall in enumerate((0.5 * t * t, t, 0.5)):
            row[X + i] -= gravity_x * fall
            row[Y + i] -= gravity_y * fall
        _bound(table, k, scales)
    table[:, TURNS] = turns
    table[:, WRAPS] = 1.0 if closed and gravity_x == 0 and gravity_y == 0 else 0.0
    if turns != 0 or not _on_line(table, scales[4], scales[5], scales[0]):
        scales[4:6] = 0
    scales[6], scales[7] = gravity_x, gravity_y
    return table, scales


@inner_kernel
def _on_line(table, nx, ny, accel):
    """Whether the plate accelerates, by `accel` [m/s2] at most, along the unit vector n only."""
    for k in range(len(table)):
        h = table[k, END] - table[k, START]
        across = abs(ny * table[k, X + 5] - nx * table[k, Y + 5])
        for i in range(4, 1, -1):
            across = abs(ny * table[k, X + i] - nx * table[k, Y + i]) + h * across
        if across > STRAIGHT * accel:
            return False
    return True


@inner_kernel
def locate(table, t, k):
    """Wrap t [s] into a closed cycle, and return it with its piece: k, or sought from its share."""
    last = len(table) - 1
    period = table[last, END]
    if t >= period:
        if table[0, WRAPS] == 0:
            return t, last
        t -= period
    if t < table[k, START] or t >= table[k, END]:
        k = min(int(t / period * (last + 1)), last)
        while k > 0 and t < table[k, START]:
            k -= 1
        while k < last and t >= table[k, END]:
            k += 1
    return t, k


@inner_kernel
def place(table, k, c, u):
    """Value of the polynomial of piece k that starts in column c, u [s] after its knot."""
    return table[k, c] + u * (
        table[k, c + 1]
        + u
        * (table[k, c + 2] + u * (table[k, c + 3] + u * (table[k, c + 4] + u * table[k, c + 5])))
    )


@inner_kernel
def slope(table, k, c, u):
    """First derivative of `place`."""
    return table[k, c + 1] + u * (
        2 * table[k, c + 2]
        + u * (3 * table[k, c + 3] + u * (4 * table[k, c + 4] + u * (5 * table[k, c + 5])))
    )


@inner_kernel
def bend(table, k, c, u):
    """Second derivative of `place`."""
    return 2 * table[k, c + 2] + u * (
        6 * table[k, c + 3] + u * (12 * table[k, c + 4] + u * (20 * table[k, c + 5]))
    )


@inner_kernel
def sample(table, t, row):
    """Set a row (6,) to pose and twist at time t [s]; before and after the cycle it goes on."""
    last = len(table) - 1
    k = min(max(int(t / table[last, END] * (last + 1)), 0), last)
    while k > 0 and t < table[k, START]:
        k -= 1
    while k < last and t >= table[k, END]:
        k += 1
    u = t - table[k, START]
    row[POSE_X], row[TWIST_X] = place(table, k, X, u), slope(table, k, X, u)
    row[POSE_Y], row[TWIST_Y] = place(table, k, Y, u), slope(table, k, Y, u)
    row[POSE_THETA], row[TWIST_THETA] = place(table, k, THETA, u), slope(table, k, THETA, u)


@kernel(nogil=True, error_model="numpy")
def samples(table, steps):
    """Return pose and twist (steps + 1, 6) at the ends of equal steps through the motion."""
    rows = np.empty((steps + 1, SAMPLE))
    for k in range(steps + 1):
        sample(table, table[-1, END] * k / steps, rows[k])
    return rows


@inner_kernel
def slip(table, t, k, point):
    """Slip w = v_s - v [m/s] of a part at a point x, y [m], vx, vy [m/s].

    Returns its piece, x, y, and norm.
    """
    px, py, vx, vy = point
    t, k = locate(table, t, k)
    u = t - table[k, START]
    wx, wy = slope(table, k, X, u) - vx, slope(table, k, Y, u) - vy
    if table[k, TURNS] != 0:
        spin = slope(table, k, THETA, u)
        wx -= spin * (py - place(table, k, Y, u))
        wy += spin * (px - place(table, k, X, u))
    return k, wx, wy, sqrt(wx * wx + wy * wy)


@inner_kernel
def surface_rate(table, t, k, point):
    """Rate [m/s2] of the surface's velocity under a part at a point as `slip` takes it; x and y."""
    px, py, vx, vy = point
    t, k = locate(table, t, k)
    u = t - table[k, START]
    ax, ay = bend(table, k, X, u), bend(table, k, Y, u)
    if table[k, TURNS] != 0:
        spin, push = slope(table, k, THETA, u), bend(table, k, THETA, u)
        ax -= push * (py - place(table, k, Y, u)) + spin * (vy - slope(table, k, Y, u))
        ay += push * (px - place(table, k, X, u)) + spin * (vx - slope(table, k, X, u))
    return ax, ay


@inner_kernel
def riding(table, t, k, qx, qy):
    """State of a part stuck at q [m, in the plate]: piece, position, velocity, acceleration."""
    t, k = locate(table, t, k)
    u = t - table[k, START]
    rx, ry, spin, push = qx, qy, 0.0, 0.0
    if table[k, TURNS] != 0:
        theta = place(table, k, THETA, u)
        rx, ry = cos(theta) * qx - sin(theta) * qy, sin(theta) * qx + cos(theta) * qy
        spin, push = slope(table, k, THETA, u), bend(table, k, THETA, u)
    return (
        k,
        place(table, k, X, u) + rx,
        place(table, k, Y, u) + ry,
        slope(table, k, X, u) - spin * ry,
        slope(table, k, Y, u) + spin * rx,
        bend(table, k, X, u) - push * ry - spin * spin * rx,
        bend(table, k, Y, u) + push * rx - spin * spin * ry,
    )


@inner_kernel
def in_plate(table, t, k, px, py):
    """Return where in the plate [m] a part at p is at time t."""
    t, k = locate(table, t, k)
    u = t - table[k, START]
    rx, ry = px - place(table, k, X, u), py - place(table, k, Y, u)
    if table[k, TURNS] == 0:
        return rx, ry
    theta = place(table, k, THETA, u)
    return cos(theta) * rx + sin(theta) * ry, cos(theta) * ry - sin(theta) * rx


@inner_kernel
def ride_bound(table, k, radius):
    """Return what a part riding at `radius` [m] feels at most [m/s2] during piece k."""
    return table[k, RIDE] + radius * table[k, RIDE + 1]


@inner_kernel
def _bound(table, k, scales):
    """Write what bounds riding parts in piece k, and update the scales, by Bezier points.

    A cubic never leaves the hull of its points: so their greatest norm bounds O'' and theta'',
    their greatest difference the rates of those; theta' is bounded from its ends.
    """
    h = table[k, END] - table[k, START]
    line = push = 0.0
    last_x = last_y = last = 0.0
    for i in range(4):
        bx, by = _bezier(table, k, X, h, i), _bezier(table, k, Y, h, i)
        b = _bezier(table, k, THETA, h, i)
        norm = sqrt(bx * bx + by * by)
        line, push = max(line, norm), max(push, abs(b))
        if norm > scales[0]:
            scales[0], scales[4], scales[5] = norm, bx / norm, by / norm
        if i > 0:
            rate = 3 / h * sqrt((bx - last_x) ** 2 + (by - last_y) ** 2)
            scales[2], scales[3] = max(scales[2], rate), max(scales[3], 3 / h * abs(b - last))
        last_x, last_y, last = bx, by, b
    scales[1] = max(scales[1], push)
    spin = max(abs(table[k, THETA + 1]), abs(slope(table, k, THETA, h))) + 0.5 * h * push
    table[k, RIDE], table[k, RIDE + 1] = line, push + spin * spin


@inner_kernel
def _bezier(table, k, c, h, i):
    """Bezier point i of the second derivative of `place`, u from 0 to h."""
    point = 2 * table[k, c + 2] + 2 * h * i * table[k, c + 3]
    if i >= 2:
        point += (4.0 if i == 2 else 12.0) * h * h * table[k, c + 4]
    if i == 3:
        point += 20 * h * h * h * table[k, c + 5]
    return point
