"""The cycle map of parts without rotation: their state after one cycle, and its derivatives.

The plate's motion is sampled at the middles of steps, which may have different lengths. In each
step, friction changes the velocity v of a part by an implicit Coulomb step, which covers slip and
stick. With the velocity difference d = surface - v it is

    v += d min(1, mu g dt / length of d),    x += v dt.

The derivatives are exact for this discrete map. One backward sweep per output computes them. If
steps end where rotations end, the results are smooth functions of the durations of the rotations.
Searches need smooth results. The innermost loop runs over the parts, so that their square roots are
computed in parallel.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .. import _kernels

PREDICTION_STEP = 0.1e-3
"""Time step for the evaluation of a finished cycle [s]. The step may be small, because there is
only one evaluation per cycle."""


class Motion(Protocol):
    """Plate motion for a prediction: a `PlateCycle`, or a piece of one."""

    @property
    def period(self) -> float:
        """Length of the motion [s]."""

    def pose(self, t: np.ndarray) -> np.ndarray:
        """Return the plate's pose (n, 3) at times (n,) [s]."""

    def twist(self, t: np.ndarray) -> np.ndarray:
        """Return the twist (n, 3), which is the derivative of the pose, at times (n,) [s]."""


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
    """Return pose and twist (n, 3) at the middles of steps of about `PREDICTION_STEP`, and the step
    lengths (n,) [s]."""
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
        Pose and twist of the plate at the middles of the steps, plate_home.
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
    """Return the derivatives of the positions that `end_state` returns. The positions are
    extrapolated with the final velocity by `coast` [s].

    The last axis contains x of all parts, then y of all parts.

    Returns
    -------
    by_pose : (2, n, 2 M)
        Derivatives with respect to the plate's x and y. The positions do not depend on theta
        itself.
    by_twist : (3, n, 2 M)
    by_dt : (n, 2 M)
    """
    return _kernels.end_state_gradient(position, velocity, pose, twist, dt, friction_accel, coast)
