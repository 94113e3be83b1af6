"""The whole stage without ROS: an image and its stamp in, parts in plate_home out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core import Rig
from plate_core.rig import to_home

from .camera.lens import Calibration, Lens, calibrate_by_rig
from .detection import DetectorOptions, detect, round_patches
from .errors import ImageError
from .plate.home import PlateLocation, locate_plate
from .plate.region import Region, make_region
from .tracking import Tracker, update

HOME = np.zeros(3)
"""The plate at rest."""

BRIGHT, DARK = 200, 30
"""Grey levels of a plate and of parts that everything is compiled for."""

CLUMP = 4
"""Half the side of a dark square for which the search in clumps is compiled [part radii]."""

EDGE_POINTS = 8
"""Points by which every bent edge of the plate is known: twice what its polynomial needs."""


CENTRE_PX = 0.01
"""Scatter of a part's centre along each axis [px]: drawn images, radius 5 to 16 px, noise of 1 to 4
grey levels, alone or touching, have 0.002 to 0.018 px. What lens and corners_px are wrong by, and
blur by motion, is not in it."""

MARK_PX = 0.08
"""Scatter of a mark's direction, times the part's radius [px]: drawn as above, at 8 px."""

ANY_ANGLE = math.pi / math.sqrt(3)
"""Standard deviation of an angle of which nothing is known [rad]: all are as likely."""


@dataclass(frozen=True, eq=False)
class Vision:
    """What is known about camera, plate and parts.

    Attributes
    ----------
    calibration : Calibration
        Between image and plate_home.
    region : Region
        Where the plate is in the image.
    options : DetectorOptions
        What a part looks like.
    radius : float
        Of the parts [m].
    """

    calibration: Calibration
    region: Region
    options: DetectorOptions
    radius: float

    def size(self, point_px: np.ndarray) -> np.ndarray:
        """Radius (n,) of a part seen at points (n, 2) [px], relative to the options' radius."""
        scale = self.calibration.scale(self.calibration.to_home(point_px))
        return np.asarray(self.radius * scale / self.options.radius_px)


def make_vision(
    rig: Rig,
    options: DetectorOptions | None = None,
    lens: Lens | None = None,
    calibration: Calibration | None = None,
    pose: np.ndarray | None = None,
) -> Vision:
    """Take camera, plate and the parts' radius from a rig.

    Parameters
    ----------
    rig : Rig
    options : DetectorOptions, optional
        Its radius is replaced by the rig's, as it is seen in the middle of the plate; under a lens
        that bends, halfway between the smallest and the largest seen on the plate.
    lens : Lens, optional
        That of camera_info; the rig's if None.
    calibration : Calibration, optional
        Lens and plate_home, if they are not those of the rig.
    pose : (3,), optional
        Of the plate [m, m, rad], plate_home; at home if None.

    Raises
    ------
    PlateError
        If the plate is not in the image, or its parts are too small or large in it.
    """
    if calibration is None:
        calibration = calibrate_by_rig(rig, lens)
    corners = to_home(HOME if pose is None else pose, rig.plate.corners)
    outline_px = calibration.to_image(corners)
    places = np.zeros((1, 2))
    if calibration.lens is not None:
        along = np.arange(EDGE_POINTS)[:, None] / EDGE_POINTS
        sides = np.roll(corners, -1, axis=0) - corners
        edges = (corners[:, None] + along * sides[:, None]).reshape(-1, 2)
        places = np.concatenate([places, edges])
        outline_px = calibration.to_image(edges).reshape(4, EDGE_POINTS, 2)
    scale = calibration.scale(places)
    radius_px = rig.parts.radius_m * float(np.sqrt(scale.min() * scale.max()))
    return Vision(
        calibration,
        make_region((rig.camera.width_px, rig.camera.height_px), outline_px),
        replace(options or DetectorOptions(), radius_px=radius_px),
        rig.parts.radius_m,
    )


def observe(vision: Vision, tracker: Tracker, image: np.ndarray, stamp: float) -> Tracker:
    """Find the parts of one image and follow them: the answer is the result's `parts`.

    Parameters
    ----------
    vision : Vision
        What is known.
    tracker : Tracker
        The parts so far.
    image : (H, W) or (H, W, 3) uint8
        Grey levels.
    stamp : float
        When it was taken [s].

    Raises
    ------
    ImageError
        If the image is not uint8, has another shape, or not the rig's size.
    """
    check_image(image, vision)
    size = None if vision.calibration.lens is None else vision.size
    found = detect(image, vision.options, vision.region, size)
    centre_px = np.stack([found["x_px"], found["y_px"]], axis=1)
    centre = vision.calibration.disc_centres(centre_px, found["radius_px"])
    angle, quality = _angles(vision, found, centre_px), _quality(vision, found, centre_px, centre)
    return update(tracker, stamp, centre, found["label"], angle, quality)


def size_problem(vision: Vision, image: np.ndarray) -> str | None:
    """Return how the round patches of an image (H, W) or (H, W, 3) differ from parts, or None.

    For photographs: most of them have another size than the rig's parts, or are brighter than the
    plate. What is found takes too long to be asked for every image of a camera.
    """
    discs = round_patches(image, vision.region)
    if not len(discs):
        return None
    seen = f"{len(discs)} round patch{'es' if len(discs) > 1 else ''}"
    if np.any(discs["contrast"] > 0):  # then all are
        return f"{seen} brighter than what is behind, allowed: parts darker than the plate"
    centre = np.stack([discs["x_px"], discs["y_px"]], axis=1)
    scale = float(np.median(vision.size(centre))) * vision.options.radius_px / vision.radius
    radius_px = float(np.median(discs["radius_px"]))
    radius, tolerance = radius_px / scale, vision.options.radius_tolerance
    if abs(radius / vision.radius - 1) <= tolerance:
        return None
    return (
        f"{seen} of {radius_px:.1f} px radius, which are {1e3 * radius:.3g} mm on the plate; the "
        f"rig's parts have {1e3 * vision.radius:.3g} mm, {scale * vision.radius:.1f} px, allowed: "
        f"{100 * tolerance:.0f} % more or less: write parts: radius_m: {radius:.2g} into the rig "
        "file, or what is wrong of plate and camera there, if the parts are as it says"
    )


def follow_plate(
    location: PlateLocation, vision: Vision, image: np.ndarray
) -> tuple[PlateLocation, Vision, np.ndarray]:
    """Find a plate with markers in an image, before `observe` looks for parts.

    Returns where it is now; a vision with the plate's region there, and the image (H, W) or
    (H, W, 3) without the markers, which could be taken for parts: with those call `observe`.

    Raises
    ------
    PlateError
        As `locate_plate`, and if the image has another size.
    """
    check_image(image, vision)
    now, image = locate_plate(location, image)
    if now.region_pose is not location.region_pose:
        vision = make_vision(now.rig, vision.options, calibration=now.home, pose=now.region_pose)
    return now, vision, image


def warm_up(vision: Vision) -> None:
    """Compile what parts need, also many that touch, before the first image comes."""
    image = three_discs(vision)
    observe(vision, Tracker(), image, 0.0)
    x, y = np.rint(np.mean(vision.region.outline_px, axis=0)).astype(int)
    half = round(CLUMP * vision.options.radius_px)
    image[y - half : y + half, x - half : x + half] = DARK
    observe(vision, Tracker(), image, 0.0)


def three_discs(vision: Vision) -> np.ndarray:
    """Return an image (H, W) uint8 of two discs that touch and a third, amid the region."""
    width, height = vision.region.size_px
    image = np.full((height, width), BRIGHT, np.uint8)
    radius = vision.options.radius_px
    middle = np.mean(vision.region.outline_px, axis=0)
    for place in (-1, 1, 5):
        x, y = np.rint(middle + [place * radius, 0]).astype(int)
        cv2.circle(image, (int(x), int(y)), round(radius), DARK, thickness=-1)
    return image


def _angles(vision: Vision, found: np.ndarray, centre_px: np.ndarray) -> np.ndarray:
    """Return the angles (n,) [rad, plate_home] of detected parts; 0 where there is no mark."""
    turn = found["angle_rad"]
    if not np.any(turn):
        return turn
    way = found["radius_px"][:, None] * np.stack([np.cos(turn), -np.sin(turn)], axis=1)
    to_home = vision.calibration.to_home
    dx, dy = (to_home(centre_px + way) - to_home(centre_px - way)).T
    return np.where(turn != 0, np.arctan2(dy, dx), 0.0)


def _quality(
    vision: Vision, found: np.ndarray, centre_px: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """Return how well parts were seen (n, 3), see `Tracker.quality`; the scatter of a part that is
    not wholly on the plate is not known."""
    whole = vision.region.depth(*centre_px.T) >= found["radius_px"]
    place = np.where(whole, CENTRE_PX / vision.calibration.scale(centre), np.nan)
    angle = np.where(found["angle_rad"] != 0, MARK_PX / found["radius_px"], ANY_ANGLE)
    return np.column_stack([place, angle, found["confidence"]])


def check_image(image: np.ndarray, vision: Vision) -> None:
    """Refuse images that are not of the rig's size."""
    width, height = vision.region.size_px
    if image.shape[:2] != (height, width):
        size = " x ".join(str(n) for n in reversed(image.shape[:2]))
        raise ImageError(
            f"image: size is {size} px, allowed: {width} x {height} px, that of the rig's camera, "
            "for which corners_px hold, or of the first picture"
        )
