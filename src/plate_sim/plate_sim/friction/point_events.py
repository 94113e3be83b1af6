"""Point parts on the plate's exact motion, event by event, to a stated accuracy: the judge.

A part slides, by Runge-Kutta 5(4) with steps that keep the estimated error small; or it is stuck
to its place in the plate, exactly, until the surface's acceleration there exceeds what static
friction gives. Where the slip vanishes the time is found; then the part sticks if the surface can
hold it, else it slides off along the surface's acceleration: on a line that is a reversal. Where
the slip in the plane only dips, steps shrink with it, but never below what the tolerance can feel.

On a tilted plate the frame falls with gravity along the plate (`plate.pieces`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from plate_core import PlateCycle, PlateError
from plate_core.kernels import constant, inner_kernel, kernel

from ..plate.ground import LEVEL, Ground
from ..plate.motion import PlateMotion
from ..plate.pieces import (
    END,
    START,
    WRAPS,
    in_plate,
    ride_bound,
    riding,
    slip,
    surface_rate,
    tabulate,
)
from .checks import LARGEST, check_motion, friction_accel, pairs, whole
from .runge_kutta import Point, even, landing, line_step, restart, runge_kutta

TOLERANCE = 1e-7
"""Default error of the displacement in one cycle [m]: a ten-thousandth of a pixel."""

SAMPLES = 64
"""Default output samples per cycle: eight in the shortest wave of a usual motion."""

FIRST_PIECE, FIRST_SAMPLE = constant(0), constant(1)
"""Where a part begins: in the table of the plate's motion, and in what is given out."""

STEP_SHARE = 0.05
"""Share of the tolerance that one step may err: errors of a cycle's steps add up and decay."""

SNAP_SHARE = 0.1
"""Share of a step's error [m] that may be left to slide when a part is taken to be stuck."""

ZERO_SHARE = 0.2
"""Share of a step's error, per period, below which a slip [m/s] counts as none."""

AHEAD = 1e-8
"""A part can stick if the surface can hold it also this share of a period later."""

FLOOR = 1e-13
"""Shortest step, as a share of the period: time itself is rounded to 1e-16 of it."""

BUDGET, COARSE = 50_000, 2000
"""Trial steps per cycle, after which equal steps, so many in a cycle, finish it unchecked."""

FINE = 1e-3
"""Share of a slip that counts as none, to which roots are found and lines kept."""

LEAST = 1e-60
"""Friction [m/s2] below this moves nothing; its directions would drown in rounding."""

SCAN, LOOKS = 3, 100
"""Least numbers of looks, per piece and per period, for the release of a stuck part."""


class Bounds(NamedTuple):
    """What one part's steps are measured by.

    Attributes
    ----------
    limit : float
        mu g [m/s2].
    period : float
        [s].
    accel, rate : float
        Greatest acceleration [m/s2] under the part and how fast it changes [1/s], about.
    """

    limit: float
    period: float
    accel: float
    rate: float


class Slide(NamedTuple):
    """A sliding part at the start of a step.

    Attributes
    ----------
    slip : float
        [m/s].
    surface : float
        Acceleration of the surface under it [m/s2].
    power : float
        The same along friction, times friction [m2/s4].
    allowed : float
        Error that the step may make [m].
    line : bool
        Whether the slip keeps to a line.
    crude : bool
        Whether the budget is spent.
    """

    slip: float
    surface: float
    power: float
    allowed: float
    line: bool
    crude: bool


class Grid(NamedTuple):
    """Output samples: their distance [s], how many there are in a cycle, the cycles already behind,
    and the gravity along the plate with which the frame falls [m/s2]."""

    step: float
    per_cycle: int
    done: int
    gravity_x: float
    gravity_y: float


@dataclass(frozen=True)
class Trajectory:
    """Motion of M parts in plate_home.

    Attributes
    ----------
    time : (k,)
        Times [s], from 0.
    position : (k, M, 2)
        Positions [m].
    velocity : (k, M, 2)
        Velocities [m/s].
    unchecked : tuple of int
        Parts whose motion was too restless for the wanted tolerance: it was finished in coarse
        steps, with an error that is not known. Empty for all but freak motions.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    unchecked: tuple[int, ...] = ()


def simulate(
    cycle: PlateCycle | PlateMotion,
    position: np.ndarray,
    velocity: np.ndarray,
    friction: float | np.ndarray,
    gravity: float = 9.81,
    cycles: int = 1,
    samples: int | None = None,
    tolerance: float = TOLERANCE,
    *,
    ground: Ground = LEVEL,
) -> Trajectory:
    """Integrate the stick-slip motion of point parts that never meet, on an endless plate.

    Event by event, for an error of `tolerance` in each cycle.

    Parameters
    ----------
    cycle : PlateCycle or PlateMotion
        Motion of the plate, repeated; a PlateMotion, which need not close, runs once.
    position, velocity : (M, 2)
        Parts at the start of the first cycle [m], [m/s], plate_home.
    friction : float or (M,)
        Friction coefficient mu, of all parts or of each.
    gravity : float
        [m/s2].
    cycles : int
        How often the cycle is run.
    samples : int, optional
        Output samples per cycle, by default `SAMPLES`.
    tolerance : float
        Wanted error of the displacement in one cycle [m].
    ground : Ground
        Static friction and tilt.

    Returns
    -------
    Trajectory
        The start and every sample: k = cycles * samples + 1.

    Raises
    ------
    PlateError
        If shapes disagree, a value is not finite, or a count or coefficient is out of range.
    """
    cycles = whole("cycles", cycles)
    check_motion(cycle, cycles)
    position = pairs("position", position)
    velocity = pairs("velocity", velocity, len(position))
    limit = friction_accel(friction, gravity, len(position))
    samples = whole("samples", SAMPLES if samples is None else samples)
    if not 0 < tolerance <= LARGEST:
        raise PlateError(f"tolerance is {tolerance!r} m, allowed: a positive number")
    effect = ground.effect(gravity)
    table, scales = tabulate(cycle, effect[:2])
    if not scales.max() <= LARGEST:
        raise PlateError(f"cycle accelerates by {scales.max():g}, allowed: up to {LARGEST:g}")
    path, speed = np.empty((2, cycles * samples + 1, len(position), 2))
    path[0], speed[0] = position, velocity
    checked = np.ones(len(position), bool)
    run_points(
        table, scales, limit, effect.static_ratio, float(tolerance), cycles, path, speed, checked
    )
    unchecked = tuple(np.flatnonzero(~checked).tolist())
    return Trajectory(np.arange(len(path)) * (cycle.period / samples), path, speed, unchecked)


@kernel(nogil=True, error_model="numpy")
def run_points(table, scales, limit, static, tolerance, cycles, path, speed, checked):
    """Fill path and speed (cycles * samples + 1, M, 2) from their first rows; return the steps.

    Parameters
    ----------
    table, scales : (K, 24), (8,)
        The plate's motion, from `pieces.tabulate`.
    limit : (M,)
        mu g of each part [m/s2].
    static : float
        Static over dynamic friction.
    tolerance : float
        Of the displacement in one cycle [m].
    cycles : int
    path, speed : (cycles * samples + 1, M, 2)
        Positions [m] and velocities [m/s], plate_home.
    checked : (M,)
        Filled with whether a part's motion was found within the budgets.
    """
    steps = 0
    for i in range(path.shape[1]):
        place, velocity, checked[i] = path[:, i], speed[:, i], True
        if limit[i] <= LEAST:
            dt = cycles * table[-1, END] / (len(path) - 1)
            for j in range(1, len(path)):
                for d in range(2):
                    place[j, d] = place[0, d] + j * dt * velocity[0, d]
                    velocity[j, d] = velocity[0, d]
                _add_fall(j * dt, scales[6], scales[7], place[j], velocity[j])
        else:
            made = _run_part(table, scales, limit[i], static, tolerance, cycles, place, velocity)
            checked[i] = made <= BUDGET * cycles
            steps += made
    return steps


@inner_kernel
def _run_part(table, scales, limit, static, tolerance, cycles, path, speed):
    """As `run_points`, for one part: path and speed (cycles * samples + 1, 2)."""
    period, wraps, static_limit = table[-1, END], table[0, WRAPS] != 0, static * limit
    count = (len(path) - 1) // cycles
    point = Point(path[0, 0], path[0, 1], speed[0, 0], speed[0, 1])
    accel, rate = _scales(scales, point.x, point.y)
    bounds = Bounds(limit, period, accel, rate)
    reach = period if rate * period < 0.5 else max(1 / rate, period / max(COARSE, len(table)))
    stuck, done, steps, k, j = False, 0, 0, FIRST_PIECE, FIRST_SAMPLE
    t, hint, qx, qy = 0.0, 0.25 * reach, 0.0, 0.0
    _, wx, wy, r = slip(table, t, k, point)
    ax, ay = surface_rate(table, t, k, point)
    while done < cycles:
        steps += 1
        grid = Grid(period / count, count, done, scales[6], scales[7])
        left = period - t
        ends = done == cycles - 1 or not wraps
        room = left if ends else period
        # Rounding of the state limits what a step can promise.
        size = abs(point.x) + abs(point.y) + period * (abs(point.vx) + abs(point.vy))
        allowed = max(STEP_SHARE * tolerance, 1e-15 * size)
        crude = steps > BUDGET * cycles
        a = sqrt(ax * ax + ay * ay)
        h, end, before, after = 0.0, point, (0.0, 0.0), (0.0, 0.0)
        if not (stuck or crude) and _calm(r, limit, a, allowed, period):
            qx, qy = in_plate(table, t, k, point.x, point.y)
            stuck = _holds(table, t + AHEAD * period, k, qx, qy, static_limit)
            if not stuck:
                h, end, before, after = restart(
                    table, t, k, min(0.5 * reach, room), point, limit, allowed / period
                )
                stuck = h == 0
                hint = h
        elif not stuck:
            before = (limit * wx / r, limit * wy / r) if r > 0 else (0.0, 0.0)
            line = abs(wx * scales[5] - wy * scales[4]) <= FINE * _zero(limit, a, allowed, period)
            line = line and (scales[4] != 0 or scales[5] != 0)
            if line:
                way = limit if wx * scales[4] + wy * scales[5] > 0 else -limit
                before, hint = (way * scales[4], way * scales[5]), reach
            hint = period / COARSE if crude else min(hint, reach)
            first = min(hint, room) if line else _to_knot(table, t, k, hint, room)
            now = Slide(r, a, before[0] * ax + before[1] * ay, allowed, line, crude)
            h, end, after, hint = _slide(table, t, k, first, hint, point, before, now, bounds)
        if stuck:
            until = _release(table, t + AHEAD * period, k, qx, qy, static_limit)
            j = _emit_held(table, t, until, k, qx, qy, grid, j, path, speed)
            h = until - t
            k, x, y, ux, uy, ax, ay = riding(table, until, k, qx, qy)
            end = Point(x, y, ux, uy)
            stuck = until >= period
            hint = 0.1 * reach
        else:
            j = _emit(t, h, point, before, end, after, grid, j, path, speed)
        point = end
        t += h
        if t >= period or (h >= left and ends):
            t = max(0.0, t - period)
            done += 1
            k = 0
            if not wraps:  # back into the room, from the frame that fell
                point = even(Point(point.x, point.y, 0.0, 0.0), (scales[6], scales[7]), period)
                point = Point(point.x, point.y, end.vx + point.vx, end.vy + point.vy)
        k, wx, wy, r = slip(table, t, k, point)
        ax, ay = surface_rate(table, t, k, point)
    path[-1, 0], path[-1, 1], speed[-1, 0], speed[-1, 1] = point
    return steps


@inner_kernel
def _scales(scales, x, y):
    """Greatest acceleration [m/s2] under a part and how fast it changes [1/s], about."""
    arm = sqrt(x * x + y * y)
    accel = scales[0] + arm * scales[1]
    jerk = scales[2] + arm * scales[3]
    return accel, jerk / accel if accel > 0 else 0.0


@inner_kernel
def _calm(r, limit, a, allowed, period):
    """Whether a slip r [m/s] is as good as none where the surface accelerates by a [m/s2]."""
    if r * r <= 2 * SNAP_SHARE * allowed * (limit - a):
        return True
    return r <= _zero(limit, a, allowed, period)


@inner_kernel
def _zero(limit, a, allowed, period):
    """Slip [m/s] that is over before friction can change v by what a step may err; no more than
    friction can give in a period, where that is next to nothing."""
    return min(ZERO_SHARE * allowed / period * max(1.0, a / limit), limit * period)


@inner_kernel
def _holds(table, t, k, qx, qy, limit):
    """Whether the surface can carry a part at q [m, in the plate] along."""
    return _felt(table, t, k, qx, qy) <= limit * limit


@inner_kernel
def _to_knot(table, t, k, h, room):
    """Shorten a step to end on a knot, unless it would span several pieces."""
    h = min(h, room)
    knot = table[k, END]
    if knot - t <= FLOOR * table[-1, END] and k + 1 < len(table):
        k += 1
        knot = table[k, END]
    gap = knot - t
    if gap > FLOOR * table[-1, END] and gap < h < 2 * (knot - table[k, START]):
        h = gap
    return h


@inner_kernel
def _slide(table, t, k, h, hint, point, force, now, bounds):
    """Make one step of a sliding part, of at most h [s].

    Returns
    -------
    h, point, force, hint : float, Point, (2,), float
        The step [s], state and friction at its end, and the next step to try [s].
    """
    limit, period = bounds.limit, bounds.period
    first, zero = h, _zero(limit, now.surface, now.allowed, period)
    while True:
        if now.line:
            turned, end, after, ep, ev = line_step(table, t, k, h, point, force)
        else:
            turned, end, after, ep, ev = runge_kutta(table, t, k, h, point, force, limit)
        must = h <= FLOOR * period or now.crude
        if turned > 0:
            tau, rest, error = landing(
                table, t, k, turned * h, point, force, now.slip, limit, FINE * zero
            )
            fits = tau > 0 and period * error <= now.allowed and rest <= zero
            if fits or must:
                h = tau if fits and not now.crude else h
                return h, even(point, force, h), force, hint
            h = hint = 0.7 * tau if tau > 0 else 0.4 * turned * h
            continue
        error = ep + period * ev
        if error > now.allowed and not must:
            h = hint = h * max(0.2, 0.9 * (now.allowed / error) ** 0.2)
            continue
        if must or not _dips(table, t, k, h, end, after, now, bounds):
            break
        h = hint = 0.5 * h
    grown = 6.0 if error * 4000 < now.allowed else 0.9 * (now.allowed / error) ** 0.2
    hint = h * grown if h == first == hint or grown < 1 else max(hint, h * grown)
    return h, end, after, hint


@inner_kernel
def _dips(table, t, k, h, end, force, now, bounds):
    """Whether the slip may vanish unseen within a step: from values and rates at its ends."""
    r, limit = now.slip, bounds.limit
    down = h * (now.power / limit - limit)
    if down >= 0:
        return False
    k, _, _, r_end = slip(table, t + h, k, end)
    ax, ay = surface_rate(table, t + h, k, end)
    up = h * ((force[0] * ax + force[1] * ay) / limit - limit)
    if up <= 0:
        return False
    # The cubic r + down s + b s^2 + c s^3, s from 0 to 1
    b, c = 3 * (r_end - r) - 2 * down - up, 2 * (r - r_end) + down + up
    root = sqrt(max(0.0, b * b - 3 * c * down))
    s = -down / (b + root) if b + root > 0 else 0.5
    least = r + s * (down + s * (b + s * c))
    return least < 0.01 * bounds.accel * h * (bounds.rate * h) ** 3


@inner_kernel
def _release(table, t, k, qx, qy, limit):
    """Time [s], at most the period, up to which the surface holds a part at q [m, in the plate]."""
    period = table[-1, END]
    radius = sqrt(qx * qx + qy * qy)
    for piece in range(k, len(table)):
        low, end = max(t, table[piece, START]), table[piece, END]
        if low >= end or ride_bound(table, piece, radius) <= limit:
            continue
        width = min((end - table[piece, START]) / SCAN, period / LOOKS)
        while low < end:
            high = min(low + width, end)
            free = _first_free(table, low, high, piece, qx, qy, limit)
            if free >= 0:
                while free - low > 1e-15 * period:
                    middle = 0.5 * (low + free)
                    if not low < middle < free:
                        break
                    if _felt(table, middle, piece, qx, qy) <= limit * limit:
                        low = middle
                    else:
                        free = middle
                return low
            low = high
    return period


@inner_kernel
def _first_free(table, low, high, k, qx, qy, limit):
    """A time [s] at which the surface cannot hold the part, looked for up to `high`; else -1.

    Looked at are the middle, the end, and the peak of the parabola through both and the start.
    """
    middle = 0.5 * (low + high)
    a = _felt(table, low, k, qx, qy)
    b = _felt(table, middle, k, qx, qy)
    c = _felt(table, high, k, qx, qy)
    if b > limit * limit:
        return middle
    bend = a - 2 * b + c
    if bend < 0 and abs(a - c) < -2 * bend:
        peak = middle + 0.25 * (high - low) * (a - c) / bend
        if _felt(table, peak, k, qx, qy) > limit * limit:
            return peak
    return high if c > limit * limit else -1.0


@inner_kernel
def _felt(table, t, k, qx, qy):
    """Square of the acceleration [m2/s4] of a place in the plate."""
    _, _, _, _, _, ax, ay = riding(table, t, k, qx, qy)
    return ax * ax + ay * ay


@inner_kernel
def _emit_held(table, t, until, k, qx, qy, grid, j, path, speed):
    """Write the samples, from the j-th on, of a part stuck at q from t to `until`; return the next
    sample. Times count from the start of the present cycle."""
    while j < len(path) - 1:
        at = (j - grid.done * grid.per_cycle) * grid.step
        if at > until:
            break
        k, path[j, 0], path[j, 1], speed[j, 0], speed[j, 1], _, _ = riding(table, at, k, qx, qy)
        _add_fall(at, grid.gravity_x, grid.gravity_y, path[j], speed[j])
        j += 1
    return j


@inner_kernel
def _emit(t, h, start, before, end, after, grid, j, path, speed):
    """Write the samples of a sliding step: the quintic through both ends' p, v and v'."""
    if j >= len(path) - 1 or (j - grid.done * grid.per_cycle) * grid.step > t + h:
        return j
    px, py, vx, vy = start
    (fx, fy), (gx, gy) = before, after
    hh = h * h
    dx, dy = end.x - px - h * vx - 0.5 * hh * fx, end.y - py - h * vy - 0.5 * hh * fy
    sx, sy = h * (end.vx - vx - h * fx), h * (end.vy - vy - h * fy)
    bx, by = hh * (gx - fx), hh * (gy - fy)
    x3, x4, x5 = 10 * dx - 4 * sx + 0.5 * bx, -15 * dx + 7 * sx - bx, 6 * dx - 3 * sx + 0.5 * bx
    y3, y4, y5 = 10 * dy - 4 * sy + 0.5 * by, -15 * dy + 7 * sy - by, 6 * dy - 3 * sy + 0.5 * by
    while j < len(path) - 1:
        tau = (j - grid.done * grid.per_cycle) * grid.step - t
        if tau > h:
            break
        u = tau / h
        cube = u * u / h
        path[j, 0] = px + tau * (vx + 0.5 * tau * fx) + u * u * u * (x3 + u * (x4 + u * x5))
        path[j, 1] = py + tau * (vy + 0.5 * tau * fy) + u * u * u * (y3 + u * (y4 + u * y5))
        speed[j, 0] = vx + tau * fx + cube * (3 * x3 + u * (4 * x4 + u * 5 * x5))
        speed[j, 1] = vy + tau * fy + cube * (3 * y3 + u * (4 * y4 + u * 5 * y5))
        _add_fall(t + tau, grid.gravity_x, grid.gravity_y, path[j], speed[j])
        j += 1
    return j


@inner_kernel
def _add_fall(t, gravity_x, gravity_y, place, velocity):
    """Add to a place and velocity (2,) what a freely falling frame has gained after t [s]."""
    place[0] += 0.5 * t * t * gravity_x
    place[1] += 0.5 * t * t * gravity_y
    velocity[0] += t * gravity_x
    velocity[1] += t * gravity_y
