"""Parts of taught types in an image: found, named, and measured."""

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
from .shapes.classes import FEWEST_NAMED, UNKNOWN, Conditions, is_named, recognise, recognise_under
from .shapes.groups import explain_groups
from .shapes.heights import seen_shift
from .shapes.patch import Patch
from .shapes.segmentation import Segments, segment
from .shapes.shadows import Lamp
from .shapes.teaching import ALIKE, gap_between

BLUR_PX = 0.8
"""Usual blur of a camera and its pixels, standard deviation [px]."""

LEAST_CORNER_PX = 0.25
"""How far corners must stand out from a round outline in the image for the angle to be told [px]:
of stars of 5 to 16 corners with so much it is a fifth of the angle between two of them off at
most."""

SIZE_ALONE = 3.0
"""Types that differ by less than so many standard deviations, and in size alone, are named."""

SAME_LENGTH, SAME_LENGTH_PX = 0.45, 2.5
"""Difference of the length of shadows by known types from that by colours, relative to it and [px],
up to which they are shadows."""

SCALE = 1000.0
"""Of photographs of which nothing is known: a pixel is a millimetre [px/m]."""


def find_parts(
    image: np.ndarray,
    types: Mapping[str, PartType] | Catalogue,
    background: Background | None = None,
    scale: float = SCALE,
    region: Region | None = None,
) -> np.ndarray:
    """Find parts of taught types in a picture taken from above.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey levels, or blue, green, red.
    types : mapping of str to PartType, or Catalogue
        By their names; or these prepared by `make_catalogue`, which takes a while.
    background : Background, optional
        The bare plate; modelled from the image if None.
    scale : float
        Of the picture [px/m].
    region : Region, optional
        Where the plate is; the whole image if None.

    Returns
    -------
    (n,) structured array
        Fields of `DETECTION`; labels are names of types, `unknown` for what is like none, and
        `group` for parts that touch and that nothing takes apart.

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
    """Find parts of taught types on the plate: (n,) `SIGHTING`."""
    return find_types_under(image, catalogue, background, calibration, region)[0]


def find_types_under(
    image: np.ndarray,
    catalogue: Catalogue,
    background: Background,
    calibration: Calibration,
    region: Region | None = None,
    before: Lamp | None = None,
) -> tuple[np.ndarray, Lamp | None]:
    """Like `find_types`, but also return the lamp that casts the shadows of all parts.

    A lamp does not move. If an image alone does not show it, for example because parts touch, the
    lamp `before` of the previous image is used, unless more parts are recognised without it.
    """
    rise = _rise_of(catalogue, calibration)

    def look(lamps: bool, lamp: Lamp | None = None) -> _Seen:
        segments = segment(image, background, region, lamps, lamp, rise)
        conditions = Conditions(segments.lamp, background)
        patches = segments.patches
        return _Seen(segments, *recognise_under(image, patches, catalogue, calibration, conditions))

    seen = look(background.learned)
    if before is not None and (seen.lamp is None or not seen.agrees):
        lit = look(False, before)
        if not lit.agrees or lit.known < FEWEST_NAMED:
            seen = seen if seen.lamp is None else look(False)
            lit = lit if lit.agrees and lit.known >= seen.known else seen
        seen = lit
    elif not seen.agrees:  # parts that touch
        seen = look(False)
    patches, found = seen.segments.patches, seen.found
    whole = seen.segments.doubtful(is_named(found))
    if whole is not None:
        # Its light side may be no shadow: a part that moves has soft edges, too.
        more = segment(image, background, region, whole=whole).patches
        again = recognise(image, more, catalogue, calibration, seen.conditions)
        patches, found = _joined(patches, found, more, again)
    found = explain_groups(image, patches, found, catalogue, calibration, seen.conditions)
    if is_blurred(image, seen.segments.patches):
        named = is_named(found)
        found["label"][named], found["blurred"][named] = UNKNOWN, True
    return found, seen.lamp


def _joined(
    patches: list[Patch], found: np.ndarray, more: list[Patch], again: np.ndarray
) -> tuple[list[Patch], np.ndarray]:
    """Return patches and their sightings (n,) SIGHTING, after the second recognition `again`.

    A sighting of the second recognition replaces the first ones that it overlaps if it has a type.
    If it overlaps none, it is added.
    """
    kept = np.ones(len(patches), bool)
    added = []
    for k, (one, known) in enumerate(zip(more, is_named(again), strict=True)):
        at = [i for i, patch in enumerate(patches) if one.overlaps(patch)]
        if known or not at:
            kept[at] = False
            added.append(k)
    patches = [patch for patch, own in zip(patches, kept, strict=True) if own]
    return patches + [more[k] for k in added], np.concatenate([found[kept], again[added]])


@dataclass(frozen=True)
class _Seen:
    """Segments of an image, sightings (n,) SIGHTING of its patches, and the conditions estimated
    from the sightings."""

    segments: Segments
    found: np.ndarray
    conditions: Conditions

    @property
    def lamp(self) -> Lamp | None:
        """The lamp of the segmentation."""
        return self.segments.lamp

    @property
    def known(self) -> int:
        """Number of sightings that have a type."""
        return int(np.count_nonzero(is_named(self.found)))

    @property
    def agrees(self) -> bool:
        """Whether the length of the shadows, measured with the sizes of known types, agrees with
        that of the segmentation."""
        if self.lamp is None or self.conditions.lamp is None:
            return True
        length, first = (
            float(np.hypot(*one.shift_px)) for one in (self.conditions.lamp, self.lamp)
        )
        return abs(length - first) <= max(SAME_LENGTH * first, SAME_LENGTH_PX)


def _rise_of(
    catalogue: Catalogue, calibration: Calibration
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function from image points (n, 2) to the shift (n, 2) of the highest parts' tops
    there [px]; None if parts are flat, or the camera's position is unknown."""
    height, place = float(np.max(catalogue.height, initial=0)), calibration.place
    if place is None or height == 0:
        return None

    def rise(point_px: np.ndarray) -> np.ndarray:
        point = calibration.to_home(point_px)
        return calibration.to_image(point + seen_shift(place, point, height)) - point_px

    return rise


def model_plate(image: np.ndarray, region: Region) -> Background:
    """Model the bare plate from one image (H, W) or (H, W, 3) that shows parts, and more than the
    plate.

    Raises
    ------
    ImageError
        If it is not uint8, or has another shape.
    """
    x0, y0, x1, y1 = region.box
    plate = model_background(np.asarray(image)[y0:y1, x0:x1])
    # What is beside the plate is not looked at.
    lab = colours(image).copy()
    lab[y0:y1, x0:x1] = plate.lab
    limit = np.full(lab.shape[:2], 255, np.uint8)
    limit[y0:y1, x0:x1] = plate.limit
    return replace(plate, lab=lab, limit=limit)


def calibrate_by_scale(scale: float) -> Calibration:
    """Return the calibration of a picture taken from above [px/m]: its first pixel is the origin of
    plate_home, x to the right, y up."""
    return calibrate_by_matrix(np.diag([scale, -scale, 1.0]))


def camera_limits(types: Mapping[str, PartType], calibration: Calibration) -> list[str]:
    """Say what the camera cannot tell of types, or only just: which look alike, which differ in
    size alone, which are too small or round to have an angle. One sentence each."""
    scale = float(calibration.scale(np.zeros((1, 2)))[0])
    found = []
    for (name, part), template in zip(types.items(), make_catalogue(types).templates, strict=True):
        if part.symmetry:
            corner_px = scale * np.sqrt(2 * template.lever2) / part.symmetry
            wave = BLUR_PX * part.symmetry / (scale * part.reach_m)
            corner_px *= np.exp(-0.5 * wave**2)
            if corner_px < LEAST_CORNER_PX:
                found.append(
                    f"type {name}: {part.symmetry} corners stand out by {corner_px:.2f} px in the "
                    f"image, allowed: {LEAST_CORNER_PX} px: its angle cannot be told"
                )
    for one, other in combinations(types.values(), 2):
        gap = gap_between(one, other, scale)
        if gap.far < ALIKE:
            found.append(gap.text)
        elif gap.far < SIZE_ALONE and abs(gap.size) > 0.9 * gap.far:
            found.append(
                f"types {one.name} and {other.name} differ in size alone, by "
                f"{abs(gap.size_px):.1f} px: light or blur may swell one to the other"
            )
    return found
