"""Point parts that slip along one line: exact but for rounding.

Where the plate turns nowhere and accelerates along one line, and a part slips along it, friction is
constant between events. The part's motion is then a parabola, its slip s a quartic in every piece
of the plate's motion, and what remains is to find its next zero. From value, slope and a bound C on
how fast the slope falls follows how far s is surely positive: s + s' u - C u^2/2 > 0. Steps so far
pass no zero, and near one they converge quadratically, as Newton's do.

Everything is told along the line, in the frame that falls with the tilt (see `motion`).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from .motion import END, START, X, Y
from .output import fall

PLACE, V_END, BOW, JERK, NEED, SNAP, COLUMNS = 2, 8, 9, 10, 11, 12, 13
"""Columns of a line's table after START and END: six powers of the place [m]; velocity at the end
[m/s]; how far the velocity is off its chord at most [m/s]; bounds on the rate of acceleration
[m/s3], on acceleration [m/s2] and on the rate of the first [m/s4]."""

ALIGNED = 1e-13
"""A slip across the line below this share of the speeds is rounding."""

AHEAD = 1e-8
"""A part can stick if the surface can hold it also this share of a period later."""

ZERO = 4e-16
"""A slip below this share of the speeds it is made of is rounding, and so with accelerations."""

NONE = 1e-14
"""A slip below this share of the speeds is over."""

FLOOR, COARSE = 1e-13, 1 / 2000
"""Least time between events as a share of the period: rounding, and where the budget is spent."""

BUDGET = 50_000
"""Events per cycle until then; a usual motion has fewer than ten."""

TRIES = 200
"""Steps to a zero: even a double one is found to rounding in 60."""


@njit(cache=True, error_model="numpy")
def tabulate_line(table, scales):
    """Return the table (K, 13) of a motion along a line; (0, 13) if it keeps to none."""
    nx, ny = scales[4], scales[5]
    line = np.empty((len(table) if nx != 0 or ny != 0 else 0, COLUMNS))
    for k in range(len(line)):
        row, h = line[k], table[k, END] - table[k, START]
        row[START], row[END] = table[k, START], table[k, END]
        for i in range(6):
            row[PLACE + i] = nx * table[k, X + i] + ny * table[k, Y + i]
        # Bezier points: a polynomial never leaves their hull.
        a, b, c, d = 2 * row[4], 6 * h * row[5], 12 * h * h * row[6], 20 * h * h * h * row[7]
        row[NEED] = max(abs(a), abs(a + b / 3), abs(a + (2 * b + c) / 3), abs(a + b + c + d))
        row[JERK] = max(abs(b), abs(b + c), abs(b + 2 * c + 3 * d)) / h
        row[SNAP] = max(abs(2 * c), abs(2 * c + 6 * d)) / (h * h)
        row[BOW] = h * h * row[JERK] / 8
        row[V_END] = _velocity(row, h)
    return line


@njit(cache=True, error_model="numpy")
def aligned(table, scales, velocity):
    """Whether a part with this velocity (2,) [m/s] slips along the line of the motion."""
    wx, wy = table[0, X + 1] - velocity[0], table[0, Y + 1] - velocity[1]
    size = abs(velocity[0]) + abs(velocity[1]) + abs(table[0, X + 1]) + abs(table[0, Y + 1])
    return abs(scales[4] * wy - scales[5] * wx) <= ALIGNED * size


@njit(cache=True, error_model="numpy")
def run_line(line, scales, limit, hold, cycles, path, speed):
    """Fill path and speed (cycles * samples + 1, 2) of one part from their first rows.

    Parameters are the motion's table and `scales` (see `motion`), what dynamic and static friction
    give [m/s2], and the number of cycles. Returns whether all was found within `BUDGET`.
    """
    nx, ny, pull, period = scales[4], scales[5], scales[6:], line[-1, END]
    samples = (len(path) - 1) // cycles
    px, py = path[0]
    vx, vy = speed[0]
    events, way = 0, _settle(line, 0.0, 0, nx * vx + ny * vy, limit, hold)
    for done in range(cycles):
        v = nx * vx + ny * vy
        ux, uy = vx - nx * v, vy - ny * v
        t, x, k, start, j = 0.0, 0.0, 0, 0.0, 1
        while t < period:
            events += 1
            least = (COARSE if events > BUDGET * cycles else FLOOR) * period
            if way == 0:
                until, k_end = _release(line, start, k, hold)
            else:
                until, k_end = _meeting(line, t, start, k, v, way, limit)
            if until < t + least:
                until, k_end = _located(line, t + least, k)
            force = way * limit
            while j <= samples:
                at = min(j * (period / samples), period) if j < samples else period
                if at > until:
                    break
                sx, sv = _after(line, at, t, k, x, v, force)
                row = done * samples + j
                path[row, 0], path[row, 1] = px + ux * at + nx * sx, py + uy * at + ny * sx
                speed[row, 0], speed[row, 1] = ux + nx * sv, uy + ny * sv
                fall(at, pull, path[row], speed[row])
                j += 1
            x, v = _after(line, until, t, k, x, v, force)
            t, k, start = until, k_end, until + AHEAD * period
            if t < period:
                way = _settle(line, t, k, v, limit, hold)
        px, py = path[(done + 1) * samples]
        vx, vy = speed[(done + 1) * samples]
    return events <= BUDGET * cycles


@njit(cache=True, error_model="numpy")
def _located(line, t, k):
    """Return t, at most the period, and its piece: k or a later one."""
    while k + 1 < len(line) and t >= line[k, END]:
        k += 1
    return min(t, line[-1, END]), k


@njit(cache=True, error_model="numpy")
def _velocity(row, u):
    """Velocity [m/s] of the plate u [s] after the start of a piece."""
    return row[3] + u * (2 * row[4] + u * (3 * row[5] + u * (4 * row[6] + u * (5 * row[7]))))


@njit(cache=True, error_model="numpy")
def _acceleration(row, u):
    """Acceleration [m/s2] of the plate u [s] after the start of a piece."""
    return 2 * row[4] + u * (6 * row[5] + u * (12 * row[6] + u * (20 * row[7])))


@njit(cache=True, error_model="numpy")
def _jerk(row, u):
    """Rate of `_acceleration` [m/s3]."""
    return 6 * row[5] + u * (24 * row[6] + u * (60 * row[7]))


@njit(cache=True, error_model="numpy")
def _place(row, u):
    """Place [m] of the plate u [s] after the start of a piece."""
    return row[2] + u * (row[3] + u * (row[4] + u * (row[5] + u * (row[6] + u * row[7]))))


@njit(cache=True, error_model="numpy")
def _after(line, at, t, k, x, v, force):
    """Place and velocity at a later time than t [s], sliding by `force` [m/s2], or stuck if 0."""
    if force != 0:
        tau = at - t
        return x + tau * (v + 0.5 * tau * force), v + tau * force
    _, k_at = _located(line, at, k)
    u = at - line[k_at, START]
    x += _place(line[k_at], u) - _place(line[k], t - line[k, START])
    return x, _velocity(line[k_at], u)


@njit(cache=True, error_model="numpy")
def _settle(line, t, k, v, limit, hold):
    """Sense in which a part at v slips from now on, 0 if the surface holds it."""
    surface = _velocity(line[k], t - line[k, START])
    if abs(surface - v) > NONE * (abs(surface) + abs(v) + limit * line[-1, END]):
        return np.sign(surface - v)
    t, k = _located(line, t + AHEAD * line[-1, END], k)
    a = _acceleration(line[k], t - line[k, START])
    return 0.0 if abs(a) <= hold else np.sign(a)


@njit(cache=True, error_model="numpy")
def _meeting(line, t, start, k, v, way, limit):
    """When a slip in the sense `way` of a part at v at time t vanishes, from `start` [s] on.

    Returns the time, at most the period, and its piece.
    """
    start, first = _located(line, start, k)
    s = way * (_velocity(line[first], start - line[first, START]) - v) - limit * (start - t)
    for k in range(first, len(line)):
        s_end = way * (line[k, V_END] - v) - limit * (line[k, END] - t)
        if min(s, s_end) <= line[k, BOW]:
            low = max(start, line[k, START])
            found = _zero_of_slip(line[k], low, t, v, way, limit)
            if found >= 0:
                return found, k
        s = s_end
    return line[-1, END], len(line) - 1


@njit(cache=True, error_model="numpy")
def _zero_of_slip(row, low, t, v, way, limit):
    """First zero of the slip in a piece from time `low` [s] on, -1 if there is none."""
    h, u = row[END] - row[START], low - row[START]
    for _ in range(TRIES):
        if u > h:
            return -1.0
        tau = row[START] + u - t
        surface = _velocity(row, u)
        s = way * (surface - v) - limit * tau
        rate = way * _acceleration(row, u) - limit
        if s <= ZERO * (abs(surface) + abs(v) + limit * tau + h * row[NEED]):
            if rate < 0:
                break
            s = 0.0
        u += _sure(s, rate, way * _jerk(row, u), row[JERK], row[SNAP])
    return row[START] + u


@njit(cache=True, error_model="numpy")
def _sure(s, rate, bend, most, change):
    """How far s surely stays positive.

    Parameters are its value and two derivatives, bounds on the second, and on the third.
    """
    if change == 0:
        return _positive(s, rate, -bend)
    near = 1.5 * abs(bend) / change  # so far the mean bend, weighted, is off by |bend|/2 at most
    return max(_positive(s, rate, most), min(near, _positive(s, rate, 0.5 * abs(bend) - bend)))


@njit(cache=True, error_model="numpy")
def _positive(s, rate, fall):
    """Where s + rate u - fall u^2/2 first vanishes, for s >= 0."""
    square = rate * rate + 2 * fall * s
    if square < 0:
        return np.inf
    if rate < 0:
        return 2 * s / (sqrt(square) - rate)
    return (rate + sqrt(square)) / fall if fall > 0 else np.inf


@njit(cache=True, error_model="numpy")
def _release(line, start, k, hold):
    """When the surface accelerates by more than `hold` [m/s2], from `start` [s] on.

    Returns the time, at most the period, and its piece.
    """
    start, first = _located(line, start, k)
    for k in range(first, len(line)):
        if line[k, NEED] > hold:
            row = line[k]
            h, u = row[END] - row[START], max(start - row[START], 0.0)
            for tries in range(TRIES):
                if u > h:
                    break
                a = _acceleration(row, u)
                jerk, snap = _jerk(row, u), 24 * row[6] + u * (120 * row[7])
                if a < 0:
                    a, jerk, snap = -a, -jerk, -snap
                if (hold - a <= ZERO * row[NEED] and jerk > 0) or tries == TRIES - 1:
                    return row[START] + u, k
                most, change = row[SNAP], 120 * abs(row[7])
                u += min(
                    _sure(max(hold - a, 0.0), -jerk, -snap, most, change),
                    _sure(hold + a, jerk, snap, most, change),
                )
    return line[-1, END], len(line) - 1
