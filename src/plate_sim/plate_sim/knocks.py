"""Impulses between rigid parts that turn, and the end of their overlaps.

Where parts touch while they close in, the least impulses that end it (one or two points, solved
together) are raised by the restitution e: (1 + e) of them. That never adds energy, whatever the
shapes (the inelastic outcome is the nearest one in the measure of energy; the elastic one is as far
on the other side). Then each point rubs: an impulse of up to mu_c times the one across takes speed
off along the rims, and never turns it around. Impulses act on both parts in one place at one time,
so momentum and angular momentum are kept: that time is when the parts touched, within the step.
What overlap a crowd leaves is ended by moving its parts apart, without speed.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

from .body_step import GYRATION2, LIGHTNESS, RADIUS
from .touching import COUNT, DEPTHS, NORMAL, POINTS

KEPT = 5e-6
"""Overlap [m] that is left: parts that part end it themselves, and no shift disturbs their angular
momentum."""

REBOUNDS = 20
"""Impulses of one knock, at most: a rub beside the line of centres may call for more than one."""

ROUNDING = 1e-12
"""A closing speed below this share of the first one is none."""

RANK = 1e-9
"""Two points whose impulses differ by a smaller share than this act as one."""


@njit(cache=True, nogil=True, error_model="numpy")
def knock(first, second, touch, rules, step, arms):
    """Let two parts, or a part and a wall, meet; return the closing speed [m/s] there was.

    Parameters
    ----------
    first, second : (22,)
        Columns as in `body_step`; states are changed. A disc that touches a piece is the first. A
        wall has the plate's pose and twist, no `LIGHTNESS` and no `RADIUS`.
    touch : (9,)
        As in `touching`; of discs, its normal is turned to when they touched.
    rules : (2,)
        Restitution and friction coefficient.
    step : float
        [s].
    arms : (2, 4)
        Room to work in.
    """
    if first[RADIUS] > 0 and second[RADIUS] > 0:
        ago = _discs_touched(first, second, first[RADIUS] + second[RADIUS], touch, step)
    else:
        ago = _touched(first, second, touch, step)
    count, n = int(touch[COUNT]), (touch[NORMAL], touch[NORMAL + 1])
    _reach(first, second, first[RADIUS], second[LIGHTNESS] == 0, touch, ago, arms)
    masses = (
        first[LIGHTNESS], first[LIGHTNESS] / first[GYRATION2],
        second[LIGHTNESS], second[LIGHTNESS] / second[GYRATION2],
    )  # fmt: skip
    before = (first[3], first[4], first[5], second[3], second[4], second[5])
    v0 = _speed(first, second, arms[0], n)
    v1 = _speed(first, second, arms[1], n) if count == 2 else 0.0
    _bounce(first, second, arms, n, masses, count, v0, v1, rules)
    for d in range(3):
        first[d] += ago * (first[3 + d] - before[d])
        second[d] += ago * (second[3 + d] - before[3 + d])
    for k in range(count):
        moved = _speed(first, second, arms[k], n) - (v0 if k == 0 else v1)
        touch[DEPTHS + k] -= ago * moved
    for k in range(count):
        left = touch[DEPTHS + k] - KEPT
        if left > 0:
            give = left / _yield(arms[k], arms[k], n, masses)
            _push(first, second, arms[k], n, give, masses, 0)
            if count == 2 and k == 0:
                touch[DEPTHS + 1] -= give * _yield(arms[0], arms[1], n, masses)
    return max(0.0, -v0, -v1)


@njit(cache=True, nogil=True, error_model="numpy")
def _bounce(first, second, arms, n, masses, count, v0, v1, rules):
    """Give impulses until no point closes in; v0, v1 are the points' speeds [m/s] along n."""
    t, still = (-n[1], n[0]), ROUNDING * max(abs(v0), abs(v1))
    for _ in range(REBOUNDS):
        if v0 >= -still and v1 >= -still:
            break
        j0, j1 = _least(arms, n, masses, v0, v1, count)
        for k in range(count):
            _push(first, second, arms[k], n, (1 + rules[0]) * (j0 if k == 0 else j1), masses, 3)
        for k in range(count):
            most = rules[1] * (1 + rules[0]) * (j0 if k == 0 else j1)
            drag = -_speed(first, second, arms[k], t) / _yield(arms[k], arms[k], t, masses)
            _push(first, second, arms[k], t, min(max(drag, -most), most), masses, 3)
        # A rub may have turned them towards each other again
        v0 = _speed(first, second, arms[0], n)
        v1 = _speed(first, second, arms[1], n) if count == 2 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _discs_touched(first, second, radii, touch, step):
    """How long ago [s] two discs touched that close in; turn the normal to that moment."""
    nx, ny, depth = touch[NORMAL], touch[NORMAL + 1], touch[DEPTHS]
    dx, dy = first[0] - second[0], first[1] - second[1]
    wx, wy = first[3] - second[3], first[4] - second[4]
    closing = -(wx * nx + wy * ny)
    if closing <= 0:
        return 0.0
    # |d - ago w| = radii
    distance, w2 = radii - depth, wx * wx + wy * wy
    ahead, lack = closing * distance, depth * (radii + distance)
    ago = min(lack / (ahead + sqrt(ahead * ahead + w2 * lack)), step)
    dx, dy = dx - ago * wx, dy - ago * wy
    far = sqrt(dx * dx + dy * dy)
    if far > 0:
        touch[NORMAL], touch[NORMAL + 1] = dx / far, dy / far
    return ago


@njit(cache=True, nogil=True, error_model="numpy")
def _touched(first, second, touch, step):
    """How long ago [s] two parts touched that close in at their present speeds."""
    ago = 0.0
    for k in range(int(touch[COUNT])):
        px, py = touch[POINTS + 2 * k], touch[POINTS + 2 * k + 1]
        ax, ay = _velocity(first, px - first[0], py - first[1])
        bx, by = _velocity(second, px - second[0], py - second[1])
        closing = touch[NORMAL] * (bx - ax) + touch[NORMAL + 1] * (by - ay)
        if closing > 0:
            ago = max(ago, min(touch[DEPTHS + k] / closing, step))
    return ago


@njit(cache=True, nogil=True, error_model="numpy")
def _reach(first, second, radius, wall, touch, ago, arms):
    """Set arms [m] from both centres to each point, when they touched."""
    for k in range(int(touch[COUNT])):
        px, py = touch[POINTS + 2 * k], touch[POINTS + 2 * k + 1]
        if radius > 0:
            arms[k, 0], arms[k, 1] = -radius * touch[NORMAL], -radius * touch[NORMAL + 1]
        else:
            ax, ay = _velocity(first, px - first[0], py - first[1])
            bx, by = _velocity(second, px - second[0], py - second[1])
            share = 0.0 if wall else 0.5
            px -= ago * (share * ax + (1 - share) * bx)
            py -= ago * (share * ay + (1 - share) * by)
            arms[k, 0] = px - first[0] + ago * first[3]
            arms[k, 1] = py - first[1] + ago * first[4]
        arms[k, 2] = arms[k, 0] + first[0] - second[0] - ago * (first[3] - second[3])
        arms[k, 3] = arms[k, 1] + first[1] - second[1] - ago * (first[4] - second[4])


@njit(cache=True, nogil=True, error_model="numpy")
def _velocity(body, x, y):
    """Velocity [m/s] of a body's place (x, y) from its centre."""
    return body[3] - body[5] * y, body[4] + body[5] * x


@njit(cache=True, nogil=True, error_model="numpy")
def _speed(first, second, arm, n):
    """How fast the first moves along n as seen from the second, at one point [m/s]."""
    ax, ay = _velocity(first, arm[0], arm[1])
    bx, by = _velocity(second, arm[2], arm[3])
    return n[0] * (ax - bx) + n[1] * (ay - by)


@njit(cache=True, nogil=True, error_model="numpy")
def _yield(arm, other, n, masses):
    """Change of that speed at `arm` by an impulse of 1 N s along n at `other` [1/kg]."""
    a, b = arm[0] * n[1] - arm[1] * n[0], arm[2] * n[1] - arm[3] * n[0]
    c, d = other[0] * n[1] - other[1] * n[0], other[2] * n[1] - other[3] * n[0]
    return masses[0] + masses[2] + masses[1] * a * c + masses[3] * b * d


@njit(cache=True, nogil=True, error_model="numpy")
def _push(first, second, arm, n, impulse, masses, row):
    """Give both an impulse along n; row 3: of their velocities, row 0: of their places."""
    first[row] += impulse * masses[0] * n[0]
    first[row + 1] += impulse * masses[0] * n[1]
    first[row + 2] += impulse * masses[1] * (arm[0] * n[1] - arm[1] * n[0])
    second[row] -= impulse * masses[2] * n[0]
    second[row + 1] -= impulse * masses[2] * n[1]
    second[row + 2] -= impulse * masses[3] * (arm[2] * n[1] - arm[3] * n[0])


@njit(cache=True, nogil=True, error_model="numpy")
def _least(arms, n, masses, v0, v1, count):
    """Least impulses along n, at least 0, after which no point closes in."""
    h00 = _yield(arms[0], arms[0], n, masses)
    j0, j1 = max(0.0, -v0 / h00), 0.0
    if count == 1:
        return j0, j1
    h11, h01 = _yield(arms[1], arms[1], n, masses), _yield(arms[0], arms[1], n, masses)
    if v0 < 0 and v1 + h01 * j0 >= 0:
        return j0, j1
    j1 = max(0.0, -v1 / h11)
    if v1 < 0 and v0 + h01 * j1 >= 0:
        return 0.0, j1
    det = h00 * h11 - h01 * h01
    if det > RANK * h00 * h11:
        return max(0.0, (h01 * v1 - h11 * v0) / det), max(0.0, (h01 * v0 - h00 * v1) / det)
    return 0.5 * j0, 0.5 * j1
