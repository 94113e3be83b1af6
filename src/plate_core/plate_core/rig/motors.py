"""Motor forces of a plate motion, and the maximum acceleration within force and thermal limits.

A motion z(t) = (x, y, theta) of the plate needs the motor forces f = B^+ (M z'' + C z' + K z). B
maps motor forces to the wrench on the plate, M is the plate's mass matrix, and C and K are the
damping and stiffness matrices of its flexures. The pseudo-inverse B^+ minimises the sum of the
squared forces, and therefore the heat.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .sections import Limits, Motor

PEAK_OVER_RMS = 1.6
"""Approximate minimum ratio of a motor's peak force to its root mean square force in the solvers'
motions. For rotations, the ratio is 1.6 to 2. For sinusoids, the ratio is 2 to 2.5
(`test_weak_motors.py`)."""

ANGULAR_STEPS = 400
"""Number of steps in which `force_per_accel` varies the angular acceleration from 0 to its maximum.
At the maximum, the rotation alone accelerates the plate's corners by 1 m/s2."""


class Reach(NamedTuple):
    """Maximum acceleration [m/s2], and a text that names the limit that determines it."""

    accel: float
    limit: str


def compute_motor_levers(motors: Sequence[Motor]) -> np.ndarray:
    """Return B^T (4, 3) at home: the derivative of each motor's travel with respect to the pose x,
    y, theta [1, 1, m].

    Motor forces f (4,) exert the wrench f B^T [N, N, N m] on the plate.
    """
    (x, y), (ex, ey) = np.array([[m.point, m.direction] for m in motors]).transpose(1, 2, 0)
    return np.column_stack([ex, ey, x * ey - y * ex])


def compute_motor_loads(
    levers: np.ndarray, stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray
) -> np.ndarray:
    """Return the matrices B^+ K, B^+ C and B^+ M (3, 4, 3) from pose, twist and acceleration of the
    plate to motor forces [N].

    `levers` is B^T (4, 3). Stiffness K, damping C and mass M are (3, 3).
    """
    inverse = np.linalg.pinv(levers.T)
    return np.array([inverse @ matrix for matrix in (stiffness, damping, mass)])


def force_per_accel(load: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the maximum force (4,) [N] of each motor for all motions of the plate in which no
    point is accelerated by more than 1 m/s2.

    Translation and rotation are combined in the worst direction for each motor. The forces of the
    flexures are omitted, because they depend on the travel and not on the acceleration.

    Parameters
    ----------
    load : (4, 3)
        Matrix B^+ M from acceleration of the plate to motor forces [N].
    half : (2,)
        Half sides of the plate [m].
    """
    # angular acceleration, so that the distance r of a corner times `angular` is from 0 to 1 m/s2
    angular = np.linspace(0, 1, ANGULAR_STEPS + 1) / float(np.hypot(*half))
    return np.array([np.max(_max_force(np.abs(row), half, angular)) for row in load])


def _max_force(row: np.ndarray, half: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """Maximum of row . (ax, ay, turn) for each angular acceleration `angular`.

    The acceleration of each corner must not exceed 1 m/s2. The translation (ax, ay) is therefore in
    the intersection of four unit discs about (+-p, +-q), with p = turn half_y and q = turn half_x.
    In the first quadrant, an arc about (-p, -q) bounds this intersection.
    """
    q, p = np.minimum(angular * half[0], 1), np.minimum(angular * half[1], 1)
    first, last = np.arcsin(q), np.arccos(p)
    angle = np.clip(np.arctan2(row[1], row[0]), first, np.maximum(first, last))
    shift = row[0] * (np.cos(angle) - p) + row[1] * (np.sin(angle) - q)
    return np.asarray(np.maximum(shift, 0) + row[2] * angular)


def compute_reach(
    motors: Sequence[Motor], load: np.ndarray, half: np.ndarray, limits: Limits
) -> Reach:
    """Return the maximum acceleration that the motors can continuously give any point of the plate.

    The result is the minimum of two limits. The peak force determines one limit. The continuous
    force determines the other limit, for motions whose peak force is `PEAK_OVER_RMS` times the root
    mean square force. `load` and `half` are the same as in `force_per_accel`.
    """
    max_force = force_per_accel(load, half)
    motor = motors[int(np.argmax(max_force))].name
    peak, lasting = limits.force / max_force.max(), limits.continuous_force / max_force.max()
    return min(
        Reach(float(peak), f"force_n of {motor}"),
        Reach(float(PEAK_OVER_RMS * lasting), f"continuous_force_n of {motor}"),
        key=lambda each: each.accel,
    )
