"""What share of a rig's limits a motion of the plate takes: mechanics written out once more.

It judges the solver and the driver's guard, so nothing here is theirs but the facts of the rig file
and the motion. Points of the plate are complex numbers x + i y: a part of it that rests at a is at
p = o + e^(i theta) a.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle, Rig

SAMPLES = 1000
"""Instants of a cycle at which it is judged."""

Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Pose, twist and acceleration of the plate (n, 3) at n instants."""


def limit_shares(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return the greatest shares (4,) of stroke, speed, acceleration and force in one cycle."""
    motion, (point, way) = _motion(cycle), _motors(rig)
    place, velocity, _ = _points(motion, point)
    most = [
        _along(way, place - point) / rig.limits.stroke_m,
        _along(way, velocity) / rig.limits.speed,
        corner_accels(rig, motion) / rig.limits.accel,
        motor_forces(rig, motion) / rig.limits.force,
    ]
    return np.array([np.max(np.abs(share)) for share in most])


def thermal_load(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return each motor's mean square force (4,) over that of its continuous force."""
    force = motor_forces(rig, _motion(cycle))[:-1]
    return np.asarray(np.mean(force**2, axis=0) / rig.limits.continuous_force**2)


def corner_accels(rig: Rig, motion: Motion) -> np.ndarray:
    """Return the accelerations (n, 4) of the plate's corners [m/s2], as complex numbers."""
    return _points(motion, _complex(rig.plate.corners))[2]


def motor_forces(rig: Rig, motion: Motion) -> np.ndarray:
    """Return the forces (n, 4) [N] of least squares that move the plate so: Newton and Euler at
    home, for a uniform plate or as the rig file tells its suspension."""
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
    point, way = _motors(rig)
    pushes = np.array([way.real, way.imag, (point.conj() * way).imag])
    return np.asarray(np.linalg.lstsq(pushes, wrench.T, rcond=None)[0].T)


def _motion(cycle: PlateCycle) -> Motion:
    """Return how the plate moves at the instants at which it is judged: start and end among
    them."""
    t = np.linspace(0, cycle.period, SAMPLES)
    return cycle.pose(t), cycle.twist(t), cycle.accel(t)


def _motors(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return where motors push (4,) [m] and their ways (4,)."""
    return (
        _complex(np.array([motor.point for motor in rig.motors])),
        _complex(np.array([motor.direction for motor in rig.motors])),
    )


def _points(motion: Motion, at: np.ndarray) -> list[np.ndarray]:
    """Return place, velocity and acceleration (n, m) of points of the plate that rest at (m,)."""
    pose, twist, accel = motion
    arm = np.exp(1j * pose[:, 2:]) * at
    spin, spin_rate = twist[:, 2:], accel[:, 2:]
    around = (arm, 1j * spin * arm, (1j * spin_rate - spin**2) * arm)
    return [
        _complex(centre)[:, None] + turned for centre, turned in zip(motion, around, strict=True)
    ]


def _complex(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2 or more) as x + i y."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def _along(way: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the parts of vectors (n, m) along unit vectors (m,)."""
    return np.asarray((way.conj() * vectors).real)
