"""First guesses of the parts' centres: cheap, to about a pixel, also where parts touch.

Dark blobs are eroded. What is then as large as one part is one; in what is larger, every piece of
edge votes for the point one radius inside it: a Hough transform for one radius.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from .. import _kernels
from ..plate.light import LitPlate

COARSE_RADIUS_PX = 3.5
"""Least radius [px] that a part keeps when rows and columns are skipped for speed."""

EROSION = 0.5
"""Rim taken off every dark blob, in part radii: cuts the neck between parts that touch, and
removes the thin dark line of a plate that is displaced a little."""

MIN_CORE = 0.1
"""Smallest eroded blob, relative to that of a whole part: what is left of a part of which hardly
half is on the plate, a quarter in a corner, or which is 0.8 as large as expected."""

MAX_CORE = 1.5
"""Largest eroded blob that is taken for one part."""

SPREAD = 0.2
"""Votes are counted together over this many radii to either side: how well a radius is known."""


def find_seeds(
    plate: LitPlate, box: tuple[int, int, int, int], threshold: float, radius_px: float
) -> np.ndarray:
    """Find the centres (n, 2) [px] of dark blobs; some may be no part.

    Parameters
    ----------
    plate : LitPlate
    box : (int, int, int, int)
        Pixels x0, y0, x1, y1, half open, that hold the plate.
    threshold : float
        Fraction of the plate's brightness below which a pixel is dark.
    radius_px : float
        Radius of a part [px].
    """
    stride = max(1, int(radius_px / COARSE_RADIUS_PX))
    grid = (box[0], box[1], stride)
    # What is outside counts as dark while eroding: a part is not eroded from the plate's edge.
    outside = ~plate.usable[box[1] : box[3] : stride, box[0] : box[2] : stride]
    if outside.size == 0:
        return np.empty((0, 2))
    dark = np.empty(outside.shape, np.uint8)
    _kernels.find_dark(*plate, threshold, grid, outside, dark)
    core = cv2.erode(dark, _disc(round(EROSION * radius_px / stride))) > outside
    whole = np.pi * ((1 - EROSION) * radius_px / stride) ** 2
    merged = np.zeros_like(core)
    seeds, boxes = _kernels.find_blobs(core, MIN_CORE * whole, MAX_CORE * whole, merged)
    seeds = seeds * stride + box[:2]
    if not len(boxes):
        return seeds
    # Around a core is what was eroded, with the edges that vote.
    pad = round(radius_px) + stride
    low, size_px = np.repeat(box[:2], 2), np.repeat(plate.grey.shape[::-1], 2)
    boxes = np.clip(boxes * stride + low + (-pad, pad, -pad, pad), 0, size_px)
    return np.concatenate([seeds, _split(plate, merged, grid, boxes, radius_px)])


@lru_cache(maxsize=16)
def _disc(radius: int) -> np.ndarray:
    """Return a round structuring element of a radius [px]."""
    reach = np.arange(-radius, radius + 1)
    return (np.hypot(reach[:, None], reach[None, :]) <= radius + 0.3).astype(np.uint8)


def _split(
    plate: LitPlate,
    merged: np.ndarray,
    grid: tuple[int, int, int],
    boxes: np.ndarray,
    radius_px: float,
) -> np.ndarray:
    """Return the centres (n, 2) [px] of parts in dark areas that are too large for one.

    They may be where `merged` (h, w) is true, on a grid (first x, first y, step [px]); `boxes`
    (m, 4) are the pixels x0, x1, y0, y1, half open, around each of these areas.
    """
    found = np.empty((0, 2))
    side = 2 * (2 * max(1, round(SPREAD * radius_px)) + 1,)
    for x0, x1, y0, y1 in boxes.tolist():
        votes = np.zeros((y1 - y0, x1 - x0), np.float32)
        _kernels.vote(*plate, x0, y0, radius_px, votes)
        votes = cv2.boxFilter(votes, -1, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        # Boxes may overlap, so that a part is found in two of them.
        for x, y in _kernels.find_peaks(votes, x0, y0, merged, grid, radius_px):
            if _kernels.nearest(found, x, y) > radius_px**2:
                found = np.vstack([found, (x, y)])
    return found
