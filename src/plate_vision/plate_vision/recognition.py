"""Recognition of parts of taught types. The functions find the parts in an image, determine their
types, and measure them.

The image is divided into patches that differ from the bare plate (`segment`). Each patch is
compared with the catalogue of types (`recognise_in_conditions`), and groups of touching parts are
separated (`explain_groups`). The length of the shadows is estimated from the types. If the
segmentation used another length of the shadows, the segmentation is repeated. Output: records of
the type `DETECTED_OBJECT`, one for each object.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from plate_core.rig import PartType

from .camera import Calibration, calibrate_by_matrix
from .detection import DETECTION, METHODS
from .plate import Region
from .shapes import Background, model_background
from .shapes.background import colours
from .shapes.blur import is_blurred
from .shapes.catalogue import Catalogue, make_catalogue
from .shapes.classes import (
    MIN_NAMED,
    UNKNOWN,
    Conditions,
    is_named,
    recognise,
    recognise_in_conditions,
)
from .shapes.groups import explain_groups
from .shapes.heights import apparent_shift
from .shapes.patch import Patch
from .shapes.segmentation import Segments, segment
from .shapes.shadows import Lamp
from .shapes.teaching import ALIKE, gap_between

BLUR_PX = 0.8
"""Typical standard deviation of a camera's blur [px]. The blur includes the effect of the pixels'
size."""

MIN_CORNER_PX = 0.25
"""Minimum protrusion of corners from a round outline in the image [px]. Below this protrusion, the
angle of the part cannot be measured. With this protrusion, the error of a star's angle is at most a
fifth of the angle between two corners. This error was determined with stars of 5 to 16 corners."""

SIZE_ALONE = 3.0
"""Minimum difference between two types that differ only in size [standard deviations]. If the
difference is below this minimum, a warning is given."""

SAME_LENGTH, SAME_LENGTH_PX = 0.45, 2.5
"""Two limits for the difference between two lengths of the shadows: the length measured with the
sizes of known types, and the length measured by colours. `SAME_LENGTH` is relative to the length by
colours [-], `SAME_LENGTH_PX` is in pixels. If the difference exceeds both limits, the dark areas
are not shadows."""

SCALE = 1000.0
"""Default scale of a photograph [px/m]. One pixel is then one millimetre."""


def find_parts(
    image: np.ndarray,
    types: Mapping[str, PartType] | Catalogue,
    background: Background | None = None,
    scale: float = SCALE,
    region: Region | None = None,
) -> np.ndarray:
    """Find parts of taught types in a picture taken vertically from above.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    types : mapping of str to PartType, or Catalogue
        Types by name, or a catalogue from `make_catalogue`. A catalogue saves time if it is used
        for several images.
    background : Background, optional
        The bare plate. None: a model of it is made from the image.
    scale : float
        Scale of the picture [px/m].
    region : Region, optional
        Region of the plate. None: the whole image.

    Returns
    -------
    (n,) structured array
        Fields of `DETECTION`. Labels are names of types, `unknown` for an object that matches no
        type, and `group` for touching parts that could not be separated.

    Raises
    ------
    ImageError
        If the image is not uint8, or has another shape.
    """
    catalogue = types if isinstance(types, Catalogue) else make_catalogue(types)
    bare = model_background(image) if background is None else background
    seen = find_types(image, catalogue, bare, calibrate_by_scale(scale), region)
    found = np.zeros(len(seen), DETECTION)
    for name in ("x_px", "y_px", "radius_px", "label", "confidence"):
        found[name] = seen[name]
    found["angle_rad"] = seen["angle"]
    found["method"] = np.where(is_named(seen), METHODS[1], METHODS[2])
    return found


def find_types(
    image: np.ndarray,
    catalogue: Catalogue,
    background: Background,
    calibration: Calibration,
    region: Region | None = None,
) -> np.ndarray:
    """Find parts of taught types on the plate. Return the records (n,) `DETECTED_OBJECT` of the
    parts."""
    return find_types_and_lamp(image, catalogue, background, calibration, region)[0]


def find_types_and_lamp(
    image: np.ndarray,
    catalogue: Catalogue,
    background: Background,
    calibration: Calibration,
    region: Region | None = None,
    before: Lamp | None = None,
) -> tuple[np.ndarray, Lamp | None]:
    """Find parts like `find_types`, but also return the lamp that casts the shadows of all parts.
    The lamp is None if the image shows no such shadows.

    A lamp is assumed not to move. `before` is the lamp of the previous image. The previous lamp is
    used if the direction of the light is not visible in this image, for example because parts
    touch. The previous lamp is not used if more parts are recognised without it.
    """
    rise = _top_shift_function(catalogue, calibration)

    def attempt(lamps: bool, lamp: Lamp | None = None) -> _Seen:
        segments = segment(image, background, region, lamps, lamp, rise)
        conditions = Conditions(segments.lamp, background)
        patches = segments.patches
        return _Seen(
            segments, *recognise_in_conditions(image, patches, catalogue, calibration, conditions)
        )

    seen = attempt(background.learned)
    if before is not None and (seen.lamp is None or not seen.agrees):
        lit = attempt(False, before)
        if not lit.agrees or lit.known < MIN_NAMED:
            seen = seen if seen.lamp is None else attempt(False)
            lit = lit if lit.agrees and lit.known >= seen.known else seen
        seen = lit
    # touching parts can look like shadows, so repeat the recognition without removing shadows
    elif not seen.agrees:
        seen = attempt(False)
    patches, found = seen.segments.patches, seen.found
    uncertain = seen.segments.uncertain(is_named(found))
    if uncertain is not None:
        # The areas in `uncertain` were removed as shadows, but may belong to parts. The reason is
        # that the edges of a moving part are as soft as the edges of a shadow. Therefore, recognise
        # these areas again without removing shadows.
        more = segment(image, background, region, whole=uncertain).patches
        more_found = recognise(image, more, catalogue, calibration, seen.conditions)
        patches, found = _merge_recognitions(patches, found, more, more_found)
    found = explain_groups(image, patches, found, catalogue, calibration, seen.conditions)
    if is_blurred(image, seen.segments.patches):
        named = is_named(found)
        found["label"][named], found["blurred"][named] = UNKNOWN, True
    return found, seen.lamp


def _merge_recognitions(
    patches: list[Patch], found: np.ndarray, more: list[Patch], more_found: np.ndarray
) -> tuple[list[Patch], np.ndarray]:
    """Merge the results of two recognitions. `found` (m,) DETECTED_OBJECT are the records of
    `patches`, and `more_found` (k,) DETECTED_OBJECT are the records of the patches `more`.

    If a patch of the second recognition has a type, this patch replaces those first patches that it
    overlaps. If the patch does not overlap any other patch, it is added.
    """
    kept = np.ones(len(patches), bool)
    added = []
    for k, (patch_found, known) in enumerate(zip(more, is_named(more_found), strict=True)):
        overlapped = [i for i, patch in enumerate(patches) if patch_found.overlaps(patch)]
        if known or not overlapped:
            kept[overlapped] = False
            added.append(k)
    patches = [patch for patch, keep in zip(patches, kept, strict=True) if keep]
    return patches + [more[k] for k in added], np.concatenate([found[kept], more_found[added]])


@dataclass(frozen=True)
class _Seen:
    """The segments of an image, the records (n,) DETECTED_OBJECT of its patches, and the imaging
    conditions that were estimated from these records."""

    segments: Segments
    found: np.ndarray
    conditions: Conditions

    @property
    def lamp(self) -> Lamp | None:
        """The lamp of the segmentation. None if there is no lamp."""
        return self.segments.lamp

    @property
    def known(self) -> int:
        """Number of patches whose type was recognised."""
        return int(np.count_nonzero(is_named(self.found)))

    @property
    def agrees(self) -> bool:
        """Whether the length of the shadows, measured with the sizes of known types, agrees with
        the length in the segmentation."""
        if self.lamp is None or self.conditions.lamp is None:
            return True
        length, first = (
            float(np.hypot(*lamp.shift_px)) for lamp in (self.conditions.lamp, self.lamp)
        )
        return abs(length - first) <= max(SAME_LENGTH * first, SAME_LENGTH_PX)


def _top_shift_function(
    catalogue: Catalogue, calibration: Calibration
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function that computes how far the height of the highest parts shifts their tops in
    the image. The function maps image points (n, 2) [px] to shifts (n, 2) [px]. Return None if all
    parts are flat, or if the camera's position is unknown."""
    height, place = float(np.max(catalogue.height, initial=0)), calibration.camera_position
    if place is None or height == 0:
        return None

    def top_shift(point_px: np.ndarray) -> np.ndarray:
        point = calibration.to_home(point_px)
        return calibration.to_image(point + apparent_shift(place, point, height)) - point_px

    return top_shift


def model_plate(image: np.ndarray, region: Region) -> Background:
    """Return a model of the bare plate, made from one image (H, W) or (H, W, 3) that shows parts
    and the plate's surround.

    Raises
    ------
    ImageError
        If the image is not uint8, or has another shape.
    """
    x0, y0, x1, y1 = region.box
    plate = model_background(np.asarray(image)[y0:y1, x0:x1])
    # Pixels outside the plate are not evaluated: the limit of these pixels is set to the maximum.
    lab = colours(image).copy()
    lab[y0:y1, x0:x1] = plate.lab
    limit = np.full(lab.shape[:2], 255, np.uint8)
    limit[y0:y1, x0:x1] = plate.limit
    return replace(plate, lab=lab, limit=limit)


def calibrate_by_scale(scale: float) -> Calibration:
    """Return the calibration of a picture that was taken vertically from above, with a scale
    [px/m]. The origin of plate_home is at the first pixel, its x axis points to the right, and its
    y axis points up."""
    return calibrate_by_matrix(np.diag([scale, -scale, 1.0]))


def camera_limits(types: Mapping[str, PartType], calibration: Calibration) -> list[str]:
    """Return messages about types that the camera cannot distinguish or measure. There is one
    message for each pair of types that look alike, and one for each pair that differs only in size.
    There is also one message for each type whose corners are too small to measure its angle."""
    scale = float(calibration.scale(np.zeros((1, 2)))[0])
    found = []
    for (name, part), template in zip(types.items(), make_catalogue(types).templates, strict=True):
        if part.symmetry:
            corner_px = scale * np.sqrt(2 * template.lever2) / part.symmetry
            wave = BLUR_PX * part.symmetry / (scale * part.reach_m)
            corner_px *= np.exp(-0.5 * wave**2)
            if corner_px < MIN_CORNER_PX:
                found.append(
                    f"type {name}: protrusion of its {part.symmetry} corners in the image is "
                    f"{corner_px:.2f} px, allowed: at least {MIN_CORNER_PX} px to measure the angle"
                )
    for first, second in combinations(types.values(), 2):
        gap = gap_between(first, second, scale)
        if gap.far < ALIKE:
            found.append(gap.text)
        elif gap.far < SIZE_ALONE and abs(gap.size) > 0.9 * gap.far:
            found.append(
                f"types {first.name} and {second.name} differ only in size, by "
                f"{abs(gap.size_px):.1f} px; with other light or blur they may be confused"
            )
    return found
