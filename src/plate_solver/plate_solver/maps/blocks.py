"""The cycle map for searches: parts in blocks, and derivatives summed over a few steps each.

The same map as `stick_slip`. Parts are innermost, in blocks of `LANES`: loops of known length over
neighbours in memory become vector instructions, so a block of few parts takes as long as a full
one, and sixteen parts take half as long as there. Steps are equal.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

LANES = 16
"""Parts in a block."""

STATE, TRACE = 5 * LANES, 5 * LANES
"""Numbers of a block's state, and of its trace for each step."""

X, Y, VX, VY, BOUND = (row * LANES for row in range(5))
"""Where a block's state has each quantity: place [m], velocity [m/s], mu g dt [m/s]."""

XX, XY, YY, ARM_X, ARM_Y = (row * LANES for row in range(5))
"""Where a block's trace has each quantity: the derivative of the velocity's change by the slip, and
the way from the plate to the part [m]."""

TINY = 1e-30
"""Keeps 0/0 away [m2/s2]."""


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state (b, `STATE`) of parts (M, 2), (M, 2), (M,); what is over is zero."""
    rows = np.column_stack([position, velocity, friction_accel * dt])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 5))
    state[: len(rows)] = rows
    return np.ascontiguousarray(state.reshape(-1, LANES, 5).transpose(0, 2, 1)).reshape(-1, STATE)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def trace(
    state: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float, steps: np.ndarray
) -> None:
    """Move parts, in blocks (b, `STATE`), through samples (n, 3) of the plate's motion; write down
    in (n, b, `TRACE`) what `adjoint` needs."""
    for k in range(len(twist)):
        w = twist[k, 2]
        for block in range(len(state)):
            own, step = state[block], steps[k, block]
            for i in range(LANES):
                rx, ry = own[X + i] - pose[k, 0], own[Y + i] - pose[k, 1]
                dx = twist[k, 0] - w * ry - own[VX + i]
                dy = twist[k, 1] + w * rx - own[VY + i]
                inverse = 1 / sqrt(dx * dx + dy * dy + TINY)
                gain = own[BOUND + i] * inverse
                slips = 1.0 if gain < 1 else 0.0
                gain = min(gain, 1.0)
                a, b = dx * inverse * slips, dy * inverse * slips  # unit vector of a slip
                step[XX + i] = gain * (1 - a * a)
                step[XY + i] = -gain * a * b
                step[YY + i] = gain * (1 - b * b)
                step[ARM_X + i], step[ARM_Y + i] = rx, ry
                own[VX + i] += gain * dx
                own[VY + i] += gain * dy
                own[X + i] += dt * own[VX + i]
                own[Y + i] += dt * own[VY + i]


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def adjoint(
    steps: np.ndarray, twist: np.ndarray, dt: float, coast: float,
    by_twist: np.ndarray, by_pose: np.ndarray,
) -> None:  # fmt: skip
    """Find the derivatives of where parts would be if they kept their last velocity for `coast` [s]
    after the motion; each is the sum over a bin of as many steps.

    Parameters
    ----------
    steps : (n, b, `TRACE`)
        Of `trace`.
    twist : (n, 3)
    dt, coast : float
    by_twist, by_pose : (bins, b, 2, 3 LANES), (bins, b, 2, 2 LANES)
        Results: of x, then of y, of a block's parts, by the plate's x and y, and theta last.
    """
    by_twist[:], by_pose[:] = 0.0, 0.0
    blocks, each = steps.shape[1], len(twist) // len(by_twist)
    back = np.zeros((blocks, 2, 4 * LANES))
    for axis in range(2):
        back[:, axis, axis * LANES : (axis + 1) * LANES] = 1.0
        back[:, axis, (2 + axis) * LANES : (3 + axis) * LANES] = coast
    for k in range(len(twist) - 1, -1, -1):
        w = twist[k, 2]
        for block in range(blocks):
            step = steps[k, block]
            for axis in range(2):
                own = back[block, axis]
                on_twist = by_twist[k // each, block, axis]
                on_pose = by_pose[k // each, block, axis]
                for i in range(LANES):
                    cx, cy = own[VX + i] + dt * own[X + i], own[VY + i] + dt * own[Y + i]
                    gx = step[XX + i] * cx + step[XY + i] * cy
                    gy = step[XY + i] * cx + step[YY + i] * cy
                    own[VX + i], own[VY + i] = cx - gx, cy - gy
                    own[X + i] += w * gy
                    own[Y + i] -= w * gx
                    on_twist[i] += gx
                    on_twist[LANES + i] += gy
                    on_twist[2 * LANES + i] += step[ARM_X + i] * gy - step[ARM_Y + i] * gx
                    on_pose[i] -= w * gy
                    on_pose[LANES + i] += w * gx
