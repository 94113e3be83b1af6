"""Faint patches of a part's size that the detector misses. The patches are counted for the
diagnostics.

The mean over the area of a part is compared with the mean over a ring around it. Both means average
many pixels. Therefore the difference of the two means shows contrasts far below the noise of a
single pixel.
"""

from __future__ import annotations

import cv2
import numpy as np

from plate_core.status import Finding, Level

from .camera.encodings import grey_levels
from .overlooked import REMEDIES, WARN_COUNT, WARN_FRACTION
from .plate.region import Region

INNER = 1.6
"""Side of the square over which the grey levels of a part are averaged [part radii]. The part
contains this square except its corners."""

RING = (2.6, 4.6)
"""Sides of the squares that bound the ring outside the part [part radii]."""

NOISE_FACTOR = 8.0
"""Minimum contrast of a patch to the ring around it, relative to the standard deviation of this
contrast over the plate [-]. This limit excludes texture."""

MIN_CONTRAST = 2.0
"""Minimum contrast of a patch [grey levels]. This limit excludes stripes and spots of the light."""

CLEAR = 3.4
"""Minimum distance of a patch from parts and other objects [part radii]. Nearer patches are ignored
because they may be shadows."""

SPREAD = 0.6
"""Maximum contrast at 1.2 radii from a patch's centre, as a fraction of the contrast in the centre.
Shadows of other objects and stripes exceed this limit, because they are larger than a part."""


COARSE_PX = 4.0
"""Radius of a part in a reduced image [px]. Images with larger parts are reduced to this radius to
save computing time."""


def faint_patches(
    image: np.ndarray, region: Region, radius_px: float, taken_px: np.ndarray, margin_px: float
) -> tuple[np.ndarray, float]:
    """Return the centres (n, 2) [px] of faint patches of a part's size, and their median contrast
    to the plate [grey levels].

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
    region : Region
        Region of the plate in the image.
    radius_px : float
        Radius of a part [px].
    taken_px : (m, 2)
        Centres of detected parts and other objects [px].
    margin_px : float
        Minimum distance of a patch from the predicted edge of the plate [px]. Nearer patches are
        ignored, because the plate may be away from home.
    """
    wide = 2 * round(margin_px) + 1
    free = cv2.erode(region.usable.astype(np.uint8), np.ones((wide, wide), np.uint8))
    free = np.asarray(free, np.float32)
    for x, y in taken_px:
        cv2.circle(free, (round(x), round(y)), round(CLEAR * radius_px), 0.0, -1)
    grey = grey_levels(image).astype(np.float32)
    step = max(round(radius_px / COARSE_PX), 1)
    size_px = grey.shape[1] // step, grey.shape[0] // step
    grey = np.asarray(cv2.resize(grey, size_px, interpolation=cv2.INTER_AREA), np.float32)
    free = np.floor(cv2.resize(free, size_px, interpolation=cv2.INTER_AREA)).astype(np.float32)
    radius_px /= step
    inner, low, high = (_box_sums(grey, free, side * radius_px) for side in (INNER, *RING))
    ring = (high[0] - low[0]) / np.maximum(high[1] - low[1], 1e-6)
    # The measured patch and the complete ring around it must be on the visible plate.
    is_free = (high[1] > 0.98 * (round(RING[1] * radius_px) | 1) ** 2) & (free > 0)
    if not np.any(is_free):
        return np.zeros((0, 2)), 0.0
    contrast = np.where(is_free, inner[0] / np.maximum(inner[1], 1e-6) - ring, 0.0)
    values = contrast[is_free]
    noise = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    size = np.abs(contrast - float(np.median(values))) * is_free
    reach = round(2 * radius_px) | 1
    peak = cv2.dilate(size, np.ones((reach, reach), np.uint8))
    rows, columns = np.nonzero((size >= peak) & (size > max(MIN_CONTRAST, NOISE_FACTOR * noise)))
    found = []
    for x, y in zip(columns.tolist(), rows.tolist(), strict=True):
        if _is_round(contrast, x, y, radius_px):
            found.append((x, y, size[y, x]))
    if not found:
        return np.zeros((0, 2)), 0.0
    places = np.array(found)
    return step * (places[:, :2] + 0.5) - 0.5, float(np.median(places[:, 2]))


def faint_finding(count: int, contrast: float, taken: int) -> Finding | None:
    """Return a finding about faint patches that are not detected, or None if there are none.
    `taken` is the number of detected parts."""
    if not count:
        return None
    are = "1 faint patch with the size of a part is"
    if count > 1:
        are = f"{count} faint patches with the size of a part are"
    many = not taken or (count >= WARN_COUNT and count > WARN_FRACTION * (count + taken))
    return Finding(
        Level.WARN if many else Level.OK,
        f"{are} not detected as parts; contrast to the plate is {contrast:.2g} grey levels; "
        f"{REMEDIES['too faint']}",
    )


def _box_sums(grey: np.ndarray, free: np.ndarray, side_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, for a square around each pixel, the sum of the free pixels' grey levels (H, W) and
    the number of free pixels (H, W)."""
    side = round(side_px) | 1

    def sum_box(values: np.ndarray) -> np.ndarray:
        return np.asarray(
            cv2.boxFilter(
                values, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
            )
        )

    return sum_box(grey * free), sum_box(free)


def _is_round(contrast: np.ndarray, x: int, y: int, radius_px: float) -> bool:
    """Whether the contrast decreases in all eight directions within 1.2 radii of a point."""
    angle = 2 * np.pi * np.arange(8) / 8
    columns = np.rint(x + 1.2 * radius_px * np.cos(angle)).astype(int)
    rows = np.rint(y + 1.2 * radius_px * np.sin(angle)).astype(int)
    height, width = contrast.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    around = contrast[rows[inside], columns[inside]] / contrast[y, x]
    return bool(np.all(around < SPREAD))
