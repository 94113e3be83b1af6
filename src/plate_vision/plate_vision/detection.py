"""Detection of parts in an image of the plate, or in a photograph.

`detect` and `find_discs` fit the plate's brightness (`fit_light`) and find seeds (first guesses of
the parts' places). These functions erase the parts' marks and measure each part by moments or by a
fit of its contour. Then the functions accept or reject the part. Input: an image (H, W) or (H, W,
3) uint8 and the plate's region. Output: `DETECTION` records in pixels. If no options describe the
parts, `detect` finds them by their outlines (`shapes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from plate_core.rig import PART_PX
from plate_core.tasks import CLASSES

from .camera import Calibration, grey_levels
from .discs import (
    GOOD_MISFIT,
    NUMBERS,
    SILHOUETTE,
    EvenDiscs,
    Silhouettes,
    crowded,
    find_marks,
    find_seeds,
    fit_discs,
    judge,
    measure_dark,
    seeds_of,
    tops,
)
from .discs.shadow import Shadow
from .errors import OptionError, check_ranges, check_size
from .overlooked import NONE_OVERLOOKED
from .plate import (
    LitPlate,
    Region,
    brightness,
    channels_of,
    contrast_image,
    fit_light,
    make_region,
)
from .plate.contrast import Channels
from .remains import (
    Remains,
    clean_remains,
    find_remains,
    overlooked_objects,
    remove_parts,
)
from .shadow_search import GOOD_FIT, MIN_OBJECTS, find_shadow
from .shapes import find_outlines

BRIGHT = "white"
"""Label of parts that are brighter than the plate."""

METHODS = ("moments", "fit", "outline", "group")
"""Methods that measure a part. "moments": the part is isolated and uniformly dark. "fit": the
contour of the part is fitted. "outline": the part's outline is measured, because no options
describe the parts. "group": like "outline", but the outline seems to be the outline of several
parts."""

LABELS, MEASURED = np.array([*CLASSES, BRIGHT]), np.array([METHODS[1], METHODS[0]])
"""`LABELS`: names of the labels, indexed by the label numbers that `judge` returns. `MEASURED`:
names of the methods, indexed by 1 if a part was measured by moments and by 0 otherwise."""

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
        ("misfit", "f8"),
    ]
)
"""One detected part, with these fields:

`x_px`, `y_px`: centre [px].
`radius_px`: radius of the disc of the same area [px].
`angle_rad`: angle [rad], counter-clockwise in the image. For an outline, it is the angle from the x
    axis to the longest side, 0 to pi. For a disc, it is the angle of the mark, or 0 without a mark.
`label`: class of the part.
`confidence`: confidence in the detection, 0 to 1.
`method`: one of `METHODS`.
`scatter_px`: standard deviation of the centre along each axis, caused by noise and misfit [px].
`misfit`: deviation from a part's silhouette. 0 means no deviation.
"""

APART = 1.4
"""Minimum distance between the centres of two parts, in radii of the larger part. For touching
parts the distance is 2. If two parts are nearer than this minimum, the part with the larger misfit
is rejected."""

BETTER = 2.0
"""Factor between the misfits of two overlapping discs. The disc with the smaller misfit m is
certainly the part if the other misfit is at least `BETTER` m + `GOOD_MISFIT`."""

CLEARLY_DARK = 0.8
"""Maximum brightness of a part's pixels in the first, fast search, relative to the plate's
brightness."""

SIGMAS = 2.2
"""Minimum contrast of a part, relative to the standard deviation of a pixel's noise. The contrast
is the mean over four pixels. The noise of this mean is half the noise of one pixel."""

ROUGH = 0.25
"""Maximum number of objects with a large misfit, relative to the number of detected parts. Above
this ratio, the search for the parts' shadow starts."""

FAINT = 2.0
"""Minimum contrast of a rejected object, relative to the minimum contrast of a part. An object
below this contrast is reported as too faint."""

MIN_ALIKE = 3
"""Minimum number of similar parts from which their median radius is used as the known radius."""

ALIKE = 0.12
"""Maximum relative deviation of similar parts' radii from their median radius [-]."""


@dataclass(frozen=True)
class DetectorOptions:
    """Description of the parts, given before detection.

    Attributes
    ----------
    radius_px : float
        Radius of a part [px], 3 to 200.
    radius_tolerance : float
        Maximum relative deviation from `radius_px`, 0.05 to 0.6.
    threshold : float
        Maximum brightness of a part, relative to the bare plate's brightness, 0.1 to 0.97. Parts
        that are brighter than the plate or of another colour must differ from the plate by at least
        1 - threshold. In noisy images, the difference must be larger.
    class_threshold : float
        Threshold between black and grey parts, 0.05 to 0.95. The unit is the bare plate's
        brightness.
    min_plate_grey : float
        Minimum brightness of the plate [grey levels], 1 to 255. Below this brightness, the light
        counts as off.
    margin_px : float
        Maximum distance of a part's centre outside the region [px], 0 to 10. The distance allows
        for errors of the calibration. Only pixels inside the region are evaluated. If a centre is
        more than about 2 px outside the region, too little of the part is visible. If the plate is
        displaced by more than about 2 px, make a new region.
    """

    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {
        "radius_px": PART_PX,
        "radius_tolerance": (0.05, 0.6),
        "threshold": (0.1, 0.97),
        "class_threshold": (0.05, 0.95),
        "min_plate_grey": (1.0, 255.0),
        "margin_px": (0.0, 10.0),
    }
    radius_px: float = 8.0
    radius_tolerance: float = 0.25
    threshold: float = 0.97
    class_threshold: float = 0.4
    min_plate_grey: float = 60.0
    margin_px: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES)


@dataclass(frozen=True, eq=False)
class PartView:
    """Appearance of a part at each place of the plate.

    Attributes
    ----------
    silhouettes : callable
        Returns the silhouettes (n,) SILHOUETTE of a part at image points (n, 2) [px].
    min_radius_px : float
        Smallest radius of a part in the image [px].
    calibration : Calibration, optional
        Calibration of the camera. Shadows are not searched if the calibration is None.
    """

    silhouettes: Silhouettes
    min_radius_px: float
    calibration: Calibration | None = None

    @classmethod
    def even(cls, radius_px: float) -> PartView:
        """Return a view in which a part is the same flat disc at all places."""
        return cls(EvenDiscs(radius_px), radius_px)


def detect(
    image: np.ndarray,
    options: DetectorOptions | None = None,
    region: Region | np.ndarray | None = None,
    view: PartView | None = None,
) -> np.ndarray:
    """Find parts in one image.

    With options, the function finds round parts of a known radius. Without options, the function
    finds all objects that differ from the background, of any outline, size and colour
    (`plate_vision.shapes`). If all these objects are round and of one size, the function measures
    them again as parts of a known radius.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels; or blue, green, red. With options, only the green channel is used to find dark
        parts.
    options : DetectorOptions, optional
        Description of the parts. None if the parts are not described.
    region : Region, or (4, 2) or (4, n, 2), optional
        Region of the plate: the result of `make_region`, or its argument `outline_px`. For several
        images, pass the result, because `make_region` takes longer than the detection. None: the
        whole image.
    view : PartView, optional
        Appearance of a part at each place; None: a disc of the options' radius everywhere.

    Returns
    -------
    (n,) structured array
        Fields of `DETECTION`; n = 0 if nothing is found.

    Raises
    ------
    ImageError
        If the image is not uint8 or has another shape, or if the region is not a quadrilateral in
        the image.
    """
    grey = grey_levels(image)
    size_px = (grey.shape[1], grey.shape[0])
    if not isinstance(region, Region):
        region = make_region(size_px, region)
    why = ", for which the region was made"
    check_size("image: size is", size_px, region.size_px, why=why)
    if options is None:
        return _detect_undescribed(image, region)
    return find_discs(image, region, options, view or PartView.even(options.radius_px)).found


class Discs(NamedTuple):
    """Result of `find_discs`.

    Attributes
    ----------
    found : (n,) DETECTION
    parts : (n,) SILHOUETTE
        Silhouettes of the parts `found`.
    overlooked : (m,) OVERLOOKED
        Objects on the plate that are not accepted as parts. The fields x and y of these objects are
        not set.
    shadow : Shadow, optional
        The shadow that every part casts; None if unknown.
    uncertain : bool
        Whether many objects have a large misfit, so that a shadow must be searched.
    """

    found: np.ndarray
    parts: np.ndarray
    overlooked: np.ndarray
    shadow: Shadow | None = None
    uncertain: bool = False

    @property
    def places(self) -> np.ndarray:
        """Centres of the parts (n, 2) [px]."""
        return _disc_centres(self.found)


def _disc_centres(found: np.ndarray) -> np.ndarray:
    places = np.empty((len(found), 2))
    places[:, 0], places[:, 1] = found["x_px"], found["y_px"]
    return places


NO_DISCS = Discs(np.empty(0, DETECTION), np.empty(0, SILHOUETTE), NONE_OVERLOOKED)
"""Result without any detection."""


def find_discs(
    image: np.ndarray,
    region: Region,
    options: DetectorOptions,
    view: PartView,
    shadow: Shadow | None = None,
    search: bool = True,
) -> Discs:
    """Find parts of a known radius, as `detect` does, in an image (H, W) or (H, W, 3).

    The first step uses grey levels and finds parts that are clearly darker than the plate. If there
    are other objects on the plate, the second step searches for parts among them by
    `plate.contrast`. The second step finds fainter parts, brighter parts, parts of another colour,
    and parts with highlights or holes. If many objects have a large misfit, the third step searches
    for shadows that are the same for all parts. `shadow` is the shadow in the previous image. The
    third step tries this shadow first. If `search` is false, the third step is omitted to save
    time.
    """
    plate = fit_light(grey_levels(image), region, options.min_plate_grey)
    if plate is None:
        return NO_DISCS
    scene = Scene(plate, channels_of(image, plate, region), region, options, view)
    if shadow is not None:
        discs = _find_shadowed_discs(scene, shadow)
        if not _has_many_misfits(discs):
            return discs
    discs = _find_dark_discs(plate, region, options, view)
    remains = find_remains(
        scene.channels, region, scene.limit, view.min_radius_px, discs.places, discs.parts
    )
    if remains is not None:
        discs = _add_parts_by_contrast(scene, discs, remains)
    discs = discs._replace(uncertain=_has_many_misfits(discs))
    if view.calibration is None or not (discs.uncertain and search):
        return discs
    every = find_remains(
        scene.channels, region, scene.limit, view.min_radius_px, NO_DISCS.places, NO_DISCS.parts
    )
    if every is None or scene.contrast is None:
        return discs
    shadow = find_shadow(
        scene.contrast, clean_remains(every, options.radius_px), view.silhouettes, view.calibration
    )
    return discs if shadow is None else _find_shadowed_discs(scene, shadow)


@dataclass(frozen=True, eq=False)
class Scene:
    """One image with its fitted plate, region, and description of the parts."""

    plate: LitPlate
    channels: Channels
    region: Region
    options: DetectorOptions
    view: PartView

    @property
    def limit(self) -> float:
        """Minimum contrast between a part and the plate [-]."""
        return max(1 - self.options.threshold, SIGMAS * self.channels.noise)

    @cached_property
    def contrast(self) -> LitPlate | None:
        """Result of `contrast_image`. None if the image shows no plate."""
        return contrast_image(self.channels, self.region)


def _has_many_misfits(discs: Discs) -> bool:
    """Whether many objects have a large misfit. Parts whose shadow is unknown also have a large
    misfit."""
    good = GOOD_MISFIT if discs.shadow is None else GOOD_FIT
    uncertain = np.count_nonzero(discs.found["misfit"] > good)
    if len(discs.overlooked):
        is_doubtful = np.isin(discs.overlooked["reason"], ("misfit", "too large", "too small"))
        uncertain += np.count_nonzero(is_doubtful)
    return bool(uncertain >= MIN_OBJECTS and uncertain > ROUGH * len(discs.found))


def _add_parts_by_contrast(scene: Scene, discs: Discs, remains: Remains) -> Discs:
    """Search the remains for further parts by contrast. Return all parts. The other objects in the
    remains are returned as overlooked objects."""
    contrast, radius_px = scene.contrast, scene.options.radius_px
    if contrast is None:
        return discs
    remains = clean_remains(remains, radius_px)
    others = _find_discs_by_contrast(scene, contrast, remains, discs, None)
    remains = remove_parts(remains, others.places, others.parts)
    things = overlooked_objects(remains, scene.region, radius_px, FAINT * scene.limit, contrast)
    found = np.concatenate([discs.found, others.found])
    return _remove_overlaps(Discs(found, np.concatenate([discs.parts, others.parts]), things))


def _find_shadowed_discs(scene: Scene, shadow: Shadow) -> Discs:
    """Find all parts by their contrast if every part casts a shadow."""
    contrast, radius_px, view = scene.contrast, scene.options.radius_px, scene.view
    remains = find_remains(
        scene.channels,
        scene.region,
        scene.limit,
        view.min_radius_px,
        NO_DISCS.places,
        NO_DISCS.parts,
    )
    if remains is None or contrast is None:
        return NO_DISCS._replace(shadow=shadow)
    remains = clean_remains(remains, radius_px)
    discs = _find_discs_by_contrast(scene, contrast, remains, NO_DISCS, shadow)
    remains = remove_parts(remains, discs.places, discs.parts)
    remains = remove_parts(remains, discs.places, shadow.drawn(discs.places, discs.parts))
    things = overlooked_objects(remains, scene.region, radius_px, FAINT * scene.limit, contrast)
    return _remove_overlaps(discs._replace(overlooked=things, shadow=shadow))


def _remove_overlaps(discs: Discs) -> Discs:
    """Remove each disc that overlaps a disc with a smaller misfit. If the misfits are similar,
    either disc may be the part. For similar misfits, the standard deviation of the remaining disc's
    place becomes at least the distance between the two discs."""
    place, radius = discs.places, discs.parts["radius_px"]
    if not np.any(crowded(place, APART * float(np.max(radius, initial=0)))):
        return discs
    found, misfit = discs.found.copy(), discs.found["misfit"]
    kept: list[int] = []
    for k in np.argsort(misfit, kind="stable").tolist():
        gap = np.hypot(*(place[kept] - place[k]).T)
        near = gap < APART * np.maximum(radius[kept], radius[k])
        for j, far in zip(np.array(kept, int)[near].tolist(), gap[near].tolist(), strict=True):
            if misfit[k] < BETTER * misfit[j] + GOOD_MISFIT:
                found["scatter_px"][j] = max(found["scatter_px"][j], far)
        if not np.any(near):
            kept.append(k)
    kept.sort()
    return discs._replace(found=found[kept], parts=discs.parts[kept])


def _find_dark_discs(
    plate: LitPlate, region: Region, options: DetectorOptions, view: PartView
) -> Discs:
    """Find parts that are clearly darker than the plate. Each part is measured by the fastest
    method that is suitable."""
    threshold = min(options.threshold, CLEARLY_DARK)
    seeds, parts = find_seeds(plate, region, threshold, view.min_radius_px, view.silhouettes)
    if not len(seeds):
        return NO_DISCS
    discs, marks, alone = measure_dark(plate, region, seeds, parts)
    light = 1 - discs["darkness"]
    return _select_parts(discs, parts, marks, light, alone, plate.noise, region, options)


def _find_discs_by_contrast(
    scene: Scene, contrast: LitPlate, remains: Remains, known: Discs, shadow: Shadow | None
) -> Discs:
    """Find parts other than the `known` ones by their contrast to the plate. If `shadow` is given,
    every part casts this shadow."""
    silhouettes = scene.view.silhouettes

    def dark_shapes(point_px: np.ndarray) -> np.ndarray:
        parts = silhouettes(point_px)
        return parts if shadow is None else shadow.drawn(point_px, parts)

    dark = remains.deviating | remains.outside.astype(np.uint8)
    seeds, parts = seeds_of(
        contrast, dark, remains.outside, remains.grid, scene.view.min_radius_px, dark_shapes
    )
    if not len(seeds):
        return NO_DISCS
    if shadow is not None:
        parts = silhouettes(seeds)
    discs = _fit_seeds(contrast, seeds, parts, known, shadow)
    is_dark = (discs["darkness"] >= scene.limit) & ~_is_overlapped(discs, parts)
    # repeat the fit without the rejected discs, because they affect the fit of their neighbours
    if not np.all(is_dark):
        seeds, parts = seeds[is_dark], parts[is_dark]
        discs = _fit_seeds(contrast, seeds, parts, known, shadow)
        discs["misfit"][discs["darkness"] < scene.limit] = np.inf
    marks = find_marks(scene.plate, seeds, parts)
    centre = _disc_centres(discs)
    radii_px = parts["growth"] * parts["radius_px"]
    light = brightness(scene.channels, tops(centre, parts), radii_px)
    alone = np.zeros(len(discs), np.bool_)
    return _select_parts(
        discs, parts, marks, light, alone, contrast.noise, scene.region, scene.options
    )


def _is_overlapped(discs: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return which discs (n,) DISC overlap a disc that fits better. For example, one seed may be on
    a part and another one on the shadow of the same part."""
    place, reach = _disc_centres(discs), APART * parts["radius_px"]
    if not np.any(crowded(place, float(np.max(reach, initial=0)))):
        return np.zeros(len(discs), np.bool_)
    gap = np.hypot(*(place[:, None] - place).T)
    better = discs["misfit"] < discs["misfit"][:, None]
    return np.any((gap < np.maximum(reach, reach[:, None])) & better, axis=1)


def _fit_seeds(
    contrast: LitPlate, seeds: np.ndarray, parts: np.ndarray, known: Discs, shadow: Shadow | None
) -> np.ndarray:
    """Fit discs (n,) DISC to seeds (n, 2) [px], together with the known discs."""
    every = np.concatenate([seeds, known.places])
    return fit_discs(contrast, every, np.concatenate([parts, known.parts]), shadow)[: len(seeds)]


def _select_parts(
    discs: np.ndarray,
    parts: np.ndarray,
    marks: np.ndarray,
    light: np.ndarray,
    by_moments: np.ndarray,
    noise: float,
    region: Region,
    options: DetectorOptions,
) -> Discs:
    """Return the measured discs (n,) DISC that are accepted as parts.

    `parts` (n,) SILHOUETTE; `marks` (n, 2) [px]; `light` (n,): brightness relative to the plate;
    `by_moments` (n,): whether a disc was measured by moments.
    """
    kept, labels, numbers = judge(
        discs, parts, marks, light, region, noise, options.radius_tolerance,
        options.class_threshold, options.margin_px,
    )  # fmt: skip
    found = np.zeros(len(kept), DETECTION)
    for name, column in zip(NUMBERS, numbers.T, strict=True):
        found[name] = column
    found["label"] = LABELS[labels]
    if len(kept) < len(discs):
        parts, by_moments = parts[kept], by_moments[kept]
    found["method"] = MEASURED[by_moments.view(np.uint8)]
    return Discs(found, parts, NONE_OVERLOOKED)


def _detect_undescribed(image: np.ndarray, region: Region) -> np.ndarray:
    """Return the parts of an image (H, W) or (H, W, 3) if no options describe them."""
    found = _find_inner_outlines(image, region)
    options = _options_for_discs(found)
    if options is not None:
        # At this point, either all parts are brighter than the plate, or all parts are darker.
        bright = bool(np.any(found["contrast"] > 0))
        grey = grey_levels(image)
        view = PartView.even(options.radius_px)
        plate = fit_light(255 - grey if bright else grey, region, options.min_plate_grey)
        brighter = (
            NO_DISCS if plate is None else _find_dark_discs(plate, region, options, view)
        ).found
        if len(brighter) >= len(found):
            if bright:
                brighter["label"] = BRIGHT
            return brighter
    parts = np.zeros(len(found), DETECTION)
    for name in ("x_px", "y_px", "radius_px", "angle_rad", "confidence"):
        parts[name] = found[name]
    brightness = 1 + found["contrast"] / np.maximum(found["background"], 1)
    parts["label"] = np.where(brightness < DetectorOptions.class_threshold, *CLASSES)
    parts["label"][found["contrast"] > 0] = BRIGHT
    parts["method"] = np.where(found["group"], METHODS[3], METHODS[2])
    return parts


def _find_inner_outlines(image: np.ndarray, region: Region) -> np.ndarray:
    """Return the patches (n,) `OUTLINE` of an image that are completely inside the region."""
    x0, y0, x1, y1 = region.box
    found = find_outlines(image[y0:y1, x0:x1])
    found["x_px"] += x0
    found["y_px"] += y0
    return found[region.depth(found["x_px"], found["y_px"]) > found["radius_px"]]


def _options_for_discs(outlines: np.ndarray) -> DetectorOptions | None:
    """Return a description of round parts if all outlines are round and have about the same size.
    All outlines must also be brighter than the plate, or all darker. Otherwise, return None."""
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
