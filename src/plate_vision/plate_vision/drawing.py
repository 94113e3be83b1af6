"""Pictures for users, drawn with OpenCV. `draw_detections` draws outlines, names and velocities of
the detected parts into an image. `draw_errors` draws the errors of a lens fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from plate_core import part_class
from plate_core.rig import PartType, to_home

from .camera.boards import LensFit
from .camera.lens import Calibration

COLOURS = ((0, 200, 255), (255, 120, 0), (80, 220, 80), (220, 80, 220), (80, 80, 255))
"""Colours (blue, green, red) of the classes, in the order of their names."""

PLATE_COLOUR, ARROW_COLOUR = (200, 200, 0), (60, 60, 230)

ARROW_S = 1.0
"""Duration of the motion that the velocity arrow of a part shows [s]."""

SHIFT = 4
"""Fractional bits of OpenCV's fixed-point coordinates: sixteenths of a pixel."""

ERROR_SCALE = 200.0
"""Factor by which the drawn errors of the calibration board's corners are enlarged."""


def draw_detections(
    image: np.ndarray,
    ids: Sequence[str],
    point_px: np.ndarray,
    radius_px: np.ndarray,
    ahead_px: np.ndarray,
    outline_px: np.ndarray,
    part_px: Sequence[np.ndarray],
) -> np.ndarray:
    """Return a colour copy (H, W, 3) with the parts' outlines, names, and velocity arrows.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    ids : (M,) str
        Names of the parts.
    point_px : (M, 2)
        Centres [px].
    radius_px : (M,)
        Radii [px].
    ahead_px : (M, 2)
        Predicted centres after `ARROW_S` [px].
    outline_px : (n, 2)
        Outline of the plate [px].
    part_px : sequence of (k, 2)
        Outlines of the parts [px]. A part with an outline (0, 2) is drawn as a circle.
    """
    picture = np.array(image) if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    outline = _fixed(outline_px)
    cv2.polylines(picture, [outline], True, PLATE_COLOUR, 1, cv2.LINE_AA, SHIFT)
    classes = sorted({name.rsplit("_", 1)[0] for name in ids})
    for name, point, radius, ahead, contour in zip(
        ids, point_px, radius_px, ahead_px, part_px, strict=True
    ):
        colour = COLOURS[classes.index(name.rsplit("_", 1)[0]) % len(COLOURS)]
        middle, end = _fixed(point), _fixed(ahead)
        size = int(_fixed(np.array([radius]))[0])
        if len(contour):
            cv2.polylines(picture, [_fixed(contour)], True, colour, 1, cv2.LINE_AA, SHIFT)
        else:
            cv2.circle(picture, middle.tolist(), size, colour, 1, cv2.LINE_AA, SHIFT)
        if np.linalg.norm(ahead - point) >= 1:
            cv2.arrowedLine(
                picture, middle.tolist(), end.tolist(), ARROW_COLOUR, 1, cv2.LINE_AA, SHIFT, 0.25
            )
        place = np.rint(point + [radius + 1, -radius - 1]).astype(int)
        cv2.putText(
            picture, name, place.tolist(), cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1, cv2.LINE_AA
        )
    return np.asarray(picture)


def outlines_px(
    types: Mapping[str, PartType],
    ids: Sequence[str],
    position: np.ndarray,
    angle: np.ndarray,
    calibration: Calibration,
) -> list[np.ndarray]:
    """Return the outlines (k, 2) [px] of parts at positions (M, 2) [m] and angles (M,) [rad], both
    in plate_home. The outline of a part without a type is (0, 2)."""
    outlines = []
    for name, place, part_angle in zip(ids, position, angle, strict=True):
        part = types.get(part_class(name))
        if part is None:
            outlines.append(np.empty((0, 2)))
            continue
        outlines.append(calibration.to_image(to_home(np.array([*place, part_angle]), part.polygon)))
    return outlines


def draw_errors(fit: LensFit) -> np.ndarray:
    """Return a picture (H, W, 3) that shows the enlarged errors of all corners, in one colour for
    each calibration picture."""
    width, height = fit.size_px
    picture = np.full((height, width, 3), 255, np.uint8)
    for number, ((_, place), error) in enumerate(zip(fit.corners, fit.errors, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        for start, end in zip(_fixed(place), _fixed(place + ERROR_SCALE * error), strict=True):
            cv2.circle(picture, start.tolist(), 2 << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)
            cv2.line(picture, start.tolist(), end.tolist(), colour, 1, cv2.LINE_AA, SHIFT)
    text = (
        f"errors x {ERROR_SCALE:g}: {fit.error_px:.3f} px rms, {len(fit.errors)} pictures, "
        f"{sum(map(len, fit.errors))} corners"
    )
    cv2.putText(picture, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return picture


def _fixed(point_px: np.ndarray) -> np.ndarray:
    """Return points in sixteenths of a pixel, clipped to the range of OpenCV's integers."""
    return np.rint(np.clip(point_px, -1e5, 1e5) * (1 << SHIFT)).astype(np.int32)
