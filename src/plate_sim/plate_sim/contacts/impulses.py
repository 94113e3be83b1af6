"""Impulses between rigid parts that turn, and the end of their overlaps.

Where parts touch while they close in, the least impulses that end it (one or two points, solved
together) are raised by the restitution e: (1 + e) of them. That never adds energy, whatever the
shapes (the inelastic outcome is the nearest one in the measure of energy; the elastic one is as far
on the other side). Then each point rubs: an impulse of up to mu_c times the one across takes speed
off along the rims, and never turns it around. Impulses act on both parts in one place at one time,
so momentum and angular momentum are kept: that time is when the parts touched, within the step.
What overlap a crowd leaves is ended by moving its parts apart, without speed.

For discs alone all this is simpler: `discs`.
"""

from __future__ import annotations

from typing import NamedTuple

from plate_core.kernels import inner_kernel

from ..friction.step import SPIN, VX, VY, X, Y
from .manifold import COUNT, DEPTHS, NORMAL, POINTS

KEPT = 5e-6
"""Overlap [m] that is left: parts that part end it themselves, and no shift disturbs their angular
momentum."""

REBOUNDS = 20
"""Impulses of one collision, at most: friction beside the line of centres may call for more than
one."""

ROUNDING = 1e-12
"""A closing speed below this share of the first one is none."""

RANK = 1e-9
"""Two points whose impulses differ by a smaller share than this act as one."""


class Rules(NamedTuple):
    """Restitution and friction coefficient of contacts; whether parts touch each other at all, and
    whether there are walls."""

    restitution: float
    friction: float
    meets: bool
    walls: bool


class Inertia(NamedTuple):
    """1/mass [1/kg] and 1/inertia [1/(kg m2)] of two parts."""

    first: float
    first_turn: float
    second: float
    second_turn: float


@inner_kernel
def closes(state, i, j, contact):
    """Whether two parts close in at any point where they touch."""
    for k in range(int(contact[COUNT])):
        px, py = contact[POINTS + 2 * k], contact[POINTS + 2 * k + 1]
        ax, ay = _velocity(state, i, px - state[X, i], py - state[Y, i])
        bx, by = _velocity(state, j, px - state[X, j], py - state[Y, j])
        if contact[NORMAL] * (bx - ax) + contact[NORMAL + 1] * (by - ay) > 0:
            return True
    return False


@inner_kernel
def collide(state, bodies, i, j, contact, rules, step, arms):
    """Let two parts, or a part and a wall, collide where they touch, in place.

    Parameters
    ----------
    state, bodies : (6, P), (n,) of BODY
        As in `friction.step`; the state of a wall is the plate's pose and twist.
    i, j : int
        The parts, of which one at least is no disc, or a part that is none and a wall. A disc is
        the first; a wall is the second, and the last of all columns and bodies.
    contact : (9,)
        As in `manifold`.
    rules : Rules
    step : float
        [s].
    arms : (2, 4)
        Room to work in.
    """
    a, b = bodies[i], bodies[j]
    ago = _touched(state, i, j, contact, step)
    count, n = int(contact[COUNT]), (contact[NORMAL], contact[NORMAL + 1])
    _set_arms(state, i, j, a.radius, b.mass_inverse == 0, contact, ago, arms)
    inertia = Inertia(
        a.mass_inverse, a.mass_inverse / a.gyration2, b.mass_inverse, b.mass_inverse / b.gyration2
    )
    before = (
        state[VX, i], state[VY, i], state[SPIN, i], state[VX, j], state[VY, j], state[SPIN, j],
    )  # fmt: skip
    v0 = _speed(state, i, j, arms[0], n)
    v1 = _speed(state, i, j, arms[1], n) if count == 2 else 0.0
    _bounce(state, i, j, arms, n, inertia, count, v0, v1, rules)
    for d in range(3):
        state[X + d, i] += ago * (state[VX + d, i] - before[d])
        state[X + d, j] += ago * (state[VX + d, j] - before[3 + d])
    for k in range(count):
        moved = _speed(state, i, j, arms[k], n) - (v0 if k == 0 else v1)
        contact[DEPTHS + k] -= ago * moved
    for k in range(count):
        left = contact[DEPTHS + k] - KEPT
        if left > 0:
            give = left / _compliance(arms[k], arms[k], n, inertia)
            _push(state, i, j, arms[k], n, give, inertia, X)
            if count == 2 and k == 0:
                contact[DEPTHS + 1] -= give * _compliance(arms[0], arms[1], n, inertia)


@inner_kernel
def _bounce(state, i, j, arms, n, inertia, count, v0, v1, rules):
    """Give impulses until no point closes in; v0, v1 are the points' speeds [m/s] along n."""
    t, still = (-n[1], n[0]), ROUNDING * max(abs(v0), abs(v1))
    raised = 1 + rules.restitution
    for _ in range(REBOUNDS):
        if v0 >= -still and v1 >= -still:
            break
        j0, j1 = _least(arms, n, inertia, v0, v1, count)
        for k in range(count):
            _push(state, i, j, arms[k], n, raised * (j0 if k == 0 else j1), inertia, VX)
        for k in range(count):
            most = rules.friction * raised * (j0 if k == 0 else j1)
            if most > 0:
                drag = -_speed(state, i, j, arms[k], t) / _compliance(arms[k], arms[k], t, inertia)
                _push(state, i, j, arms[k], t, min(max(drag, -most), most), inertia, VX)
        # Friction may have turned them towards each other again
        v0 = _speed(state, i, j, arms[0], n)
        v1 = _speed(state, i, j, arms[1], n) if count == 2 else 0.0


@inner_kernel
def _touched(state, i, j, contact, step):
    """How long ago [s] two parts touched that close in at their present speeds."""
    ago = 0.0
    for k in range(int(contact[COUNT])):
        px, py = contact[POINTS + 2 * k], contact[POINTS + 2 * k + 1]
        ax, ay = _velocity(state, i, px - state[X, i], py - state[Y, i])
        bx, by = _velocity(state, j, px - state[X, j], py - state[Y, j])
        closing = contact[NORMAL] * (bx - ax) + contact[NORMAL + 1] * (by - ay)
        if closing > 0:
            ago = max(ago, min(contact[DEPTHS + k] / closing, step))
    return ago


@inner_kernel
def _set_arms(state, i, j, radius, wall, contact, ago, arms):
    """Set arms [m] from both centres to each point, when they touched."""
    for k in range(int(contact[COUNT])):
        if radius > 0:
            arms[k, 0], arms[k, 1] = -radius * contact[NORMAL], -radius * contact[NORMAL + 1]
        else:
            px, py = contact[POINTS + 2 * k], contact[POINTS + 2 * k + 1]
            ax, ay = _velocity(state, i, px - state[X, i], py - state[Y, i])
            bx, by = _velocity(state, j, px - state[X, j], py - state[Y, j])
            share = 0.0 if wall else 0.5
            px -= ago * (share * ax + (1 - share) * bx)
            py -= ago * (share * ay + (1 - share) * by)
            arms[k, 0] = px - state[X, i] + ago * state[VX, i]
            arms[k, 1] = py - state[Y, i] + ago * state[VY, i]
        wx, wy = state[VX, i] - state[VX, j], state[VY, i] - state[VY, j]
        arms[k, 2] = arms[k, 0] + state[X, i] - state[X, j] - ago * wx
        arms[k, 3] = arms[k, 1] + state[Y, i] - state[Y, j] - ago * wy


@inner_kernel
def _velocity(state, i, x, y):
    """Velocity [m/s] of a part's place (x, y) from its centre."""
    return state[VX, i] - state[SPIN, i] * y, state[VY, i] + state[SPIN, i] * x


@inner_kernel
def _speed(state, i, j, arm, n):
    """How fast the first moves along n as seen from the second, at one point [m/s]."""
    ax, ay = _velocity(state, i, arm[0], arm[1])
    bx, by = _velocity(state, j, arm[2], arm[3])
    return n[0] * (ax - bx) + n[1] * (ay - by)


@inner_kernel
def _compliance(arm, other, n, inertia):
    """Change of that speed at `arm` by an impulse of 1 N s along n at `other` [1/kg]."""
    a, b = arm[0] * n[1] - arm[1] * n[0], arm[2] * n[1] - arm[3] * n[0]
    c, d = other[0] * n[1] - other[1] * n[0], other[2] * n[1] - other[3] * n[0]
    return inertia.first + inertia.second + inertia.first_turn * a * c + inertia.second_turn * b * d


@inner_kernel
def _push(state, i, j, arm, n, impulse, inertia, row):
    """Give both an impulse along n; row VX: of their velocities, row X: of their places."""
    state[row, i] += impulse * inertia.first * n[0]
    state[row + 1, i] += impulse * inertia.first * n[1]
    state[row + 2, i] += impulse * inertia.first_turn * (arm[0] * n[1] - arm[1] * n[0])
    state[row, j] -= impulse * inertia.second * n[0]
    state[row + 1, j] -= impulse * inertia.second * n[1]
    state[row + 2, j] -= impulse * inertia.second_turn * (arm[2] * n[1] - arm[3] * n[0])


@inner_kernel
def _least(arms, n, inertia, v0, v1, count):
    """Least impulses along n, at least 0, after which no point closes in."""
    h00 = _compliance(arms[0], arms[0], n, inertia)
    j0, j1 = max(0.0, -v0 / h00), 0.0
    if count == 1:
        return j0, j1
    h11 = _compliance(arms[1], arms[1], n, inertia)
    h01 = _compliance(arms[0], arms[1], n, inertia)
    if v0 < 0 and v1 + h01 * j0 >= 0:
        return j0, j1
    j1 = max(0.0, -v1 / h11)
    if v1 < 0 and v0 + h01 * j1 >= 0:
        return 0.0, j1
    det = h00 * h11 - h01 * h01
    if det > RANK * h00 * h11:
        return max(0.0, (h01 * v1 - h11 * v0) / det), max(0.0, (h01 * v0 - h00 * v1) / det)
    return 0.5 * j0, 0.5 * j1
