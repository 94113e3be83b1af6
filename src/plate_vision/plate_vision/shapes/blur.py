"""The blur of an image, measured at the contours of its patches. If the blur is large, different
types look similar."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from ..camera.encodings import grey_levels
from .patch import Patch

MAX_PX, MAX_RADIUS = 0.5, 0.144
"""Maximum blur (standard deviation) of an image in which types are determined: `MAX_PX` [px] plus
`MAX_RADIUS` times the parts' median radius. In synthetic images with a blur of 2.0 px or more, nuts
of 10 px radius were recognised as washers. With a blur of 1.8 px, the nuts were recognised
correctly. For nuts of 19 px radius, the corresponding values were 3.4 px and 3.1 px."""

POINTS = 24
"""Number of points on the contour of a patch."""

PERCENT = 25
"""Percentile of the blur at the points of a contour. This percentile is used as the blur of the
patch. A low percentile is used because shadows and motion blur only some sections of a contour."""

FIRST = 8
"""Maximum number of patches whose blur is measured first. If these patches are sharp, no other
patches are measured."""

SHARP = 0.6
"""Maximum blur of the first patches in an image that is certainly sharp, relative to the maximum
blur [-]. In such an image, the other patches are not measured. In images with too much blur, the
blur of the first patches is at least 0.8 times the maximum."""

BESIDE_PX = 9.0
"""Maximum length of a profile on each side of the contour [px]."""

BESIDE_RADIUS = 0.6
"""Maximum length of a profile on each side of the contour, relative to the radius. The smaller of
both maxima is used."""

STEPS = 13
"""Number of samples of a profile."""

SECANT = 3
"""Distance along a contour [points]. The contour's direction at a point is computed from the two
points at this distance before and after it."""


def is_blurred(image: np.ndarray, patches: Sequence[Patch]) -> bool:
    """Whether an image (H, W) or (H, W, 3) uint8 is so blurred that types may be confused. The blur
    is measured at the patches of the image."""
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
    """Return the blur of the contours of patches with radii (n,) [px] in an image (H, W) uint8. The
    blur is a standard deviation [px].

    At each point of a contour, the blur is contrast / (sqrt(2 pi) slope). The result is the median
    over the patches of a low percentile (`PERCENT`) over the points of each contour."""
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
