"""The frames: plate_home (fixed in the room), the moving plate, and the camera's image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import RigError

if TYPE_CHECKING:
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
    """Map plate_home [m] to the image [px]: (3, 3), from the images of the plate's four corners.

    If the lens distorts: to the straight image, see `to_image`.
    """
    corners_px = np.array(rig.camera.corners_px)
    if rig.camera.lens is not None and rig.camera.lens.bends:
        corners_px = rig.camera.lens.straighten(corners_px)
    return fit_homography(rig.plate.corners, corners_px)


def fit_homography(point: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the homography (3, 3) that takes four points (4, 2) to their images (4, 2)."""
    rows = []
    values = []
    for (x, y), (u, v) in zip(point, image, strict=True):
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


def to_image(rig: Rig, point: np.ndarray) -> np.ndarray:
    """Return where the camera sees points (M, 2) [m, plate_home]: (M, 2) [px]."""
    straight = project(homography(rig), point)
    lens = rig.camera.lens
    return straight if lens is None or not lens.bends else lens.bend(straight)


def row_delay(rig: Rig, point: np.ndarray) -> np.ndarray:
    """Return by how much later (M,) [s] than the image's middle row those rows are exposed that
    show points (M, 2) [m, plate_home]."""
    row = to_image(rig, point)[:, 1]
    return np.asarray(rig.camera.readout_s * (row / rig.camera.height_px - 0.5))


def part_radius_px(rig: Rig) -> float:
    """Return the radius of a part in the middle of the plate as the camera sees it [px]."""
    radius = rig.parts.radius_m
    right, left, up, down = to_image(rig, radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    (ax, ay), (bx, by) = right - left, up - down
    return float(np.sqrt(np.abs(ax * by - ay * bx)) / 2)


def camera_pose(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return where plate_home is in the camera's frame, by the rig's corners and lens: `home_pose`.

    Raises
    ------
    RigError
        If the rig knows no lens.
    """
    lens = rig.camera.lens
    if lens is None:
        raise RigError("camera: focal_px and centre_px are missing: its pose is not known")
    return home_pose(homography(rig), lens.matrix)


def home_pose(image_from_home: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where plate_home is in the camera's frame (x to the right, y down, z ahead).

    The rigid pose that is nearest to the homography: K [r1 r2 t] up to scale. Corners measured to
    a pixel fit it to about a pixel.

    Parameters
    ----------
    image_from_home : (3, 3)
        Homography from plate_home [m] to the straight image [px].
    matrix : (3, 3)
        The camera matrix K [px].

    Returns
    -------
    rotation : (3, 3)
        Its columns are the axes of plate_home.
    translation : (3,)
        Its origin [m].
    """
    columns = np.linalg.solve(matrix, image_from_home)
    columns *= np.sign(columns[2, 2])  # the origin is ahead of the camera
    left, size, right = np.linalg.svd(columns[:, :2], full_matrices=False)
    axes = left @ right
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    return rotation, columns[:, 2] / size.mean()
