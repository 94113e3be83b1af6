"""Shadows: areas where the background is darker, but its chroma is unchanged. The edges of shadows
are soft.

The edge of a part is as sharp as the image. The part's shadow is lighter than the part, and the
edge of the shadow is softer. Therefore, each patch is separated into a light and a dark side (by
Otsu's method), and it is checked whether the light side is a shadow. `find_lamp` determines one
lamp for all shadows, and `remove_shadows` removes single shadows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from .. import _kernels

SOFT = (1.25, 0.8, 1.7)
"""Minimum width of a shadow's edge, relative to the width of sharp edges. The first value applies
if at least `MIN_PATCHES` patches have a shadow. The second value applies if these shadows are also
on the same side. The third value applies if fewer than `MIN_PATCHES` patches have a shadow."""

MIN_PATCHES = 3
"""Minimum number of patches with a shadow. If this number and the fraction `AGREE` are reached, all
patches are assumed to have a shadow."""

ALIGNED = 0.8
"""Minimum length of a mean vector: the mean of the unit vectors from the parts to their shadows.
With this length, the shadows count as being on the same side."""

DEPTHS = 0.4
"""Maximum difference of a shadow's depth from the median depth of all shadows in the image,
relative to this median. The depth of a shadow is its deviation from the background."""

SHARP_PERCENT = 25
"""Percentile of the edge widths of all patches. This percentile is used as the width of sharp
edges."""

CLEAR_EDGE = 0.5
"""Minimum deviation of a patch from the background, relative to the upper quartile of all patches.
The edges of fainter patches are not evaluated, because they are not clear."""

WIDE_PERCENT = 80
"""Percentile of the edge widths of all parts in an image. This percentile is used as the width of
the parts' edges."""

LIGHTER: float = _kernels.LIGHTER
"""Maximum deviation of a shadow from the background, relative to the deviation of the part that
casts the shadow."""

AGREE = 0.25
"""Minimum fraction of the patches that must have a shadow, so that all patches are assumed to have
a shadow."""

MOSTLY = 0.7
"""Minimum fraction of a separate shadow that looks like a darker plate."""

SEPARATE_EDGE = 3.0
"""Minimum edge width of a separate shadow, relative to the width of sharp edges."""

WIDE_PX = 25.0
"""Edge width above which a patch is always a shadow [px]."""

DARK_WIDTH = 0.6
"""Minimum ratio of the width of a patch's dark side to the width of its light side. If the median
of this ratio over all patches with a light side is lower, the dark sides are the side faces of high
parts. The light sides are then not shadows but the tops of these parts."""

MIN_AREA_PX2 = 30
"""Minimum area of a patch whose edges are evaluated [px2]."""


SQUARE = np.ones((3, 3), np.uint8)
"""Kernel of the morphological operations: a pixel and its eight neighbours."""

MIN_CAST = (0.06, 0.75)
"""Range of the fraction of a patch that is shadow. If the fraction is outside this range, the
shadow's length is not measured."""

MIN_PART = 0.2
"""Minimum fraction of a patch that cannot be shadow because of its colour. Below this fraction, the
darker side of the patch is used as the part."""

ONE_LAMP = 0.85
"""Minimum cosine of the angle between two shadows from one lamp. The same value is the minimum
length of the mean of the unit vectors to the shadows of one lamp."""

OF_ONE_LAMP = 0.6
"""Minimum fraction of the clear shadows that one lamp must cast. Without this minimum, the light
and dark sides of touching parts, which have random directions, could be mistaken for shadows."""

SPREAD = 0.35
"""Maximum spread of the shadows' lengths, relative to their median. The spread is the median of the
absolute deviations from the median. If the spread exceeds this maximum, no lamp is determined."""

MIN_SHADE = 30.0
"""Minimum deviation of the shadows of a lamp from the background [L, 0 to 255]. If the median
deviation of an image's shadows is below this minimum, no lamp is determined. Fainter or softer
shadows surround a part on all sides and are recognised by their soft edges."""

MIN_PX = 1.0
"""Minimum length of the shadows of a lamp [px]. If the median length of an image's shadows is below
this minimum, no lamp is determined."""

FACE = 0.9
"""Minimum fraction of the pixels of a dark side that must be near the light side, so that the dark
side counts as side faces. A pixel is near if its distance is at most the shift of the part's top in
the image that the part's height causes. The other pixels are noise."""

FACE_SLACK_PX = 1.5
"""Distance that is added to the shift of a part's top when the pixels of side faces are determined
[px]. This distance allows for blur."""


class Sides(NamedTuple):
    """Areas where patches look like a darker background: see `ShadowEdges` in shadows.hpp.

    Attributes
    ----------
    like : (H, W) bool
        Whether a pixel is darker than the background but has the background's chroma.
    lit : (H, W) bool
        Whether a pixel of `like` is light enough for a shadow.
    slope : (H, W) float32
        Gradient of the lightness [L/px].
    steepest : (count,) float32
        Maximum slope of the darker pixels of each patch [L/px].
    largest : (count,) float32
        Maximum deviation of the darker pixels of each patch [L].
    total : (count,) int64
        Number of pixels of each patch.
    balance : (count,) int64
        Number of brighter pixels of each patch, minus the number of its pixels that look like a
        darker background.
    """

    like: np.ndarray
    lit: np.ndarray
    slope: np.ndarray
    steepest: np.ndarray
    largest: np.ndarray
    total: np.ndarray
    balance: np.ndarray


@dataclass(frozen=True, eq=False)
class Lamp:
    """The one lamp that casts the shadows of an image.

    Attributes
    ----------
    level : float
        Deviation of a shadow from the background [L].
    shift_px : (2,)
        Displacement from a part to the end of its shadow [px].
    length_sd_px : float
        Standard deviation of the shadows' lengths over the patches [px].
    """

    level: float
    shift_px: np.ndarray
    length_sd_px: float


def find_sides(
    lab: np.ndarray,
    bare: np.ndarray,
    chroma: float,
    limit: np.ndarray,
    labels: np.ndarray,
    count: int,
) -> Sides:
    """Find the areas where patches look like a darker background.

    Parameters
    ----------
    lab, bare : (H, W, C) uint8
        Colours of the image and of the background.
    chroma : float
        Weight of a and b relative to L.
    limit : (H, W) uint8
        Maximum deviation of a pixel from the background for which it counts as background [L].
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    count : int
        Number of labels, including 0.
    """
    like, lit = np.zeros((2, *labels.shape), np.bool_)
    slope = np.zeros(labels.shape, np.float32)
    steepest, largest = np.zeros((2, count), np.float32)
    total, balance = np.zeros((2, count), np.int64)
    _kernels.find_shadow_edges(
        lab, bare, chroma, limit, labels, like, lit, slope, steepest, largest, total, balance
    )
    return Sides(like, lit, slope, steepest, largest, total, balance)


def find_faces(
    sides: Sides,
    deviations: np.ndarray,
    labels: np.ndarray,
    rise: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return which patches (count,) bool have no shadow, because their dark side consists of side
    faces and their light side is the top of a high part.

    In the image, the height of a part shifts its top outwards from the base. Therefore, each pixel
    of a side face, even in a hole, has a pixel of the top within this shift in the outward
    direction. A part with a shadow does not have this property. The shadows from a lamp have the
    same direction everywhere, and parts are wider than side faces.

    Parameters
    ----------
    sides, deviations, labels
        As in `find_lamp`.
    rise : callable
        Returns the shifts (n, 2) of the tops of parts at image points (n, 2) [px].
    """
    count = len(sides.total)
    faces = np.zeros(count, bool)
    bound, *_ = _separate_sides(sides, deviations, labels)
    rows, columns = np.nonzero((bound > 0)[labels])
    patch = labels[rows, columns]
    for k in np.flatnonzero(bound > 0).tolist():
        y, x = rows[patch == k], columns[patch == k]
        ((dx, dy),) = rise(np.array([[np.mean(x), np.mean(y)]]))
        length = float(np.hypot(dx, dy))
        if length < MIN_PX:
            continue
        window = np.s_[y.min() : y.max() + 1, x.min() : x.max() + 1]
        dark, light = labels[window] == k, sides.lit[window] & (deviations[window] < bound[k])
        top = cv2.morphologyEx((dark & light).astype(np.uint8), cv2.MORPH_OPEN, SQUARE)
        reach = int(np.ceil(length + FACE_SLACK_PX))
        end = np.rint(reach + np.array([dx, dy]) * (1 + FACE_SLACK_PX / length)).astype(int)
        outwards = np.zeros((2 * reach + 1,) * 2, np.uint8)
        cv2.line(outwards, (reach, reach), end.tolist(), 1)
        below = cv2.dilate(cv2.dilate(top, SQUARE), outwards, borderValue=0) > 0
        faces[k] = np.mean(below[dark & (deviations[window] >= bound[k])]) > FACE
    return faces


def _separate_sides(
    sides: Sides, deviations: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return three arrays (count,) with values of each patch. The first array contains the
    deviation that separates the light side of a patch from its dark side, or 0 if the patch has
    only one side. The other two arrays contain the deviations of the light side and of the dark
    side."""
    bound, light, dark = np.empty((3, len(sides.total)), np.float32)
    _kernels.part_sides(
        deviations, sides.lit, sides.slope, sides.steepest, labels, bound, light, dark
    )
    return bound, light, dark


def find_lamp(
    sides: Sides, deviations: np.ndarray, labels: np.ndarray, faces: np.ndarray | None = None
) -> Lamp | None:
    """Find the one lamp of an image that casts shadows on the same side of most parts. Return None
    if there is no such lamp.

    The length of a shadow is the distance by which it extends beyond the part. The length is
    measured for parts that are darker than their shadow or have another colour.

    Parameters
    ----------
    sides : Sides
    deviations : (H, W) uint8
        Deviation of each pixel from the background [L]; 0 if it shows the background.
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    faces : (count,) bool, optional
        Whether a patch certainly has no shadow: see `find_faces`.
    """
    count = len(sides.total)
    large = sides.total >= MIN_AREA_PX2
    large[0] = False
    if faces is not None:
        large &= ~faces
    min_count = max(MIN_PATCHES, AGREE * np.count_nonzero(large))
    cast = cv2.morphologyEx(sides.lit.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    places = cv2.findNonZero((deviations > 0).view(np.uint8))
    if places is None:
        return None
    columns, rows = places.reshape(-1, 2).T
    patch, shaded = labels[rows, columns], cast[rows, columns] > 0
    in_part = ~sides.lit[rows, columns]
    shade = np.bincount(patch[shaded], minlength=count)
    if np.count_nonzero(large & (shade > MIN_CAST[0] * sides.total)) < min_count:
        return None
    grey = np.bincount(patch[in_part], minlength=count) < MIN_PART * sides.total
    # If a part and its shadow differ only in brightness, the darker side of the patch is the part.
    bound, *_ = _separate_sides(sides, deviations, labels)
    darker = (grey & (bound > 0))[patch] & (deviations[rows, columns] > bound[patch])
    in_part |= darker
    shaded &= ~darker
    shade = np.bincount(patch[shaded], minlength=count)
    body = np.bincount(patch[in_part], minlength=count)
    fraction = shade / np.maximum(sides.total, 1)
    clear = large & (fraction > MIN_CAST[0]) & (fraction < MIN_CAST[1])
    clear &= body > MIN_PART * sides.total
    if np.count_nonzero(clear) < min_count:
        return None
    pixels = np.stack([columns, rows]).astype(float)
    middles = [
        np.stack([np.bincount(patch[members], line[members], count) for line in pixels], axis=1)
        / np.maximum(number, 1)[:, None]
        for members, number in ((shaded, shade), (in_part, body))
    ]
    direction = (middles[0] - middles[1])[clear]
    direction /= np.maximum(np.hypot(*direction.T), 1e-9)[:, None]
    alike = direction @ direction.T > ONE_LAMP
    number = np.count_nonzero(alike, axis=1)
    if np.max(number) < max(min_count, OF_ONE_LAMP * len(direction)):
        return None
    group = alike[np.argmax(number)]
    clear[clear] = group
    mean = np.mean(direction[group], axis=0)
    if np.hypot(*mean) < ONE_LAMP:
        return None
    unit = mean / np.hypot(*mean)
    level = float(np.median(deviations[rows, columns][shaded]))
    dark = in_part | (deviations[rows, columns] > 0.5 * level)
    along = unit @ pixels
    end, part_end = np.full((2, count), -np.inf)
    np.maximum.at(end, patch[dark], along[dark])
    np.maximum.at(part_end, patch[in_part], along[in_part])
    length = end[clear] - part_end[clear]
    typical_length = float(np.median(length))
    spread = float(np.median(np.abs(length - typical_length)))
    if typical_length < MIN_PX or spread > SPREAD * typical_length or level < MIN_SHADE:
        return None
    return Lamp(level, typical_length * unit, 1.5 * spread)


def remove_shadows(
    sides: Sides,
    deviations: np.ndarray,
    labels: np.ndarray,
    plate_known: bool = False,
    faces: np.ndarray | None = None,
) -> np.ndarray:
    """Set `deviations` to 0 where an image deviates from the background because of a shadow. Return
    for each patch (count,) bool whether any of its pixels were removed as shadow.

    Parameters
    ----------
    sides : Sides
        Areas where patches look like a darker background.
    deviations : (H, W) uint8
        Deviation of each pixel from the background [L]; 0 if it shows the background.
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    plate_known : bool
        Whether the background was learned. If so, a patch is certainly a part if it is neither
        faint nor like a darker plate. The width of sharp edges is then measured at these patches.
    faces : (count,) bool, optional
        Whether a patch certainly has no shadow: see `find_faces`.
    """
    like, lit, slope, steepest, largest, total, balance = sides
    count = len(total)
    _clear_shadows_of_bright_parts(
        deviations, like, labels, (balance > 0) & (total >= MIN_AREA_PX2)
    )
    width = largest / np.maximum(steepest, 1)
    large = np.flatnonzero((total >= MIN_AREA_PX2) & (steepest > 0))
    cut = np.zeros(count, bool)
    if not len(large):
        return cut
    sharp = float(np.percentile(width[large], SHARP_PERCENT))
    if plate_known:
        sharp = max(sharp, _part_width(width, largest, total, balance, large))
    bound, light, dark = _separate_sides(sides, deviations, labels)
    if faces is not None:
        bound[faces] = 0
    if np.any(bound > 0):
        around = cv2.dilate(deviations, np.ones((5, 5), np.uint8))
        fade, direction = np.empty(count, np.float32), np.zeros((count, 2))
        _kernels.find_fade(deviations, around, lit, slope, labels, bound, light, fade, direction)
        softness = np.where(fade > 0, light / np.maximum(sharp * fade, 1e-3), 0)
        bound = _shadow_limits(bound, light, dark, softness, direction, len(large))
        light_side = (lit & (deviations < bound[labels])).astype(np.uint8)
        shadow = cv2.morphologyEx(light_side, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
        if np.any(shadow) and _are_parts_wide(shadow, (deviations > 0) & ~shadow, labels):
            deviations[shadow] = 0
            cut[labels[shadow]] = True
    alone = (width > min(SEPARATE_EDGE * sharp, WIDE_PX)) & (balance < -MOSTLY * total)
    if np.any(alone[large]):
        deviations[alone[labels]] = 0
    return cut & ~alone


def _part_width(
    width: np.ndarray,
    largest: np.ndarray,
    total: np.ndarray,
    balance: np.ndarray,
    large: np.ndarray,
) -> float:
    """Return the width of the parts' edges [px], determined from the edge widths (count,) of
    patches. Only the patches `large` (n,) are evaluated.

    A high percentile is used because motion may blur the image in one direction. Edges across this
    direction have the maximum width. Faint patches are ignored.
    """
    typical_width = np.sort(largest[large])[3 * len(large) // 4]
    clear = large[largest[large] >= CLEAR_EDGE * typical_width]
    parts = clear[balance[clear] >= -MOSTLY * total[clear]]
    if len(parts) >= MIN_PATCHES:
        return float(np.sort(width[parts])[WIDE_PERCENT * len(parts) // 100])
    return float(np.sort(width[clear])[len(clear) // 2])


def _clear_shadows_of_bright_parts(
    deviations: np.ndarray, like: np.ndarray, labels: np.ndarray, bright: np.ndarray
) -> None:
    """Set the deviation to 0 in the shadows of parts that are brighter than the plate. These
    shadows are the pixels that look like a darker plate and are connected with the plate."""
    if not np.any(bright):
        return
    shadow = (like & bright[labels]).astype(np.uint8)
    element = np.ones((3, 3), np.uint8)
    plate = cv2.morphologyEx((labels == 0).astype(np.uint8), cv2.MORPH_OPEN, element)
    count, places = cv2.connectedComponents(shadow | plate)
    reached = np.zeros(count, bool)
    reached[places[plate > 0]] = True
    deviations[(shadow > 0) & reached[places]] = 0


def _are_parts_wide(shadow: np.ndarray, parts: np.ndarray, labels: np.ndarray) -> bool:
    """Whether the parts are more than `DARK_WIDTH` times as wide as their shadows in most patches
    with a shadow. The width is the maximum distance of a pixel from the edge of the area."""
    width = np.zeros((2, labels.max() + 1), np.float32)
    for max_width, side in zip(width, (shadow, parts), strict=True):
        inside = cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, 3)
        np.maximum.at(max_width, labels[side], inside[side])
    cast, casts = width[:, width[0] > 0]
    return bool(np.median(casts / cast) > DARK_WIDTH)


def _shadow_limits(
    bound: np.ndarray,
    light: np.ndarray,
    dark: np.ndarray,
    softness: np.ndarray,
    direction: np.ndarray,
    patches: int,
) -> np.ndarray:
    """Return the maximum deviation of a shadow for each patch (count,). Pixels that look like a
    darker plate belong to the shadow if their deviation is at most this value.

    The light is the same for all parts. If the light sides of many patches have soft edges, or are
    in the same direction, all parts are assumed to have shadows with the same deviation.
    """
    seen = (bound > 0) & (softness > 0)
    if np.count_nonzero(seen) >= max(AGREE * patches, MIN_PATCHES):
        aligned = float(np.hypot(*np.mean(direction[seen], axis=0)))
        typical_softness = float(np.median(softness[seen]))
        if typical_softness > (SOFT[1] if aligned > ALIGNED else SOFT[0]):
            depth = float(np.median(light[seen]))
            alike = (bound > 0) & (np.abs(light / depth - 1) < DEPTHS)
            return np.where(alike, bound, np.where(depth < LIGHTER * dark, 0.5 * (depth + dark), 0))
    return np.where(seen & (softness > SOFT[2]), bound, 0)
