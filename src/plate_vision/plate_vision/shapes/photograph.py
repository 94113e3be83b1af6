"""Properties of the patches of a photograph: their centres, sizes, directions and contrasts.

`find_outlines` needs no description of the parts. The function uses a model of the photograph's
background.
"""

from __future__ import annotations

import cv2
import numpy as np

from .background import Background, colours_like, model_background, steepness
from .segmentation import find_patches

MAX_PIXELS = 1_000_000
"""Maximum number of pixels that are evaluated. Larger images are reduced first, because parts
remain large enough."""

ROUND = 0.95
"""Minimum of 4 pi area / length^2 for the hull of a disc. For a regular octagon, the value is
0.948."""

SURE = 60.0
"""Minimum contrast of a clear object [grey levels]. Below this contrast, the confidence is
reduced."""

SOFT = 0.3
"""Maximum gradient at the contour of a soft patch, relative to the background's limit [1/px]. The
lower quartile over the contour is used. A patch that is both soft and frayed (`FRAYED`) is
rejected, because it is not a part."""

FRAYED = 0.85
"""Maximum fraction of its convex hull that a frayed patch fills."""

OUTLINE = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_rad", "f8"),
        ("contrast", "f8"),
        ("background", "f8"),
        ("round", "?"),
        ("group", "?"),
        ("confidence", "f8"),
    ]
)
"""One patch, with these fields:

`x_px`, `y_px`: centroid [px].
`radius_px`: radius of the disc of the same area [px].
`angle_rad`: direction of the longest side, 0 to pi, counter-clockwise in the image. 0 for discs.
`contrast`: difference from the background [grey levels], negative if the patch is darker.
`background`: grey level of the background.
`round`: whether the patch is a disc.
`group`: whether the patch consists of several parts.
`confidence`: the filled fraction of the convex hull, 0 to 1, reduced for low contrast.
"""


def find_outlines(image: np.ndarray) -> np.ndarray:
    """Return the complete patches (n,) OUTLINE of an image (H, W) or (H, W, 3) uint8. No
    description of the parts is needed."""
    full = np.array(image.shape[1::-1])
    factor = int(np.ceil(np.sqrt(full[0] * full[1] / MAX_PIXELS)))
    if factor > 1:
        size = np.maximum(full // factor, 1)
        image = cv2.resize(image, size.tolist(), interpolation=cv2.INTER_AREA)
    scale = full / image.shape[1::-1]
    image = np.ascontiguousarray(image)
    background = model_background(image)
    patches = [patch for patch in find_patches(image, background) if patch.whole]
    slope = _relative_gradient(image, background)
    found = np.zeros(len(patches), OUTLINE)
    edged = np.ones(len(patches), bool)
    grey = image if image.ndim == 2 else image[:, :, 1]
    for number, (detection, patch) in enumerate(zip(found, patches, strict=True)):
        outline = patch.outline.astype(np.float32)
        hull = cv2.convexHull(outline)
        filled = cv2.contourArea(outline) / max(cv2.contourArea(hull), 1)
        compact = 4 * np.pi * cv2.contourArea(hull) / max(cv2.arcLength(hull, True), 1) ** 2
        # In the original image and in the smaller image, the centre of the first pixel has the
        # coordinate 0. The pixels of both images have different sizes.
        detection["x_px"], detection["y_px"] = scale * (patch.centre_px + 0.5) - 0.5
        detection["radius_px"] = np.mean(scale) * patch.radius_px
        detection["round"] = compact > ROUND and filled > ROUND
        detection["angle_rad"] = 0 if detection["round"] else _long_side_direction(outline)
        behind = background.grey[patch.window][patch.mask]
        detection["background"] = np.median(behind)
        detection["contrast"] = np.median(grey[patch.window][patch.mask].astype(float) - behind)
        detection["group"] = patch.group
        detection["confidence"] = filled * min(1, abs(detection["contrast"]) / SURE)
        column, row = np.rint(outline).astype(int).T
        edged[number] = filled > FRAYED or np.percentile(slope[row, column], 25) > SOFT
    return found[edged]


def _relative_gradient(image: np.ndarray, background: Background) -> np.ndarray:
    """Return the maximum gradient of the colours within one pixel around each pixel (H, W) [1/px],
    relative to the maximum deviation of the background."""
    lab = colours_like(image, background)
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0).reshape(lab.shape)
    weights = (1.0, background.chroma, background.chroma)
    steepest = cv2.dilate(steepness(smooth, weights) / 8, np.ones((3, 3), np.uint8))
    return np.asarray(steepest / np.maximum(background.limit, 1))


def _long_side_direction(outline: np.ndarray) -> float:
    """Return the direction [rad] of the longest side of the rectangle with minimum area around an
    outline."""
    corners = cv2.boxPoints(cv2.minAreaRect(outline))
    sides = np.diff(corners[:3], axis=0)
    x, y = sides[np.argmax(np.hypot(*sides.T))]
    return float(np.arctan2(-y, x) % np.pi)
