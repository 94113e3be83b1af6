"""Parts that touch: one patch is split where it is narrow between two wide places.

How wide it is says the distance to its rim. Where two wide places meet, the way between them has a
narrowest point, the saddle. They are two parts if it is clearly narrower than the narrower of both.
"""

from __future__ import annotations

import cv2
import numpy as np

from .. import _kernels

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
    labels = np.zeros(depth.shape, np.int32)
    count, necks = _kernels.find_basins(depth, NECK, LEAST_DROP_PX, LEVELS_PX, labels)
    own = labels[ZOOM // 2 :: ZOOM, ZOOM // 2 :: ZOOM][1:-1, 1:-1]
    return np.ascontiguousarray(own), count, necks


def _framed(image: np.ndarray) -> np.ndarray:
    """Return an image (h + 2, w + 2) with a frame of 0."""
    return np.asarray(cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0))
