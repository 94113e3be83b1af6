"""Seeds: first guesses of the parts' centres. Seeds are computed fast, with errors of about a
pixel, even where parts touch.

Dark blobs are eroded. The centre of an eroded blob of one part's size is one seed. If the blob is
larger than one part, each pixel at an edge votes for the point one radius inside the edge. This
voting is a Hough transform for one radius.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from ..plate.region import Region
from .silhouette import SILHOUETTE, Silhouettes, reach_limits, silhouette_rows, to_image

COARSE_RADIUS_PX = 3.5
"""Minimum radius of a part on the coarse grid [grid steps]. The grid skips rows and columns to save
time."""

EROSION = 0.5
"""Width by which dark blobs are eroded [part radii]. The erosion separates parts that touch, and
removes the thin dark line of a plate that is displaced a little."""

MIN_CORE = 0.1
"""Minimum size of an eroded blob, relative to the eroded blob of a whole part. With this limit, a
part is found if almost half of its area is on the plate. In a corner of the plate, a quarter of its
area is sufficient. A part with 0.8 times the expected radius is also found."""

MAX_CORE = 1.5
"""Maximum size of an eroded blob that counts as one part, relative to the blob of a whole part."""

SPREAD = 0.2
"""Half width of the window over which votes are summed [part radii]. This width is the maximum
error of the radius."""


def find_seeds(
    plate: LitPlate,
    region: Region,
    threshold: float,
    radius_px: float,
    silhouettes: Silhouettes,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (n, 2) [px] of possible parts in dark blobs, and the silhouettes (n,)
    SILHOUETTE of a part at these places.

    Parameters
    ----------
    plate : LitPlate
    region : Region
        Region of the plate in the image.
    threshold : float
        Fraction of the plate's brightness below which a pixel is dark.
    radius_px : float
        Smallest radius of a part in the image [px].
    silhouettes : callable
        Returns the silhouettes of a part at image points.
    """
    stride = max(1, int(radius_px / COARSE_RADIUS_PX))
    # Pixels outside the plate count as dark. Without this rule, the erosion would remove pixels of
    # parts at the plate's edge.
    outside = region.outside(stride)
    if outside.size == 0:
        return np.empty((0, 2)), np.empty(0, SILHOUETTE)
    dark = np.empty(outside.shape, np.uint8)
    grid = (*region.box[:2], stride)
    _kernels.find_dark(*plate.pixels, threshold, grid, outside, dark)
    return seeds_of(plate, dark, outside, grid, radius_px, silhouettes)


def seeds_of(
    plate: LitPlate,
    dark: np.ndarray,
    outside: np.ndarray,
    grid: tuple[int, int, int],
    radius_px: float,
    silhouettes: Silhouettes,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the places (n, 2) [px] of parts in dark pixels (h, w) uint8 of a coarse grid.

    `outside` (h, w) bool is true for pixels outside the plate. The array `dark` marks the pixels
    outside the plate as dark. `grid` is the first x, the first y and the step [px]. Other
    parameters as in `find_seeds`.
    """
    x0, y0, stride = grid
    eroded = round(EROSION * radius_px / stride)
    core = cv2.erode(dark, _disc_element(eroded)) > outside
    number = np.zeros(core.shape, np.int32)
    blobs = _kernels.find_blobs(core, number)
    if not len(blobs):
        return np.empty((0, 2)), np.empty(0, SILHOUETTE)
    middle = blobs[:, :2] * stride + (x0, y0)
    parts = silhouettes(middle)
    lean = parts["lean_px"]
    leans = np.any(lean)
    inner = parts["radius_px"] - EROSION * radius_px
    expected_area = np.pi * inner**2
    if leans:
        expected_area += 2 * inner * np.hypot(*lean.T)
    size = blobs[:, 2] / (expected_area / stride**2)
    large = size > MAX_CORE
    single = (size >= MIN_CORE) & ~large
    # In an oblique view, the centre of a part's blob is half-way between the centres of its base
    # and its top.
    seeds = middle[single]
    if leans:
        seeds = seeds - 0.5 * to_image(parts[single], lean[single])
    if not np.any(large):
        return seeds, parts[single]
    # Extend the boxes of the blobs so that they contain the eroded pixels and the edges that vote
    # in the Hough transform.
    pad = np.rint(reach_limits(parts[large])).astype(int)[:, None] + stride
    low, size_px = np.repeat((x0, y0), 2), np.repeat(plate.grey.shape[::-1], 2)
    boxes = np.clip(blobs[large, 3:].astype(int) * stride + low + pad * (-1, 1, -1, 1), 0, size_px)
    merged = np.concatenate([[False], large])[number]
    split = _split_dark_areas(plate, merged, grid, boxes, parts[large])
    parts = np.concatenate([parts[single], silhouettes(split)])
    return np.concatenate([seeds, split]), parts


@lru_cache(maxsize=16)
def _disc_element(radius: int) -> np.ndarray:
    """Return a round structuring element of a radius [px]."""
    reach = np.arange(-radius, radius + 1)
    return (np.hypot(reach[:, None], reach[None, :]) <= radius + 0.3).astype(np.uint8)


def _split_dark_areas(
    plate: LitPlate,
    merged: np.ndarray,
    grid: tuple[int, int, int],
    boxes: np.ndarray,
    parts: np.ndarray,
) -> np.ndarray:
    """Return the places (n, 2) [px] of parts in dark areas that are too large for one part.

    Places are only found where `merged` (h, w) is true on a grid (first x, first y, step [px]).
    `boxes` (m, 4) are the pixel ranges x0, x1, y0, y1, half open, around the areas. `parts` (m,)
    SILHOUETTE are the silhouettes of a part in these areas.
    """
    found = np.empty((0, 2))
    for (x0, x1, y0, y1), part in zip(boxes.tolist(), np.split(parts, len(parts)), strict=True):
        radius_px = float(part["radius_px"][0])
        side = 2 * (2 * max(1, round(SPREAD * radius_px)) + 1,)
        votes = np.zeros((y1 - y0, x1 - x0), np.float32)
        _kernels.vote(*plate.pixels, x0, y0, silhouette_rows(part), votes)
        votes = cv2.boxFilter(votes, -1, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        # The boxes may overlap. Therefore ignore a part that was already detected in another box.
        for x, y in _kernels.find_peaks(votes, x0, y0, merged, grid, radius_px):
            if _kernels.nearest(found, x, y) > radius_px**2:
                found = np.vstack([found, (x, y)])
    return found
