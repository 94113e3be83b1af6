"""Conversion between the frames: plate_home (world-fixed), the moving plate, and the image.

The plate's corners in the image define a homography from plate_home to the image. For a calibrated
lens, the conversion also includes the lens distortion. The homography and the lens determine the
camera's pose.
"""

from __future__ import annotations

import numpy as np

from ..errors import RigError
from .rig import Rig

CORNER_PX = 1.0
"""Assumed error of a corner's coordinates in the image [px]. This error is typical of corners that
a user clicks by hand."""

PLACE_ERROR = 0.1
"""Maximum error of the camera's position due to corner errors of `CORNER_PX`, as a fraction of the
camera's height. The relative error of the parts' parallax is about as large."""


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
    """Express points of plate_home in the frame of the moving plate. This function is the inverse
    of `to_home`."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    rotation = np.array([[cos, -sin], [sin, cos]])
    return (np.asarray(point) - pose[:2]) @ rotation


def surface_velocity(pose: np.ndarray, twist: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the velocity of the plate's surface under points, equation (2) of the paper.

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
    """Return the homography (3, 3) from plate_home [m] to the image [px], from the image points of
    the plate's four corners.

    If the lens has distortion, the homography maps to the undistorted image.
    """
    corners_px = np.array(rig.camera.corners_px)
    if rig.camera.lens is not None and rig.camera.lens.bends:
        corners_px = rig.camera.lens.straighten(corners_px)
    return fit_homography(rig.plate.corners, corners_px)


def fit_homography(point: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the homography (3, 3) that maps four points (4, 2) to their image points (4, 2)."""
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
    """Return the image points (M, 2) [px] of points (M, 2) [m, plate_home], with distortion."""
    straight = project(homography(rig), point)
    lens = rig.camera.lens
    return straight if lens is None or not lens.bends else lens.bend(straight)


def row_delay(rig: Rig, point: np.ndarray) -> np.ndarray:
    """Return the exposure delay (M,) [s] of the image rows that show points (M, 2) [m, plate_home],
    relative to the middle row."""
    row = to_image(rig, point)[:, 1]
    return np.asarray(rig.camera.readout_s * (row / rig.camera.height_px - 0.5))


def part_radius_px(rig: Rig) -> float:
    """Return the radius in the image of a part in the middle of the plate [px]."""
    radius = rig.parts.radius_m
    right, left, up, down = to_image(rig, radius * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    (ax, ay), (bx, by) = right - left, up - down
    return float(np.sqrt(np.abs(ax * by - ay * bx)) / 2)


def camera_pose(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of plate_home in the camera frame, from the rig's corners and lens. See
    `home_pose`.

    Raises
    ------
    RigError
        If the lens is not calibrated.
    """
    lens = rig.camera.lens
    if lens is None:
        raise RigError("camera: focal_px and centre_px are missing, so the pose is unknown")
    return home_pose(homography(rig), lens.matrix)


def home_pose(image_from_home: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of plate_home in the camera frame (x right, y down, z forward).

    The homography is K [r1 r2 t] up to scale, with the first two columns r1, r2 of the rotation and
    the translation t. The result is the rigid pose nearest to the homography. If the corners are
    accurate to one pixel, the pose reproduces them to about one pixel.

    Parameters
    ----------
    image_from_home : (3, 3)
        Homography from plate_home [m] to the undistorted image [px].
    matrix : (3, 3)
        The camera matrix K [px].

    Returns
    -------
    rotation : (3, 3)
        Columns: axes of plate_home.
    translation : (3,)
        Origin of plate_home [m].
    """
    columns = np.linalg.solve(matrix, image_from_home)
    # choose the sign so that the origin is in front of the camera
    columns *= np.sign(columns[2, 2])
    left, size, right = np.linalg.svd(columns[:, :2], full_matrices=False)
    axes = left @ right
    rotation = np.column_stack([axes, np.cross(axes[:, 0], axes[:, 1])])
    return rotation, columns[:, 2] / size.mean()


def camera_position(rig: Rig) -> np.ndarray | None:
    """Return the camera's centre of projection (3,) [m, plate_home], z above the plate at rest.

    There are three cases:

    - The lens is calibrated (`focal_px`). The position is -R^T t, with R and t of `camera_pose`.
    - Only the camera's height z is known (`camera: height_m`). The principal point is assumed to be
      in the middle of the image. Let p be the point of the plate that is visible at the principal
      point, and let the third row of the homography be (h, 1), with h in 1/m. Points x with h x + 1
      = 0 have depth zero in the camera frame. These points form a line with the distance D = (h p +
      1) / norm(h) from p. A camera that is tilted by theta from straight above has D = z (tan theta
      + cot theta) = 2 z / sin(2 theta), and is above p - z tan(theta) h / norm(h). Without
      perspective, h = 0 and the camera is above p. Tilts of more than 45 degrees are treated as 45
      degrees.
    - Neither lens nor height is known. Square pixels and the same principal point are assumed. A
      least-squares solution of the two equations of `_estimate_focal_px` gives the focal length f,
      and the position follows as in the first case.

    Returns
    -------
    (3,) or None
        None if the perspective is too weak for the third case, that is, if errors of `CORNER_PX` in
        all coordinates of the corners change the position by more than the fraction `PLACE_ERROR`
        of the camera's height. Also None if the middle of the image shows no point of the plate's
        plane, or if a corner is outside the lens's field of view.
    """
    camera = rig.camera
    if camera.lens is not None:
        position = _camera_position(homography(rig), camera.lens.matrix)
        return position if np.all(np.isfinite(position)) else None
    corners, plate = np.array(camera.corners_px), rig.plate.corners
    middle = np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2])
    if camera.height_m is not None:
        return _position_from_height(fit_homography(plate, corners), middle, camera.height_m)
    place = _position_from_focal_length(plate, corners, middle)
    if place is None:
        return None
    square = 0.0
    for index in range(corners.size):
        moved = corners.copy()
        moved.flat[index] += CORNER_PX
        other = _position_from_focal_length(plate, moved, middle)
        square += np.inf if other is None else float(np.sum((other - place) ** 2))
    return place if np.sqrt(square) <= PLACE_ERROR * place[2] else None


def _camera_position(image_from_home: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    rotation, translation = home_pose(image_from_home, matrix)
    return np.asarray(-rotation.T @ translation)


def _position_from_height(
    image_from_home: np.ndarray, middle: np.ndarray, height: float
) -> np.ndarray | None:
    """Return the position (3,) of a camera with a known height above the plate [m], the second case
    of `camera_position`. None if there is no such position."""
    (p,) = project(np.linalg.inv(image_from_home), middle)
    slope = image_from_home[2, :2] / image_from_home[2, 2]
    ahead, size = float(slope @ p + 1), float(np.hypot(*slope))
    if ahead <= 0:
        return None
    tilt = 0.5 * np.arcsin(min(1.0, 2 * height * size / ahead))
    step = height * np.tan(tilt) * slope / size if size else np.zeros(2)
    return np.append(p - step, height)


def _position_from_focal_length(
    plate: np.ndarray, corners: np.ndarray, middle: np.ndarray
) -> np.ndarray | None:
    """Return the position (3,) of a camera with unknown height and focal length, the third case of
    `camera_position`. None if the homography does not determine the focal length."""
    view = fit_homography(plate, corners)
    focal = _estimate_focal_px(view, middle)
    if focal is None:
        return None
    matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    return _camera_position(view, matrix)


def _estimate_focal_px(image_from_home: np.ndarray, middle: np.ndarray) -> float | None:
    """Return the focal length f [px] of a camera with square pixels from its homography H (3, 3).
    None if the homography has no perspective.

    Let K = diag(f, f, 1) with the middle of the image as the origin. The first two columns of K^-1
    H are the plate's axes times a common scale. These columns are orthogonal, ax . ay + f^2 bx by =
    0, and have equal lengths, norm(ax)^2 - norm(ay)^2 + f^2 (bx^2 - by^2) = 0. ax and ay are the
    first two entries of these columns of H, and bx and by are their third entries (Zhang 2000,
    equations 3 and 4).
    """
    a = image_from_home[:2, :2] - np.outer(middle, image_from_home[2, :2])
    b = image_from_home[2, :2]
    flat = np.array([a[:, 0] @ a[:, 1], a[:, 0] @ a[:, 0] - a[:, 1] @ a[:, 1]])
    deep = np.array([b[0] * b[1], b[0] ** 2 - b[1] ** 2])
    square = -float(flat @ deep)
    return float(np.sqrt(square / (deep @ deep))) if square > 0 else None
