"""Two discs that touch, and a disc at a wall: what `impulses` says of rigid parts, in closed form.

The impulse across goes through a disc's centre, so it turns no disc, and friction between the rims
changes no closing speed: one impulse across and one along the rims are all.
"""

from __future__ import annotations

from math import sqrt

from plate_core.kernels import inner_kernel

from ..friction.step import ANGLE, SPIN, VX, VY, X, Y
from .impulses import KEPT


@inner_kernel
def overlap(state, bodies, i, j):
    """How deep [m] two discs overlap; 0 if they do not."""
    dx, dy = state[X, i] - state[X, j], state[Y, i] - state[Y, j]
    size = bodies[i].radius + bodies[j].radius
    lack = size * size - dx * dx - dy * dy
    return lack / (size + sqrt(dx * dx + dy * dy)) if lack > 0 else 0.0


@inner_kernel
def collide_discs(state, bodies, i, j, rules, step):
    """Let two discs collide if they touch, in place; return how deep [m] they overlapped.

    Parameters
    ----------
    state, bodies : (6, P), (n,) of BODY
        As in `friction.step`.
    rules : impulses.Rules
    step : float
        [s].
    """
    dx, dy = state[X, i] - state[X, j], state[Y, i] - state[Y, j]
    ri, rj = bodies[i].radius, bodies[j].radius
    size, distance2 = ri + rj, dx * dx + dy * dy
    lack = size * size - distance2
    if lack <= 0:
        return 0.0
    wx, wy = state[VX, i] - state[VX, j], state[VY, i] - state[VY, j]
    closing, far, ago = -(wx * dx + wy * dy), sqrt(distance2), 0.0
    depth = lack / (size + far)
    if closing > 0:  # |d - ago w| = size: when they touched
        ago = lack / (closing + sqrt(closing * closing + (wx * wx + wy * wy) * lack))
        ago, far = (ago, size) if ago <= step else (step, 0.0)
        dx, dy = dx - ago * wx, dy - ago * wy
        far = far if far > 0 else sqrt(dx * dx + dy * dy)
    elif depth <= KEPT:
        return depth
    # Two centres in one point have no line; any direction will do.
    nx, ny = (dx / far, dy / far) if far > 0 else (1.0, 0.0)
    mi, mj = bodies[i].mass_inverse, bodies[j].mass_inverse
    left, light = depth - KEPT, mi + mj
    if closing > 0:
        gain = (1 + rules.restitution) * max(0.0, -(wx * nx + wy * ny))
        left -= ago * gain
        _push(state, i, mi * gain / light, nx, ny, ago)
        _push(state, j, -mj * gain / light, nx, ny, ago)
        if rules.friction > 0:
            arm = far - ri
            ti, tj = mi * ri / bodies[i].gyration2, mj * arm / bodies[j].gyration2
            along = wy * nx - wx * ny - ri * state[SPIN, i] - arm * state[SPIN, j]
            most = rules.friction * gain / light
            drag = min(max(-along / (light + ri * ti + arm * tj), -most), most)
            _push(state, i, mi * drag, -ny, nx, ago)
            _push(state, j, -mj * drag, -ny, nx, ago)
            _turn(state, i, -ti * drag, ago)
            _turn(state, j, -tj * drag, ago)
    if left > 0:
        left /= light
        state[X, i] += mi * left * nx
        state[Y, i] += mi * left * ny
        state[X, j] -= mj * left * nx
        state[Y, j] -= mj * left * ny
    return depth


@inner_kernel
def collide_with_wall(state, bodies, i, depth, nx, ny, rules, step):
    """Let a disc that is `depth` [m] in a wall, whose inward normal is n, collide with it.

    Other parameters are those of `collide_discs`; the last column of the state is the plate's pose
    and twist.
    """
    radius, left, wall = bodies[i].radius, depth - KEPT, state.shape[1] - 1
    rx, ry = state[X, i] - state[X, wall], state[Y, i] - state[Y, wall]
    wx, wy = state[VX, i] - state[VX, wall], state[VY, i] - state[VY, wall]
    turn, arm = state[SPIN, wall], radius - 0.5 * depth
    closing = -nx * (wx + turn * (ry - arm * ny)) - ny * (wy - turn * (rx - arm * nx))
    if closing > 0:
        ago = min(depth / closing, step)
        # The rim where and when they touched
        px, py = rx - ago * wx - radius * nx, ry - ago * wy - radius * ny
        wx, wy = wx + turn * py, wy - turn * px
        gain = (1 + rules.restitution) * max(0.0, -(wx * nx + wy * ny))
        left -= ago * gain
        _push(state, i, gain, nx, ny, ago)
        if rules.friction > 0:
            roll = radius / bodies[i].gyration2
            along = wy * nx - wx * ny - radius * state[SPIN, i]
            most = rules.friction * gain
            drag = min(max(-along / (1 + radius * roll), -most), most)
            _push(state, i, drag, -ny, nx, ago)
            _turn(state, i, -roll * drag, ago)
    if left > 0:
        state[X, i] += left * nx
        state[Y, i] += left * ny


@inner_kernel
def _push(state, i, speed, nx, ny, ago):
    """Change a part's velocity by `speed` [m/s] along n as if it were `ago` [s] since."""
    state[VX, i] += speed * nx
    state[VY, i] += speed * ny
    state[X, i] += ago * speed * nx
    state[Y, i] += ago * speed * ny


@inner_kernel
def _turn(state, i, spin, ago):
    """Change a part's spin [rad/s] as if it were `ago` [s] since."""
    state[SPIN, i] += spin
    state[ANGLE, i] += ago * spin
