"""Parts of unknown size, shape and brightness, by their outlines: for photographs.

The image's border shows the background, which is learned first: a smooth surface. What differs from
it as a compact, convex patch is a part, all brighter or all darker, whichever differ more.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..plate.region import quadratic

BORDER = 0.05
"""Width of the border that shows mostly background, as a fraction of the image's shorter side."""

SAMPLES = 6000
"""Pixels to which the background is fitted."""

NEAR_SIGMA = 2.5
"""Deviation, in standard deviations of the background, up to which a pixel may belong to it."""

MIN_SIGMA = 1.5
"""Least standard deviation that the background is thought to have [grey levels]."""

CONTRAST_SIGMA = 3.5
"""Least deviation of a part from the background, in the background's standard deviations."""

MOST_PIXELS = 500_000
"""Larger images are made smaller first: a part is then still more than large enough."""

MIN_AREA_PX2 = 50.0
"""Smallest part: a disc of 4 px radius."""

MAX_FRACTION = 0.9
"""Largest fraction of the image that a part can fill."""

SOLID = (0.75, 0.88)
"""Least fraction of its convex hull that a patch fills: at first, and with its own threshold."""

COMPACT = 0.55
"""Least 4 pi area / length2 of a part's hull: a triangle with equal sides has 0.60."""

SOFT = 0.5
"""Widest edge of a part, in radii: that of a round shadow without a core is 1.4 wide."""

SMOOTH_PX = 1.0
"""Standard deviation [px] of the blur against noise."""

RINGS = (0.6, 1.5)
"""A part's own level is taken within so many radii, that of its surroundings around so many."""

RING_WIDTH = 0.2
"""Half width of the ring of surroundings, in radii."""

PASSES = 3
"""Times that an outline is traced again: from where it was found last."""

ROUND = 0.95
"""From this 4 pi area / length2 on a hull is a disc: a regular octagon has 0.948."""


OUTLINE = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_rad", "f8"),
        ("contrast", "f8"),
        ("background", "f8"),
        ("round", "?"),
        ("confidence", "f8"),
    ]
)
"""A part found by its outline: centre of its area [px]; radius of the disc of the same area [px];
direction of the longest side, 0 to pi, counter-clockwise as seen, 0 for discs; difference from the
background around it [grey levels], negative if darker; grey levels behind it; whether it is a disc;
confidence, 0 to 1: how much of the hull is filled, less for little contrast."""


def find_outlines(grey: np.ndarray) -> np.ndarray:
    """Find compact, convex patches (n,) OUTLINE in an image (H, W) uint8 that differ from its
    background."""
    factor = int(np.ceil(np.sqrt(grey.size / MOST_PIXELS)))
    if factor > 1:
        size = (max(grey.shape[1] // factor, 1), max(grey.shape[0] // factor, 1))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTH_PX)
    learned = learn_background(smooth)
    if learned is None:
        return np.empty(0, OUTLINE)
    background, sigma = learned
    both = [_of_sign(sign * (smooth - background), sigma, sign) for sign in (1.0, -1.0)]
    # The higher contrast is that of parts, the lower that of shadows.
    found = max(
        both, key=lambda found: float(np.median(np.abs(found["contrast"]))) if len(found) else 0.0
    )
    column, row = np.rint([found["x_px"], found["y_px"]]).astype(int)
    found["background"] = background[row, column]
    # The middle of the first pixel is 0 in the small image, and (factor - 1) / 2 in the large one.
    for name in ("x_px", "y_px"):
        found[name] = factor * found[name] + 0.5 * (factor - 1)
    found["radius_px"] *= factor
    return found


def learn_background(image: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Learn what is behind the parts of an image (H, W): a quadratic surface.

    It is flat and taken from the border at first; then tilted, then curved, and grows over all that
    is like it. Returns it (H, W), and the standard deviation [grey levels] of what belongs to it;
    None if the image is too small.
    """
    height, width = image.shape
    if min(height, width) < 8:
        return None
    step = max(1, int(np.sqrt(height * width / SAMPLES)))
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step].reshape(2, -1)
    value = image[y, x].astype(float)
    scale = 0.5 * max(height, width)
    u, v = (x - 0.5 * width) / scale, (y - 0.5 * height) / scale
    design = quadratic(u, v)
    depth = np.min([x, y, width - 1 - x, height - 1 - y], axis=0)
    border = depth <= max(BORDER * min(height, width), step)
    fitted = np.full(len(value), np.median(value[border]))
    sigma = _spread(value[border] - fitted[border])
    surface = np.zeros(6)
    for terms, inside in ((1, border), (3, border), (3, True), (3, True), (6, True), (6, True)):
        kept = (np.abs(value - fitted) < NEAR_SIGMA * sigma) & inside
        if np.count_nonzero(kept) < 2 * terms:
            return None
        surface = np.zeros(6)
        surface[:terms] = np.linalg.lstsq(design[kept, :terms], value[kept], rcond=None)[0]
        fitted = design @ surface
        sigma = _spread((value - fitted)[kept])
    row, column = np.mgrid[:height, :width].astype(np.float32)
    a, b, c, d, e, f = surface.astype(np.float32)
    u, v = (column - 0.5 * width) / scale, (row - 0.5 * height) / scale
    return (a + u * (b + d * u + e * v) + v * (c + f * v)).astype(np.float32), sigma


def _spread(values: np.ndarray) -> float:
    """Return the standard deviation of values, by their median deviation from zero."""
    return max(1.4826 * float(np.median(np.abs(values))), MIN_SIGMA)


def _of_sign(height: np.ndarray, sigma: float, sign: float) -> np.ndarray:
    """Return patches (n,) OUTLINE of one sign, the background left out.

    `height` (H, W) is how far the image rises above the background: positive for parts.
    """
    threshold = _otsu(np.maximum(height, 0))
    if threshold is None:
        return np.empty(0, OUTLINE)
    slopes = np.gradient(height)
    found: list[tuple[float | bool, ...]] = []
    for outline in _patches(height > threshold):
        shape = _shape(outline)
        if shape is None or shape[2] < SOLID[0] or _touches(outline, height.shape):
            continue
        for _ in range(PASSES):
            refined = _refine(height, shape[0], shape[1])
            shape = None if refined is None else _shape(refined[0])
            if shape is None:
                break
        if refined is None or shape is None:
            continue
        outline, contrast = refined
        level = _middle(height, shape[0], shape[1])
        if shape[2] < SOLID[1] or min(contrast, level) < CONTRAST_SIGMA * sigma:
            continue
        centre, radius, solid, compact = shape
        if compact < COMPACT or np.pi * radius**2 > MAX_FRACTION * height.size:
            continue
        if contrast > SOFT * radius * _fall(slopes, outline[:, 0], centre):
            continue
        angle = 0.0 if compact > ROUND else _angle(outline)
        confidence = solid * min(1.0, contrast / (2 * CONTRAST_SIGMA * sigma))
        found.append((*centre, radius, angle, sign * contrast, 0, compact > ROUND, confidence))
    return np.array(found, OUTLINE)


def _fall(slopes: list[np.ndarray], outline: np.ndarray, centre: tuple[float, float]) -> float:
    """Return how steeply [grey levels/px] an image falls outwards at an outline (k, 2), on average;
    `slopes` are its derivatives along y and x (H, W)."""
    x, y = outline.T
    ray = (outline - centre) / np.maximum(np.linalg.norm(outline - centre, axis=1), 1)[:, None]
    return float(-np.mean(slopes[1][y, x] * ray[:, 0] + slopes[0][y, x] * ray[:, 1]))


def _middle(height: np.ndarray, centre: tuple[float, float], radius: float) -> float:
    """Return the median of an image (H, W) in the middle of a part."""
    reach = max(int(RINGS[0] * radius), 1)
    x, y = round(centre[0]), round(centre[1])
    inner = height[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    return float(np.median(inner))


def _otsu(values: np.ndarray) -> float | None:
    """Return the threshold that parts values (H, W) best in two; None if none is above 0."""
    top = float(values.max())
    if top <= 0:
        return None
    bins = np.minimum(values * (256 / top), 255).astype(np.uint8)
    return (1 + cv2.threshold(bins, 0, 255, cv2.THRESH_OTSU)[0]) * top / 256


def _patches(mask: np.ndarray) -> list[np.ndarray]:
    """Return the outer outlines (k, 1, 2) of patches that are more than a few pixels wide."""
    small = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, small)
    return list(cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0])


def _touches(outline: np.ndarray, shape: tuple[int, ...]) -> bool:
    """Tell whether an outline reaches the image's border: then it is not all seen."""
    low, high = outline.min(axis=(0, 1)), outline.max(axis=(0, 1))
    return bool(np.any(low <= 0) or high[0] >= shape[1] - 1 or high[1] >= shape[0] - 1)


def _shape(outline: np.ndarray) -> tuple[tuple[float, float], float, float, float] | None:
    """Return an outline's centre [px], radius by area [px], and how solid and compact it is."""
    area = cv2.contourArea(outline)
    if area < MIN_AREA_PX2:
        return None
    hull = cv2.convexHull(outline)
    whole = cv2.contourArea(hull)
    moments = cv2.moments(outline)
    centre = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
    length = cv2.arcLength(hull, True)
    # The outline runs through the middles of the outermost pixels: half a pixel inside.
    radius = float(np.sqrt(area / np.pi)) + 0.5
    return centre, radius, area / whole, 4 * np.pi * whole / length**2


def _refine(
    height: np.ndarray, centre: tuple[float, float], radius: float
) -> tuple[np.ndarray, float] | None:
    """Trace a patch again, halfway between its own level and that of its surroundings: outline
    (k, 1, 2) int, and contrast [grey levels]."""
    reach = int(np.ceil(2 * RINGS[1] * radius))
    x0, y0 = max(int(centre[0]) - reach, 0), max(int(centre[1]) - reach, 0)
    window = height[y0 : int(centre[1]) + reach + 1, x0 : int(centre[0]) + reach + 1]
    y, x = np.mgrid[: window.shape[0], : window.shape[1]]
    distance = np.hypot(x - (centre[0] - x0), y - (centre[1] - y0)) / radius
    inner = distance < RINGS[0]
    # The light falls off across the part: its surroundings are a plane, of their darker half.
    ring = np.abs(distance - RINGS[1]) < RING_WIDTH
    design = np.stack([np.ones_like(distance), x - x.mean(), y - y.mean()], axis=-1)
    outer = np.full(window.shape, np.median(window[ring]) if np.any(ring) else 0.0)
    for _ in range(2):
        low = ring & (window <= outer + MIN_SIGMA)
        if np.count_nonzero(low) > 9:
            outer = design @ np.linalg.lstsq(design[low], window[low], rcond=None)[0]
    contrast = float(np.median((window - outer)[inner]))
    patches = _patches((window - outer > 0.5 * contrast) & (distance < RINGS[1]))
    offset = np.array([[x0, y0]], np.int32)
    middle = (centre[0] - x0, centre[1] - y0)
    around = [p for p in patches if cv2.pointPolygonTest(p, middle, False) >= 0]
    return (around[0] + offset, contrast) if around else None


def _angle(outline: np.ndarray) -> float:
    """Return the direction [rad] of the longest side of the tightest rectangle around it."""
    corners = cv2.boxPoints(cv2.minAreaRect(outline))
    sides = np.diff(corners[:3], axis=0)
    x, y = sides[np.argmax(np.hypot(*sides.T))]
    return float(np.arctan2(-y, x) % np.pi)
