"""The blur of an image, measured at the contours of its patches. A large blur makes types look
alike."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from ..camera.encodings import grey_levels
from .patch import Patch

MAX_PX, MAX_RADIUS = 0.5, 0.144
"""Maximum blur of an image in which types are named, a standard deviation: the sum of the first
[px] and this fraction of the parts' median radius. In synthetic images nuts were taken for washers
from 2.0 px with parts of 10 px radius, and from 3.4 px with 19 px, but not with 1.8 and 3.1 px."""

POINTS = 24
"""Number of points on the contour of a patch."""

PERCENT = 25
"""Percentile of the blur at these points. A percentile is used because shadow and motion blur only
a part of a contour."""

FIRST = 8
"""Number of patches that are measured first."""

SHARP = 0.6
"""Fraction of the maximum blur below which the first patches alone show that the image is sharp. In
images with too much blur, the first patches have at least 0.8 of the maximum."""

BESIDE_PX = 9.0
"""Maximum length of a profile on each side of the contour [px]."""

BESIDE_RADIUS = 0.6
"""Maximum length of a profile on each side of the contour, relative to the radius. The smaller of
both maxima is used."""

STEPS = 13
"""Number of samples of a profile."""

SECANT = 3
"""Distance to the two neighbours on the contour that give its direction [points of the contour]."""


def is_blurred(image: np.ndarray, patches: Sequence[Patch]) -> bool:
    """Whether an image (H, W) or (H, W, 3) uint8 is so blurred, measured by its patches, that types
    may be confused."""
    usable = [patch for patch in patches if patch.whole and not patch.group]
    if not usable:
        return False
    grey, radius_px = grey_levels(image), np.array([patch.radius_px for patch in usable])
    limit_px = MAX_PX + MAX_RADIUS * float(np.median(radius_px))
    step = -(-len(usable) // FIRST)
    if edge_blur_px(grey, usable[::step], radius_px[::step]) < SHARP * limit_px:
        return False
    return edge_blur_px(grey, usable, radius_px) > limit_px


def edge_blur_px(grey: np.ndarray, patches: Sequence[Patch], radius_px: np.ndarray) -> float:
    """Return the blur of the contours of patches of radii (n,) [px] in an image (H, W) uint8, a
    standard deviation [px]: contrast / (sqrt(2 pi) slope), the median over the patches."""
    points, secants = [], []
    for patch in patches:
        contours, _ = cv2.findContours(
            patch.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        contour = max(contours, key=len)[:, 0].astype(np.float32)
        row = np.arange(POINTS) * len(contour) // POINTS
        points.append(contour[row] + np.array(patch.corner, np.float32))
        secants.append(contour[(row + SECANT) % len(contour)] - contour[row - SECANT])
    point, along = np.stack(points), np.stack(secants)
    across = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    across /= np.maximum(np.hypot(along[..., 0], along[..., 1]), 1e-6)[..., None]
    reach = np.minimum(BESIDE_PX, BESIDE_RADIUS * radius_px).astype(np.float32)
    step = reach[:, None, None, None] * np.linspace(-1, 1, STEPS, dtype=np.float32)[:, None]
    place = point[:, :, None] + step * across[:, :, None]
    x, y = cv2.split(place.reshape(-1, STEPS, 2))
    level = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    level = level.reshape(len(patches), POINTS, STEPS).astype(np.float32)
    contrast = np.abs(level[..., -1] - level[..., 0])
    slope = np.abs(np.diff(level, axis=2)).max(axis=2) * ((STEPS - 1) / 2 / reach)[:, None]
    blur = contrast / (math.sqrt(2 * math.pi) * np.maximum(slope, 1e-3))
    return float(np.median(np.percentile(blur, PERCENT, axis=1)))
