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

import numpy as np

from .. import _kernels
from .blocks import LANES

TURNING_STATE: int = _kernels.TURNING_STATE
TURNING_TRACE: int = _kernels.TURNING_TRACE
"""Numbers of a block's state, and of its trace for each step: rows of `LANES`, see turning.hpp."""


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
    return _kernels.end_turning(position, velocity, spin, spread, pose, twist, dt, friction_accel)


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
    return _kernels.end_turning_gradient(
        position, velocity, spin, spread, pose, twist, dt, friction_accel, coast
    )


def turning_blocks_of(
    position: np.ndarray, velocity: np.ndarray, friction_accel: np.ndarray, dt: float,
    spin: np.ndarray, spread: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return the state (b, `TURNING_STATE`) of parts as `end_turning` takes them; parts that fill
    up a block lie still."""
    still = np.zeros(len(position))
    rows = np.column_stack([position, velocity, friction_accel * dt, still, spin, spread])
    state = np.zeros((-(-len(rows) // LANES) * LANES, 10), np.float32)
    state[:, 7] = state[:, 9] = 1.0  # second moments xx and yy
    state[: len(rows)] = rows
    blocks = state.reshape(-1, LANES, 10).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks).reshape(-1, TURNING_STATE)


def trace_turning(
    state: np.ndarray, pose: np.ndarray, twist: np.ndarray, dt: float, steps: np.ndarray
) -> None:
    """Move parts, in blocks (b, `TURNING_STATE`), through samples (n, 3) of the plate's motion;
    write down in (n, b, `TURNING_TRACE`) what `adjoint_turning` needs."""
    _kernels.trace_turning(state, pose, twist, dt, steps)


def adjoint_turning(
    steps: np.ndarray, twist: np.ndarray, dt: float, coast: float,
    by_twist: np.ndarray,
) -> None:  # fmt: skip
    """Find the derivatives of places and turns as `blocks.adjoint` does of places.

    Parameters
    ----------
    steps : (n, b, `TURNING_TRACE`)
        Of `trace_turning`.
    twist : (n, 3)
    dt, coast : float
    by_twist : (bins, b, 3, 3 LANES)
        Result: of x, of y, then of the turns of a block's parts, by the plate's twist along x, y
        and theta. Poses follow from it.
    """
    _kernels.adjoint_turning(steps, twist, dt, coast, by_twist)
