"""The cycle map of parts that do not rotate. The map computes the state of the parts after one
cycle, and the derivatives of this state.

The plate's motion is sampled at the middles of time steps, which may have different lengths dt. Let
x be the position of a part, v its velocity, and d the velocity of the surface under the part minus
v. In each step, Coulomb friction changes v and x implicitly, for slip and for stick:

    v += d min(1, mu g dt / length of d),    x += v dt.

The derivatives are exact for this discrete map. The derivatives are computed by one backward pass
over the steps for each output. If time steps end at the ends of rotations, the results are smooth
functions of the durations of the rotations. Searches need smooth results. The innermost loop runs
over the parts, so that the square roots of several parts are computed in parallel.

The kernels contain this rule several times: with and without derivatives, in single and in double
precision, and for rotating parts. The forms are equal up to rounding. One common form would be
slower where derivatives are not required, and would change the last bits of all results.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .. import _kernels

PREDICTION_STEP = 0.1e-3
"""Time step for the evaluation of a finished cycle [s]. The step may be small, because there is
only one evaluation per cycle."""


class Motion(Protocol):
    """Plate motion for a prediction. The motion is a `PlateCycle`, or a section of a cycle."""

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
    """Predict the positions (M, 2) [m] and velocities (M, 2) [m/s] of parts after a cycle, with
    time steps of `PREDICTION_STEP`."""
    friction_accel = np.array(np.broadcast_to(friction_accel, len(position)), dtype=float)
    return end_state(position, velocity, *finely_sampled(cycle), friction_accel)


def finely_sampled(cycle: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample a motion at the middles of time steps of about `PREDICTION_STEP`. Return pose and
    twist (n, 3), and the lengths of the steps (n,) [s]."""
    steps = max(1, round(cycle.period / PREDICTION_STEP))
    t = (np.arange(steps) + 0.5) * (cycle.period / steps)
    return cycle.pose(t), cycle.twist(t), np.full(steps, cycle.period / steps)


def end_state(
    position: np.ndarray, velocity: np.ndarray, pose: np.ndarray, twist: np.ndarray,
    dt: np.ndarray, friction_accel: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the positions and velocities of the parts (M, 2) after the sampled motion.

    Parameters
    ----------
    position, velocity : (M, 2)
        Positions [m] and velocities [m/s] of the parts at the start, in plate_home.
    pose, twist : (n, 3)
        Pose [m, m, rad] and twist [m/s, m/s, rad/s] of the plate at the middles of the steps, in
        plate_home.
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
    """Return the derivatives of the positions that `end_state` returns. The positions are first
    extrapolated by the time `coast` [s] with the final velocities.

    The last axis contains x of all parts, then y of all parts.

    Returns
    -------
    by_pose : (2, n, 2 M)
        Derivatives with respect to the plate's x and y. The positions do not depend on the angle
        theta, but only on its rate.
    by_twist : (3, n, 2 M)
    by_dt : (n, 2 M)
    """
    return _kernels.end_state_gradient(position, velocity, pose, twist, dt, friction_accel, coast)
