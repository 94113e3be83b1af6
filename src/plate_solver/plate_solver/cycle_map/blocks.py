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
"""Size of the state of a block: number of rows of `LANES` numbers. blocks.hpp lists the rows."""


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state (b, `STATE`) of M parts. Unused places of the last block contain zeros."""
    rows = np.column_stack([position, velocity, friction_accel * dt])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 5), np.float32)
    state[: len(rows)] = rows
    return np.ascontiguousarray(state.reshape(-1, LANES, 5).transpose(0, 2, 1)).reshape(-1, STATE)
