"""The frames: plate_home (fixed in the room), the moving plate, and the camera's image."""

from __future__ import annotations

import numpy as np

from .rig import Rig


def to_home(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Express points of the moving plate in plate_home.

    Parameters
    ----------
    pose : (3,)
        x, y [m], theta [rad] of the plate in plate_home.
    point : (M, 2)
        Points [m], plate frame.

    Returns
    -------
    (M, 2)
        The same points [m], plate_home.
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    rotation = np.array([[cos, -sin], [sin, cos]])
    return np.asarray(point) @ rotation.T + pose[:2]


def to_plate(pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Express points of plate_home in the moving plate: the inverse of `to_home`."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    rotation = np.array([[cos, -sin], [sin, cos]])
    return (np.asarray(point) - pose[:2]) @ rotation


def surface_velocity(pose: np.ndarray, twist: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Velocity of the plate's surface under points, equation (2) of the paper.

    Parameters
    ----------
    pose, twist : (..., 3)
        Pose [m, m, rad] and twist [m/s, m/s, rad/s] of the plate in plate_home.
    point : (..., 2)
        Points [m], plate_home.

    Returns
    -------
    (..., 2)
        Velocity [m/s], plate_home.
    """
    arm = point - pose[..., :2]
    spin = twist[..., 2]
    return np.stack(
        [twist[..., 0] - spin * arm[..., 1], twist[..., 1] + spin * arm[..., 0]], axis=-1
    )


def homography(rig: Rig) -> np.ndarray:
    """Map plate_home [m] to the image [px]: (3, 3), from the images of the plate's four corners."""
    rows = []
    values = []
    for (x, y), (u, v) in zip(rig.plate.corners, rig.camera.corners_px, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
        values += [u, v]
    solution = np.linalg.solve(np.array(rows), np.array(values))
    return np.append(solution, 1.0).reshape(3, 3)


def project(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Apply a homography (3, 3) to points (M, 2)."""
    point = np.asarray(point, dtype=float).reshape(-1, 2)
    mapped = point @ matrix[:, :2].T + matrix[:, 2]
    return mapped[:, :2] / mapped[:, 2:]
