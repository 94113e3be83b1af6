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


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state of M parts as b blocks (b, 5 `LANES`), as in blocks.hpp. Unused places of
    the last block contain zeros."""
    return packed(np.column_stack([position, velocity, friction_accel * dt]), np.zeros(5))


def packed(rows: np.ndarray, unused: np.ndarray) -> np.ndarray:
    """Arrange rows (M, k) of numbers, one row per part, in b blocks (b, k `LANES`). Unused places
    of the last block contain the row `unused` (k,)."""
    state = np.tile(unused.astype(np.float32), (-(-len(rows) // LANES) * LANES, 1))
    state[: len(rows)] = rows
    blocks = state.reshape(-1, LANES, len(unused)).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks).reshape(-1, len(unused) * LANES)
