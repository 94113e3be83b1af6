"""Remains: pixels of a coarse grid that differ from the bare plate and do not belong to a detected
part.

The detector searches the remains for parts that are not simply darker than the plate. Objects in
the remains that are not accepted as parts become overlooked objects (`overlooked_objects`). Each
overlooked object has a reason why it is not a part.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from . import _kernels
from .discs import COARSE_RADIUS_PX
from .discs.silhouette import silhouette_rows
from .overlooked import NONE_OVERLOOKED, OVERLOOKED
from .plate import LitPlate, Region
from .plate.contrast import Channels, find_deviating_pixels

COARSE_STEP = 2
"""Step between the rows and columns of the grid that the first, fast check evaluates. The check
detects groups of four neighbouring pixels. Such a group is smaller than the smallest relevant
object."""

MIN_AREA = 0.1
"""Minimum area of an object, relative to a part's area. Smaller objects are dust."""

HOLE = 0.5
"""Maximum area of a highlight or a hole, relative to a part's area. If an object encloses an area
up to this size, the area belongs to the object."""

SMALL, LARGE = 0.6, 1.6
"""Range of an object's area, relative to a part's area. If the area is outside this range, the
object is too small or too large."""


class Remains(NamedTuple):
    """Pixels that differ from the bare plate and belong to no part.

    Attributes
    ----------
    deviating : (h, w) uint8
        1 where a pixel of the grid differs from the bare plate, 0 elsewhere.
    outside : (h, w) bool
        Whether a pixel of the grid is outside the plate.
    grid : (int, int, int)
        First x, first y, and step of the grid [px].
    """

    deviating: np.ndarray
    outside: np.ndarray
    grid: tuple[int, int, int]


def find_remains(
    channels: Channels,
    region: Region,
    limit: float,
    min_radius_px: float,
    centre: np.ndarray,
    parts: np.ndarray,
) -> Remains | None:
    """Return the remains without the parts at places (n, 2) [px] with silhouettes (n,) SILHOUETTE.
    Return None if there are no remains. `limit` is the minimum contrast of a pixel, and
    `min_radius_px` is the smallest radius of a part [px]."""
    x0, y0 = region.box[:2]
    stride = max(1, int(min_radius_px / COARSE_RADIUS_PX))
    shapes = silhouette_rows(parts)
    coarse = (x0, y0, COARSE_STEP * stride)
    counts = _inner_pixels(region, COARSE_STEP * stride, min_radius_px)
    if counts.size == 0:
        return None
    lit = channels.image, channels.lights
    if not _kernels.any_deviating(*lit, limit, counts, coarse, centre, shapes):
        return None
    outside = region.outside(stride)
    grid = (x0, y0, stride)
    deviating = find_deviating_pixels(channels, limit, grid, outside.shape)
    deviating[outside] = 0
    _kernels.clear_parts(deviating, grid, centre, shapes)
    return Remains(deviating, outside, grid)


def remove_parts(remains: Remains, centre: np.ndarray, parts: np.ndarray) -> Remains:
    """Remove parts at places (n, 2) [px] with silhouettes (n,) SILHOUETTE from the remains."""
    deviating = remains.deviating.copy()
    _kernels.clear_parts(deviating, remains.grid, centre, silhouette_rows(parts))
    return remains._replace(deviating=deviating)


def clean_remains(remains: Remains, radius_px: float) -> Remains:
    """Remove specks from the remains, and fill small enclosed areas, which are highlights and holes
    of parts. `radius_px` is the radius of a part [px]."""
    stride = remains.grid[2]
    deviating = remains.deviating.copy()
    max_hole = HOLE * np.pi * (radius_px / stride) ** 2
    count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - deviating, connectivity=4)
    height, width = deviating.shape
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, bottom = left + stats[:, cv2.CC_STAT_WIDTH], top + stats[:, cv2.CC_STAT_HEIGHT]
    hole = (stats[:, cv2.CC_STAT_AREA] <= max_hole) & (left > 0) & (top > 0)
    hole &= (right < width) & (bottom < height)
    hole[0] = False  # label 0 is the area of the objects, not a hole
    if count > 1 and np.any(hole):
        deviating[hole[labels]] = 1
    # Small specks are removed after the holes are filled. In the opposite order, a hole near the
    # edge of an object could lose its border and would not be filled.
    deviating = np.asarray(cv2.morphologyEx(deviating, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)))
    return remains._replace(deviating=deviating)


def overlooked_objects(
    remains: Remains, region: Region, radius_px: float, faint: float, contrast: LitPlate
) -> np.ndarray:
    """Return the objects (n,) OVERLOOKED of the remains. The fields x and y of the objects are not
    set.

    `radius_px` is a part's radius. Objects with a contrast below `faint` are too faint. `contrast`
    is the `contrast_image`.
    """
    x0, y0, stride = remains.grid
    levels = 1 - contrast.grey[y0::stride, x0::stride] / np.float32(contrast.light[0])
    count, labels, stats, middle = cv2.connectedComponentsWithStats(remains.deviating)
    part_area = np.pi * (radius_px / stride) ** 2
    rows = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= MIN_AREA * part_area]
    if not rows:
        return NONE_OVERLOOKED
    beside = cv2.dilate(remains.outside.astype(np.uint8), np.ones((3, 3), np.uint8))
    things = np.zeros(len(rows), OVERLOOKED)
    for thing, k in zip(things, rows, strict=True):
        left, top, wide, high, area = stats[k].tolist()
        place = np.s_[top : top + high, left : left + wide]
        in_object = labels[place] == k
        # In the area, a pixel of the blurred edge counts as a fraction of a pixel. The fraction is
        # proportional to its contrast.
        contrasts = levels[place][in_object]
        usual = float(np.median(contrasts))
        area = min(area, max(float(np.sum(contrasts)), 0.0) / max(usual, 1e-3))
        thing["x_px"], thing["y_px"] = middle[k] * stride + (x0, y0)
        thing["radius_px"] = np.sqrt(area / np.pi) * stride
        if np.any(beside[place][in_object]):
            thing["reason"] = "at the edge"
        elif area < SMALL * part_area:
            thing["reason"] = "too small"
        elif area > LARGE * part_area:
            thing["reason"] = "too large"
        elif usual < faint:
            thing["reason"] = "too faint"
        else:
            thing["reason"] = "misfit"
    inside = region.depth(things["x_px"], things["y_px"]) > 0
    things["reason"][~inside] = "beyond the plate"
    return things


@lru_cache(maxsize=4)
def _inner_pixels(region: Region, stride: int, radius_px: float) -> np.ndarray:
    """Return which pixels (h, w) bool of the grid are inside the plate, at least a radius [px] from
    its edge. Pixels nearer to the edge may show the edge of a plate that is not at home."""
    x0, y0, x1, y1 = region.box
    columns, rows = np.arange(x0, x1, stride)[None, :], np.arange(y0, y1, stride)[:, None]
    return np.asarray(region.depth(columns, rows) >= radius_px)
