"""The corners of a plate without markers, found by the plate's outline in a picture.

`find_plate_corners` measures the four edges (`measure_outline`) and intersects them. The function
repeats both steps around the new corners until the corners no longer change.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from plate_core import Rig

from ..camera.encodings import grey_levels
from ..camera.lens import Lens, calibrate_by_rig
from ..errors import CalibrationError
from .outline import OUTWARD, Outline, OutlineGrid, edge_points, measure_outline

MIN_COVER = 0.05
"""Minimum area of the plate, relative to the image's area [-]. A quadrilateral below this area is
another object, such as a label or a tool."""

CORNER_STEP = 0.02
"""Maximum deviation of a contour from a quadrilateral, relative to the contour's length [-]."""

ROUNDS = 3
"""Maximum number of refinements. If the camera was moved by 15 % of the plate's length, an error of
0.05 px remains after the second refinement."""

SETTLED_M = 2e-4
"""Maximum shift of the corners in the last refinement [m]. If the shift exceeds this maximum, the
corners are refined again."""


def find_plate_corners(
    image: np.ndarray, rig: Rig, lens: Lens | None = None
) -> tuple[np.ndarray, float]:
    """Find the plate's corners in an image (H, W) or (H, W, 3) uint8 of the plate at rest at home.

    The outline is first searched near the rig's `corners_px`. If the outline is not found there,
    bright or dark quadrilaterals in the picture are tried, starting with the largest one. The
    corners are returned in the order of `corners_px`.

    Parameters
    ----------
    lens : Lens, optional
        Lens of the camera; None: the lens of the rig file.

    Returns
    -------
    corners_px : (4, 2)
        Corners in the order of the rig file [px].
    error : float
        Root mean square deviation of the measured edges from a plate with these corners [m].

    Raises
    ------
    CalibrationError
        If the outline is not visible on all four sides.
    """
    starts = [np.array(rig.camera.corners_px, float), *_find_quadrilaterals(image, rig)]
    for start in starts:
        found = _refine_by_edges(image, rig, lens, start)
        if found is not None:
            return found
    raise CalibrationError(
        "the plate's outline is not visible on all four sides; the picture must show the whole "
        "plate, brighter or darker than its surroundings, with no parts near its edges"
    )


def _refine_by_edges(
    image: np.ndarray, rig: Rig, lens: Lens | None, corners_px: np.ndarray
) -> tuple[np.ndarray, float] | None:
    error = np.inf
    for _ in range(ROUNDS):
        rig = replace(rig, camera=replace(rig.camera, corners_px=_to_pairs(corners_px)))
        try:
            calibration = calibrate_by_rig(rig, lens)
        except CalibrationError:
            return None
        grid = OutlineGrid.of(rig, calibration)
        outline = measure_outline(image, grid)
        if not np.all(outline.seen):
            return None
        corners, error = _intersect_edges(outline, grid)
        corners_px = calibration.to_image(corners)
        if float(np.max(np.abs(corners - rig.plate.corners))) < SETTLED_M:
            break
    return corners_px, error


def _intersect_edges(outline: Outline, grid: OutlineGrid) -> tuple[np.ndarray, float]:
    """Return the intersections of the measured edges (4, 2) [m], in the order of `Plate.corners`.
    Also return the root mean square of the edges' bows [m]."""
    ends = edge_points(grid.half, np.array([-1.0, 1.0]))  # (4, 2, 2)
    middle, slope, bow = outline.edges.T
    offset = middle[:, None] + slope[:, None] * np.array([-1.0, 1.0])
    ends = ends + offset[..., None] * OUTWARD[:, None]
    side = ends[:, 1] - ends[:, 0]
    corners = []
    for edge in range(4):  # at each corner, the previous edge ends and edge number `edge` begins
        before = edge - 1
        matrix = np.column_stack([side[before], -side[edge]])
        along = np.linalg.solve(matrix, ends[edge, 0] - ends[before, 0])
        corners.append(ends[before, 0] + along[0] * side[before])
    return np.array(corners), float(np.sqrt(np.mean(bow**2)))


def _find_quadrilaterals(image: np.ndarray, rig: Rig) -> list[np.ndarray]:
    """Return the corners (4, 2) [px] of large quadrilaterals that are brighter or darker than the
    rest. The largest quadrilateral comes first. The corners are in the order of the rig's
    corners."""
    grey = cv2.GaussianBlur(grey_levels(image), (5, 5), 0)
    _, bright = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    found = []
    for mask in (bright, 255 - bright):
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            hull = cv2.convexHull(contour)
            area = cv2.contourArea(hull)
            if not MIN_COVER <= area / grey.size <= 0.98:
                continue
            length = cv2.arcLength(hull, closed=True)
            corners = cv2.approxPolyDP(hull, CORNER_STEP * length, closed=True).reshape(-1, 2)
            if len(corners) == 4:
                found.append((area, corners.astype(float)))
    found.sort(key=lambda one: -one[0])
    return [_order_corners(corners, rig) for _, corners in found]


def _order_corners(corners_px: np.ndarray, rig: Rig) -> np.ndarray:
    """Return corners (4, 2) [px] in the order of the rig's corners: with the same sense of rotation
    and the same first corner. The directions of the corners from the middle are compared, because a
    shift does not change these directions."""
    known = np.array(rig.camera.corners_px, float)
    if _signed_area(corners_px) * _signed_area(known) < 0:
        corners_px = corners_px[::-1]
    orders = [np.roll(corners_px, -k, axis=0) for k in range(4)]
    return min(
        orders,
        key=lambda one: float(np.sum((_normalise_corners(one) - _normalise_corners(known)) ** 2)),
    )


def _normalise_corners(corners_px: np.ndarray) -> np.ndarray:
    from_centre = corners_px - corners_px.mean(axis=0)
    return np.asarray(from_centre / np.sqrt(np.mean(from_centre**2)))


def _signed_area(corners_px: np.ndarray) -> float:
    x, y = corners_px.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _to_pairs(corners_px: np.ndarray) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in corners_px)
