"""The location of plate_home in the image, and the pose of the plate in plate_home. Markers on the
plate determine both.

plate_home is located once, by a homography from the corners of all markers (`find_home`). The
plate's pose is determined in every image, by a rigid least-squares fit (`find_pose`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core import Rig
from plate_core.rig import Fiducials, project, to_home

from ..camera.encodings import grey_levels
from ..camera.lens import Calibration, Lens, calibrate_by_matrix, rig_lens
from ..camera.markers import find_markers, square_corners
from ..errors import CalibrationError

MIN_SEEN = 2
"""Minimum number of detected markers for the measurement of a pose. With a single marker, the angle
would be inaccurate, because a marker is only 3 cm long."""

WORST_FIT_M = 1e-3
"""Maximum root mean square deviation of the markers' corners from their places in the rig file [m].
This maximum is ten times the deviation of a good print in a sharp picture."""

FOLLOWED_FIT_M = 3e-4
"""Maximum root mean square deviation of the markers' corners from their places in the rig file, if
the patterns of the markers are not read [m]. This maximum is smaller than `WORST_FIT_M`, so that
other objects are not mistaken for markers."""

QUIET_ZONE = 0.2
"""Width of the border around a marker that is painted over together with the marker, relative to
the marker's side [-]."""

MOVED_M = 5e-4
"""Displacement of a corner of the plate above which the plate's region of the image (`Region`) is
computed again [m]. In the default rig, this displacement is half a pixel. Smaller displacements are
ignored, because this computation takes longer than the detection of the parts."""

AWAY_M = 2e-3
"""Maximum distance of the plate from home without a warning [m]."""


@dataclass(frozen=True, eq=False)
class PlateLocation:
    """Location of a plate with markers.

    Attributes
    ----------
    rig : Rig
        Rig with fiducials.
    lens : Lens, optional
        Lens of camera_info; None: the lens of the rig file.
    home : Calibration or None
        Calibration from the first image that showed all markers; None before this image.
    pose : (3,) or None
        x, y [m], theta [rad] in plate_home in the last image; None if too few markers were visible.
    region_pose : (3,) or None
        Pose for which the plate's region of the image (`Region`) was last computed. None if the
        region was not computed yet.
    """

    rig: Rig
    lens: Lens | None = None
    home: Calibration | None = None
    pose: np.ndarray | None = None
    region_pose: np.ndarray | None = None

    @property
    def problem(self) -> str | None:
        """Warning for the user, or None."""
        if self.pose is None:
            return "the plate's markers are not detected; the plate's last position is used"
        distance = float(np.hypot(*self.pose[:2]))
        if distance > AWAY_M:
            return (
                f"distance of the plate from home is {1e3 * distance:.1f} mm when the image is "
                f"taken, allowed: up to {1e3 * AWAY_M:g} mm; check that the camera is triggered "
                "at the cycle's start. If the camera was moved, call the service reset"
            )
        return None


def locate_plate(location: PlateLocation, image: np.ndarray) -> tuple[PlateLocation, np.ndarray]:
    """Locate the plate in an image (H, W) or (H, W, 3) uint8, before the detection of parts.

    Return the new location, and the image without the markers, because the markers could be
    mistaken for parts. `region_pose` of the new location changes if a new region is required.

    Raises
    ------
    CalibrationError
        If plate_home is unknown and the image does not show it, or if the rig has no markers.
    """
    rig, fiducials, home = location.rig, fiducials_of(location.rig), location.home
    if home is None:
        home, _ = find_home(image, fiducials, location.lens or rig_lens(rig))
        if home.lens is not None:
            plate_px = project(home.image_from_home, rig.plate.corners)
            home.lens.check_folding(plate_px, straight=True)
    pose = find_pose(image, fiducials, home, location.pose)
    used = location.region_pose
    plate_pose = pose if pose is not None else np.zeros(3) if used is None else used
    if used is None or _max_corner_displacement(rig, plate_pose, used) > MOVED_M:
        used = (
            plate_pose
            if _max_corner_displacement(rig, plate_pose, np.zeros(3)) > MOVED_M
            else np.zeros(3)
        )
    location = replace(location, home=home, pose=pose, region_pose=used)
    return location, hide_markers(image, fiducials, home, plate_pose)


def fiducials_of(rig: Rig) -> Fiducials:
    """Return the markers of a rig.

    Raises
    ------
    CalibrationError
        If the rig file has no markers.
    """
    if rig.fiducials is None:
        raise CalibrationError(
            "rig file: the section fiducials is missing, required: a rig file with this section"
        )
    return rig.fiducials


def find_home(
    image: np.ndarray, fiducials: Fiducials, lens: Lens | None = None
) -> tuple[Calibration, float]:
    """Find plate_home in an image (H, W) or (H, W, 3) uint8 of the plate at rest at home.

    Return the calibration, and the root mean square deviation of the markers' corners from
    `fiducials` [m].

    Raises
    ------
    CalibrationError
        If not all markers are visible, or if they are not at the places in the rig file.
    """
    found = find_markers(grey_levels(image), fiducials.dictionary)
    missing = [str(number) for number in fiducials.numbers if number not in found]
    if missing:
        several = len(missing) > 1
        markers = f"markers {', '.join(missing)} are" if several else f"marker {missing[0]} is"
        problem = f"fiducials: {markers} not detected"
        if _is_mirrored(image, fiducials):
            raise CalibrationError(
                f"{problem}, because the image is mirrored: in its mirror image, all markers are "
                "detected. Switch off the flip in the camera's driver (a flip left to right or "
                "upside down); an image in a mirror needs one flip"
            )
        raise CalibrationError(
            f"{problem}; all markers ({', '.join(map(str, fiducials.numbers))}) must be uncovered "
            "and in the image"
        )
    corners_px = np.concatenate([found[number] for number in fiducials.numbers])
    straight = corners_px if lens is None else lens.straighten(corners_px)
    corners = fiducials.corners.reshape(-1, 2)
    if not np.all(np.isfinite(straight)):
        raise CalibrationError(
            "fiducials: markers are detected outside the lens's field of view; check that K and D "
            "are from this camera, at this image size"
        )
    matrix, _ = cv2.findHomography(corners, straight)
    if matrix is None:
        raise CalibrationError(
            "fiducials: no homography fits the markers, allowed: markers that span an area"
        )
    calibration = calibrate_by_matrix(matrix, lens)
    error = _rms(calibration.to_home(corners_px) - corners)
    if error > WORST_FIT_M:
        raise CalibrationError(
            f"fiducials: corners are {1e3 * error:.2g} mm from their places in the rig file, "
            f"allowed: {1e3 * WORST_FIT_M:g} mm; check centre_m, side_m and the markers' order"
        )
    return calibration, error


def _is_mirrored(image: np.ndarray, fiducials: Fiducials) -> bool:
    """Return whether all markers are detected in the mirror image. A rotation of the image does not
    matter, because markers are detected at all angles."""
    found = find_markers(grey_levels(image)[:, ::-1], fiducials.dictionary)
    return all(number in found for number in fiducials.numbers)


def find_pose(
    image: np.ndarray,
    fiducials: Fiducials,
    home: Calibration,
    last: np.ndarray | None = None,
) -> np.ndarray | None:
    """Return the plate's pose (3,) [m, m, rad] in plate_home, determined by the visible markers.

    Return None if fewer than `MIN_SEEN` markers are visible, or if the markers contradict each
    other. `last` is a pose with an error of at most a few pixels. If `last` is given, the markers'
    edges are searched near this pose first. This search takes half the time of a search for
    markers.
    """
    grey = grey_levels(image)
    if last is not None:
        around = home.to_image(to_home(last, fiducials.corners.reshape(-1, 2)))
        corners = square_corners(grey, around.reshape(-1, 4, 2))
        pose = _estimate_pose(fiducials, home, corners, FOLLOWED_FIT_M)
        if pose is not None:
            return pose
    found = find_markers(grey, fiducials.dictionary)
    unseen = np.full((4, 2), np.nan)
    corners = np.array([found.get(number, unseen) for number in fiducials.numbers])
    return _estimate_pose(fiducials, home, corners, WORST_FIT_M)


def fit_pose(point: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the least-squares rigid motion (3,) [m, m, rad] from points (n, 2) [m, plate frame] to
    points (n, 2) [m, plate_home], and the root mean square residual [m].

    With centred points a and b: theta = atan2(sum(a x b), sum(a . b)).
    """
    a, b = point - point.mean(axis=0), seen - seen.mean(axis=0)
    theta = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = to_home(np.array([0.0, 0.0, theta]), point.mean(axis=0)[None])[0]
    pose = np.array([*(seen.mean(axis=0) - turned), theta])
    return pose, _rms(to_home(pose, point) - seen)


def hide_markers(
    image: np.ndarray, fiducials: Fiducials, home: Calibration, pose: np.ndarray
) -> np.ndarray:
    """Return a copy of the image in which the markers have the brightness of the plate around them.

    The detection then does not mistake the markers for parts. The detection also does not find
    parts that are on a marker. `pose` (3,) [m, m, rad] is the pose of the plate.
    """
    copy = np.array(image)
    height, width = image.shape[:2]
    for corners in fiducials.corners:
        middle = corners.mean(axis=0)
        border = middle + (1 + 2 * QUIET_ZONE) * (corners - middle)
        border_px = home.to_image(to_home(pose, border))
        place = np.clip(np.rint(border_px), 0, [width - 1, height - 1]).astype(np.int32)
        # The median of the corners' colours is used, because a part may cover one of the corners.
        shade = np.median(image[place[:, 1], place[:, 0]], axis=0)
        cv2.fillConvexPoly(copy, place, np.atleast_1d(shade).tolist())
    return copy


def _estimate_pose(
    fiducials: Fiducials, home: Calibration, corners_px: np.ndarray, worst: float
) -> np.ndarray | None:
    """Return the pose determined by corners (n, 4, 2) [px]. Corners that are not visible are NaN.
    Return None if too few markers are visible, or if the residual of the fit is larger than `worst`
    [m]."""
    rows = np.flatnonzero(np.all(np.isfinite(corners_px), axis=(1, 2)))
    if len(rows) < MIN_SEEN:
        return None
    seen = home.to_home(corners_px[rows].reshape(-1, 2))
    pose, error = fit_pose(fiducials.corners[rows].reshape(-1, 2), seen)
    return None if error > worst else pose


def _max_corner_displacement(rig: Rig, pose: np.ndarray, other: np.ndarray) -> float:
    """Return the maximum displacement of the plate's corners between two poses, per axis [m]."""
    corners = rig.plate.corners
    return float(np.abs(to_home(pose, corners) - to_home(other, corners)).max())


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
