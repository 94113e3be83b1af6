"""The cycle map for searches: parts in blocks, and derivatives summed over a few steps each.

The same map as `stick_slip`, in single precision: places are rounded by less than 1e-7 m. Parts are
innermost, in blocks of `LANES`: loops of known length over neighbours in memory become vector
instructions, so a block of few parts takes as long as a full one. Steps are equal.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

LANES: int = _kernels.LANES
"""Parts in a block."""

STATE: int = _kernels.STATE
TRACE: int = _kernels.TRACE
"""Numbers of a block's state, and of its trace for each step: rows of `LANES`, see blocks.hpp."""


def blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float
) -> np.ndarray:
    """Return the state (b, `STATE`) of parts (M, 2), (M, 2), (M,); what is over is zero."""
    rows = np.column_stack([position, velocity, friction_accel * dt])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 5), np.float32)
    state[: len(rows)] = rows
    return np.ascontiguousarray(state.reshape(-1, LANES, 5).transpose(0, 2, 1)).reshape(-1, STATE)


def trace(
    state: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float, steps: np.ndarray
) -> None:
    """Move parts, in blocks (b, `STATE`), through samples (n, 3) of the plate's motion; write down
    in (n, b, `TRACE`) what `adjoint` needs."""
    _kernels.trace(state, pose, twist, dt, steps)


def adjoint(
    steps: np.ndarray, twist: np.ndarray, dt: float, coast: float,
    by_twist: np.ndarray,
) -> None:  # fmt: skip
    """Find the derivatives of where parts would be if they kept their last velocity for `coast` [s]
    after the motion; each is the sum over a bin of as many steps.

    Parameters
    ----------
    steps : (n, b, `TRACE`)
        Of `trace`.
    twist : (n, 3)
    dt, coast : float
    by_twist : (bins, b, 2, 3 LANES)
        Result: of x, then of y, of a block's parts, by the plate's twist along x, y and theta.
        Poses follow from it.
    """
    _kernels.adjoint(steps, twist, dt, coast, by_twist)
