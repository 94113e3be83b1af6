"""First guesses of the parts' centres: cheap, to about a pixel, also where parts touch."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numba import njit

from .brightness import PlateBrightness, bare
from .region import SEAM_PX, Region
from .votes import split

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


def find_seeds(
    grey: np.ndarray,
    region: Region,
    brightness: PlateBrightness,
    usable: np.ndarray,
    threshold: float,
    radius_px: float,
) -> np.ndarray:
    """Find the centres of dark blobs.

    Parameters
    ----------
    grey : (H, W) uint8
        Image [grey levels].
    region : Region
        Where the plate is.
    brightness : PlateBrightness
        The bare plate.
    usable : (H, W) bool
        Pixels that show the plate.
    threshold : float
        Share of the plate's brightness below which a pixel is dark.
    radius_px : float
        Radius of a part [px].

    Returns
    -------
    (n, 2) float
        Centres [px]; some may be no part.
    """
    stride = max(1, int(radius_px / COARSE_RADIUS_PX))
    xs, ys, outside = _grid(region, stride)
    if xs.size == 0 or ys.size == 0:
        return np.empty((0, 2))
    # What is outside counts as dark while eroding: a part is not eroded from the plate's edge.
    dark = outside.copy()
    _darken(grey, brightness.light(threshold), region.box[:2], stride, dark)
    eroded = cv2.erode(dark, _disc(round(EROSION * radius_px / stride)))
    core = np.asarray(eroded, dtype=np.uint8) & ~outside
    contours = cv2.findContours(core, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    whole = np.pi * ((1 - EROSION) * radius_px / stride) ** 2
    if not contours:
        return np.empty((0, 2))
    length = np.array([len(contour) for contour in contours])
    area = np.array([cv2.contourArea(contour) for contour in contours])
    size = (area + 0.5 * length + 1) / whole  # pixels, by Pick's theorem
    first = np.cumsum(length) - length
    middle = np.add.reduceat(np.concatenate(contours)[:, 0], first) / length[:, None]
    seeds = middle[(size >= MIN_CORE) & (size <= MAX_CORE)]
    seeds = seeds * stride + region.box[:2]
    large = np.flatnonzero(size > MAX_CORE)
    if not large.size:
        return seeds
    merged = np.zeros_like(core)
    boxes = []
    for index in large.tolist():
        cv2.drawContours(merged, contours, index, (1,), cv2.FILLED)
        x, y, wide, high = (length * stride for length in cv2.boundingRect(contours[index]))
        boxes.append((x, x + wide, y, y + high))
    # Around a core is what was eroded, with the edges that vote.
    pad = round(radius_px) + stride
    low, size_px = np.repeat(region.box[:2], 2), np.repeat(grey.shape[::-1], 2)
    box = np.clip(np.array(boxes) + low + (-pad, pad, -pad, pad), 0, size_px)
    grid = (int(region.box[0]), int(region.box[1]), stride)
    return np.concatenate([seeds, split(grey, brightness, usable, merged, grid, box, radius_px)])


@njit(cache=True, fastmath=True)
def _darken(
    grey: np.ndarray, light: np.ndarray, corner: tuple[int, int], stride: int, dark: np.ndarray
) -> None:
    """Set 1 in `dark` (h, w), a coarse grid from `corner`, where it is darker than `light`."""
    for row in range(dark.shape[0]):
        y = corner[1] + row * stride
        for column in range(dark.shape[1]):
            x = corner[0] + column * stride
            dark[row, column] |= grey[y, x] < bare(light, x, y)


@lru_cache(maxsize=16)
def _grid(region: Region, stride: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns (1, w) and rows (h, 1) [px] of the coarse image; 1 (h, w) where it does not
    show the plate."""
    x0, y0, x1, y1 = region.box
    xs, ys = np.arange(x0, x1, stride)[None, :], np.arange(y0, y1, stride)[:, None]
    return xs, ys, (region.depth(xs, ys) < SEAM_PX).astype(np.uint8)


@lru_cache(maxsize=16)
def _disc(radius: int) -> np.ndarray:
    """Return a round structuring element of a radius [px]."""
    reach = np.arange(-radius, radius + 1)
    return (np.hypot(reach[:, None], reach[None, :]) <= radius + 0.3).astype(np.uint8)
