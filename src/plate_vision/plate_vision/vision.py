"""The detection stage without ROS. Input: an image and its stamp. Output: tracked parts in
plate_home.

`make_vision` prepares camera, plate and parts from a rig. `observe` finds the parts of one image,
converts them to plate_home by the calibration, and updates the tracker with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import NAMELESS, PLAUSIBLE_AREA, Rig
from plate_core.rig import to_home

from .camera.lens import Calibration, Lens, calibrate_by_rig
from .detection import DetectorOptions, PartView, find_discs
from .discs import SeenDiscs, outlines
from .errors import check_image, check_size
from .overlooked import OVERLOOKED, may_be_parts, unnamed_objects
from .plate.home import PlateLocation, locate_plate
from .plate.light import check_complete
from .plate.region import Region, make_region
from .recognition import find_types_and_lamp, model_plate
from .shapes import Background
from .shapes.catalogue import Catalogue, make_catalogue
from .shapes.classes import UNKNOWN, is_named
from .tracking import Prediction, Tracker, update

HOME = np.zeros(3)
"""Pose of the plate at rest [m, m, rad]."""

EDGE_POINTS = 8
"""Number of points for each curved edge of the plate. The polynomial of degree 4 that is fitted to
the edge needs at least 5 points."""


CENTRE_PX = 0.01
"""Standard deviation of a part's centre along each axis [px]. In synthetic images, the standard
deviation is 0.002 to 0.018 px. These images show single and touching parts of 5 to 16 px radius
with a noise of 1 to 4 grey levels. Motion blur and errors of the lens and of corners_px are not
included."""

MARK_PX = 0.08
"""Standard deviation of a mark's direction [rad], multiplied by the part's radius [px]. The value
was measured in synthetic images with parts of 8 px radius."""

SHAPE_PX = 0.04
"""Standard deviation of the centre of a part of a taught type along each axis [px]. The value was
measured in synthetic images of 0.7 to 2 px/mm, with a blur of 0.7 to 1.5 px."""

UNKNOWN_PX = 0.3
"""Standard deviation of the centre of an object without a type [px]. The standard deviation is
large because only the object's outline is known."""

UNKNOWN_RADII = 0.3
"""Standard deviation of the centre of an object that may be a round part [part radii]. The standard
deviation is large because the object's outline includes its shadow."""

SPECK = 0.3
"""Minimum area of an object without a type, relative to the smallest type's area [-]. Smaller
objects are ignored."""

RIG_SIZE = ", the image size of the rig's camera and corners_px, or the size of the first picture"
"""Source of the required image size, as text for messages."""

ANY_ANGLE = math.pi / math.sqrt(3)
"""Standard deviation of an unknown angle [rad], which is uniformly distributed from -pi to pi."""


@dataclass(frozen=True, eq=False)
class Vision:
    """Model of camera, plate and parts that `observe` uses.

    Attributes
    ----------
    calibration : Calibration
        Transformation between the image and plate_home.
    region : Region
        Region of the plate in the image.
    options : DetectorOptions
        Description of the parts.
    view : PartView
        Appearance of a part at each place.
    radius : float
        Radius of the parts [m].
    catalogue : Catalogue, optional
        Types of parts; None: all parts are discs with this radius.
    background : Background, optional
        Image of the bare plate, for parts with types. None: a model of the bare plate is made from
        each image.
    inner : (2,)
        Half side lengths of the area that the plate covers for every motor position [m]. Outside
        this area, an object without a type may be the edge of a plate that was not at home.
    """

    calibration: Calibration
    region: Region
    options: DetectorOptions
    view: PartView
    radius: float
    catalogue: Catalogue | None = None
    background: Background | None = None
    inner: np.ndarray = field(default_factory=lambda: np.full(2, np.inf))

    @property
    def lit_region(self) -> Region | None:
        """Region in which the plate must be bright. None for parts with types, because their plate
        can be dark."""
        return self.region if self.catalogue is None else None

    def radius_px(self, point_px: np.ndarray) -> np.ndarray:
        """Return the radius (n,) of the disc with the same area as the image of a part at points
        (n, 2) [px]."""
        return np.asarray(self.view.silhouettes(point_px)["radius_px"])


def make_vision(
    rig: Rig,
    options: DetectorOptions | None = None,
    lens: Lens | None = None,
    calibration: Calibration | None = None,
    pose: np.ndarray | None = None,
) -> Vision:
    """Prepare a Vision from a rig's camera, plate, and parts.

    Parameters
    ----------
    rig : Rig
    options : DetectorOptions, optional
        Description of the parts. The radius of this description is replaced by the geometric mean
        of the smallest and the largest radius of the rig's parts in the image.
    lens : Lens, optional
        Lens of camera_info; None: the lens of the rig file.
    calibration : Calibration, optional
        Lens and transformation to plate_home, if they differ from those of the rig file.
    pose : (3,), optional
        Pose of the plate [m, m, rad] in plate_home; None: the plate is at home.

    Raises
    ------
    PlateError
        If the plate is not in the image, or if its parts are too small or too large in the image.
    """
    if calibration is None:
        calibration = calibrate_by_rig(rig, lens)
    corners = to_home(HOME if pose is None else pose, rig.plate.corners)
    along = np.arange(EDGE_POINTS)[:, None] / EDGE_POINTS
    sides = np.roll(corners, -1, axis=0) - corners
    edges = (corners[:, None] + along * sides[:, None]).reshape(-1, 2)
    if calibration.lens is None:
        outline_px = calibration.to_image(corners)
    else:
        outline_px = calibration.to_image(edges).reshape(4, EDGE_POINTS, 2)
    seen = rig.parts.radius_m * calibration.scale(
        np.concatenate([corners.mean(axis=0)[None], edges])
    )
    radius_px = float(np.sqrt(seen.min() * seen.max()))
    return Vision(
        calibration,
        make_region((rig.camera.width_px, rig.camera.height_px), outline_px),
        replace(options or DetectorOptions(), radius_px=radius_px),
        PartView(
            SeenDiscs(calibration, rig.parts.radius_m, rig.parts.height_m),
            float(seen.min()),
            calibration,
        ),
        rig.parts.radius_m,
        make_catalogue(rig.types) if rig.types else None,
        inner=rig.plate.half - rig.limits.stroke_m,
    )


def observe(
    vision: Vision,
    tracker: Tracker,
    image: np.ndarray,
    stamp: float,
    expected: Prediction | None = None,
) -> Tracker:
    """Find the parts of one image and track them. The field `parts` of the result contains the
    parts.

    Parameters
    ----------
    vision : Vision
        Model of camera, plate and parts.
    tracker : Tracker
        State after the previous image.
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    stamp : float
        Time at which the image was taken [s].
    expected : Prediction, optional
        Positions of the parts predicted from the plate's motion; see `tracking.update`.

    Raises
    ------
    ImageError
        If the image is not uint8, has another shape, does not have the size of the rig's images, or
        is incomplete.
    """
    check_size("image: size is", image.shape[1::-1], vision.region.size_px, why=RIG_SIZE)
    check_image(image)
    check_complete(image, vision.region)
    if vision.catalogue is not None:
        return _observe_types(vision, vision.catalogue, tracker, image, stamp, expected)
    # The search for a shadow takes long. Therefore only the 1st, 2nd, 4th, 8th... of consecutive
    # uncertain images are searched.
    search = tracker.uncertain & (tracker.uncertain + 1) == 0
    discs = find_discs(image, vision.region, vision.options, vision.view, tracker.shadow, search)
    found = discs.found
    places = discs.places
    centre = vision.calibration.disc_centres(
        places[:, None] + outlines(discs.parts, found["radius_px"])
    )
    angle = _part_angles(vision, found, places)
    quality = _detection_quality(vision, found, places, centre)
    things, label = discs.overlooked, found["label"]
    if len(things):
        things = things.copy()
        things["x"], things["y"] = vision.calibration.to_home(
            np.stack([things["x_px"], things["y_px"]], axis=1)
        ).T
        scale = vision.calibration.scale(np.column_stack([things["x"], things["y"]]))
        size = things["radius_px"] / scale
        # The objects in `unknown` may be parts. The planner must not move other parts into these
        # objects.
        unknown = may_be_parts(things, size, vision.radius, vision.inner, centre)
        more, zero = things[unknown], np.zeros(np.count_nonzero(unknown))
        centre = np.vstack([centre, np.column_stack([more["x"], more["y"]])])
        label = np.concatenate([label, np.full(len(more), UNKNOWN, label.dtype)])
        angle = np.concatenate([angle, zero])
        thing_quality = np.column_stack(
            [zero + UNKNOWN_RADII * vision.radius, zero + ANY_ANGLE, zero]
        )
        quality = np.vstack([quality, thing_quality])
    after = update(
        tracker, stamp, centre, label, angle, quality, expected=expected, overlooked=things
    )
    if after is tracker:  # the tracker has already used this image
        return tracker
    uncertain = tracker.uncertain + 1 if discs.uncertain and discs.shadow is None else 0
    after = replace(after, shadow=discs.shadow, uncertain=uncertain)
    return _add_unsettled(vision, after)


def _observe_types(
    vision: Vision,
    catalogue: Catalogue,
    tracker: Tracker,
    image: np.ndarray,
    stamp: float,
    expected: Prediction | None,
) -> Tracker:
    """Find and track parts of taught types, as `observe` does."""
    bare = vision.background
    if bare is None:
        bare = model_plate(image, vision.region)
    seen, lamp = find_types_and_lamp(
        image, catalogue, bare, vision.calibration, vision.region, tracker.lamp
    )
    named = is_named(seen)
    centre = np.column_stack([seen["x"], seen["y"]])
    scale = vision.calibration.scale(centre)
    min_area = SPECK * np.min(catalogue.area)
    on_plate = np.all(np.abs(centre) <= vision.inner, axis=1)
    limits = np.sqrt(np.array([min_area, PLAUSIBLE_AREA[1] * np.max(catalogue.area)]) / np.pi)
    things = unnamed_objects(seen, on_plate, seen["radius_px"] / scale, *limits)
    kept = named | (on_plate & (np.pi * (seen["radius_px"] / scale) ** 2 > min_area))
    seen, named, centre, scale = seen[kept], named[kept], centre[kept], scale[kept]
    symmetries = {template.part.name: template.part.symmetry for template in catalogue.templates}
    symmetry = np.array([symmetries.get(label, 0) for label in seen["label"].tolist()], int)
    place = np.hypot(np.where(named, SHAPE_PX, UNKNOWN_PX) / scale, seen["place_sd"])
    place[~seen["whole"]] = np.nan
    angle = np.where(symmetry > 0, seen["angle_sd"], ANY_ANGLE)
    quality = np.column_stack([place, angle, seen["confidence"]])
    after = update(
        tracker, stamp, centre, seen["label"], seen["angle"], quality, symmetry, expected, things
    )
    return after if after is tracker else _add_unsettled(vision, replace(after, lamp=lamp))


def _add_unsettled(vision: Vision, tracker: Tracker) -> Tracker:
    """Add unsettled objects to the overlooked objects. The newest detection of an unsettled object
    has a class. The object's track has no class yet, because earlier images did not show the object
    as a part."""
    tracks = [track for track in tracker.found if track.label in NAMELESS]
    tracks = [track for track in tracks if track.votes[-1] not in NAMELESS]
    if not tracks:
        return tracker
    things = np.zeros(len(tracks), OVERLOOKED)
    place = np.array([track.position for track in tracks])
    things["x"], things["y"] = place.T
    place_px = vision.calibration.to_image(place)
    things["x_px"], things["y_px"] = place_px.T
    things["radius_px"], things["reason"] = vision.radius_px(place_px), "unsettled"
    return replace(tracker, overlooked=np.concatenate([tracker.overlooked, things]))


def follow_plate(
    location: PlateLocation, vision: Vision, image: np.ndarray
) -> tuple[PlateLocation, Vision, np.ndarray]:
    """Find a plate with markers in an image, before `observe` searches for parts.

    Return the new location, a vision whose region is at this location, and the image (H, W) or (H,
    W, 3) without the markers. Markers could be mistaken for parts. The vision and the image are the
    input of `observe`.

    Raises
    ------
    PlateError
        If the plate cannot be located (see `locate_plate`), or if the image has another size.
    """
    check_size("image: size is", image.shape[1::-1], vision.region.size_px, why=RIG_SIZE)
    now, image = locate_plate(location, image)
    if now.region_pose is not location.region_pose:
        # Without the types, `make_vision` does not compute the catalogue of the types again. The
        # existing catalogue is reused below.
        rig = replace(now.rig, types={})
        placed = make_vision(rig, vision.options, calibration=now.home, pose=now.region_pose)
        vision = replace(placed, catalogue=vision.catalogue, background=vision.background)
    return now, vision, image


def _part_angles(vision: Vision, found: np.ndarray, centre_px: np.ndarray) -> np.ndarray:
    """Return the angles (n,) [rad, plate_home] of parts `found` (n,) DETECTION. The angle of a part
    without a mark is 0."""
    angle = found["angle_rad"]
    if not np.any(angle):
        return angle
    radius_px = found["radius_px"][:, None] * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
    to_home = vision.calibration.to_home
    dx, dy = (to_home(centre_px + radius_px) - to_home(centre_px - radius_px)).T
    return np.where(angle != 0, np.arctan2(dy, dx), 0.0)


def _detection_quality(
    vision: Vision, found: np.ndarray, centre_px: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """Return the quality of the detections (n, 3) (see `Tracker.quality`). If a part is not
    completely on the plate, the standard deviation of its position is unknown, NaN."""
    # The plate may extend beyond the image. Therefore the distance from the image border is
    # computed, too.
    corner_px = np.array(vision.region.size_px) - 1
    border_px = np.minimum(centre_px, corner_px - centre_px).min(axis=1) + 0.5
    depth_px = np.minimum(vision.region.depth(*centre_px.T), border_px)
    is_inside = depth_px >= found["radius_px"]
    place_px = np.hypot(CENTRE_PX, found["scatter_px"])
    place = np.where(is_inside, place_px / vision.calibration.scale(centre), np.nan)
    angle = np.where(found["angle_rad"] != 0, MARK_PX / found["radius_px"], ANY_ANGLE)
    return np.column_stack([place, angle, found["confidence"]])
