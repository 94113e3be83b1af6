"""The plate's markers: where plate_home is in the image, and where the plate is in plate_home."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from plate_core.rig import Fiducials, to_home

from .calibration import Calibration, Lens, calibrate_by_matrix
from .errors import CalibrationError
from .markers import find_markers
from .squares import square_corners

LEAST_SEEN = 2
"""Markers needed for a pose: with one alone the angle would hang on 3 cm."""

WORST_FIT_M = 1e-3
"""Largest root mean square deviation [m] of the markers' corners from where the rig file has them
that is believed: ten times what a good print and a sharp picture leave."""

FOLLOWED_FIT_M = 3e-4
"""The same where markers are followed by their edges alone: others must not be taken for them."""

QUIET_SHARE = 0.2
"""Border [sides] of bare plate around a marker, which is painted over with it."""


@dataclass(frozen=True, eq=False)
class PlatePose:
    """Where the plate is in one image.

    Attributes
    ----------
    pose : (3,)
        x, y [m], theta [rad], plate_home.
    error_m : float
        Root mean square deviation of the markers' corners [m].
    seen : tuple of int
        Numbers of the markers it is taken from.
    """

    pose: np.ndarray
    error_m: float
    seen: tuple[int, ...]


def find_home(
    image: np.ndarray, fiducials: Fiducials, lens: Lens | None = None
) -> tuple[Calibration, float]:
    """Find plate_home in an image of the plate at rest at home.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    fiducials : Fiducials
        Where the markers are on the plate.
    lens : Lens, optional
        To be taken into account.

    Returns
    -------
    Calibration
    float
        Root mean square deviation of the markers' corners from it [m].

    Raises
    ------
    CalibrationError
        If not all markers are seen, or they are not where the rig file has them.
    """
    found = find_markers(_grey(image), fiducials.dictionary)
    missing = [str(number) for number in fiducials.numbers if number not in found]
    if missing:
        raise CalibrationError(
            f"fiducials: {', '.join(missing)} not seen, allowed: all of "
            f"{', '.join(map(str, fiducials.numbers))} (cover none, let all be in the image)"
        )
    if lens is not None and not np.any(lens.distortion):
        lens = None
    corners_px = np.concatenate([found[number] for number in fiducials.numbers])
    straight = corners_px if lens is None else lens.straighten(corners_px)
    corners = fiducials.corners.reshape(-1, 2)
    matrix, _ = cv2.findHomography(corners, straight)
    if matrix is None:
        raise CalibrationError("fiducials: no homography, allowed: markers that span an area")
    calibration = calibrate_by_matrix(matrix, lens)
    error = _rms(calibration.to_home(corners_px) - corners)
    if error > WORST_FIT_M:
        raise CalibrationError(
            f"fiducials: corners are {1e3 * error:.2g} mm from where the rig file has them, "
            f"allowed: {1e3 * WORST_FIT_M:g} mm (are centre_m, side_m and the order right?)"
        )
    return calibration, error


def find_pose(
    image: np.ndarray,
    fiducials: Fiducials,
    calibration: Calibration,
    last: np.ndarray | None = None,
) -> PlatePose | None:
    """Find the plate's pose by the markers that are seen.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    fiducials : Fiducials
    calibration : Calibration
        Of plate_home.
    last : (3,), optional
        A pose [m, m, rad] that is not far, in pixels: there edges are looked for before markers
        are, which takes half the time.

    Returns
    -------
    PlatePose or None
        None if fewer than `LEAST_SEEN` markers are seen, or they contradict each other.
    """
    grey = _grey(image)
    if last is not None:
        around = calibration.to_image(to_home(last, fiducials.corners.reshape(-1, 2)))
        corners = square_corners(grey, around.reshape(-1, 4, 2))
        pose = _pose(fiducials, calibration, corners, FOLLOWED_FIT_M)
        if pose is not None:
            return pose
    found = find_markers(grey, fiducials.dictionary)
    unseen = np.full((4, 2), np.nan)
    corners = np.array([found.get(number, unseen) for number in fiducials.numbers])
    return _pose(fiducials, calibration, corners, WORST_FIT_M)


def fit_pose(point: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, float]:
    """Find the rigid motion in the plane with the least sum of squares.

    Parameters
    ----------
    point : (n, 2)
        Points [m, plate frame].
    seen : (n, 2)
        Where they are [m, plate_home].

    Returns
    -------
    (3,)
        Pose x, y [m], theta [rad].
    float
        Root mean square deviation [m].
    """
    a, b = point - point.mean(axis=0), seen - seen.mean(axis=0)
    theta = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = to_home(np.array([0.0, 0.0, theta]), point.mean(axis=0)[None])[0]
    pose = np.array([*(seen.mean(axis=0) - turned), theta])
    return pose, _rms(to_home(pose, point) - seen)


def hide(
    image: np.ndarray, fiducials: Fiducials, calibration: Calibration, pose: np.ndarray
) -> np.ndarray:
    """Return a copy of the image in which the markers have the brightness of the plate around.

    So that no part is seen in them. A part that lies on a marker is not seen either.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    fiducials : Fiducials
    calibration : Calibration
    pose : (3,)
        Of the plate [m, m, rad].
    """
    copy = np.array(image)
    for corners in fiducials.corners:
        middle = corners.mean(axis=0)
        rim = middle + (1 + 2 * QUIET_SHARE) * (corners - middle)
        rim_px = calibration.to_image(to_home(pose, rim))
        height, width = image.shape[:2]
        place = np.clip(np.rint(rim_px), 0, [width - 1, height - 1]).astype(np.int32)
        # The corners of the border are bare plate, unless a part lies there: so their median.
        shade = np.median(image[place[:, 1], place[:, 0]], axis=0)
        cv2.fillConvexPoly(copy, place, np.atleast_1d(shade).tolist())
    return copy


def _pose(
    fiducials: Fiducials, calibration: Calibration, corners_px: np.ndarray, worst: float
) -> PlatePose | None:
    """Return the pose by corners (n, 4, 2) [px], NaN where unseen, if it is believed."""
    rows = np.flatnonzero(np.all(np.isfinite(corners_px), axis=(1, 2)))
    if len(rows) < LEAST_SEEN:
        return None
    seen = calibration.to_home(corners_px[rows].reshape(-1, 2))
    pose, error = fit_pose(fiducials.corners[rows].reshape(-1, 2), seen)
    if error > worst:
        return None
    return PlatePose(pose, error, tuple(fiducials.numbers[i] for i in rows))


def _grey(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else np.ascontiguousarray(image[:, :, 1])


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
