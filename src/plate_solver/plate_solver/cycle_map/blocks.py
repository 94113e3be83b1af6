"""The cycle map for searches. This version processes parts in blocks and sums derivatives over bins
of steps.

The map is the same as in `stick_slip`, but in single precision and with equal steps. The rounding
error of a position is below 1e-7 m. The innermost loop runs over the `LANES` parts of a block and
compiles to vector instructions. Therefore a partly filled block takes as long as a full one.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

LANES: int = _kernels.LANES
"""Number of parts in a block."""

STATE: int = _kernels.STATE
TRACE: int = _kernels.TRACE
"""Size of a block's state, and of its trace per step, in rows of `LANES`: see blocks.hpp."""


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state (b, `STATE`) of M parts. Unused places of the last block contain zeros."""
    rows = np.column_stack([position, velocity, friction_accel * dt])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 5), np.float32)
    state[: len(rows)] = rows
    return np.ascontiguousarray(state.reshape(-1, LANES, 5).transpose(0, 2, 1)).reshape(-1, STATE)


def trace(
    state: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float, steps: np.ndarray
) -> None:
    """Integrate parts, in blocks (b, `STATE`), over samples (n, 3) of the plate's motion.

    The state is updated in place. The data for `adjoint` is written to `steps` (n, b, `TRACE`).
    """
    _kernels.trace(state, pose, twist, dt, steps)


def adjoint(
    steps: np.ndarray, twist: np.ndarray, dt: float, coast: float,
    by_twist: np.ndarray,
) -> None:  # fmt: skip
    """Compute the derivatives of the final positions. The positions are extrapolated with the final
    velocity by `coast` [s].

    Each derivative is the sum over the n/bins steps of a bin.

    Parameters
    ----------
    steps : (n, b, `TRACE`)
        Output of `trace`.
    twist : (n, 3)
    dt, coast : float
    by_twist : (bins, b, 2, 3 LANES)
        Output: derivatives of x, then of y, of a block's parts with respect to the plate's twist
        along x, y and theta. The pose is the integral of the twist.
    """
    _kernels.adjoint(steps, twist, dt, coast, by_twist)
