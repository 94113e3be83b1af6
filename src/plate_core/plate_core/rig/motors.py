"""Motor forces of a plate motion, and the maximum acceleration within force and thermal limits.

A motion z(t) = (x, y, theta) of the plate needs the motor forces f = B^+ (M z'' + C z' + K z). B
maps motor forces to the wrench on the plate, M is the plate's mass matrix, and C and K are damping
and stiffness of its flexures. The pseudo-inverse B^+ minimises the sum of squared forces, and
therefore the heat.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .suspension import mass_matrix

if TYPE_CHECKING:
    from .rig import Rig

PEAK_OVER_RMS = 1.6
"""Approximate minimum ratio of a motor's peak force to its root mean square force in the solvers'
motions. For rotations, the ratio is 1.6 to 2. For sinusoids, it is 2 to 2.5
(`test_weak_motors.py`)."""

TURN_STEPS = 400
"""Number of steps in which `force_per_accel` varies the angular acceleration from 0 to its maximum,
at which the plate's corners have 1 m/s2."""


class Reach(NamedTuple):
    """Maximum acceleration [m/s2], and a text that names the limit."""

    accel: float
    limit: str


def motor_levers(rig: Rig) -> np.ndarray:
    """Return B^T (4, 3) at home, the derivative of each motor's travel by the pose x, y, theta
    [1, 1, m].

    Motor forces f (4,) therefore exert the wrench f B^T [N, N, N m] on the plate.
    """
    (x, y), (ex, ey) = np.array([[m.point, m.direction] for m in rig.motors]).transpose(1, 2, 0)
    return np.column_stack([ex, ey, x * ey - y * ex])


def plate_mass(rig: Rig) -> np.ndarray:
    """Return the mass matrix M (3, 3) of the suspension, or of a uniform plate if the rig has no
    suspension."""
    if rig.suspension is not None:
        return np.array(rig.suspension.mass)
    return np.array(mass_matrix(rig.plate.mass_kg, rig.plate.inertia_kgm2))


def motor_loads(rig: Rig) -> np.ndarray:
    """Compute `Rig.motor_loads`, which caches the result."""
    inverse = np.linalg.pinv(motor_levers(rig).T)
    suspension, none = rig.suspension, np.zeros((3, 3))
    stiffness = none if suspension is None else np.array(suspension.stiffness)
    damping = none if suspension is None else np.array(suspension.damping)
    return np.array([inverse @ each for each in (stiffness, damping, plate_mass(rig))])


def force_per_accel(rig: Rig) -> np.ndarray:
    """Return the maximum force (4,) [N] of each motor if no point of the plate exceeds 1 m/s2.

    Translation and rotation are combined in the worst direction for each motor. The forces of the
    flexures are omitted, because they depend on the travel and not on the acceleration.
    """
    load = rig.motor_loads[2]
    half = rig.plate.half
    turn = np.linspace(0, 1, TURN_STEPS + 1) / float(np.hypot(*half))  # r theta'' from 0 to 1 m/s2
    return np.array([np.max(_support(np.abs(row), half, turn)) for row in load])


def _support(row: np.ndarray, half: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Maximum of row . (ax, ay, turn) for each angular acceleration, with corners within 1 m/s2.

    The translation (ax, ay) is in the intersection of four unit discs about (+-p, +-q), with
    p = turn half_y and q = turn half_x. An arc about (-p, -q) bounds its first quadrant.
    """
    q, p = np.minimum(turn * half[0], 1), np.minimum(turn * half[1], 1)
    first, last = np.arcsin(q), np.arccos(p)
    angle = np.clip(np.arctan2(row[1], row[0]), first, np.maximum(first, last))
    shift = row[0] * (np.cos(angle) - p) + row[1] * (np.sin(angle) - q)
    return np.asarray(np.maximum(shift, 0) + row[2] * turn)


def motor_reach(rig: Rig) -> Reach:
    """Return the maximum acceleration that the motors can continuously give any point of the plate.

    It is the minimum of two limits. The peak force determines one limit. The continuous force
    determines the other, in motions whose peak force is `PEAK_OVER_RMS` times the root mean square
    force.
    """
    most, limits = force_per_accel(rig), rig.limits
    motor = rig.motors[int(np.argmax(most))].name
    peak, lasting = limits.force / most.max(), limits.continuous_force / most.max()
    return min(
        Reach(float(peak), f"force_n of {motor}"),
        Reach(float(PEAK_OVER_RMS * lasting), f"continuous_force_n of {motor}"),
        key=lambda each: each.accel,
    )


def reach(rig: Rig) -> Reach:
    """Compute `Rig.reach`, which caches the result."""
    allowed = Reach(rig.limits.accel, "accel_mps2")
    return min(allowed, motor_reach(rig), key=lambda each: each.accel)
