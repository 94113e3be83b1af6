"""The cycle map: where parts are after one cycle, and how that depends on the plate's motion.

The plate's motion is sampled at the middles of steps, equal or not. In each step friction pulls a
part's velocity towards that of the surface, by at most mu g dt (implicit Coulomb step: slip and
stick alike). The derivatives are exact for this discrete map: one backward sweep per output. Steps
may end where a rotation ends: so no sample is passed by a rotation's edge, and searches do not
stumble over one.

Parts are innermost: their square roots overlap.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .. import _kernels

PREDICTION_STEP = 0.1e-3
"""Step for predicting what a finished cycle does [s]: it is done once, so it may be fine."""


class Motion(Protocol):
    """What parts are predicted under: a `PlateCycle`, or a piece of one."""

    @property
    def period(self) -> float:
        """Length [s]."""

    def pose(self, t: np.ndarray) -> np.ndarray:
        """Return the plate's pose (n, 3) at times (n,) [s]."""

    def twist(self, t: np.ndarray) -> np.ndarray:
        """Return its derivative (n, 3)."""


def after(
    cycle: Motion,
    position: np.ndarray,
    velocity: np.ndarray,
    friction_accel: float | np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Predict the state (M, 2) [m], [m/s] of parts after a cycle, in steps of `PREDICTION_STEP`."""
    friction_accel = np.array(np.broadcast_to(friction_accel, len(position)), dtype=float)
    return end_state(position, velocity, *finely_sampled(cycle), friction_accel)


def finely_sampled(cycle: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pose and twist (n, 3) at the middles of steps of `PREDICTION_STEP`, and these (n,)."""
    steps = max(1, round(cycle.period / PREDICTION_STEP))
    t = (np.arange(steps) + 0.5) * (cycle.period / steps)
    return cycle.pose(t), cycle.twist(t), np.full(steps, cycle.period / steps)


def end_state(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the parts' position and velocity (M, 2) after the sampled motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Parts at the start [m], [m/s], plate_home.
    pose, twist : (n, 3)
        Plate at the middles of the steps, plate_home.
    dt : (n,)
        Lengths of the steps [s].
    friction_accel : (M,)
        mu g of each part [m/s2].
    """
    return _kernels.end_state(position, velocity, pose, twist, dt, friction_accel)


def end_state_gradient(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray, coast: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the derivatives of the positions of `end_state`: x of all parts, then y of all; or of
    where the parts would be if they kept their last velocity for `coast` [s].

    Returns
    -------
    by_pose : (2, n, 2 M)
        By the plate's x and y; the positions do not depend on theta itself.
    by_twist : (3, n, 2 M)
    by_dt : (n, 2 M)
    """
    return _kernels.end_state_gradient(position, velocity, pose, twist, dt, friction_accel, coast)
