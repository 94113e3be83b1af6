"""First guesses of the parts' centres: cheap, to about a pixel, also where parts touch."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numba import njit

from .brightness import bare
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
    light: np.ndarray,
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
    light : (9,)
        The bare plate, of `fit_brightness`.
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
    _darken(grey, light, threshold, region.box[:2], stride, dark)
    core = cv2.erode(dark, _disc(round(EROSION * radius_px / stride))) > outside
    whole = np.pi * ((1 - EROSION) * radius_px / stride) ** 2
    places = np.flatnonzero(core)
    seeds, boxes, merged = _blobs(core, places, MIN_CORE * whole, MAX_CORE * whole)
    seeds = seeds * stride + region.box[:2]
    if not len(boxes):
        return seeds
    # Around a core is what was eroded, with the edges that vote.
    pad = round(radius_px) + stride
    low, size_px = np.repeat(region.box[:2], 2), np.repeat(grey.shape[::-1], 2)
    box = np.clip(boxes * stride + low + (-pad, pad, -pad, pad), 0, size_px)
    grid = (int(region.box[0]), int(region.box[1]), stride)
    return np.concatenate([seeds, split(grey, light, usable, merged, grid, box, radius_px)])


@njit(cache=True, fastmath=True, error_model="numpy")
def _darken(
    grey: np.ndarray,
    light: np.ndarray,
    share: float,
    corner: tuple[int, int],
    stride: int,
    dark: np.ndarray,
) -> None:
    """Set 1 in `dark` (h, w), a coarse grid from `corner`, where there is less than a share of the
    light."""
    light = light.copy()
    light[:6] *= np.float32(share)
    for row in range(dark.shape[0]):
        y = corner[1] + row * stride
        for column in range(dark.shape[1]):
            x = corner[0] + column * stride
            dark[row, column] |= grey[y, x] < bare(light, x, y)


@njit(cache=True, error_model="numpy")
def _blobs(
    core: np.ndarray, places: np.ndarray, least: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centres x, y (n, 2) of the blobs in `core` (h, w) of `least` to `most` pixels; the
    boxes x0, x1, y0, y1 (m, 4), half open, of larger ones, and a mask (h, w) of these.

    `places` are the indices of the pixels in blobs; `core` is False everywhere afterwards.
    """
    height, width = core.shape
    xs, ys = np.empty(len(places), np.int64), np.empty(len(places), np.int64)
    centres, boxes = np.empty((len(places), 2)), np.empty((len(places), 4), np.int64)
    merged = np.zeros_like(core)
    whole, large = 0, 0
    for place in places:
        y, x = divmod(place, width)
        if not core[y, x]:
            continue
        core[y, x] = False
        xs[0], ys[0], size, done = x, y, 1, 0
        while done < size:
            for row in range(max(ys[done] - 1, 0), min(ys[done] + 2, height)):
                for column in range(max(xs[done] - 1, 0), min(xs[done] + 2, width)):
                    if core[row, column]:
                        core[row, column] = False
                        xs[size], ys[size] = column, row
                        size += 1
            done += 1
        if size > most:
            x0, x1, y0, y1 = xs[:size].min(), xs[:size].max(), ys[:size].min(), ys[:size].max()
            boxes[large] = x0, x1 + 1, y0, y1 + 1
            large += 1
            for k in range(size):
                merged[ys[k], xs[k]] = True
        elif size >= least:
            centres[whole] = xs[:size].mean(), ys[:size].mean()
            whole += 1
    return centres[:whole], boxes[:large], merged


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
