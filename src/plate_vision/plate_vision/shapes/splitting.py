"""Separation of touching parts: a patch is split where it is narrow between two wide areas.

The width is measured by the distance to the patch's contour. Between two wide areas, this distance
has a saddle point, which is called the neck. If the neck is clearly narrower than the narrower
area, the areas are two parts. The method is a watershed of the distance transform.
"""

from __future__ import annotations

import cv2
import numpy as np

from .. import _kernels

ZOOM = 2
"""Factor by which the resolution of a patch is increased before it is split."""

NECK = 0.78
"""Maximum width of a neck between two parts, relative to the width of the narrower part. Within one
part, such as a bracket or a screw, the neck is as wide as the arm."""

MIN_DROP_PX = 0.6
"""Minimum difference between the half width of a part and the half width of the neck [px]. A
difference below this minimum is noise."""

LEVEL = 0.8
"""Minimum cover (fraction that the part covers) of a pixel that counts for the width. The cover is
smaller in the gap between blurred parts."""

LEVELS_PX = 16
"""Resolution of the distances when pixels are sorted [steps per pixel]."""


def split_patch(cover: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, int, np.ndarray]:
    """Split a patch.

    Parameters
    ----------
    cover : (h, w) float32
        Fraction of each pixel that the part covers.
    mask : (h, w) bool
        Pixels of the patch.

    Returns
    -------
    (h, w) int32
        Number of the part to which each pixel belongs, from 1; 0 outside.
    int
        Number of parts.
    (n, 3) float64
        Necks. Each row contains the numbers of two parts, and the width of the neck between them,
        relative to the width of the narrower part.
    """
    framed = _add_frame(np.where(mask, cover, np.float32(0)))
    size = (ZOOM * framed.shape[1], ZOOM * framed.shape[0])
    fine = cv2.resize(framed, size, interpolation=cv2.INTER_LINEAR)
    inner = cv2.distanceTransform((fine > LEVEL).astype(np.uint8), cv2.DIST_L2, 5)
    outer = cv2.distanceTransform(
        cv2.resize(_add_frame(mask.astype(np.uint8)), size, interpolation=cv2.INTER_NEAREST),
        cv2.DIST_L2,
        3,
    )
    depth = np.where(outer > 0, inner + 0.02 * outer, 0).astype(np.float32) / ZOOM
    labels = np.zeros(depth.shape, np.int32)
    count, necks = _kernels.find_basins(depth, NECK, MIN_DROP_PX, LEVELS_PX, labels)
    unzoomed = labels[ZOOM // 2 :: ZOOM, ZOOM // 2 :: ZOOM][1:-1, 1:-1]
    return np.ascontiguousarray(unzoomed), count, necks


def _add_frame(image: np.ndarray) -> np.ndarray:
    """Return an image (h + 2, w + 2) with a frame of 0."""
    return np.asarray(cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0))
