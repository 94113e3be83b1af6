"""Find round parts in an image of the plate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .brightness import fit_brightness
from .errors import ImageError, OptionError
from .fit import fit_discs
from .measure import RIM_PX, Discs, crowded, measure_alone
from .region import SEAM_PX, Region, check_region, make_region, usable_pixels
from .seeds import find_seeds

CLASSES = ("black", "grey")
"""The labels, darkest first."""

DETECTION = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_rad", "f8"),
        ("label", "U8"),
    ]
)
"""One part: centre and radius [px]; angle [rad], 0 since round parts show none; class."""

MAX_MISFIT = 0.2
"""Largest deviation of a part from an evenly dark disc."""

BLUR_PX = 1.5
"""Reach [px] of a part's blurred edge: how near a neighbour's pixels may come to a window."""


@dataclass(frozen=True)
class DetectorOptions:
    """What a part looks like.

    Attributes
    ----------
    radius_px : float
        Radius of a part [px], 3 to 200.
    radius_tolerance : float
        Greatest deviation from it, as a share of it, 0.05 to 0.6.
    threshold : float
        Share of the bare plate's brightness below which a pixel belongs to a part, 0.1 to 0.95.
    class_threshold : float
        Share of the bare plate's brightness below which a part is black, above which grey, 0.05 to
        0.95.
    min_plate_grey : float
        Darkest plate that is believed [grey levels], 1 to 255: below that the light is off.
    margin_px : float
        How far outside the region a part's centre may be [px], 0 to 10: for errors of the
        calibration. Only pixels inside the region are looked at, so of a part that is 2 px further
        out too little is seen. A plate that is displaced by more needs another region.
    """

    radius_px: float = 8.0
    radius_tolerance: float = 0.2
    threshold: float = 0.8
    class_threshold: float = 0.4
    min_plate_grey: float = 60.0
    margin_px: float = 1.0

    def __post_init__(self) -> None:
        ranges = {
            "radius_px": (3.0, 200.0),
            "radius_tolerance": (0.05, 0.6),
            "threshold": (0.1, 0.95),
            "class_threshold": (0.05, 0.95),
            "min_plate_grey": (1.0, 255.0),
            "margin_px": (0.0, 10.0),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise OptionError(f"{name} is {value}, allowed: {low:g} to {high:g}")


def detect(
    image: np.ndarray,
    options: DetectorOptions | None = None,
    region_px: np.ndarray | None = None,
    size: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Find round parts, darker than the plate, in one image.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels. Of a colour image the middle channel is used: green, in either order.
    options : DetectorOptions, optional
        What a part looks like.
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
    options = options or DetectorOptions()
    grey = _grey(image)
    region = make_region(*grey.shape, None if region_px is None else check_region(region_px))
    discs = _find_discs(grey, region, options, size)
    found = np.zeros(len(discs.radius), DETECTION)
    found["x_px"], found["y_px"] = discs.centre.T
    found["radius_px"] = discs.radius
    found["label"] = np.where(1 - discs.darkness < options.class_threshold, *CLASSES)
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


def _find_discs(
    grey: np.ndarray,
    region: Region,
    options: DetectorOptions,
    size: Callable[[np.ndarray], np.ndarray] | None,
) -> Discs:
    """Seeds, then measurement, then a check of what was measured."""
    radius = options.radius_px
    brightness = fit_brightness(grey, region, options.min_plate_grey)
    seeds = np.empty((0, 2))
    if brightness is not None:
        usable = usable_pixels(region, *grey.shape)
        seeds = find_seeds(grey, region, brightness, usable, options.threshold, radius)
    if brightness is None or not len(seeds):
        return Discs(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))
    discs, shared = measure_alone(grey, brightness, seeds, radius)
    shared |= region.depth(*seeds.T) - SEAM_PX < radius + RIM_PX + 1
    shared |= crowded(seeds, 2 * radius + RIM_PX + BLUR_PX)
    if np.any(shared):
        fitted = fit_discs(grey, brightness, usable, seeds[shared], radius)
        discs = discs.select(np.flatnonzero(~shared)).join(fitted)
    expected = np.full(len(discs.radius), radius) if size is None else radius * size(discs.centre)
    return discs.select(np.flatnonzero(_is_part(discs, region, options, expected)))


def _is_part(
    discs: Discs, region: Region, options: DetectorOptions, radius: np.ndarray
) -> np.ndarray:
    """Tell which discs (n,) look like a part on the plate; `radius` (n,) [px] is its there."""
    return (
        (np.abs(discs.radius / radius - 1) <= options.radius_tolerance)
        & (discs.darkness > 1 - options.threshold)
        & (discs.misfit < MAX_MISFIT)
        & (region.depth(*discs.centre.T) >= -options.margin_px)
    )
