"""Parts that touch: one patch is split where it is narrow between two wide places.

How wide it is says the distance to its rim. Where two wide places meet, the way between them has a
narrowest point, the saddle. They are two parts if it is clearly narrower than the narrower of both.
"""

from __future__ import annotations

import cv2
import numpy as np

from plate_core.kernels import inner_kernel, kernel

ZOOM = 2
"""Finer pixels in which patches are split."""

NECK = 0.78
"""Widest neck between two parts, relative to the width of the narrower: that of a bracket or a
screw is as wide as its arm."""

LEAST_DROP_PX = 0.6
"""A neck is narrower on each side by at least so much [px]: less is noise of the rim."""

LEVEL = 0.8
"""Cover from which on a pixel counts for the width: the gap between blurred parts is deeper."""

LEVELS_PX = 16
"""Steps of the distance for each pixel, in which pixels are sorted."""


THIN_PX, THINNER = 2.2, 0.3
"""Half the width of what is never parted from something wider: a wire, a ragged rim [px]; and
relative to that."""

MOST_NECKS = 200
"""Necks of one patch that are kept."""


def split(cover: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, int, np.ndarray]:
    """Split a patch.

    Parameters
    ----------
    cover : (h, w) float32
        How much of each pixel is part.
    mask : (h, w) bool
        Its pixels.

    Returns
    -------
    (h, w) int32, int
        Number of the part to which each pixel belongs, from 1, 0 outside; how many parts.
    (n, 3) float64
        Necks between two parts: their numbers, and how wide it is relative to the narrower.
    """
    framed = _framed(np.where(mask, cover, np.float32(0)))
    size = (ZOOM * framed.shape[1], ZOOM * framed.shape[0])
    fine = cv2.resize(framed, size, interpolation=cv2.INTER_LINEAR)
    inner = cv2.distanceTransform((fine > LEVEL).astype(np.uint8), cv2.DIST_L2, 5)
    outer = cv2.distanceTransform(
        cv2.resize(_framed(mask.astype(np.uint8)), size, interpolation=cv2.INTER_NEAREST),
        cv2.DIST_L2,
        3,
    )
    depth = np.where(outer > 0, inner + 0.02 * outer, 0).astype(np.float32) / ZOOM
    labels, count, necks = _basins(depth, NECK, LEAST_DROP_PX, LEVELS_PX)
    own = labels[ZOOM // 2 :: ZOOM, ZOOM // 2 :: ZOOM][1:-1, 1:-1]
    return np.ascontiguousarray(own), count, necks


def _framed(image: np.ndarray) -> np.ndarray:
    """Return an image (h + 2, w + 2) with a frame of 0."""
    return np.asarray(cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0))


@inner_kernel
def _root(parent: np.ndarray, flood: int) -> int:
    """Return the flood that this one has become part of."""
    while parent[flood] != flood:
        flood = parent[flood]
    return flood


@kernel(error_model="numpy")
def _basins(
    depth: np.ndarray, neck: float, least_drop: float, levels: int
) -> tuple[np.ndarray, int, np.ndarray]:
    """Flood a distance (h, w) from its peaks downwards: labels (h, w), how many there are, and the
    necks (n, 3) between them.

    Where two floods meet they are one, unless both peaks are well above.
    """
    height, width = depth.shape
    # Sort pixels by counting them in steps of the distance.
    top = 0
    for y in range(height):
        for x in range(width):
            top = max(top, int(depth[y, x] * levels))
    start = np.zeros(top + 2, np.int64)
    for y in range(height):
        for x in range(width):
            if depth[y, x] > 0:
                start[top - np.int64(depth[y, x] * levels) + 1] += 1
    for k in range(top + 1):
        start[k + 1] += start[k]
    order = np.empty(start[top + 1], np.int64)
    for y in range(height):
        for x in range(width):
            if depth[y, x] > 0:
                k = top - int(depth[y, x] * levels)
                order[start[k]] = y * width + x
                start[k] += 1
    labels = np.zeros((height, width), np.int32)
    parent = np.zeros(len(order) + 1, np.int32)
    peak = np.zeros(len(order) + 1, np.float64)
    basins = 0
    meeting = np.zeros((MOST_NECKS, 2), np.int32)
    saddle = np.zeros(MOST_NECKS, np.float64)
    meetings = 0
    for pixel in order:
        y, x = divmod(int(pixel), width)
        here = depth[y, x]
        own = np.int32(0)
        nearest, best = np.int32(0), 0.0
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if not (0 <= y + dy < height and 0 <= x + dx < width):
                    continue
                other = labels[y + dy, x + dx]
                if other == 0:
                    continue
                rise = (depth[y + dy, x + dx] - here) / np.sqrt(np.float64(dx * dx + dy * dy))
                if nearest == 0 or rise > best:
                    nearest, best = other, rise
                other = _root(parent, other)
                if own == 0 or own == other:
                    own = other
                    continue
                lower = min(peak[own], peak[other])
                thin = lower < THIN_PX and lower < THINNER * max(peak[own], peak[other])
                if here >= neck * lower or lower - here < least_drop or thin:
                    if peak[own] < peak[other]:
                        own, other = other, own
                    parent[other] = own
                elif meetings < MOST_NECKS:
                    new = True
                    for m in range(meetings):
                        a, b = _root(parent, meeting[m, 0]), _root(parent, meeting[m, 1])
                        if (a == own and b == other) or (a == other and b == own):
                            new = False
                            break
                    if new:
                        meeting[meetings, 0], meeting[meetings, 1] = own, other
                        saddle[meetings] = here
                        meetings += 1
        if own == 0:
            basins += 1
            nearest = np.int32(basins)
            parent[nearest] = nearest
            peak[nearest] = here
        labels[y, x] = nearest
    number = np.zeros(basins + 1, np.int32)
    count = 0
    for k in range(1, basins + 1):
        if parent[k] == k:
            count += 1
            number[k] = count
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label:
                labels[y, x] = number[_root(parent, label)]
    necks = np.zeros((meetings, 3), np.float64)
    for m in range(meetings):
        a, b = _root(parent, meeting[m, 0]), _root(parent, meeting[m, 1])
        necks[m, 0], necks[m, 1] = number[a], number[b]
        necks[m, 2] = saddle[m] / min(peak[a], peak[b])
    return labels, count, necks
