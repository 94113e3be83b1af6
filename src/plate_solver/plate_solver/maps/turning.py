"""The cycle map of parts that turn: place, angle and how they depend on the plate's motion.

A part that slides at s and is turned at c relative to the plate feels, to first order in c, the
torque mu m g c J/s, where J is the mean square of its points' distances from its centre along the
slide: the second moment of its contact, so a bar is turned most where it slides along its length.
Force and torque share what friction gives as on an ellipse (Howe and Cutkosky 1996):

    q^2 = s^2 + J c^2,    force = mu m g s/q,    torque = mu m g J c/q

In each step friction changes velocity and spin by that times dt, but by no more than the slip. J is
that of the angle at the start: parts turn by a few degrees within a cycle. For discs, bars, nuts,
brackets and screws the turn of random cycles is right within a tenth, the place as well as without
turning.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

from .blocks import LANES

SLOW2 = 1e-4
"""Square of the slip [m2/s2] below which its direction counts less and less: where a part hardly
slides J is its mean over all directions."""

TINY = 1e-30
"""Keeps 0/0 away [m2/s2]."""

TURNING_STATE, TURNING_TRACE = 10 * LANES, 11 * LANES
"""Numbers of a block's state, and of its trace for each step."""

X, Y, VX, VY, BOUND, TURN, SPIN, SXX, SXY, SYY = (row * LANES for row in range(10))
"""Where a block's state has each quantity: as in `blocks`, then turn [rad], spin [rad/s] and second
moments [m2]."""

ARM_X, ARM_Y = 9 * LANES, 10 * LANES
"""Where its trace has the way from the plate to the part [m]; before that are the derivatives of
the changes of velocity and spin by slip and relative spin, row by row (3, 3)."""


def room_spread(spread: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return xx, xy, yy (M, 3) [m2] in plate_home of second moments (M, 2, 2) [m2] of parts' own
    frames, turned by angles (M,) [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    xx, xy, yy = spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]
    return np.column_stack(
        [
            c * c * xx - 2 * c * s * xy + s * s * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            s * s * xx + 2 * c * s * xy + c * c * yy,
        ]
    )


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def end_turning(
    position: np.ndarray, velocity: np.ndarray, spin: np.ndarray, spread: np.ndarray,
    pose: np.ndarray, twist: np.ndarray, dt: np.ndarray, friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return position (M, 2) [m], velocity (M, 2) [m/s], turn (M,) [rad] and spin (M,) [rad/s] of
    parts after the sampled motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Centres at the start [m], [m/s], plate_home.
    spin : (M,)
        At the start [rad/s].
    spread : (M, 3)
        Second moments xx, xy, yy of their contacts [m2], as they lie in plate_home.
    pose, twist : (n, 3)
        Plate at the middles of the steps, plate_home.
    dt : (n,)
        Lengths of the steps [s].
    friction_accel : (M,)
        mu g [m/s2].
    """
    p, v = position.copy(), velocity.copy()
    turn, c = np.zeros(len(p)), spin.copy()
    for i in range(len(p)):
        px, py, vx, vy, w, angle = p[i, 0], p[i, 1], v[i, 0], v[i, 1], c[i], 0.0
        xx, xy, yy = spread[i, 0], spread[i, 1], spread[i, 2]
        gyration2 = xx + yy
        for k in range(len(twist)):
            dw, h = twist[k, 2] - w, dt[k]
            dx = twist[k, 0] - twist[k, 2] * (py - pose[k, 1]) - vx
            dy = twist[k, 1] + twist[k, 2] * (px - pose[k, 0]) - vy
            square = dx * dx + dy * dy
            along = dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy
            j = (along + SLOW2 * 0.5 * gyration2) / (square + SLOW2)
            gain = friction_accel[i] * h
            gain = gain / (max(sqrt(square + j * dw * dw), gain) + TINY)
            vx += gain * dx
            vy += gain * dy
            w += gain * j / gyration2 * dw
            px += h * vx
            py += h * vy
            angle += h * w
        p[i, 0], p[i, 1], v[i, 0], v[i, 1], c[i], turn[i] = px, py, vx, vy, w, angle
    return p, v, turn, c


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def end_turning_gradient(
    position: np.ndarray, velocity: np.ndarray, spin: np.ndarray, spread: np.ndarray,
    pose: np.ndarray, twist: np.ndarray, dt: np.ndarray, friction_accel: np.ndarray,
    coast: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the derivatives of the end positions and turns, exact for the discrete map; or of
    where parts would be if they kept their last velocity and spin for `coast` [s].

    Returns
    -------
    by_pose : (2, n, 3 M)
        Last x of all parts, then y of all, then turn of all.
    by_twist : (3, n, 3 M)
    by_dt : (n, 3 M)
    """
    count, n = len(position), len(twist)
    by_twist, by_pose = np.empty((3, n, 3 * count)), np.empty((2, n, 3 * count))
    by_dt = np.empty((n, 3 * count))
    gain, arm, path = np.empty((n, 9)), np.empty((n, 2)), np.empty((n, 6))
    for i in range(count):
        px, py, vx, vy, w = position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], spin[i]
        xx, xy, yy = spread[i, 0], spread[i, 1], spread[i, 2]
        gyration2, accel = xx + yy, friction_accel[i]
        for k in range(n):
            own, h = gain[k], dt[k]
            rx, ry, dw = px - pose[k, 0], py - pose[k, 1], twist[k, 2] - w
            dx, dy = twist[k, 0] - twist[k, 2] * ry - vx, twist[k, 1] + twist[k, 2] * rx - vy
            square = dx * dx + dy * dy
            along = dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy
            j = (along + SLOW2 * 0.5 * gyration2) / (square + SLOW2)
            jx = 2 * (dx * xx + dy * xy - dx * j) / (square + SLOW2)
            jy = 2 * (dx * xy + dy * yy - dy * j) / (square + SLOW2)
            q = sqrt(square + j * dw * dw)
            slips = q > accel * h
            inverse = 1 / (max(q, accel * h) + TINY)
            g = accel * h * inverse
            down = g * inverse * inverse if slips else 0.0  # of the gain, by q^2/2
            bx, by = dx + 0.5 * dw * dw * jx, dy + 0.5 * dw * dw * jy  # of q^2/2
            lever, turns = j / gyration2, dw / gyration2
            own[0], own[1], own[2] = g - down * dx * bx, -down * dx * by, -down * dx * j * dw
            own[3], own[4], own[5] = -down * dy * bx, g - down * dy * by, -down * dy * j * dw
            own[6] = turns * (g * jx - down * j * bx)
            own[7] = turns * (g * jy - down * j * by)
            own[8] = lever * (g - down * dw * j * dw)
            arm[k, 0], arm[k, 1] = rx, ry
            force = accel * inverse if slips else 0.0
            path[k, 0], path[k, 1], path[k, 2] = force * dx, force * dy, force * lever * dw
            vx += g * dx
            vy += g * dy
            w += g * lever * dw
            path[k, 3], path[k, 4], path[k, 5] = vx, vy, w
            px += h * vx
            py += h * vy
        for axis in range(3):
            row = axis * count + i
            # Adjoints of place and angle (a), velocity and spin (b) at the end of step k.
            ax = 1.0 if axis == 0 else 0.0
            ay = 1.0 if axis == 1 else 0.0
            aw = 1.0 if axis == 2 else 0.0
            bx, by, bw = coast * ax, coast * ay, coast * aw
            for back in range(n):
                k = n - 1 - back
                own, h, s = gain[k], dt[k], twist[k, 2]
                bx += h * ax
                by += h * ay
                bw += h * aw
                by_dt[k, row] = (
                    ax * path[k, 3] + ay * path[k, 4] + aw * path[k, 5]
                    + bx * path[k, 0] + by * path[k, 1] + bw * path[k, 2]
                )  # fmt: skip
                gx = own[0] * bx + own[3] * by + own[6] * bw
                gy = own[1] * bx + own[4] * by + own[7] * bw
                gw = own[2] * bx + own[5] * by + own[8] * bw
                bx -= gx
                by -= gy
                bw -= gw
                ax += s * gy
                ay -= s * gx
                by_twist[0, k, row] = gx
                by_twist[1, k, row] = gy
                by_twist[2, k, row] = arm[k, 0] * gy - arm[k, 1] * gx + gw
                by_pose[0, k, row] = -s * gy
                by_pose[1, k, row] = s * gx
    return by_pose, by_twist, by_dt


def turning_blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float,
    spin: np.ndarray, spread: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the state (b, `TURNING_STATE`) of parts as `end_turning` takes them; parts that fill
    up a block lie still."""
    still = np.zeros(len(position))
    rows = np.column_stack([position, velocity, friction_accel * dt, still, spin, spread])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 10))
    state[:, SXX // LANES] = state[:, SYY // LANES] = 1.0
    state[: len(rows)] = rows
    blocks = state.reshape(-1, LANES, 10).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks).reshape(-1, TURNING_STATE)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def trace_turning(
    state: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float, steps: np.ndarray
) -> None:
    """Move parts, in blocks (b, `TURNING_STATE`), through samples (n, 3) of the plate's motion;
    write down in (n, b, `TURNING_TRACE`) what `adjoint_turning` needs."""
    for k in range(len(twist)):
        s = twist[k, 2]
        for block in range(len(state)):
            own, step = state[block], steps[k, block]
            for i in range(LANES):
                rx, ry = own[X + i] - pose[k, 0], own[Y + i] - pose[k, 1]
                dx, dy = twist[k, 0] - s * ry - own[VX + i], twist[k, 1] + s * rx - own[VY + i]
                dw = s - own[SPIN + i]
                xx, xy, yy = own[SXX + i], own[SXY + i], own[SYY + i]
                square = dx * dx + dy * dy
                by_gyration2, by_square = 1 / (xx + yy), 1 / (square + SLOW2)
                along = dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy
                j = (along + SLOW2 * 0.5 * (xx + yy)) * by_square
                jx, jy = 2 * (dx * xx + dy * xy - dx * j), 2 * (dx * xy + dy * yy - dy * j)
                jx, jy = jx * by_square, jy * by_square
                inverse = 1 / sqrt(square + j * dw * dw + TINY)
                g = own[BOUND + i] * inverse
                slips = 1.0 if g < 1 else 0.0
                g = min(g, 1.0)
                down = g * inverse * inverse * slips
                bx, by = dx + 0.5 * dw * dw * jx, dy + 0.5 * dw * dw * jy
                lever, turns = j * by_gyration2, dw * by_gyration2
                step[i], step[LANES + i] = g - down * dx * bx, -down * dx * by
                step[2 * LANES + i] = -down * dx * j * dw
                step[3 * LANES + i], step[4 * LANES + i] = -down * dy * bx, g - down * dy * by
                step[5 * LANES + i] = -down * dy * j * dw
                step[6 * LANES + i] = turns * (g * jx - down * j * bx)
                step[7 * LANES + i] = turns * (g * jy - down * j * by)
                step[8 * LANES + i] = lever * (g - down * dw * j * dw)
                step[ARM_X + i], step[ARM_Y + i] = rx, ry
                own[VX + i] += g * dx
                own[VY + i] += g * dy
                own[SPIN + i] += g * lever * dw
                own[X + i] += dt * own[VX + i]
                own[Y + i] += dt * own[VY + i]
                own[TURN + i] += dt * own[SPIN + i]


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def adjoint_turning(
    steps: np.ndarray, twist: np.ndarray, dt: float, coast: float,
    by_twist: np.ndarray, by_pose: np.ndarray,
) -> None:  # fmt: skip
    """Find the derivatives of places and turns as `blocks.adjoint` does of places.

    Parameters
    ----------
    steps : (n, b, `TURNING_TRACE`)
        Of `trace_turning`.
    twist : (n, 3)
    dt, coast : float
    by_twist, by_pose : (bins, b, 3, 3 LANES), (bins, b, 3, 2 LANES)
        Results: of x, of y, then of the turns of a block's parts, by the plate's x and y, and theta
        last.
    """
    by_twist[:], by_pose[:] = 0.0, 0.0
    blocks, each = steps.shape[1], len(twist) // len(by_twist)
    back = np.zeros((blocks, 3, 6 * LANES))  # adjoints of x, y, turn; vx, vy, spin
    for axis in range(3):
        back[:, axis, axis * LANES : (axis + 1) * LANES] = 1.0
        back[:, axis, (3 + axis) * LANES : (4 + axis) * LANES] = coast
    for k in range(len(twist) - 1, -1, -1):
        s = twist[k, 2]
        for block in range(blocks):
            step = steps[k, block]
            for axis in range(3):
                own = back[block, axis]
                on_twist = by_twist[k // each, block, axis]
                on_pose = by_pose[k // each, block, axis]
                for i in range(LANES):
                    cx = own[3 * LANES + i] + dt * own[i]
                    cy = own[4 * LANES + i] + dt * own[LANES + i]
                    cw = own[5 * LANES + i] + dt * own[2 * LANES + i]
                    gx = step[i] * cx + step[3 * LANES + i] * cy + step[6 * LANES + i] * cw
                    gy = step[LANES + i] * cx + step[4 * LANES + i] * cy + step[7 * LANES + i] * cw
                    gw = step[2 * LANES + i] * cx + step[5 * LANES + i] * cy
                    gw += step[8 * LANES + i] * cw
                    own[3 * LANES + i], own[4 * LANES + i] = cx - gx, cy - gy
                    own[5 * LANES + i] = cw - gw
                    own[i] += s * gy
                    own[LANES + i] -= s * gx
                    on_twist[i] += gx
                    on_twist[LANES + i] += gy
                    on_twist[2 * LANES + i] += step[ARM_X + i] * gy - step[ARM_Y + i] * gx + gw
                    on_pose[i] -= s * gy
                    on_pose[LANES + i] += s * gx
