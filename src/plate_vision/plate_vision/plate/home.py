"""Where plate_home is in the image, and where the plate is in plate_home: by markers on the plate.

plate_home is found once, the plate in every image.
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

LEAST_SEEN = 2
"""Markers needed for a pose: with one alone the angle would hang on 3 cm."""

WORST_FIT_M = 1e-3
"""Largest root mean square deviation [m] of the markers' corners from where the rig file has them
that is believed: ten times what a good print and a sharp picture leave."""

FOLLOWED_FIT_M = 3e-4
"""The same where markers are followed by their edges alone: others must not be taken for them."""

QUIET = 0.2
"""Border [sides] of bare plate around a marker, which is painted over with it."""

MOVED_M = 5e-4
"""Way of a corner of the plate [m] from which parts are looked for in another region: half a pixel
of the default rig. A new region takes longer than the detection."""

AWAY_M = 2e-3
"""A plate this far from home [m] when an image is taken is worth a warning."""


@dataclass(frozen=True, eq=False)
class PlateLocation:
    """What is known of where a plate with markers is.

    Attributes
    ----------
    rig : Rig
        With fiducials.
    lens : Lens, optional
        That of camera_info; the rig's if None.
    home : Calibration or None
        Found in the first image that showed all markers; until then None.
    pose : (3,) or None
        x, y [m], theta [rad] in plate_home in the last image; None if too few markers were seen.
    region_pose : (3,) or None
        That for which the region was made in which parts are looked for; None if none was.
    """

    rig: Rig
    lens: Lens | None = None
    home: Calibration | None = None
    pose: np.ndarray | None = None
    region_pose: np.ndarray | None = None

    @property
    def problem(self) -> str | None:
        """What a user should know, or None."""
        if self.pose is None:
            return "the plate's markers are not seen, it is taken to be where it was"
        away = float(np.hypot(*self.pose[:2]))
        if away > AWAY_M:
            return (
                f"the plate is {1e3 * away:.1f} mm from home when the image is taken, allowed: "
                f"{1e3 * AWAY_M:g} mm (is the camera triggered at the cycle's start; was it moved? "
                "then call the service reset)"
            )
        return None


def locate_plate(location: PlateLocation, image: np.ndarray) -> tuple[PlateLocation, np.ndarray]:
    """Look for the plate in an image (H, W) or (H, W, 3) uint8, before parts are looked for.

    Returns where it is, with another `region_pose` if parts are to be looked for in another region;
    and the image without the markers, which could be taken for parts.

    Raises
    ------
    CalibrationError
        If plate_home is not known yet, and the image does not show it; or the rig has no markers.
    """
    rig, fiducials = location.rig, location.rig.fiducials
    if fiducials is None:
        raise CalibrationError("rig: has no fiducials, allowed: a rig file with that section")
    home = location.home
    if home is None:
        home, _ = find_home(image, fiducials, location.lens or rig_lens(rig))
        if home.lens is not None:
            plate_px = project(home.image_from_home, rig.plate.corners)
            home.lens.check_folding(plate_px, straight=True)
    pose = find_pose(image, fiducials, home, location.pose)
    used = location.region_pose
    here = pose if pose is not None else np.zeros(3) if used is None else used
    if used is None or _way(rig, here, used) > MOVED_M:
        used = here if _way(rig, here, np.zeros(3)) > MOVED_M else np.zeros(3)
    location = replace(location, home=home, pose=pose, region_pose=used)
    return location, hide_markers(image, fiducials, home, here)


def find_home(
    image: np.ndarray, fiducials: Fiducials, lens: Lens | None = None
) -> tuple[Calibration, float]:
    """Find plate_home in an image (H, W) or (H, W, 3) uint8 of the plate at rest at home.

    Returns also the root mean square deviation [m] of the markers' corners from where `fiducials`
    has them.

    Raises
    ------
    CalibrationError
        If not all markers are seen, or they are not where the rig file has them.
    """
    found = find_markers(grey_levels(image), fiducials.dictionary)
    missing = [str(number) for number in fiducials.numbers if number not in found]
    if missing:
        raise CalibrationError(
            f"fiducials: {', '.join(missing)} not seen, allowed: all of "
            f"{', '.join(map(str, fiducials.numbers))} (cover none, let all be in the image)"
        )
    corners_px = np.concatenate([found[number] for number in fiducials.numbers])
    straight = corners_px if lens is None else lens.straighten(corners_px)
    corners = fiducials.corners.reshape(-1, 2)
    if not np.all(np.isfinite(straight)):
        raise CalibrationError(
            "fiducials: markers are seen where the lens shows nothing, allowed: K and D of this "
            "camera, at this size of image"
        )
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
    home: Calibration,
    last: np.ndarray | None = None,
) -> np.ndarray | None:
    """Return the plate's pose (3,) [m, m, rad], plate_home, by the markers that are seen.

    None if fewer than `LEAST_SEEN` are, or they contradict each other. `last` is a pose that is not
    far, in pixels: there edges are looked for before markers are, which takes half the time.
    """
    grey = grey_levels(image)
    if last is not None:
        around = home.to_image(to_home(last, fiducials.corners.reshape(-1, 2)))
        corners = square_corners(grey, around.reshape(-1, 4, 2))
        pose = _pose(fiducials, home, corners, FOLLOWED_FIT_M)
        if pose is not None:
            return pose
    found = find_markers(grey, fiducials.dictionary)
    unseen = np.full((4, 2), np.nan)
    corners = np.array([found.get(number, unseen) for number in fiducials.numbers])
    return _pose(fiducials, home, corners, WORST_FIT_M)


def fit_pose(point: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rigid motion (3,) [m, m, rad] with the least sum of squares, and what it leaves.

    It takes points (n, 2) [m, plate frame] to where they are seen (n, 2) [m, plate_home]; what it
    leaves is the root mean square deviation [m].
    """
    a, b = point - point.mean(axis=0), seen - seen.mean(axis=0)
    theta = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = to_home(np.array([0.0, 0.0, theta]), point.mean(axis=0)[None])[0]
    pose = np.array([*(seen.mean(axis=0) - turned), theta])
    return pose, _rms(to_home(pose, point) - seen)


def hide_markers(
    image: np.ndarray, fiducials: Fiducials, home: Calibration, pose: np.ndarray
) -> np.ndarray:
    """Return a copy of the image in which the markers have the brightness of the plate around.

    So that no part is seen in them. A part that lies on a marker is not seen either. `pose` (3,)
    [m, m, rad] is the plate's.
    """
    copy = np.array(image)
    height, width = image.shape[:2]
    for corners in fiducials.corners:
        middle = corners.mean(axis=0)
        rim = middle + (1 + 2 * QUIET) * (corners - middle)
        rim_px = home.to_image(to_home(pose, rim))
        place = np.clip(np.rint(rim_px), 0, [width - 1, height - 1]).astype(np.int32)
        # The corners of the border are bare plate, unless a part lies there: so their median.
        shade = np.median(image[place[:, 1], place[:, 0]], axis=0)
        cv2.fillConvexPoly(copy, place, np.atleast_1d(shade).tolist())
    return copy


def _pose(
    fiducials: Fiducials, home: Calibration, corners_px: np.ndarray, worst: float
) -> np.ndarray | None:
    """Return the pose by corners (n, 4, 2) [px], NaN where unseen, if it is believed."""
    rows = np.flatnonzero(np.all(np.isfinite(corners_px), axis=(1, 2)))
    if len(rows) < LEAST_SEEN:
        return None
    seen = home.to_home(corners_px[rows].reshape(-1, 2))
    pose, error = fit_pose(fiducials.corners[rows].reshape(-1, 2), seen)
    return None if error > worst else pose


def _way(rig: Rig, pose: np.ndarray, other: np.ndarray) -> float:
    """Return how far the plate's corners are apart at two poses [m]."""
    corners = rig.plate.corners
    return float(np.abs(to_home(pose, corners) - to_home(other, corners)).max())


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
