"""Fractions of a rig's limits that a motion of the plate uses, computed by independent equations of
motion.

The result is an independent check of the solver and the driver. Therefore this module shares only
the rig file and the motion with the solver and the driver. Points of the plate are complex numbers
x + i y. With the plate's pose (o, theta), a point a of the plate is at p = o + e^(i theta) a.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle, Rig

SAMPLES = 1000
"""Number of equally spaced samples per cycle."""

PIECE_SAMPLES = 8
"""Number of samples per piece between two knots. A piece can be shorter than the interval between
the equally spaced samples, because the velocity of the motion can change within a nanosecond."""

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Pose, twist and acceleration of the plate (n, 3) at n instants."""


def limit_fractions(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return the maximum fractions (4,) of stroke, speed, acceleration and force in one cycle."""
    motion, (point, direction) = _motion(cycle, _all_times(cycle)), _motors(rig)
    position, velocity, _ = _points(motion, point)
    values = [
        _components_along(direction, position - point) / rig.limits.stroke_m,
        _components_along(direction, velocity) / rig.limits.speed,
        corner_accels(rig, motion) / rig.limits.accel,
        motor_forces(rig, motion) / rig.limits.force,
    ]
    return np.array([np.max(np.abs(value)) for value in values])


def thermal_load(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return each motor's load (4,): mean(F^2) / F_continuous^2."""
    force = motor_forces(rig, _motion(cycle, np.linspace(0, cycle.period, SAMPLES)))[:-1]
    return np.asarray(np.mean(force**2, axis=0) / rig.limits.continuous_force**2)


def corner_accels(rig: Rig, motion: Motion) -> np.ndarray:
    """Return the accelerations (n, 4) of the plate's corners [m/s2], as complex numbers."""
    return _points(motion, _complex(rig.plate.corners))[2]


def motor_forces(rig: Rig, motion: Motion) -> np.ndarray:
    """Return the motor forces (n, 4) [N] of minimum norm for a motion.

    The forces F satisfy B F = w. Each column of B is a motor's force and torque about the centre of
    the plate at home. The wrench w is diag(m, m, I) accel for a uniform plate, with I = m (length^2
    + width^2) / 12. For a rig with a suspension, w = M accel + D twist + K pose with the mass M,
    damping D and stiffness K of the suspension.
    """
    pose, twist, accel = motion
    if rig.suspension is None:
        plate = rig.plate
        inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
        wrench = accel * [plate.mass_kg, plate.mass_kg, inertia]
    else:
        mass, damping, stiffness = (
            np.array(getattr(rig.suspension, name)) for name in ("mass", "damping", "stiffness")
        )
        wrench = accel @ mass + twist @ damping + pose @ stiffness
    point, direction = _motors(rig)
    pushes = np.array([direction.real, direction.imag, (point.conj() * direction).imag])
    return np.asarray(np.linalg.lstsq(pushes, wrench.T, rcond=None)[0].T)


def _all_times(cycle: PlateCycle) -> np.ndarray:
    """Return equally spaced times of a cycle, and `PIECE_SAMPLES` times of each piece [s]."""
    parts = np.arange(PIECE_SAMPLES) / PIECE_SAMPLES
    pieces = cycle.times[:-1, None] + np.diff(cycle.times)[:, None] * parts
    return np.concatenate([np.linspace(0, cycle.period, SAMPLES), pieces.ravel()])


def _motion(cycle: PlateCycle, t: np.ndarray) -> Motion:
    """Return the plate's motion at times (n,) [s]."""
    return cycle.pose(t), cycle.twist(t), cycle.accel(t)


def _motors(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (4,) [m] at which the motors push, and their directions (4,)."""
    return (
        _complex(np.array([motor.point for motor in rig.motors])),
        _complex(np.array([motor.direction for motor in rig.motors])),
    )


def _points(motion: Motion, points: np.ndarray) -> list[np.ndarray]:
    """Return position, velocity and acceleration (n, m) of points of the plate.

    `points` (m,) are the points at home. With r = e^(i theta) a and the angular velocity w:
    p = o + r, v = o' + i w r, a = o'' + (i w' - w^2) r.
    """
    pose, twist, accel = motion
    arm = np.exp(1j * pose[:, 2:]) * points
    spin, spin_rate = twist[:, 2:], accel[:, 2:]
    around = (arm, 1j * spin * arm, (1j * spin_rate - spin**2) * arm)
    return [
        _complex(centre)[:, None] + turned for centre, turned in zip(motion, around, strict=True)
    ]


def _complex(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2 or more) as x + i y."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def _components_along(direction: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the components of vectors (n, m) along unit vectors (m,)."""
    return np.asarray((direction.conj() * vectors).real)
