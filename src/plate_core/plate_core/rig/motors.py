"""What force a motion takes of the four motors, and what acceleration they have force and heat for.

A motion of the plate z(t) = (x, y, theta) takes the forces f = B^+ (M z'' + C z' + K z): B carries
the motors' forces to the plate, M is its mass matrix, C and K are those of its flexures. The
pseudo-inverse shares the load so that the sum of squares, the heat, is least.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .suspension import mass_matrix

if TYPE_CHECKING:
    from .rig import Rig

PEAK_OVER_RMS = 1.6
"""A motor's peak force over its root mean square in the solvers' motions, about the least:
rotations have 1.6 to 2, sinusoids 2 to 2.5 (`test_weak_motors.py`)."""

TURN_STEPS = 400
"""Steps of angular acceleration between none and all that a corner may have."""


class Reach(NamedTuple):
    """The greatest acceleration, and what limits it, in words."""

    accel: float
    limit: str


def motor_levers(rig: Rig) -> np.ndarray:
    """Return B^T (4, 3) at home: what each motor's travel is of the pose x, y, theta [1, 1, m].

    So forces f (4,) push the plate with the wrench f B^T [N, N, N m].
    """
    (x, y), (ex, ey) = np.array([[m.point, m.direction] for m in rig.motors]).transpose(1, 2, 0)
    return np.column_stack([ex, ey, x * ey - y * ex])


def plate_mass(rig: Rig) -> np.ndarray:
    """Return M (3, 3): the suspension's, where the rig has one, or that of a uniform plate."""
    if rig.suspension is not None:
        return np.array(rig.suspension.mass)
    return np.array(mass_matrix(rig.plate.mass_kg, rig.plate.inertia_kgm2))


def motor_loads(rig: Rig) -> np.ndarray:
    """Compute `Rig.motor_loads`, which keeps it."""
    inverse = np.linalg.pinv(motor_levers(rig).T)
    suspension, none = rig.suspension, np.zeros((3, 3))
    stiffness = none if suspension is None else np.array(suspension.stiffness)
    damping = none if suspension is None else np.array(suspension.damping)
    return np.array([inverse @ each for each in (stiffness, damping, plate_mass(rig))])


def force_per_accel(rig: Rig) -> np.ndarray:
    """Return the most force (4,) [N] of each motor for 1 m/s2 at most of any point of the plate.

    Shift and turn together, in the direction that is worst for this motor. The flexures' share is
    left out: it goes with the travel.
    """
    load = rig.motor_loads[2]
    half = rig.plate.half
    turn = np.linspace(0, 1, TURN_STEPS + 1) / float(np.hypot(*half))  # r theta'' up to 1 m/s2
    return np.array([np.max(_support(np.abs(row), half, turn)) for row in load])


def _support(row: np.ndarray, half: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Greatest row . (ax, ay, turn) for each angular acceleration, corners within 1 m/s2.

    The shift is in the intersection of four unit discs about (+-p, +-q), p = turn half_y and
    q = turn half_x: an arc about (-p, -q) bounds its first quadrant.
    """
    q, p = np.minimum(turn * half[0], 1), np.minimum(turn * half[1], 1)
    first, last = np.arcsin(q), np.arccos(p)
    angle = np.clip(np.arctan2(row[1], row[0]), first, np.maximum(first, last))
    shift = row[0] * (np.cos(angle) - p) + row[1] * (np.sin(angle) - q)
    return np.asarray(np.maximum(shift, 0) + row[2] * turn)


def motor_reach(rig: Rig) -> Reach:
    """Return what the motors can give any point of the plate in any direction, continuously.

    The lesser of what their peak force gives; and of what heat allows them, in motions whose peak
    is `PEAK_OVER_RMS` times the root mean square.
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
    """Compute `Rig.reach`, which keeps it."""
    allowed = Reach(rig.limits.accel, "accel_mps2")
    return min(allowed, motor_reach(rig), key=lambda each: each.accel)
