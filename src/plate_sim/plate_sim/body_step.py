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
from .motion import END as UNTIL
from .motion import START, THETA, X, Y, place, slope
from .rubbing import rub, slip_after

AFTER, LIMIT, GYRATION2, RADIUS, FIRST, END = 6, 12, 13, 14, 15, 16
REACH, LIGHTNESS, SLIM, FIRST_PIECE, END_PIECE, WIDTH = 17, 18, 19, 20, 21, 22
"""Columns of a part, one array, as compiled calls take few arguments quickly. First x, y [m], angle
[rad] and their rates, in plate_home; room for the state after a step; mu g [m/s2]; inertia by mass
[m2]; radius of a disc, else 0 [m]; its first point in the mesh, its last + 1; greatest distance of
the rim from the centre of mass [m]; 1/mass [1/kg]; about half the least width [m]; its first convex
piece, its last + 1."""

INNER, GROUND = 3, 6
"""Rows of the plate's motion: pose and twist at the start, middle and end of a step; the same of a
shorter step within; then pull x, y [m/s2], and static over dynamic friction."""

HALVINGS = 9
"""How often a step is halved where the slip turns: friction reverses on time to 1/512 of it."""

STEADY = 0.9
"""Least cosine of the slip's turn to the middle and the end of a step that is not halved."""

STUCK = 1e-3
"""A slip below this share of mu g dt counts as none: it comes from rounding, not from sliding."""

GENTLE = 0.5
"""Friction that changes by less than this share of the slip in a step needs no implicit rule."""

DISC_STIFF = 3.0
"""A disc's friction changes at most about so much [mu g] when its slip changes by its own size."""


@njit(cache=True, nogil=True, error_model="numpy")
def advance(table, start, step, plate, parts, i, mesh):
    """Advance part i by a step [s] that begins at `start` [s] in the cycle, in place.

    Parameters
    ----------
    table, plate : (K, 24), (7, 6)
        The plate's motion as `motion.tabulate` makes it, and rows of it as described above.
    parts : (M, 22)
        Columns as above.
    mesh : (n, 7)
        Columns as in `rubbing`.
    """
    none = STUCK * parts[i, LIMIT] * step
    if _try(plate, 0, step, False, none, parts, i, mesh):
        for d in range(6):
            parts[i, d] = parts[i, AFTER + d]
        return
    finest = 1 << HALVINGS
    done, size = 0, finest >> 1
    while done < finest:
        t, h = start + done * step / finest, step * size / finest
        for k in range(3):
            plate_at(table, t + 0.5 * k * h, plate, INNER + k)
        if not _try(plate, INNER, h, size == 1, none, parts, i, mesh):
            size >>= 1
            continue
        for d in range(6):
            parts[i, d] = parts[i, AFTER + d]
        done += size
        if done % (2 * size) == 0:
            size *= 2


@njit(cache=True, nogil=True, error_model="numpy")
def _try(plate, row, h, last, none, parts, i, mesh):
    """Make one step of h [s]; return whether it is fine enough.

    `row`: of its start. `last`: it has to be. `none`: slip [m/s] that counts as none.
    """
    x, y, angle = parts[i, 0], parts[i, 1], parts[i, 2]
    vx, vy, spin = parts[i, 3], parts[i, 4], parts[i, 5]
    gyration2, kick = parts[i, GYRATION2], parts[i, LIMIT] * h
    px, py, ratio = h * plate[GROUND, 0], h * plate[GROUND, 1], plate[GROUND, 2]
    if kick <= 0:
        _move(parts, i, h, vx + px, vy + py, spin)
        return True
    sx, sy, sc = _slip(plate, row, x, y, vx, vy, spin)
    if sx * sx + sy * sy + gyration2 * sc * sc <= none * none:
        if _rides(plate, row, px, py, ratio * kick, parts, i, mesh):
            return True
    else:
        mx, my, mc = _slip(
            plate, row + 1, x + 0.5 * h * vx, y + 0.5 * h * vy, vx + 0.5 * px, vy + 0.5 * py, spin
        )  # fmt: skip
        ax, ay, ac, stiff = _rub(sx, sy, sc, angle, parts, i, mesh)
        hx, hy, hc = mx - 0.5 * kick * ax, my - 0.5 * kick * ay, mc - 0.5 * kick * ac
        gentle, turn = kick * stiff <= GENTLE, angle + 0.5 * h * spin
        if gentle:
            ax, ay, ac, stiff = _rub(hx, hy, hc, turn, parts, i, mesh)
            ax, ay, ac, gentle = kick * ax, kick * ay, kick * ac, kick * stiff <= GENTLE
        if not gentle:
            hx, hy, hc = _slip_after(mx, my, mc, turn, 0.5 * kick, parts, i, mesh)
            ax, ay, ac = 2 * (mx - hx), 2 * (my - hy), 2 * (mc - hc)
        _move(parts, i, h, vx + px + ax, vy + py + ay, spin + ac)
        ex, ey, ec = _slip(
            plate, row + 2, parts[i, AFTER], parts[i, AFTER + 1], parts[i, AFTER + 3],
            parts[i, AFTER + 4], parts[i, AFTER + 5],
        )  # fmt: skip
        steady = _alike(sx, sy, sc, hx, hy, hc, gyration2)
        if steady and _alike(sx, sy, sc, ex, ey, ec, gyration2):
            return True
    if last:
        fx, fy, fc = _slip(plate, row + 2, x + h * vx, y + h * vy, vx + px, vy + py, spin)
        turn = angle + h * spin
        ex, ey, ec = _slip_after(fx, fy, fc, turn, ratio * kick, parts, i, mesh)
        if ratio > 1 and (ex != 0 or ey != 0 or ec != 0):
            ex, ey, ec = _slip_after(fx, fy, fc, turn, kick, parts, i, mesh)
        _move(parts, i, h, vx + px + fx - ex, vy + py + fy - ey, spin + fc - ec)
    return last


@njit(cache=True, nogil=True, error_model="numpy")
def _rides(plate, row, px, py, kick, parts, i, mesh):
    """Let a stuck part ride through a step; return whether friction can hold it.

    p [m/s]: what the pull gives in the step. kick [m/s]: what static friction can give.
    """
    end = row + 2
    turn = plate[end, 2] - plate[row, 2]
    rx, ry = parts[i, 0] - plate[row, 0], parts[i, 1] - plate[row, 1]
    qx, qy = cos(turn) * rx - sin(turn) * ry, sin(turn) * rx + cos(turn) * ry
    parts[i, AFTER], parts[i, AFTER + 1] = plate[end, 0] + qx, plate[end, 1] + qy
    parts[i, AFTER + 2], parts[i, AFTER + 5] = parts[i, 2] + turn, plate[end, 5]
    parts[i, AFTER + 3] = plate[end, 3] - plate[end, 5] * qy
    parts[i, AFTER + 4] = plate[end, 4] + plate[end, 5] * qx
    ux, uy = parts[i, AFTER + 3] - parts[i, 3], parts[i, AFTER + 4] - parts[i, 4]
    uc = parts[i, AFTER + 5] - parts[i, 5]
    ex, ey, ec = _slip_after(ux - px, uy - py, uc, parts[i, 2], kick, parts, i, mesh)
    if ex != 0 or ey != 0 or ec != 0:
        return False
    # Also at the end of the step, where it may come loose: the velocity is about a parabola.
    turn = plate[row + 1, 2] - plate[row, 2]
    mx, my, mc = _slip(
        plate, row + 1, plate[row + 1, 0] + rx - turn * ry, plate[row + 1, 1] + ry + turn * rx,
        parts[i, 3], parts[i, 4], parts[i, 5],
    )  # fmt: skip
    ex, ey, ec = _slip_after(
        3 * ux - 4 * mx - px, 3 * uy - 4 * my - py, 3 * uc - 4 * mc, parts[i, 2], kick, parts, i,
        mesh,
    )  # fmt: skip
    return ex == 0 and ey == 0 and ec == 0


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(ax, ay, ac, bx, by, bc, gyration2):
    """Whether two slips have nearly the same direction."""
    product = ax * bx + ay * by + gyration2 * ac * bc
    a2 = ax * ax + ay * ay + gyration2 * ac * ac
    b2 = bx * bx + by * by + gyration2 * bc * bc
    return product > 0 and product * product > STEADY * STEADY * a2 * b2


@njit(cache=True, nogil=True, error_model="numpy")
def _rub(dx, dy, dc, angle, parts, i, mesh):
    """As `rubbing.rub`, in plate_home, for a part at `angle` [rad]; also for discs."""
    gyration2, first, end = parts[i, GYRATION2], int(parts[i, FIRST]), int(parts[i, END])
    if first == end:
        s2, radius = dx * dx + dy * dy, parts[i, RADIUS]
        size2 = s2 + gyration2 * dc * dc
        if size2 <= 0:
            return 0.0, 0.0, 0.0, np.inf
        s = sqrt(s2)
        f, turn = disc_force(s, radius * abs(dc))
        share = f / s if s > 0 else 0.0
        turn *= radius / gyration2
        return share * dx, share * dy, turn if dc > 0 else -turn, DISC_STIFF / sqrt(size2)
    c, s = cos(angle), sin(angle)
    ax, ay, ac, stiff = rub(c * dx + s * dy, c * dy - s * dx, dc, gyration2, mesh, first, end)
    return c * ax - s * ay, s * ax + c * ay, ac, stiff


@njit(cache=True, nogil=True, error_model="numpy")
def _slip_after(dx, dy, dc, angle, kick, parts, i, mesh):
    """As `rubbing.slip_after`, in plate_home, for a part at `angle` [rad]; also for discs."""
    gyration2, first, end = parts[i, GYRATION2], int(parts[i, FIRST]), int(parts[i, END])
    if first == end:
        return disc_slip_after(dx, dy, dc, kick, gyration2, parts[i, RADIUS])
    c, s = cos(angle), sin(angle)
    ex, ey, ec = slip_after(
        c * dx + s * dy, c * dy - s * dx, dc, kick, gyration2, mesh, first, end
    )  # fmt: skip
    return c * ex - s * ey, s * ex + c * ey, ec


@njit(cache=True, nogil=True, error_model="numpy")
def _move(parts, i, h, ux, uy, uc):
    """Go on for h [s] while the velocity changes evenly to (ux, uy, uc)."""
    parts[i, AFTER] = parts[i, 0] + 0.5 * h * (parts[i, 3] + ux)
    parts[i, AFTER + 1] = parts[i, 1] + 0.5 * h * (parts[i, 4] + uy)
    parts[i, AFTER + 2] = parts[i, 2] + 0.5 * h * (parts[i, 5] + uc)
    parts[i, AFTER + 3], parts[i, AFTER + 4], parts[i, AFTER + 5] = ux, uy, uc


@njit(cache=True, nogil=True, error_model="numpy")
def _slip(plate, row, x, y, vx, vy, spin):
    """Twist of the plate at (x, y) less that of a part: equation (2)."""
    return (
        plate[row, 3] - plate[row, 5] * (y - plate[row, 1]) - vx,
        plate[row, 4] + plate[row, 5] * (x - plate[row, 0]) - vy,
        plate[row, 5] - spin,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def plate_at(table, t, plate, row):
    """Set a row of the plate's motion at time t [s]; before and after the cycle it goes on."""
    last = len(table) - 1
    k = min(max(int(t / table[last, UNTIL] * (last + 1)), 0), last)
    while k > 0 and t < table[k, START]:
        k -= 1
    while k < last and t >= table[k, UNTIL]:
        k += 1
    u = t - table[k, START]
    plate[row, 0], plate[row, 1] = place(table, k, X, u), place(table, k, Y, u)
    plate[row, 2], plate[row, 5] = place(table, k, THETA, u), slope(table, k, THETA, u)
    plate[row, 3], plate[row, 4] = slope(table, k, X, u), slope(table, k, Y, u)
