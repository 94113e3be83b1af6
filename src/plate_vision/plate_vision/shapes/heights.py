"""Footprints of parts with a height, computed from the images of the parts.

For a camera at height H above the point c of the plate, a point p at height z appears at the
following place of the plate:

    c + (p - c) H / (H - z).

A part with the footprint F therefore covers t F (F scaled by t about c) for all t from 1 to k = H /
(H - height). This area is the image of the top and of those side faces that are visible to the
camera. A point p belongs to the footprint if t p is covered for all these t. For a convex part,
this method is exact. Narrow notches and holes become narrower in the footprint, by the shift of the
top.

The same method is used for a part and its shadow from one lamp. A part and its shadow together
cover the footprint and all copies of the footprint that are displaced along the shadow, up to the
shadow's length.
"""

from __future__ import annotations

import cv2
import numpy as np

from .. import _kernels
from .outlines import MIN_HOLE_POINTS, Outline, make_outline

FINE = 8
"""Number of sub-pixels along each side of a pixel with which footprints are drawn."""

STEP_PX = 1.0
"""Maximum shift between two heights that are evaluated [px]."""

MAX_STEPS = 24
"""Maximum number of heights that are evaluated."""

MIN_SHIFT_PX = 0.02
"""Shift of the top below which no correction is made [px]."""

MARGIN_PX = 3.31
"""Width of the margin around a drawn footprint [px]. The width is not a whole number of sub-pixels,
because otherwise an edge could pass exactly through the centres of sub-pixels."""


BLUR_PX = 0.7
"""Blur of a drawn footprint [px]. With the blur, the edge can be located between two pixels."""


def magnification(place: np.ndarray, height: float) -> float:
    """Return the factor H / (H - height) by which points at a height [m] appear farther from the
    point below a camera at `place` (3,) [m]."""
    return float(place[2] / (place[2] - height))


def apparent_shift(place: np.ndarray, point: np.ndarray, height: float) -> np.ndarray:
    """Return the apparent shifts (n, 2) [m] of points at a height [m] above the points (n, 2) [m]
    of the plate."""
    return np.asarray((point - place[:2]) * (magnification(place, height) - 1))


def footprint(
    outline: Outline,
    place: np.ndarray | None,
    height: float,
    scale: float,
    shadow: np.ndarray | None = None,
) -> Outline | None:
    """Return the outline of a part's footprint on the plate.

    Parameters
    ----------
    outline : Outline
        Outline of the visible part and its shadow, transformed to the plate.
    place : (3,), optional
        Position of the camera [m, plate_home]; None: unknown.
    height : float
        Height of the part [m].
    scale : float
        Scale of the image at the part [px/m].
    shadow : (2,), optional
        Displacement from the part to the end of its shadow [m]; None without a shadow.

    Returns
    -------
    Outline or None
        None if no area remains. This is the case if the actual part is lower than `height`, or if
        its actual shadow is shorter than `shadow`.
    """
    rings = outline.rings
    seen = [rings]
    if place is not None and height > 0:
        factor, below = magnification(place, height), place[:2]
        shift_px = scale * float(np.max(np.hypot(*(outline.points - below).T))) * (factor - 1)
        seen += [
            [below + (ring - below) * t for ring in rings]
            for t in np.linspace(1, 1 / factor, _step_count(shift_px))[1:]
        ]
    if shadow is not None:
        shift_px = scale * float(np.hypot(*shadow))
        seen += [
            [ring - t * shadow for ring in rings]
            for t in np.linspace(0, 1, _step_count(shift_px))[1:]
        ]
    if len(seen) == 1:
        return outline
    low = (
        np.min([visible_rings[0].min(axis=0) for visible_rings in seen], axis=0) - MARGIN_PX / scale
    )
    high = np.max([visible_rings[0].max(axis=0) for visible_rings in seen], axis=0)
    size = np.ceil((high - low) * scale + MARGIN_PX).astype(int)
    fine = np.zeros(FINE * size[::-1], np.uint8)
    both = np.full_like(fine, 255)
    for visible_rings in seen:
        fine[:] = 0
        for number, ring in enumerate(visible_rings):
            # Pixel centres have whole-number coordinates, in the image as well as in the finer
            # grid.
            point = (ring - low) * scale
            point = np.rint(16 * (FINE * (point + 0.5) - 0.5)).astype(np.int32)
            cv2.fillPoly(fine, [point], 0 if number else 255, shift=4)
        cv2.bitwise_and(both, fine, both)
    cover = cv2.resize(both, size.tolist(), interpolation=cv2.INTER_AREA)
    field = cv2.GaussianBlur(np.asarray(cover, np.float32) / 255, (0, 0), BLUR_PX)
    found = _trace_rings(field, len(outline.points[: outline.ends[0]]))
    if not found:
        return None
    return make_outline([low + ring / scale for ring in found])


def _step_count(shift_px: float) -> int:
    """Return the number of places along a shift [px] that are evaluated. The number is 1 if the
    shift is too small."""
    if shift_px < MIN_SHIFT_PX:
        return 1
    return int(min(np.ceil(shift_px / STEP_PX) + 1, MAX_STEPS))


def _trace_rings(cover: np.ndarray, count: int) -> list[np.ndarray]:
    """Return the rings (k, 2) [px] where a cover (h, w) float32 is 0.5. The cover is the covered
    fraction of each pixel. The ring around the largest patch has `count` points, and the points on
    its holes have the same density."""
    mask = cv2.copyMakeBorder((cover >= 0.5).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
    contours, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = [i for i in range(len(contours)) if tree[0, i, 3] < 0 and len(contours[i]) >= 4]
    if not outer:
        return []
    largest = max(outer, key=lambda i: cv2.contourArea(contours[i]))
    found = []
    for i in [largest, *(i for i in range(len(contours)) if tree[0, i, 3] == largest)]:
        ring = contours[i][:, 0]
        hole_count = max(round(count * len(ring) / len(contours[largest])), MIN_HOLE_POINTS)
        if len(ring) >= 4:
            points = np.empty((count if i == largest else hole_count, 2))
            _kernels.find_edge(cover, ring, i != largest, points)
            found.append(points)
    return found
