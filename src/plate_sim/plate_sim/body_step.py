"""One step of one finite part: it slides and turns, rides with the plate, or comes to stick.

Friction at the middle of the step moves a part that slides steadily (midpoint rule: second order;
explicit, or implicit where friction changes much with the slip). Where the slip turns quickly or
vanishes the step is halved, at most `HALVINGS` times, and the shortest are implicit Euler steps. A
part that sticks at both ends of a step rides with the plate exactly, so it cannot creep.
"""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
from numba import njit

# numba does not see changes in these: delete the cache then
from .disc_friction import disc_force, disc_slip_after
from .motion import END, START, THETA, X, Y, place, slope
from .rubbing import rub, slip_after

LIMIT, GYRATION2, RADIUS, REACH, LIGHTNESS, SLIM = 0, 1, 2, 3, 4, 5
"""Columns of the parts' facts: mu g [m/s2]; inertia by mass [m2]; radius of a disc, else 0 [m];
greatest distance of the rim from the centre of mass [m]; 1/mass [1/kg]; half the least width [m]."""

HALVINGS = 9
"""How often a step is halved where the slip turns: friction reverses on time to 1/512 of it."""

STEADY = 0.9
"""Least cosine of the slip's turn to the middle and the end of a step that is not halved."""

END_SHARE = 1 / 16
"""Share of a step, at its end, over which a stuck part must be held on its own."""

STUCK = 1e-3
"""A slip below this share of mu g dt counts as none: it comes from rounding, not from sliding."""

GENTLE = 0.5
"""Friction that changes by less than this share of the slip in a step needs no implicit rule."""

DISC_STIFF = 3.0
"""A disc's friction changes at most about so much [mu g] when its slip changes by its own size."""


@njit(cache=True, nogil=True, error_model="numpy")
def advance(table, start, step, facts, ground, points, weights, blur, force, now, after):
    """Advance a part by a step [s] that begins at `start` [s] in the cycle, in place.

    Parameters
    ----------
    table : (K, 23)
        The plate's motion, as `motion.tabulate` makes it.
    facts : (6,)
        The part's row.
    ground : (3,)
        Pull x, y [m/s2], and static over dynamic friction.
    points, weights, blur : (n, 2), (n,), (n,)
        Of its footprint; none for a disc that presses evenly.
    force : (n, 3)
        Room to work in, finite.
    now, after : (6,)
        x, y [m], angle [rad] and their rates, plate_home; changed. Room to work in.
    """
    finest = 1 << HALVINGS
    none = STUCK * facts[LIMIT] * step
    done, size = 0, finest
    while done < finest:
        t, h = start + done * step / finest, step * size / finest
        fits = _try(
            table, t, h, size == 1, none, facts, ground, points, weights, blur, force, now, after
        )  # fmt: skip
        if not fits:
            size //= 2
            continue
        now[:] = after
        done += size
        if size < finest and done % (2 * size) == 0:
            size *= 2


@njit(cache=True, nogil=True, error_model="numpy")
def _try(table, t, h, last, none, facts, ground, points, weights, blur, force, now, after):
    """Make one step of h [s] from `now` to `after` (6,); return whether it is fine enough.

    `last`: it has to be. `none`: slip [m/s] that counts as none.
    """
    x, y, angle, vx, vy, spin = now[0], now[1], now[2], now[3], now[4], now[5]
    limit, gyration2 = facts[LIMIT], facts[GYRATION2]
    px, py = h * ground[0], h * ground[1]
    kick = limit * h
    if kick <= 0:
        _move(now, after, h, vx + px, vy + py, spin)
        return True
    sx, sy, sc = _slip(table, t, x, y, vx, vy, spin)
    size2 = sx * sx + sy * sy + gyration2 * sc * sc
    if size2 <= none * none:
        if _rides(table, t, h, facts, ground, points, weights, blur, force, now, after):
            return True
    else:
        ux, uy, uc, mx, my, mc = _middle(
            table, t, h, facts, ground, points, weights, blur, force, now, sx, sy, sc
        )  # fmt: skip
        _move(now, after, h, vx + ux, vy + uy, spin + uc)
        ex, ey, ec = _slip(table, t + h, after[0], after[1], after[3], after[4], after[5])
        steady = _alike(sx, sy, sc, mx, my, mc, gyration2)
        if steady and _alike(sx, sy, sc, ex, ey, ec, gyration2):
            return True
    if not last:
        return False
    fx, fy, fc = _slip(table, t + h, x + h * vx, y + h * vy, vx + px, vy + py, spin)
    turn = angle + h * spin
    ex, ey, ec = _slip_after(
        fx, fy, fc, turn, ground[2] * kick, facts, points, weights, blur, force
    )  # fmt: skip
    if ground[2] > 1 and (ex != 0 or ey != 0 or ec != 0):
        ex, ey, ec = _slip_after(fx, fy, fc, turn, kick, facts, points, weights, blur, force)
    _move(now, after, h, vx + px + fx - ex, vy + py + fy - ey, spin + fc - ec)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _rides(table, t, h, facts, ground, points, weights, blur, force, now, after):
    """Let a stuck part ride for h [s]; return whether friction can hold it."""
    angle, most = now[2], ground[2] * facts[LIMIT]
    # Over the whole step, and also at its end, where it may come loose
    _ride(table, t, (1 - END_SHARE) * h, now, after)
    lx, ly, lc = after[3], after[4], after[5]
    _ride(table, t, h, now, after)
    tail = END_SHARE * h
    ex, ey, ec = _slip_after(
        after[3] - lx - tail * ground[0], after[4] - ly - tail * ground[1], after[5] - lc, angle,
        tail * most, facts, points, weights, blur, force,
    )  # fmt: skip
    if ex != 0 or ey != 0 or ec != 0:
        return False
    ex, ey, ec = _slip_after(
        after[3] - now[3] - h * ground[0], after[4] - now[4] - h * ground[1], after[5] - now[5],
        angle, h * most, facts, points, weights, blur, force,
    )  # fmt: skip
    return ex == 0 and ey == 0 and ec == 0


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(table, t, h, facts, ground, points, weights, blur, force, now, sx, sy, sc):
    """Change of a sliding part's velocity over h [s], and its slip in the middle, whose friction
    does that."""
    x, y, angle, vx, vy, spin = now[0], now[1], now[2], now[3], now[4], now[5]
    px, py, half, kick = h * ground[0], h * ground[1], 0.5 * h, facts[LIMIT] * h
    mx, my, mc = _slip(
        table, t + half, x + half * vx, y + half * vy, vx + 0.5 * px, vy + 0.5 * py, spin
    )  # fmt: skip
    ax, ay, ac, stiff = _rub(sx, sy, sc, angle, facts, points, weights, blur)
    if kick * stiff <= GENTLE:
        hx, hy, hc = mx - 0.5 * kick * ax, my - 0.5 * kick * ay, mc - 0.5 * kick * ac
        ax, ay, ac, stiff = _rub(hx, hy, hc, angle + half * spin, facts, points, weights, blur)
        if kick * stiff <= GENTLE:
            return px + kick * ax, py + kick * ay, kick * ac, hx, hy, hc
    hx, hy, hc = _slip_after(
        mx, my, mc, angle + half * spin, 0.5 * kick, facts, points, weights, blur, force
    )  # fmt: skip
    return px + 2 * (mx - hx), py + 2 * (my - hy), 2 * (mc - hc), hx, hy, hc


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(ax, ay, ac, bx, by, bc, gyration2):
    """Whether two slips have nearly the same direction."""
    product = ax * bx + ay * by + gyration2 * ac * bc
    a2 = ax * ax + ay * ay + gyration2 * ac * ac
    b2 = bx * bx + by * by + gyration2 * bc * bc
    return product > 0 and product * product > STEADY * STEADY * a2 * b2


@njit(cache=True, nogil=True, error_model="numpy")
def _rub(dx, dy, dc, angle, facts, points, weights, blur):
    """As `rubbing.rub`, in plate_home, for a part at `angle` [rad]; also for discs."""
    gyration2 = facts[GYRATION2]
    if len(weights) == 0:
        s2, radius = dx * dx + dy * dy, facts[RADIUS]
        size2 = s2 + gyration2 * dc * dc
        if size2 <= 0:
            return 0.0, 0.0, 0.0, np.inf
        s = sqrt(s2)
        f, turn = disc_force(s, radius * abs(dc))
        share = f / s if s > 0 else 0.0
        turn *= radius / gyration2
        return share * dx, share * dy, turn if dc > 0 else -turn, DISC_STIFF / sqrt(size2)
    c, s = cos(angle), sin(angle)
    ax, ay, ac, stiff = rub(
        c * dx + s * dy, c * dy - s * dx, dc, gyration2, points, weights, blur
    )  # fmt: skip
    return c * ax - s * ay, s * ax + c * ay, ac, stiff


@njit(cache=True, nogil=True, error_model="numpy")
def _slip_after(dx, dy, dc, angle, kick, facts, points, weights, blur, force):
    """As `rubbing.slip_after`, in plate_home, for a part at `angle` [rad]; also for discs."""
    if len(weights) == 0:
        return disc_slip_after(dx, dy, dc, kick, facts[GYRATION2], facts[RADIUS])
    c, s = cos(angle), sin(angle)
    ex, ey, ec = slip_after(
        c * dx + s * dy, c * dy - s * dx, dc, kick, facts[GYRATION2], points, weights, blur, force
    )  # fmt: skip
    return c * ex - s * ey, s * ex + c * ey, ec


@njit(cache=True, nogil=True, error_model="numpy")
def _move(now, after, h, ux, uy, uc):
    """Go on for h [s] while the velocity changes evenly to (ux, uy, uc)."""
    after[0] = now[0] + 0.5 * h * (now[3] + ux)
    after[1] = now[1] + 0.5 * h * (now[4] + uy)
    after[2] = now[2] + 0.5 * h * (now[5] + uc)
    after[3], after[4], after[5] = ux, uy, uc


@njit(cache=True, nogil=True, error_model="numpy")
def piece_at(table, t):
    """Piece of the motion at time t [s]; the first and the last go on beyond the cycle's ends."""
    last = len(table) - 1
    k = min(max(int(t / table[last, END] * (last + 1)), 0), last)
    while k > 0 and t < table[k, START]:
        k -= 1
    while k < last and t >= table[k, END]:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def _slip(table, t, x, y, vx, vy, spin):
    """Twist of the plate at (x, y) less that of a part: equation (2)."""
    k = piece_at(table, t)
    u = t - table[k, START]
    turn = slope(table, k, THETA, u)
    return (
        slope(table, k, X, u) - turn * (y - place(table, k, Y, u)) - vx,
        slope(table, k, Y, u) + turn * (x - place(table, k, X, u)) - vy,
        turn - spin,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _ride(table, t, h, now, after):
    """Set `after` to where a part stuck to the plate is after h [s]."""
    k = piece_at(table, t)
    u = t - table[k, START]
    rx, ry = now[0] - place(table, k, X, u), now[1] - place(table, k, Y, u)
    before = place(table, k, THETA, u)
    k = piece_at(table, t + h)
    u = t + h - table[k, START]
    turn = place(table, k, THETA, u) - before
    qx, qy = cos(turn) * rx - sin(turn) * ry, sin(turn) * rx + cos(turn) * ry
    spin = slope(table, k, THETA, u)
    after[0], after[1] = place(table, k, X, u) + qx, place(table, k, Y, u) + qy
    after[2] = now[2] + turn
    after[3], after[4] = slope(table, k, X, u) - spin * qy, slope(table, k, Y, u) + spin * qx
    after[5] = spin
