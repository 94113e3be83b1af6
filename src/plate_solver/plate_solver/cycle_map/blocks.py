"""The version of the cycle map that searches use. This version processes parts in blocks, and sums
derivatives over groups of time steps.

The map is the same as in `stick_slip`, but in single precision and with equal steps. The rounding
error of a position is below 1e-7 m. The innermost loop runs over the `LANES` parts of a block and
is compiled to vector instructions. Therefore, a partly filled block needs as much time as a full
block.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

LANES: int = _kernels.LANES
"""Number of parts in a block."""

STATE: int = _kernels.STATE
"""Size of the state of a block, as a number of rows with `LANES` numbers each. blocks.hpp lists the
rows."""


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state of M parts as b blocks (b, `STATE`). Unused places of the last block contain
    zeros."""
    rows = np.column_stack([position, velocity, friction_accel * dt])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 5), np.float32)
    state[: len(rows)] = rows
    return np.ascontiguousarray(state.reshape(-1, LANES, 5).transpose(0, 2, 1)).reshape(-1, STATE)
