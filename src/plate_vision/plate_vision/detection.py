"""Find parts in an image of the plate, or in a photograph."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .discs import MAX_MISFIT, find_discs
from .errors import ImageError, OptionError
from .measure import Discs
from .options import DetectorOptions
from .outlines import Outlines, find_outlines
from .region import Region, region_of

CLASSES = ("black", "grey")
"""The labels of parts darker than the plate, darkest first."""

BRIGHT = "white"
"""The label of parts brighter than what is behind them."""

METHODS = ("moments", "fit", "outline")
"""Ways in which a part was measured, cheapest first: it stands alone; it touches others or the
plate's edge; nothing was known of it."""

DETECTION = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_rad", "f8"),
        ("label", "U8"),
        ("confidence", "f8"),
        ("method", "U8"),
    ]
)
"""One part: centre and radius [px], of the disc of the same area; angle [rad], counter-clockwise as
seen: of its longest side with x, 0 to pi; of a disc that of its mark, 0 without one; class;
confidence, 0 to 1; how it was measured."""

MIN_ALIKE = 3
"""Parts of like size from which on their size is taken as known."""

ALIKE = 0.12
"""Largest deviation from the middle radius, as a share of it, of parts that are alike."""


def detect(
    image: np.ndarray,
    options: DetectorOptions | None = None,
    region_px: np.ndarray | None = None,
    size: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Find parts in one image.

    With options, round parts of a known radius, darker than the plate. Without, whatever differs
    from the background as a compact, convex patch, brighter or darker, of any size: round ones that
    are alike are then measured again as parts of a known radius.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels. Of a colour image the middle channel is used: green, in either order.
    options : DetectorOptions, optional
        What a part looks like; None if that is not known.
    region_px : (4, 2) or (4, n, 2), optional
        Corners of the plate in the image [px], in order around it; or, where a lens bends the
        edges, points of each edge from its first corner to just before the next. The whole image
        if None. The centre of the first pixel is (0, 0), x to the right, y down.
    size : callable, optional
        Gives for image points (n, 2) [px] the radius that a part has there, as a share (n,) of the
        options' radius. Everywhere 1 if None.

    Returns
    -------
    (n,) structured array
        Fields of `DETECTION`; n = 0 if nothing is found.

    Raises
    ------
    ImageError
        If the image is not uint8, has another shape, or the region is no quadrilateral in it.
    """
    grey = _grey(image)
    region = region_of(grey.shape[0], grey.shape[1], region_px)
    if options is None:
        return _survey(grey, region)
    return _from_discs(find_discs(grey, region, options, size), options)


def _survey(grey: np.ndarray, region: Region) -> np.ndarray:
    """Return the parts of an image (H, W) of which nothing is known."""
    x0, y0, x1, y1 = region.box
    outlines = find_outlines(np.ascontiguousarray(grey[y0:y1, x0:x1]))
    outlines = outlines.select(region.depth(*(outlines.centre + (x0, y0)).T) > outlines.radius)
    options = _if_alike(outlines)
    if options is not None:
        bright = bool(np.mean(outlines.contrast) > 0)
        again = _from_discs(find_discs(255 - grey if bright else grey, region, options), options)
        if len(again) >= len(outlines.radius):
            if bright:
                again["label"] = BRIGHT
            return again
    found = np.zeros(len(outlines.radius), DETECTION)
    found["x_px"], found["y_px"] = (outlines.centre + (x0, y0)).T
    found["radius_px"], found["angle_rad"] = outlines.radius, outlines.angle
    share = 1 + outlines.contrast / np.maximum(outlines.background, 1)
    found["label"] = np.where(share < DetectorOptions.class_threshold, *CLASSES)
    found["label"][outlines.contrast > 0] = BRIGHT
    found["confidence"], found["method"] = outlines.confidence, METHODS[2]
    return found


def _if_alike(outlines: Outlines) -> DetectorOptions | None:
    """Return what round parts look like if they all have one size; None if not."""
    if len(outlines.radius) < MIN_ALIKE or not np.all(outlines.disc):
        return None
    radius = float(np.median(outlines.radius))
    if np.max(np.abs(outlines.radius / radius - 1)) > ALIKE:
        return None
    try:
        return DetectorOptions(radius_px=radius)
    except OptionError:
        return None


def _from_discs(discs: Discs, options: DetectorOptions) -> np.ndarray:
    """Return discs as parts."""
    found = np.zeros(len(discs.radius), DETECTION)
    found["x_px"], found["y_px"] = discs.centre.T
    found["radius_px"] = discs.radius
    found["angle_rad"] = discs.angle
    found["label"] = np.where(1 - discs.darkness < options.class_threshold, *CLASSES)
    found["confidence"] = 1 - discs.misfit / MAX_MISFIT
    found["method"] = np.where(discs.fitted, METHODS[1], METHODS[0])
    return found


def _grey(image: np.ndarray) -> np.ndarray:
    """Return the grey levels (H, W) of an image; refuse what is no image."""
    image = np.asarray(image)
    if image.dtype != np.uint8:
        raise ImageError(f"image: values are {image.dtype}, allowed: uint8")
    if image.ndim == 3 and image.shape[2] == 3:
        image = image[:, :, 1]
    if image.ndim != 2 or image.size == 0:
        raise ImageError(f"image: shape is {image.shape}, allowed: (H, W) or (H, W, 3), not empty")
    return image
