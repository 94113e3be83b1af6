"""Point parts on the plate's exact motion, event by event, to a stated accuracy.

A part slides, by Runge-Kutta 5(4) with steps that keep the estimated error small; or it is stuck
to its place in the plate, exactly, until the surface's acceleration there exceeds what static
friction gives. Where the slip vanishes the time is found; then the part sticks if the surface can
hold it, else it slides off along the surface's acceleration: on a line that is a reversal. Where
the slip in the plane only dips, steps shrink with it, but never below what the tolerance can feel.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

from .line import aligned, run_line
from .motion import END, START, WRAPS, hold_bound, in_plate, riding, slip, surface_rate
from .output import emit, emit_held, fall
from .sliding import landing, line_step, restart, runge_kutta

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


@njit(cache=True, nogil=True, error_model="numpy")
def run_points(table, line, scales, limit, static, tolerance, cycles, path, speed, checked):
    """Fill path and speed (cycles * samples + 1, M, 2) from their first rows; return the steps.

    Parameters
    ----------
    table, line, scales : (K, 24), (K, 13) or (0, 13), (8,)
        The plate's motion, from `tabulate` and `tabulate_line`.
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
                fall(j * dt, scales[6:], place[j], velocity[j])
        elif len(line) and aligned(table, scales, velocity[0]):
            hold = static * limit[i]
            checked[i] = run_line(line, scales, limit[i], hold, cycles, place, velocity)
        else:
            made = _run_part(table, scales, limit[i], static, tolerance, cycles, place, velocity)
            checked[i] = made <= BUDGET * cycles
            steps += made
    return steps


@njit(cache=True, error_model="numpy")
def _run_part(table, scales, limit, static, tolerance, cycles, path, speed):
    """As `run_points`, for one part: path and speed (cycles * samples + 1, 2)."""
    period, wraps, hold, pull = table[-1, END], table[0, WRAPS] != 0, static * limit, scales[6:]
    grid = (period / ((len(path) - 1) // cycles), (len(path) - 1) // cycles)
    px, py, vx, vy = path[0, 0], path[0, 1], speed[0, 0], speed[0, 1]
    accel, pace = _scales(scales, px, py)
    reach = period if pace * period < 0.5 else max(1 / pace, period / max(COARSE, len(table)))
    stuck, done, steps, k, j = False, 0, 0, 0, 1
    t, hint, qx, qy = 0.0, 0.25 * reach, 0.0, 0.0
    _, wx, wy, r = slip(table, t, k, px, py, vx, vy)
    ax, ay = surface_rate(table, t, k, px, py, vx, vy)
    while done < cycles:
        steps += 1
        left = period - t
        ends = done == cycles - 1 or not wraps
        room = left if ends else period
        # Rounding of the state limits what a step can promise.
        size = abs(px) + abs(py) + period * (abs(vx) + abs(vy))
        allowed = max(STEP_SHARE * tolerance, 1e-15 * size)
        crude = steps > BUDGET * cycles
        a = sqrt(ax * ax + ay * ay)
        if not (stuck or crude) and _calm(r, limit, a, allowed, period):
            qx, qy = in_plate(table, t, k, px, py)
            stuck = _holds(table, t + AHEAD * period, k, qx, qy, hold)
            if not stuck:
                h, x, y, ux, uy, fx, fy, gx, gy = restart(
                    table, t, k, min(0.5 * reach, room), px, py, vx, vy, limit, allowed / period
                )  # fmt: skip
                stuck = h == 0
                hint = h
        elif not stuck:
            fx, fy = (limit * wx / r, limit * wy / r) if r > 0 else (0.0, 0.0)
            line = abs(wx * scales[5] - wy * scales[4]) <= FINE * _zero(limit, a, allowed, period)
            line = line and (scales[4] != 0 or scales[5] != 0)
            if line:
                way = limit if wx * scales[4] + wy * scales[5] > 0 else -limit
                fx, fy, hint = way * scales[4], way * scales[5], reach
            hint = period / COARSE if crude else min(hint, reach)
            first = min(hint, room) if line else _to_knot(table, t, k, hint, room)
            h, x, y, ux, uy, gx, gy, hint = _slide(
                table, t, k, first, hint, px, py, vx, vy, fx, fy, r,
                fx * ax + fy * ay, limit, a, allowed, period, accel, pace, crude, line,
            )  # fmt: skip
        if stuck:
            until = _release(table, t + AHEAD * period, k, qx, qy, hold)
            j = emit_held(table, t, until, k, qx, qy, done, grid, pull, j, path, speed)
            h = until - t
            k, x, y, ux, uy, ax, ay = riding(table, until, k, qx, qy)
            stuck = until >= period
            hint = 0.1 * reach
        else:
            j = emit(
                t, h, px, py, vx, vy, fx, fy, x, y, ux, uy, gx, gy, done, grid, pull, j, path, speed
            )  # fmt: skip
        px, py, vx, vy = x, y, ux, uy
        t += h
        if t >= period or (h >= left and ends):
            t = max(0.0, t - period)
            done += 1
            k = 0
            if not wraps:
                px, py = px + 0.5 * period * period * pull[0], py + 0.5 * period * period * pull[1]
                vx, vy = vx + period * pull[0], vy + period * pull[1]
        k, wx, wy, r = slip(table, t, k, px, py, vx, vy)
        ax, ay = surface_rate(table, t, k, px, py, vx, vy)
    path[-1, 0], path[-1, 1], speed[-1, 0], speed[-1, 1] = px, py, vx, vy
    return steps


@njit(cache=True, error_model="numpy")
def _scales(scales, px, py):
    """Greatest acceleration [m/s2] under a part and how fast it changes [1/s], about."""
    arm = sqrt(px * px + py * py)
    accel = scales[0] + arm * scales[1]
    jerk = scales[2] + arm * scales[3]
    return accel, jerk / accel if accel > 0 else 0.0


@njit(cache=True, error_model="numpy")
def _calm(r, limit, a, allowed, period):
    """Whether a slip r [m/s] is as good as none where the surface accelerates by a [m/s2]."""
    if r * r <= 2 * SNAP_SHARE * allowed * (limit - a):
        return True
    return r <= _zero(limit, a, allowed, period)


@njit(cache=True, error_model="numpy")
def _zero(limit, a, allowed, period):
    """Slip [m/s] that is over before friction can change v by what a step may err."""
    return ZERO_SHARE * allowed / period * max(1.0, a / limit)


@njit(cache=True, error_model="numpy")
def _holds(table, t, k, qx, qy, limit):
    """Whether the surface can carry a part at q [m, in the plate] along."""
    return _felt(table, t, k, qx, qy) <= limit * limit


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _slide(
    table, t, k, h, hint, px, py, vx, vy, fx, fy, r, power, limit, a, allowed, period, accel,
    pace, crude, line,
):  # fmt: skip
    """Make one step of a sliding part, of at most h [s], with an error within `allowed` [m].

    Returns the step [s], the state and friction at its end, and the next step to try [s].
    """
    first, zero = h, _zero(limit, a, allowed, period)
    while True:
        if line:
            turned, x, y, ux, uy, gx, gy, ep, ev = line_step(
                table, t, k, h, px, py, vx, vy, fx, fy, limit
            )
        else:
            turned, x, y, ux, uy, gx, gy, ep, ev = runge_kutta(
                table, t, k, h, px, py, vx, vy, fx, fy, limit
            )
        tiny = h <= FLOOR * period
        if turned > 0:
            tau, rest, error = landing(
                table, t, k, turned * h, px, py, vx, vy, fx, fy, r, limit, FINE * zero
            )  # fmt: skip
            fits = period * error <= allowed and rest <= zero
            if (tau > 0 and fits) or tiny or crude:
                h = tau if tau > 0 and fits and not crude else h
                x, y = px + h * (vx + 0.5 * h * fx), py + h * (vy + 0.5 * h * fy)
                return h, x, y, vx + h * fx, vy + h * fy, fx, fy, hint
            h = hint = 0.7 * tau if tau > 0 else 0.4 * turned * h
            continue
        error = ep + period * ev
        if error > allowed and not (tiny or crude):
            h = hint = h * max(0.2, 0.9 * (allowed / error) ** 0.2)
            continue
        down = h * (power / limit - limit)
        if down >= 0 or tiny or crude or not _dips(
            table, t, k, h, x, y, ux, uy, gx, gy, r, down, limit, 0.01 * accel * h * (pace * h) ** 3
        ):  # fmt: skip
            break
        h = hint = 0.5 * h
    grown = 6.0 if error * 4000 < allowed else 0.9 * (allowed / error) ** 0.2
    hint = h * grown if h == first == hint or grown < 1 else max(hint, h * grown)
    return h, x, y, ux, uy, gx, gy, hint


@njit(cache=True, error_model="numpy")
def _dips(table, t, k, h, x, y, ux, uy, gx, gy, r, down, limit, margin):
    """Whether the slip may vanish unseen within a step: from values and rates at its ends."""
    k, _, _, r_end = slip(table, t + h, k, x, y, ux, uy)
    ax, ay = surface_rate(table, t + h, k, x, y, ux, uy)
    up = h * ((gx * ax + gy * ay) / limit - limit)
    if up <= 0:
        return False
    # The cubic r + down s + b s^2 + c s^3, s from 0 to 1
    b, c = 3 * (r_end - r) - 2 * down - up, 2 * (r - r_end) + down + up
    root = sqrt(max(0.0, b * b - 3 * c * down))
    s = -down / (b + root) if b + root > 0 else 0.5
    least = r + s * (down + s * (b + s * c))
    return least < margin


@njit(cache=True, error_model="numpy")
def _release(table, t, k, qx, qy, limit):
    """Time [s], at most the period, up to which the surface holds a part at q [m, in the plate]."""
    period = table[-1, END]
    radius = sqrt(qx * qx + qy * qy)
    for piece in range(k, len(table)):
        low, end = max(t, table[piece, START]), table[piece, END]
        if low >= end or hold_bound(table, piece, radius) <= limit:
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _felt(table, t, k, qx, qy):
    """Square of the acceleration [m2/s4] of a place in the plate."""
    _, _, _, _, _, ax, ay = riding(table, t, k, qx, qy)
    return ax * ax + ay * ay
