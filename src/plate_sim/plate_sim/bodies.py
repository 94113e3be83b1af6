"""Finite parts on the moving plate: they slide, turn and stick by friction all over a footprint.

The plate's exact motion (equation (2) of the paper, with its pose) moves the surface under each
part; `rubbing` turns that into the part's slip after a step. A sliding step takes friction at its
middle (implicit midpoint rule: second order); where the slip turns quickly or vanishes the step is
halved, at most `HALVINGS` times, and the shortest are implicit Euler steps. A part that sticks at
both ends of a step rides with the plate exactly, so it cannot creep. Parts never meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, cos, sin, sqrt

import numpy as np
from numba import njit

from plate_core import PlateCycle, PlateError

from .footprint import Footprint
from .friction import friction_accel, pairs
from .motion import START, THETA, X, Y, locate, place, slope, tabulate
from .points import SAMPLES
from .rubbing import slip_after

STEP = 2e-4
"""Default longest integration step [s]."""

HALVINGS = 9
"""How often a step is halved where the slip turns: friction reverses on time to 1/512 of it."""

STEADY = 0.9
"""Least cosine of the slip's turn to the middle and the end of a step that is not halved."""

END_SHARE = 1 / 16
"""Share of a step, at its end, over which a stuck part must be held on its own."""

STUCK = 1e-3
"""A slip below this share of mu g dt counts as none: it comes from rounding, not from sliding."""


@dataclass(frozen=True)
class BodyTrajectory:
    """Motion of M finite parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times [s], from 0.
    position, velocity : (k, M, 2)
        Of the centres of mass [m], [m/s].
    angle, spin : (k, M)
        [rad] (not wrapped), [rad/s]; counter-clockwise.
    """

    time: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def simulate_bodies(
    cycle: PlateCycle,
    footprint: Footprint | Sequence[Footprint],
    position: np.ndarray,
    angle: float | np.ndarray,
    velocity: np.ndarray,
    spin: float | np.ndarray,
    friction: float | np.ndarray,
    gravity: float = 9.81,
    cycles: int = 1,
    samples: int | None = None,
    step: float = STEP,
) -> BodyTrajectory:
    """Integrate the motion of finite parts that never meet, on an endless plate.

    Parameters
    ----------
    cycle : PlateCycle
        Motion of the plate, repeated.
    footprint : Footprint, or M of them
        Of all parts or of each.
    position, velocity : (M, 2)
        Centres of mass at the start of the first cycle [m], [m/s], plate_home.
    angle, spin : float or (M,)
        [rad], [rad/s].
    friction : float or (M,)
        Friction coefficient mu, of all parts or of each.
    gravity : float
        [m/s2].
    cycles : int
        How often the cycle is run.
    samples : int, optional
        Output samples per cycle, by default `points.SAMPLES`.
    step : float
        Longest integration step [s].

    Returns
    -------
    BodyTrajectory
        The start and every sample: k = cycles * samples + 1.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, or a count or coefficient is out of range.
    """
    if not isinstance(cycle, PlateCycle):
        raise PlateError(f"cycle is a {type(cycle).__name__}, allowed: a PlateCycle")
    position = pairs("position", position)
    count = len(position)
    velocity = pairs("velocity", velocity, count)
    angle, spin = _each("angle", angle, count), _each("spin", spin, count)
    limit = friction_accel(friction, gravity, count)
    parts = [footprint] * count if isinstance(footprint, Footprint) else list(footprint)
    if len(parts) != count or not all(isinstance(part, Footprint) for part in parts):
        raise PlateError(f"footprint is a list of {len(parts)}, allowed: {count} Footprints, or 1")
    samples = SAMPLES if samples is None else samples
    for name, value in (("samples", samples), ("cycles", cycles)):
        if not isinstance(value, (int, np.integer)) or value < 1:
            raise PlateError(f"{name} is {value!r}, allowed: a whole number, at least 1")
    if not 0 < step < np.inf:
        raise PlateError(f"step is {step!r} s, allowed: a positive number")
    table, _ = tabulate(cycle)
    interval = cycle.period / samples
    pieces = max(1, ceil(interval / step - 1e-9))
    state = np.empty((cycles * samples + 1, count, 6))
    state[0] = np.column_stack([position, angle, velocity, spin])
    for i, part in enumerate(parts):
        _run_body(
            table, interval / pieces, pieces, samples, limit[i], part.gyration2, part.points,
            part.weights, part.blur, state[:, i],
        )  # fmt: skip
    time = np.arange(len(state)) * interval
    return BodyTrajectory(time, state[..., :2], state[..., 2], state[..., 3:5], state[..., 5])


def _each(name: str, value: float | np.ndarray, count: int) -> np.ndarray:
    array = np.asarray(value, dtype=float)
    if array.shape not in ((), (count,)):
        raise PlateError(f"{name} has shape {array.shape}, allowed: () or ({count},)")
    if not np.isfinite(array).all():
        raise PlateError(f"{name} has values that are not finite: {array.tolist()}")
    return np.broadcast_to(array, (count,))


@njit(cache=True, nogil=True)
def _run_body(
    table, step, pieces, samples, limit, gyration2, points, weights, blur, state
):  # fmt: skip
    """Fill the states (k, 6) of one part, x, y, angle and their rates, from the first row."""
    force = np.zeros((len(points), 3))
    now, after = state[0].copy(), np.empty(6)
    finest = 1 << HALVINGS
    for row in range(1, len(state)):
        for piece in range(pieces):
            start = ((row - 1) % samples * pieces + piece) * step
            done, size = 0, finest
            while done < finest:
                t, h = start + done * step / finest, step * size / finest
                fits = _advance(
                    table, t, h, size == 1, limit, STUCK * limit * step, gyration2, points,
                    weights, blur, force, now, after,
                )  # fmt: skip
                if not fits:
                    size //= 2
                    continue
                now[:] = after
                done += size
                if size < finest and done % (2 * size) == 0:
                    size *= 2
        state[row] = now


@njit(cache=True, nogil=True)
def _advance(
    table, t, h, last, limit, none, gyration2, points, weights, blur, force, now, after
):  # fmt: skip
    """Make one step of h [s] from `now` to `after` (6,); return whether it is fine enough.

    `last`: it has to be. `none`: slip [m/s] that counts as none.
    """
    x, y, angle, vx, vy, spin = now[0], now[1], now[2], now[3], now[4], now[5]
    if limit * h <= 0:
        after[:] = now
        after[:3] += h * now[3:]
        return True
    sx, sy, sc = _slip(table, t, x, y, vx, vy, spin)
    size2 = sx * sx + sy * sy + gyration2 * sc * sc
    if size2 <= none * none:
        # Held over the whole step, and also at its end, where it may come loose
        _ride(table, t, (1 - END_SHARE) * h, now, after)
        lx, ly, lc = after[3], after[4], after[5]
        _ride(table, t, h, now, after)
        ex, ey, ec = _rub(
            after[3] - lx, after[4] - ly, after[5] - lc, angle, END_SHARE * limit * h, gyration2,
            points, weights, blur, force,
        )  # fmt: skip
        if ex == 0 and ey == 0 and ec == 0:
            ex, ey, ec = after[3] - vx, after[4] - vy, after[5] - spin
            ex, ey, ec = _rub(
                ex, ey, ec, angle, limit * h, gyration2, points, weights, blur, force
            )  # fmt: skip
        if (ex == 0 and ey == 0 and ec == 0) or not last:
            return ex == 0 and ey == 0 and ec == 0
    else:
        # Friction at the middle of the step
        mx, my, mc = _slip(
            table, t + 0.5 * h, x + 0.5 * h * vx, y + 0.5 * h * vy, vx, vy, spin
        )  # fmt: skip
        ax, ay, ac = _rub(
            mx, my, mc, angle + 0.5 * h * spin, 0.5 * limit * h, gyration2, points, weights, blur,
            force,
        )  # fmt: skip
        ux, uy, uc = vx + 2 * (mx - ax), vy + 2 * (my - ay), spin + 2 * (mc - ac)
        _move(now, after, h, ux, uy, uc)
        ex, ey, ec = _slip(table, t + h, after[0], after[1], ux, uy, uc)
        steady = _alike(sx, sy, sc, ax, ay, ac, gyration2)
        if steady and _alike(sx, sy, sc, ex, ey, ec, gyration2):
            return True
        if not last:
            return False
    fx, fy, fc = _slip(table, t + h, x + h * vx, y + h * vy, vx, vy, spin)
    ex, ey, ec = _rub(
        fx, fy, fc, angle + h * spin, limit * h, gyration2, points, weights, blur, force
    )  # fmt: skip
    _move(now, after, h, vx + fx - ex, vy + fy - ey, spin + fc - ec)
    return True


@njit(cache=True, nogil=True)
def _alike(ax, ay, ac, bx, by, bc, gyration2):
    """Whether two slips have nearly the same direction."""
    product = ax * bx + ay * by + gyration2 * ac * bc
    a2 = ax * ax + ay * ay + gyration2 * ac * ac
    b2 = bx * bx + by * by + gyration2 * bc * bc
    return product > STEADY * sqrt(a2 * b2)


@njit(cache=True, nogil=True)
def _rub(dx, dy, dc, angle, kick, gyration2, points, weights, blur, force):
    """As `slip_after`, in plate_home, for a part at `angle` [rad]."""
    c, s = cos(angle), sin(angle)
    ex, ey, ec = slip_after(
        c * dx + s * dy, c * dy - s * dx, dc, kick, gyration2, points, weights, blur, force
    )  # fmt: skip
    return c * ex - s * ey, s * ex + c * ey, ec


@njit(cache=True, nogil=True)
def _move(now, after, h, ux, uy, uc):
    """Go on for h [s] while the velocity changes evenly to (ux, uy, uc)."""
    after[0] = now[0] + 0.5 * h * (now[3] + ux)
    after[1] = now[1] + 0.5 * h * (now[4] + uy)
    after[2] = now[2] + 0.5 * h * (now[5] + uc)
    after[3], after[4], after[5] = ux, uy, uc


@njit(cache=True, nogil=True)
def _slip(table, t, x, y, vx, vy, spin):
    """Twist of the plate at (x, y) less that of a part: equation (2)."""
    t, k = locate(table, t, 0)
    u = t - table[k, START]
    turn = slope(table, k, THETA, u)
    return (
        slope(table, k, X, u) - turn * (y - place(table, k, Y, u)) - vx,
        slope(table, k, Y, u) + turn * (x - place(table, k, X, u)) - vy,
        turn - spin,
    )


@njit(cache=True, nogil=True)
def _ride(table, t, h, now, after):
    """Set `after` to where a part stuck to the plate is after h [s]."""
    t0, k = locate(table, t, 0)
    u = t0 - table[k, START]
    rx, ry = now[0] - place(table, k, X, u), now[1] - place(table, k, Y, u)
    before = place(table, k, THETA, u)
    t1, k = locate(table, t0 + h, k)
    u = t1 - table[k, START]
    turn = place(table, k, THETA, u) - before
    qx, qy = cos(turn) * rx - sin(turn) * ry, sin(turn) * rx + cos(turn) * ry
    spin = slope(table, k, THETA, u)
    after[0], after[1] = place(table, k, X, u) + qx, place(table, k, Y, u) + qy
    after[2] = now[2] + turn
    after[3], after[4] = slope(table, k, X, u) - spin * qy, slope(table, k, Y, u) + spin * qx
    after[5] = spin
