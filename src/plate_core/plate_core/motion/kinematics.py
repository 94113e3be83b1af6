"""Forward and inverse kinematics of the four motors and the plate.

Motor i pushes the plate at the point a_i along d_i. A flexure lets the motor's shaft move freely
perpendicular to d_i. Therefore the travel of the motor is exactly q_i = d_i . (o + (R(theta) - 1)
a_i), without linearisation. o is the position of the plate. Four motors move three coordinates. One
motor is redundant, so the travels of the four motors must fit one pose of the plate.
"""

from __future__ import annotations

import numpy as np

from ..errors import CycleError
from ..rig import Rig

CONSISTENCY_TOLERANCE = 5e-6
"""Maximum deviation of the four motor travels from the travels of a rigid plate [m]. A larger
deviation would bend the plate's suspension."""


def motor_state(
    rig: Rig, pose: np.ndarray, twist: np.ndarray, accel: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Travel, speed and acceleration of the motors for a motion of the plate.

    Parameters
    ----------
    pose, twist, accel : (n, 3)
        Motion of the plate in plate_home [m, m, rad], and its first and second derivative.

    Returns
    -------
    q, qd, qdd : (n, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of each motor.
    """
    point, direction = _motor_geometry(rig)
    theta, spin, spin_rate = pose[:, 2], twist[:, 2], accel[:, 2]
    along, across = _projections(point, direction, theta)
    q = pose[:, :2] @ direction.T + along - np.sum(direction * point, axis=1)
    qd = twist[:, :2] @ direction.T + spin[:, None] * across
    qdd = accel[:, :2] @ direction.T + spin_rate[:, None] * across - spin[:, None] ** 2 * along
    return q, qd, qdd


def plate_state(
    rig: Rig,
    q: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
    tolerance: float = CONSISTENCY_TOLERANCE,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion of the plate for a motion of the motors: the inverse of `motor_state`.

    Parameters
    ----------
    q, qd, qdd : (n, 4)
        Travel [m], speed [m/s] and acceleration [m/s2] of each motor.
    tolerance : float
        Maximum deviation of the motors' travels from those of a rigid plate [m]. Use inf for sensor
        measurements.

    Returns
    -------
    pose, twist, accel : (n, 3)
        Least-squares estimate of the plate's motion in plate_home [m, m, rad; per s; per s2].

    Raises
    ------
    CycleError
        If no pose of a rigid plate fits all four motors within `tolerance`.
    """
    point, direction = _motor_geometry(rig)
    home = np.sum(direction * point, axis=1)
    pose = np.zeros((len(q), 3))
    # Newton's method. Because theta is small, the result is exact up to rounding after three steps.
    # The fourth step is a reserve.
    for _ in range(4):
        along, across = _projections(point, direction, pose[:, 2])
        error = q - (pose[:, :2] @ direction.T + along - home)
        jacobian = _jacobian(direction, across)
        pose = (
            pose
            + np.linalg.solve(_normal_matrix(jacobian), _project(jacobian, error)[..., None])[
                ..., 0
            ]
        )
    along, across = _projections(point, direction, pose[:, 2])
    error = q - (pose[:, :2] @ direction.T + along - home)
    if error.size and np.max(np.abs(error)) > tolerance:
        sample, motor = np.unravel_index(np.argmax(np.abs(error)), error.shape)
        raise CycleError(
            f"position of {rig.motors[motor].name} at sample {sample} does not fit the other "
            f"motors: the deviation is {abs(error[sample, motor]) * 1e3:.4g} mm, allowed: "
            f"{tolerance * 1e3:g} mm"
        )
    jacobian = _jacobian(direction, across)
    normal = _normal_matrix(jacobian)
    twist = np.linalg.solve(normal, _project(jacobian, qd)[..., None])[..., 0]
    central = twist[:, 2:] ** 2 * along
    accel = np.linalg.solve(normal, _project(jacobian, qdd + central)[..., None])[..., 0]
    return pose, twist, accel


def _motor_geometry(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    point = np.array([motor.point for motor in rig.motors])
    direction = np.array([motor.direction for motor in rig.motors])
    return point, direction


def _projections(
    point: np.ndarray, direction: np.ndarray, theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return d_i . R a_i and d_i . J R a_i, both (n, 4) [m]. J rotates by 90 degrees."""
    cos, sin = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x = cos * point[:, 0] - sin * point[:, 1]
    y = sin * point[:, 0] + cos * point[:, 1]
    along = direction[:, 0] * x + direction[:, 1] * y
    across = -direction[:, 0] * y + direction[:, 1] * x
    return along, across


def _jacobian(direction: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Jacobian dq/dpose (n, 4, 3)."""
    translation = np.broadcast_to(direction, (len(across), 4, 2))
    return np.concatenate([translation, across[..., None]], axis=2)


def _normal_matrix(jacobian: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nik->njk", jacobian, jacobian)


def _project(jacobian: np.ndarray, value: np.ndarray) -> np.ndarray:
    return np.einsum("nij,ni->nj", jacobian, value)
