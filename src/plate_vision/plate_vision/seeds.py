"""First guesses of the parts' centres: cheap, to about a pixel, also where parts touch."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from .brightness import PlateBrightness
from .region import SEAM_PX, Region

COARSE_RADIUS_PX = 4.0
"""Radius [px] that a part keeps when rows and columns are skipped for speed."""

EROSION = 0.5
"""Rim taken off every dark blob, in part radii: cuts the neck between parts that touch, and
removes the thin dark line of a plate that is displaced a little."""

MIN_CORE = 0.1
"""Smallest eroded blob, relative to that of a whole part: what is left of a part of which hardly
half is on the plate, a quarter in a corner, or which is 0.8 as large as expected."""

MAX_CORE = 1.5
"""Largest eroded blob that is taken for one part."""

PEAK = (0.6, 1.5)
"""Least and greatest distance from a part's centre to the bright plate, in part radii, in a merged
blob: what is deeper is no part but something large."""

GAP = 0.35
"""Half width of the gaps looked for between the parts of a merged blob, in part radii: between
three parts that touch is room for a circle of 0.15 radii."""

GAP_DARKNESS = 0.8
"""Darkness, relative to what surrounds it, below which a pixel is such a gap."""

SEPARATION = 1.3
"""Least distance of two centres in a merged blob, in part radii: parts that touch have 2."""


def find_seeds(
    grey: np.ndarray,
    region: Region,
    brightness: PlateBrightness,
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
    coarse = grey[region.box[1] : region.box[3] : stride, region.box[0] : region.box[2] : stride]
    dark = (coarse < threshold * brightness.at(xs, ys)).view(np.uint8)
    # What is outside counts as dark while eroding: a part is not eroded from the plate's edge.
    eroded = cv2.erode(dark | outside, _disc(round(EROSION * radius_px / stride)))
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
    for index in np.flatnonzero(size > MAX_CORE).tolist():
        x, y, width, height = (length * stride for length in cv2.boundingRect(contours[index]))
        box = (x + region.box[0], y + region.box[1], width, height)
        centres = _split(grey, region, brightness, threshold, radius_px, box)
        inside = np.zeros_like(core)
        cv2.drawContours(inside, contours, index, (1,), cv2.FILLED)
        column, row = ((centres - region.box[:2]) / stride).astype(int).T
        seeds = np.concatenate([seeds, centres[inside[row, column] > 0]])
    return seeds


def _split(
    grey: np.ndarray,
    region: Region,
    brightness: PlateBrightness,
    threshold: float,
    radius_px: float,
    box: tuple[int, int, int, int],
) -> np.ndarray:
    """Return the centres (n, 2) [px] of parts that touch, in a box x, y, width, height [px].

    A part's centre is where the distance to the bright plate and to the gaps between parts is
    greatest: first the best such point, then the next best that is not too near, and so on.
    """
    pad = round(radius_px)
    x0, y0 = max(box[0] - pad, region.box[0]), max(box[1] - pad, region.box[1])
    x1 = min(box[0] + box[2] + pad, region.box[2])
    y1 = min(box[1] + box[3] + pad, region.box[3])
    xs, ys = np.arange(x0, x1)[None, :], np.arange(y0, y1)[:, None]
    darkness = 1 - grey[y0:y1, x0:x1] / brightness.at(xs, ys)
    filled = cv2.morphologyEx(darkness, cv2.MORPH_CLOSE, _disc(round(GAP * radius_px)))
    part = (darkness > 1 - threshold) & (darkness > GAP_DARKNESS * filled)
    inside = region.depth(xs, ys) >= SEAM_PX
    solid = (part | ~inside).astype(np.uint8)
    distance = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = cv2.GaussianBlur(distance, (3, 3), 0)
    peak = (distance >= cv2.dilate(distance, _disc(round(radius_px / 2)))) & inside
    peak &= (distance > PEAK[0] * radius_px) & (distance < PEAK[1] * radius_px)
    y, x = np.nonzero(peak)
    points = np.stack([x, y], axis=1)[np.argsort(-distance[y, x], kind="stable")].astype(float)
    chosen = []
    while len(points):
        chosen.append(points[0])
        points = points[np.hypot(*(points - points[0]).T) > SEPARATION * radius_px]
    return np.array(chosen).reshape(-1, 2) + np.array([x0, y0])


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
