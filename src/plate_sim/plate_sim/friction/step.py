"""One step of one finite part: it slides and turns, rides with the plate, or comes to stick.

Friction at the middle of the step moves a part that slides steadily (midpoint rule: second order;
explicit, or implicit where friction changes much with the slip). Where the slip turns quickly the
step is halved, at most `HALVINGS` times; where it reverses the step is cut just before. The
shortest are implicit Euler steps. A part that sticks at both ends of a step rides with the plate
exactly, so it cannot creep.

Discs that slide steadily are most of all parts in most steps: `glide` moves them all at once,
without branches, several per instruction; `advance` does what is left, part by part.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from plate_core.kernels import inner_kernel

from ..plate.pieces import (
    POSE_THETA,
    POSE_X,
    POSE_Y,
    SAMPLE,
    TWIST_THETA,
    TWIST_X,
    TWIST_Y,
    sample,
)
from .disc import SERIES, SNAP, disc_force, disc_slip_after, series
from .patch import friction, slip_after
from .reversal import reversal

X, Y, ANGLE, VX, VY, SPIN = range(6)
"""Rows of a state (6, P): place [m], angle [rad] and their rates, in plate_home, of P parts."""

BODY = np.dtype(
    [
        (name, np.float64)
        for name in ("mu_g", "gyration2", "radius", "reach", "slim", "mass_inverse")
    ]
    + [(name, np.int64) for name in ("first_point", "end_point", "first_piece", "end_piece")]
)
"""What does not change of a part: mu g [m/s2]; inertia by mass [m2]; radius of a disc, else 0 [m];
greatest distance of the rim from the centre of mass [m]; about half the least width [m]; 1/mass
[1/kg]; its first point in the mesh (`patch.POINT`), its last + 1, none for a disc; its
first convex piece, its last + 1."""

LANES = 8
"""Parts that `glide` moves at once: states are padded to a multiple of it."""

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


class Motion(NamedTuple):
    """State of one part: place [m], angle [rad], and their rates, plate_home."""

    x: float
    y: float
    angle: float
    vx: float
    vy: float
    spin: float


class Slip(NamedTuple):
    """Twist of the plate less that of a part, at its centre [m/s, m/s, rad/s]."""

    x: float
    y: float
    turn: float


@inner_kernel(fastmath={"nsz"})  # NaN and infinity mark lanes that do not glide
def glide(plate, step, ground, state, discs, done):
    """Move the discs that slide steadily through a step, as `advance` would; tell which.

    Parameters
    ----------
    plate : (3, 6)
        Samples of the plate's motion (`pieces.sample`) at the step's start, middle and end.
    step : float
        [s].
    ground : GroundEffect
    state : (6, P)
        P a multiple of `LANES`; changed.
    discs : (4, P)
        mu g [m/s2], squared radius and radius of gyration [m2], and 1 where there is a disc.
    done : (P,)
        Set to 1 where the disc has been moved, else to 0.
    """
    x, y, angle, vx, vy, spin = state[0], state[1], state[2], state[3], state[4], state[5]
    mu_g, radius2, gyration2, there = discs[0], discs[1], discs[2], discs[3]
    sx, sy, su, sv, sw = plate[0, 0], plate[0, 1], plate[0, 3], plate[0, 4], plate[0, 5]
    mx, my, mu, mv, mw = plate[1, 0], plate[1, 1], plate[1, 3], plate[1, 4], plate[1, 5]
    ex, ey, eu, ev, ew = plate[2, 0], plate[2, 1], plate[2, 3], plate[2, 4], plate[2, 5]
    fall_x, fall_y = step * ground.gravity_x, step * ground.gravity_y
    half = 0.5 * step
    for i in range(len(done)):
        dv, r2, g2 = mu_g[i] * step, radius2[i], gyration2[i]
        u, v, c = vx[i], vy[i], spin[i]
        # Slip and friction at the start
        ax, ay, ac = su - sw * (y[i] - sy) - u, sv + sw * (x[i] - sx) - v, sw - c
        a2 = ax * ax + ay * ay
        ak2 = r2 * ac * ac / a2
        force, torque = series(ak2)
        share = 0.5 * dv / np.sqrt(a2)
        # At the middle
        px, py = x[i] + half * u, y[i] + half * v
        bx = mu - mw * (py - my) - u - 0.5 * fall_x - share * force * ax
        by = mv + mw * (px - mx) - v - 0.5 * fall_y - share * force * ay
        bc = mw - c - share * torque * (r2 / g2) * ac
        b2 = bx * bx + by * by
        bk2 = r2 * bc * bc / b2
        force, torque = series(bk2)
        share = dv / np.sqrt(b2)
        # State and slip at the end
        ux, uy = u + fall_x + share * force * bx, v + fall_y + share * force * by
        uc = c + share * torque * (r2 / g2) * bc
        px, py = x[i] + half * (u + ux), y[i] + half * (v + uy)
        zx, zy, zc = eu - ew * (py - ey) - ux, ev + ew * (px - ex) - uy, ew - uc
        # Does it slide fast enough, and nearly in one direction? (`_alike`)
        a2, b2 = a2 + g2 * ac * ac, b2 + g2 * bc * bc
        z2 = zx * zx + zy * zy + g2 * zc * zc
        ab = ax * bx + ay * by + g2 * ac * bc
        az = ax * zx + ay * zy + g2 * ac * zc
        gentle = (min(a2, b2) >= (DISC_STIFF / GENTLE * dv) ** 2) & (there[i] * dv > 0)
        gentle = gentle & (max(ak2, bk2) <= SERIES)
        turn = min(ab * abs(ab) - STEADY**2 * a2 * b2, az * abs(az) - STEADY**2 * a2 * z2)
        steady = gentle & (turn > 0)
        done[i] = 1.0 if steady else 0.0
        x[i] = px if steady else x[i]
        y[i] = py if steady else y[i]
        angle[i] = angle[i] + half * (c + uc) if steady else angle[i]
        vx[i] = ux if steady else u
        vy[i] = uy if steady else v
        spin[i] = uc if steady else c


@inner_kernel
def advance(table, start, step, plate, inner, ground, state, i, body, mesh):
    """Advance part i by a step, in place.

    Parameters
    ----------
    table, start, step : (K, 24), float, float
        The plate's motion as `pieces.tabulate` makes it; when the step begins in it, and its length
        [s].
    plate, inner : (3, 6), (3, 6)
        Samples of the motion at the step's start, middle and end; room for those of shorter steps.
    ground : GroundEffect
    state : (6, P)
    body : BODY
    mesh : (n,) of patch.POINT
    """
    motion = Motion(
        state[X, i], state[Y, i], state[ANGLE, i], state[VX, i], state[VY, i], state[SPIN, i]
    )
    none = STUCK * body.mu_g * step
    fine, after, ahead = False, motion, 0.0
    if body.radius > 0 and motion.spin == 0 and body.first_point == body.end_point:
        fine, after = _reverse(plate, step, ground, motion, body)
    if not fine:
        fine, after, ahead = _try(plate, step, False, none, ground, motion, body, mesh)
    if not fine:
        after = _advance_in_parts(
            table, start, step, none, plate[0], ahead, inner, ground, motion, body, mesh
        )
    state[X, i], state[Y, i], state[ANGLE, i] = after.x, after.y, after.angle
    state[VX, i], state[VY, i], state[SPIN, i] = after.vx, after.vy, after.spin


@inner_kernel
def _reverse(plate, h, ground, motion, body):
    """Return whether a disc at no spin is at rest or turns its slip round so quickly that
    `reversal` serves, and its motion after a step of h [s]."""
    m = motion
    if plate[0, TWIST_THETA] != 0 or plate[1, TWIST_THETA] != 0 or plate[2, TWIST_THETA] != 0:
        return False, m
    dv = body.mu_g * h
    fits, mean_x, mean_y, vx, vy = reversal(
        plate, h * ground.gravity_x, h * ground.gravity_y, ground.static_ratio * dv, dv, m.vx, m.vy
    )
    return fits, Motion(m.x + h * mean_x, m.y + h * mean_y, m.angle, vx, vy, 0.0)


@inner_kernel
def _advance_in_parts(table, start, step, none, plate, ahead, inner, ground, motion, body, mesh):
    """Return the motion after a step that is cut until each part of it is fine enough.

    plate (6,): a sample at its start. ahead: as `_try` returns it for the whole step.
    """
    finest = 1 << HALVINGS
    done, size, to_end = 0, _shorter(finest, ahead), ahead > 0
    for k in range(SAMPLE):
        inner[0, k] = plate[k]
    while True:
        t, h = start + done * step / finest, step * size / finest
        sample(table, t + 0.5 * h, inner[1])
        sample(table, t + h, inner[2])
        fine, after, ahead = _try(inner, h, size == 1, none, ground, motion, body, mesh)
        if not fine:
            size, to_end = _shorter(size, ahead), ahead > 0
            continue
        motion = after
        done += size
        if done == finest:
            return motion
        # Where the slip was to vanish just ahead the finest part passes that, then all the rest.
        size = 1 if to_end and size > 1 else finest - done if to_end else 2 * size
        size, to_end = min(size, finest - done), to_end and size == 1
        for k in range(SAMPLE):
            inner[0, k] = inner[2, k]


@inner_kernel
def _shorter(size, ahead):
    """A shorter part of a step than `size`: up to where the slip vanishes, or half of it."""
    return max(1, min(size - 1, int(size * ahead))) if ahead > 0 else size >> 1


@inner_kernel
def _try(plate, h, last, none, ground, motion, body, mesh):
    """Make one step of h [s].

    `last`: it has to be fine enough. `none`: slip [m/s] that counts as none. Returned are whether
    it is, the motion after it, and, if not, at what share of it the slip is about to reverse; else
    0.
    """
    m, dv = motion, body.mu_g * h
    fall_x, fall_y, static = h * ground.gravity_x, h * ground.gravity_y, ground.static_ratio * dv
    if dv <= 0:
        return True, _moved(m, h, m.vx + fall_x, m.vy + fall_y, m.spin), 0.0
    ahead = 0.0
    slip = _slip(plate[0], m.x, m.y, m.vx, m.vy, m.spin)
    stuck = slip.x**2 + slip.y**2 + body.gyration2 * slip.turn**2 <= none * none
    if stuck:
        rides, after = _ride(plate, fall_x, fall_y, static, m, body, mesh)
        if rides:
            return True, after, 0.0
    middle = _slip(
        plate[1], m.x + 0.5 * h * m.vx, m.y + 0.5 * h * m.vy, m.vx + 0.5 * fall_x,
        m.vy + 0.5 * fall_y, m.spin,
    )  # fmt: skip
    half, push = _midpoint(slip, middle, m.angle, 0.5 * h * m.spin, dv, body, mesh)
    after = _moved(m, h, m.vx + fall_x + push.x, m.vy + fall_y + push.y, m.spin + push.turn)
    end = _slip(plate[2], after.x, after.y, after.vx, after.vy, after.spin)
    loose = True
    if stuck:  # it comes loose: from 0 the slip grows about as a parabola, at first along this
        slip = Slip(4 * half.x - end.x, 4 * half.y - end.y, 4 * half.turn - end.turn)
        rate = Slip(
            4 * middle.x - end.x - push.x, 4 * middle.y - end.y - push.y,
            4 * middle.turn - end.turn - push.turn,
        )  # fmt: skip
        loose = static <= dv or not _holds(rate, m.angle, static, body, mesh)
    if loose and _alike(slip, half, body.gyration2) and _alike(slip, end, body.gyration2):
        return True, after, 0.0
    product = slip.x * end.x + slip.y * end.y + body.gyration2 * slip.turn * end.turn
    if product < 0 and not stuck:
        size2 = slip.x**2 + slip.y**2 + body.gyration2 * slip.turn**2
        ahead = size2 / (size2 - product)
    if last:
        free = _slip(plate[2], m.x + h * m.vx, m.y + h * m.vy, m.vx + fall_x, m.vy + fall_y, m.spin)
        turned = m.angle + h * m.spin
        end = _slip_after(free, turned, static, body, mesh)
        if static > dv and (end.x != 0 or end.y != 0 or end.turn != 0):
            end = _slip_after(free, turned, dv, body, mesh)
        after = _moved(
            m, h, m.vx + fall_x + free.x - end.x, m.vy + fall_y + free.y - end.y,
            m.spin + free.turn - end.turn,
        )  # fmt: skip
    return last, after, ahead


@inner_kernel
def _midpoint(slip, free, angle, turn, dv, body, mesh):
    """Return the slip in the middle of a step, and what friction there adds to the twist.

    `slip` is that at the start, at `angle` [rad]; `free` that in the middle, `turn` [rad] on, if
    there were no friction.
    """
    push, stiff = _friction(slip, angle, body, mesh)
    half = Slip(
        free.x - 0.5 * dv * push.x, free.y - 0.5 * dv * push.y, free.turn - 0.5 * dv * push.turn
    )
    gentle = dv * stiff <= GENTLE
    if gentle:
        push, stiff = _friction(half, angle + turn, body, mesh)
        push, gentle = Slip(dv * push.x, dv * push.y, dv * push.turn), dv * stiff <= GENTLE
    if not gentle:
        half = _slip_after(free, angle + turn, 0.5 * dv, body, mesh)
        push = Slip(2 * (free.x - half.x), 2 * (free.y - half.y), 2 * (free.turn - half.turn))
    return half, push


@inner_kernel
def _ride(plate, fall_x, fall_y, static, motion, body, mesh):
    """Return whether friction can hold a stuck part through a step, and its motion then.

    fall [m/s]: what gravity gives along the plate. static [m/s]: what static friction can give.
    """
    m, start, middle, end = motion, plate[0], plate[1], plate[2]
    turn = end[POSE_THETA] - start[POSE_THETA]
    rx, ry = m.x - start[POSE_X], m.y - start[POSE_Y]
    qx, qy = cos(turn) * rx - sin(turn) * ry, sin(turn) * rx + cos(turn) * ry
    after = Motion(
        end[POSE_X] + qx, end[POSE_Y] + qy, m.angle + turn,
        end[TWIST_X] - end[TWIST_THETA] * qy, end[TWIST_Y] + end[TWIST_THETA] * qx,
        end[TWIST_THETA],
    )  # fmt: skip
    ux, uy, uc = after.vx - m.vx, after.vy - m.vy, after.spin - m.spin
    if not _holds(Slip(ux - fall_x, uy - fall_y, uc), m.angle, static, body, mesh):
        return False, after
    # Also at the end of the step, where it may come loose: the velocity is about a parabola.
    turn = middle[POSE_THETA] - start[POSE_THETA]
    half = _slip(
        middle, middle[POSE_X] + rx - turn * ry, middle[POSE_Y] + ry + turn * rx, m.vx, m.vy, m.spin
    )
    rate = Slip(3 * ux - 4 * half.x - fall_x, 3 * uy - 4 * half.y - fall_y, 3 * uc - 4 * half.turn)
    return _holds(rate, m.angle, static, body, mesh), after


@inner_kernel
def _holds(slip, angle, dv, body, mesh):
    """Whether friction that can give dv [m/s] takes all of a slip."""
    if slip.x * slip.x + slip.y * slip.y > (1 + SNAP) ** 2 * dv * dv:
        return False
    left = _slip_after(slip, angle, dv, body, mesh)
    return left.x == 0 and left.y == 0 and left.turn == 0


@inner_kernel
def _alike(a, b, gyration2):
    """Whether two slips have nearly the same direction."""
    product = a.x * b.x + a.y * b.y + gyration2 * a.turn * b.turn
    a2 = a.x * a.x + a.y * a.y + gyration2 * a.turn * a.turn
    b2 = b.x * b.x + b.y * b.y + gyration2 * b.turn * b.turn
    return product > 0 and product * product > STEADY * STEADY * a2 * b2


@inner_kernel
def _friction(slip, angle, body, mesh):
    """As `patch.friction`, in plate_home, for a part at `angle` [rad]; also for discs."""
    if body.first_point == body.end_point:
        s2 = slip.x * slip.x + slip.y * slip.y
        size2 = s2 + body.gyration2 * slip.turn * slip.turn
        if size2 <= 0:
            return Slip(0.0, 0.0, 0.0), np.inf
        s = sqrt(s2)
        force, torque = disc_force(s, body.radius * abs(slip.turn))
        share = force / s if s > 0 else 0.0
        torque *= body.radius / body.gyration2
        torque = torque if slip.turn > 0 else -torque
        return Slip(share * slip.x, share * slip.y, torque), DISC_STIFF / sqrt(size2)
    c, s = cos(angle), sin(angle)
    ax, ay, ac, stiff = friction(
        c * slip.x + s * slip.y, c * slip.y - s * slip.x, slip.turn, body.gyration2, mesh,
        body.first_point, body.end_point,
    )  # fmt: skip
    return Slip(c * ax - s * ay, s * ax + c * ay, ac), stiff


@inner_kernel
def _slip_after(free, angle, dv, body, mesh):
    """As `patch.slip_after`, in plate_home, for a part at `angle` [rad]; also for discs."""
    if body.first_point == body.end_point:
        ex, ey, ec = disc_slip_after(free.x, free.y, free.turn, dv, body.gyration2, body.radius)
        return Slip(ex, ey, ec)
    c, s = cos(angle), sin(angle)
    ex, ey, ec = slip_after(
        c * free.x + s * free.y, c * free.y - s * free.x, free.turn, dv, body.gyration2, mesh,
        body.first_point, body.end_point,
    )  # fmt: skip
    return Slip(c * ex - s * ey, s * ex + c * ey, ec)


@inner_kernel
def _moved(m, h, vx, vy, spin):
    """Return the motion h [s] later if the velocity changes evenly to (vx, vy, spin)."""
    return Motion(
        m.x + 0.5 * h * (m.vx + vx), m.y + 0.5 * h * (m.vy + vy),
        m.angle + 0.5 * h * (m.spin + spin), vx, vy, spin,
    )  # fmt: skip


@inner_kernel
def _slip(plate, x, y, vx, vy, spin):
    """Twist of the plate (6,) at (x, y) less that of a part: equation (2)."""
    return Slip(
        plate[TWIST_X] - plate[TWIST_THETA] * (y - plate[POSE_Y]) - vx,
        plate[TWIST_Y] + plate[TWIST_THETA] * (x - plate[POSE_X]) - vy,
        plate[TWIST_THETA] - spin,
    )
