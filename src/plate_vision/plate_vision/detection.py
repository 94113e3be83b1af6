"""Find parts in an image of the plate, or in a photograph.

The way of an image: the plate's region is known, its light is fitted, seeds are found, marks are
painted over, parts are measured, and judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plate_core.rig import PART_PX

from .camera import grey_levels
from .discs import (
    RIM_PX,
    SILHOUETTE,
    Silhouettes,
    crowded,
    even_discs,
    find_seeds,
    fit_discs,
    longest,
    mark_angles,
    measure_alone,
    paint_over,
    to_image,
)
from .errors import OptionError, check_ranges, check_size
from .plate import SEAM_PX, Region, fit_light, make_region
from .shapes import find_outlines

CLASSES = ("black", "grey")
"""The labels of parts darker than the plate, darkest first."""

BRIGHT = "white"
"""The label of parts brighter than what is behind them."""

METHODS = ("moments", "fit", "outline", "group")
"""Ways in which a part was measured, cheapest first: by moments, if it stands alone and is evenly
dark; by a fit of its contour; by its outline, if nothing was known of it; as a group, if it seems
to be several parts."""

DETECTION = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_rad", "f8"),
        ("label", "U32"),
        ("confidence", "f8"),
        ("method", "U8"),
        ("scatter_px", "f8"),
    ]
)
"""One part: centre and radius [px], of the disc of the same area; angle [rad], counter-clockwise as
seen: of its longest side with x, 0 to pi; of a disc that of its mark, 0 without one; class;
confidence, 0 to 1; how it was measured; standard deviation of the centre along each axis [px], as
far as noise and misfit cause it."""

MAX_MISFIT = 0.2
"""Largest deviation of a part from an evenly dark disc."""

EVEN_MISFIT = 0.06
"""Largest misfit of a part that is measured by moments: with more it is not evenly dark."""

ROUND = 1.2
"""Largest reach of a silhouette, relative to its radius, that counts as round: seen at 34 degrees
from above."""

BLUR_PX = 1.5
"""Reach [px] of a part's blurred edge: how near a neighbour's pixels may come to a window."""

MIN_ALIKE = 3
"""Parts of like size from which on their size is taken as known."""

ALIKE = 0.12
"""Largest relative deviation from the median radius of parts that are alike."""


@dataclass(frozen=True)
class DetectorOptions:
    """What is known of the parts before they are seen.

    Attributes
    ----------
    radius_px : float
        Radius of a part [px], 3 to 200.
    radius_tolerance : float
        Greatest relative deviation from it, 0.05 to 0.6.
    threshold : float
        Fraction of the bare plate's brightness below which a pixel belongs to a part, 0.1 to 0.95.
    class_threshold : float
        Fraction of the bare plate's brightness below which a part is black, above which grey, 0.05
        to 0.95.
    min_plate_grey : float
        Darkest plate that is believed [grey levels], 1 to 255: below that the light is off.
    margin_px : float
        How far outside the region a part's centre may be [px], 0 to 10: for errors of the
        calibration. Only pixels inside the region are looked at, so of a part that is 2 px further
        out too little is seen. A plate that is displaced by more needs another region.
    """

    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "radius_px": PART_PX,
        "radius_tolerance": (0.05, 0.6),
        "threshold": (0.1, 0.95),
        "class_threshold": (0.05, 0.95),
        "min_plate_grey": (1.0, 255.0),
        "margin_px": (0.0, 10.0),
    }
    radius_px: float = 8.0
    radius_tolerance: float = 0.2
    threshold: float = 0.8
    class_threshold: float = 0.4
    min_plate_grey: float = 60.0
    margin_px: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES)


@dataclass(frozen=True, eq=False)
class PartView:
    """How a part is seen at each place of the plate.

    Attributes
    ----------
    silhouettes : callable
        Returns the silhouettes (n,) SILHOUETTE of a part at image points (n, 2) [px].
    least_px : float
        Smallest radius of a part in the image [px].
    """

    silhouettes: Silhouettes
    least_px: float

    @classmethod
    def even(cls, radius_px: float) -> PartView:
        """Return a view in which a part is the same flat disc at all places."""
        return cls(even_discs(radius_px), radius_px)


def detect(
    image: np.ndarray,
    options: DetectorOptions | None = None,
    region: Region | np.ndarray | None = None,
    view: PartView | None = None,
) -> np.ndarray:
    """Find parts in one image.

    With options, round parts of a known radius, darker than the plate. Without, whatever differs
    from the background, of any outline, size and colour, as `plate_vision.shapes` finds it: round
    ones that are alike are then measured again as parts of a known radius.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels; or blue, green, red, of which with options green alone is used.
    options : DetectorOptions, optional
        What a part looks like; None if that is not known.
    region : Region, or (4, 2) or (4, n, 2), optional
        Where the plate is: prepared by `make_region`, which takes longer than the detection; or
        what that takes. The whole image if None.
    view : PartView, optional
        How a part is seen at each place; everywhere a disc of the options' radius if None.

    Returns
    -------
    (n,) structured array
        Fields of `DETECTION`; n = 0 if nothing is found.

    Raises
    ------
    ImageError
        If the image is not uint8, has another shape, or the region is no quadrilateral in it.
    """
    grey = grey_levels(image)
    size_px = (grey.shape[1], grey.shape[0])
    if not isinstance(region, Region):
        region = make_region(size_px, region)
    why = ", for which the region was made"
    check_size("image: size is", size_px, region.size_px, why=why)
    if options is None:
        return _detect_any(image, region)
    return find_discs(grey, region, options, view or PartView.even(options.radius_px))[0]


def round_patches(image: np.ndarray, region: Region) -> np.ndarray:
    """Return the discs (n,) `OUTLINE` of any size on the plate, darker or brighter than it."""
    found = _outlines(image, region)
    return found[found["round"] & ~found["group"]]


def find_discs(
    grey: np.ndarray, region: Region, options: DetectorOptions, view: PartView
) -> tuple[np.ndarray, np.ndarray]:
    """Return parts of a known radius, as `detect` does, and their silhouettes (n,) SILHOUETTE. Each
    is measured in the cheapest way.

    One that stands alone is measured by moments, the others by a fit of their contours that knows
    of their neighbours.
    """
    plate = fit_light(grey, region, options.min_plate_grey)
    seeds = np.empty((0, 2))
    if plate is not None:
        seeds, parts = find_seeds(
            plate, region.box, options.threshold, view.least_px, view.silhouettes
        )
    if plate is None or not len(seeds):
        return np.empty(0, DETECTION), np.empty(0, SILHOUETTE)
    tops = seeds + to_image(parts, parts["lean_px"])
    plate, marks = paint_over(plate, tops, parts["growth"] * parts["radius_px"])
    reach = longest(parts)
    alone = ~crowded(seeds, 2 * float(np.max(reach)) + RIM_PX + BLUR_PX)
    alone &= region.depth(*seeds.T) - SEAM_PX >= reach + RIM_PX + 1
    alone &= (parts["growth"] == 1) & (reach < ROUND * parts["radius_px"])
    discs, clear = measure_alone(plate, seeds, parts["radius_px"], alone)
    alone &= clear & (discs["misfit"] < EVEN_MISFIT)
    if not np.all(alone):
        discs[~alone] = fit_discs(plate, seeds[~alone], parts[~alone])
    centre = np.stack([discs["x_px"], discs["y_px"]], axis=1)
    is_part = (
        (np.abs(discs["radius_px"] / parts["radius_px"] - 1) <= options.radius_tolerance)
        & (discs["darkness"] > 1 - options.threshold)
        & (discs["misfit"] < MAX_MISFIT)
        & (region.depth(*centre.T) >= -options.margin_px)
    )
    tops = centre + to_image(parts, parts["lean_px"])
    found = np.zeros(len(discs), DETECTION)
    for name in ("x_px", "y_px", "radius_px", "scatter_px"):
        found[name] = discs[name]
    found["angle_rad"] = mark_angles(marks, tops)
    found["label"] = np.where(1 - discs["darkness"] < options.class_threshold, *CLASSES)
    found["confidence"] = 1 - discs["misfit"] / MAX_MISFIT
    found["method"] = np.where(alone, METHODS[0], METHODS[1])
    return found[is_part], parts[is_part]


def _detect_any(image: np.ndarray, region: Region) -> np.ndarray:
    """Return the parts of an image (H, W) or (H, W, 3) of which nothing is known."""
    found = _outlines(image, region)
    options = _if_alike(found)
    if options is not None:
        bright = bool(np.any(found["contrast"] > 0))  # all are brighter, or all darker
        grey = grey_levels(image)
        view = PartView.even(options.radius_px)
        again, _ = find_discs(255 - grey if bright else grey, region, options, view)
        if len(again) >= len(found):
            if bright:
                again["label"] = BRIGHT
            return again
    parts = np.zeros(len(found), DETECTION)
    for name in ("x_px", "y_px", "radius_px", "angle_rad", "confidence"):
        parts[name] = found[name]
    brightness = 1 + found["contrast"] / np.maximum(found["background"], 1)
    parts["label"] = np.where(brightness < DetectorOptions.class_threshold, *CLASSES)
    parts["label"][found["contrast"] > 0] = BRIGHT
    parts["method"] = np.where(found["group"], METHODS[3], METHODS[2])
    return parts


def _outlines(image: np.ndarray, region: Region) -> np.ndarray:
    """Return the patches (n,) `OUTLINE` of an image that are wholly in the region."""
    x0, y0, x1, y1 = region.box
    found = find_outlines(image[y0:y1, x0:x1])
    found["x_px"] += x0
    found["y_px"] += y0
    return found[region.depth(found["x_px"], found["y_px"]) > found["radius_px"]]


def _if_alike(outlines: np.ndarray) -> DetectorOptions | None:
    """Return what round parts look like if they all have one size; None if not."""
    if len(outlines) < MIN_ALIKE or not np.all(outlines["round"] & ~outlines["group"]):
        return None
    if len(np.unique(outlines["contrast"] > 0)) > 1:
        return None
    radius = float(np.median(outlines["radius_px"]))
    if np.max(np.abs(outlines["radius_px"] / radius - 1)) > ALIKE:
        return None
    try:
        return DetectorOptions(radius_px=radius)
    except OptionError:
        return None
