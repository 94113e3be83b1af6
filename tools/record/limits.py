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


def limit_shares(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return the greatest shares (4,) of stroke, speed, acceleration and force in one cycle."""
    t = instants(cycle)
    point, way = _motors(rig)
    place, velocity, _ = _points(cycle, t, point)
    _, _, accel = _points(cycle, t, _complex(rig.plate.corners))
    most = [
        _along(way, place - point) / rig.limits.stroke_m,
        _along(way, velocity) / rig.limits.speed,
        accel / rig.limits.accel,
        motor_forces(rig, cycle, t) / rig.limits.force,
    ]
    return np.array([np.max(np.abs(share)) for share in most])


def thermal_load(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return each motor's mean square force (4,) over that of its continuous force."""
    force = motor_forces(rig, cycle, instants(cycle)[:-1])
    return np.asarray(np.mean(force**2, axis=0) / rig.limits.continuous_force**2)


def instants(cycle: PlateCycle) -> np.ndarray:
    """Return the times (SAMPLES,) [s] at which a cycle is judged, its start and end among them."""
    return np.linspace(0, cycle.period, SAMPLES)


def motor_forces(rig: Rig, cycle: PlateCycle, t: np.ndarray) -> np.ndarray:
    """Return the forces (n, 4) [N] of least squares that move the plate so: Newton and Euler at
    home, for a uniform plate or as the rig file tells its suspension."""
    if rig.suspension is None:
        plate = rig.plate
        inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
        wrench = cycle.accel(t) * [plate.mass_kg, plate.mass_kg, inertia]
    else:
        mass, damping, stiffness = (
            np.array(getattr(rig.suspension, name)) for name in ("mass", "damping", "stiffness")
        )
        wrench = cycle.accel(t) @ mass + cycle.twist(t) @ damping + cycle.pose(t) @ stiffness
    point, way = _motors(rig)
    pushes = np.array([way.real, way.imag, (point.conj() * way).imag])
    return np.asarray(np.linalg.lstsq(pushes, wrench.T, rcond=None)[0].T)


def _motors(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return where motors push (4,) [m] and their ways (4,)."""
    return (
        _complex(np.array([motor.point for motor in rig.motors])),
        _complex(np.array([motor.direction for motor in rig.motors])),
    )


def _points(cycle: PlateCycle, t: np.ndarray, at: np.ndarray) -> list[np.ndarray]:
    """Return place, velocity and acceleration (n, m) of points of the plate that rest at (m,)."""
    pose, twist, accel = cycle.pose(t), cycle.twist(t), cycle.accel(t)
    arm = np.exp(1j * pose[:, 2:]) * at
    spin, spin_rate = twist[:, 2:], accel[:, 2:]
    around = (arm, 1j * spin * arm, (1j * spin_rate - spin**2) * arm)
    return [
        _complex(centre)[:, None] + turned
        for centre, turned in zip((pose, twist, accel), around, strict=True)
    ]


def _complex(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2 or more) as x + i y."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def _along(way: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the parts of vectors (n, m) along unit vectors (m,)."""
    return np.asarray((way.conj() * vectors).real)
