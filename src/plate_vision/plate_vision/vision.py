"""The whole stage without ROS: an image and its stamp in, parts in plate_home out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plate_core import Rig

from .calibration import Calibration, Lens, calibrate_by_rig
from .detection import DetectorOptions, detect
from .errors import ImageError
from .tracking import Tracker, step


@dataclass(frozen=True, eq=False)
class Vision:
    """What is known about camera, plate and parts.

    Attributes
    ----------
    calibration : Calibration
        Between image and plate_home.
    region_px : (4, 2)
        The plate's corners in the image [px].
    size_px : (int, int)
        Width and height of the images [px].
    options : DetectorOptions
        What a part looks like.
    """

    calibration: Calibration
    region_px: np.ndarray
    size_px: tuple[int, int]
    options: DetectorOptions


def make_vision(
    rig: Rig, options: DetectorOptions | None = None, lens: Lens | None = None
) -> Vision:
    """Take camera, plate and the parts' radius from a rig.

    Parameters
    ----------
    rig : Rig
    options : DetectorOptions, optional
        Its radius is replaced by the rig's, as it is seen in the middle of the plate.
    lens : Lens, optional
        If the camera's distortion is known.
    """
    calibration = calibrate_by_rig(rig, lens)
    radius_px = rig.parts.radius_m * float(calibration.scale(np.zeros((1, 2)))[0])
    return Vision(
        calibration,
        np.array(rig.camera.corners_px),
        (rig.camera.width_px, rig.camera.height_px),
        replace(options or DetectorOptions(), radius_px=radius_px),
    )


def look(vision: Vision, tracker: Tracker, image: np.ndarray, stamp: float) -> Tracker:
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
    width, height = vision.size_px
    if image.shape[:2] != (height, width):
        seen = " x ".join(str(n) for n in reversed(image.shape[:2]))
        raise ImageError(
            f"image: size is {seen} px, allowed: {width} x {height} px, the size in the rig file "
            "for which its corners_px hold"
        )
    found = detect(image, vision.options, vision.region_px)
    centre = vision.calibration.to_home(np.stack([found["x_px"], found["y_px"]], axis=1))
    return step(tracker, stamp, centre, found["label"])
