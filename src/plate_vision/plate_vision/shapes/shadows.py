"""Shadows: where the background is darker, its chroma kept, and fades into the plate.

A part ends at an edge as sharp as the image is; its shadow is lighter than the part, and its edge
is softer. So each patch is parted in a light and a dark side, and the light one is looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from .. import _kernels

SOFT = (1.25, 0.8, 1.7)
"""Width of the edge of a shadow, relative to that of sharp edges, at least: where several patches
have one; also all on the same side; where only one has."""

FEWEST = 3
"""Patches that are several."""

ALIGNED = 0.8
"""Length of the mean of unit vectors that point to one side."""

DEPTHS = 0.4
"""Relative spread of the deviations of the shadows in an image."""

SHARP_PERCENT = 25
"""Of the patches so many have edges that are called sharp."""

CLEAR_EDGE, WIDE_PERCENT = 0.5, 80
"""Deviation of patches with clear edges, relative to the upper quartile of all; per cent of the
edges of parts that are no wider than the width of an image's edges."""

LIGHTER: float = _kernels.LIGHTER
"""Deviation of a shadow, relative to that of the part that casts it, at most."""

AGREE = 0.25
"""Fraction of the patches that have a shadow, from which on all are thought to have one."""

MOSTLY = 0.7
"""Of a shadow that lies alone so much is like a darker plate, at least."""

ALONE = 3.0
"""Width of the edge of a shadow that lies alone, relative to sharp edges."""

WIDE_PX = 25.0
"""Width from which on the edge of a patch is that of a shadow, whatever else is seen [px]."""

THICK = 0.6
"""Thickness of a part, relative to that of its shadow, at least: a thin dark side is a face of a
high part, seen from beside it, and the light one its top."""

LEAST_AREA_PX2 = 30
"""Least patch of which the edges are looked at."""


SQUARE = np.ones((3, 3), np.uint8)
"""Kernel of the morphological operations: a pixel and its eight neighbours."""

LEAST_CAST = (0.06, 0.75)
"""Fraction of a patch that a shadow takes, at least and at most, if its length is measured."""

LEAST_PART = 0.2
"""Fraction of it that the part takes, at least, of what is no shadow by its colour."""

ONE_LAMP = 0.85
"""Cosine of the angle between two shadows up to which one lamp may cast both; length of the mean of
unit vectors to the shadows, from which on one lamp casts them all."""

OF_ONE_LAMP = 0.6
"""Fraction of the patches with a clear shadow that one lamp casts, at least: parts that touch have
their light and dark sides anywhere."""

SPREAD = 0.35
"""Largest spread of the shadows' lengths, relative to the usual one: median deviation."""

DEEP = 30.0
"""Deviation of a shadow from the plate, at least, if it is taken off by its length [L]: a fifth
of the light. A fainter or softer one is on all sides of a part: its softness tells it."""

SHORTEST_PX = 1.0
"""Shortest shadow that is taken off as such [px]."""

FACE = 0.9
"""Minimum fraction of a patch's dark side that must lie within the top's shift of the light side,
so that the dark side counts as side faces. The rest is noise."""

FACE_SLACK_PX = 1.5
"""Maximum distance of the top beyond the shift by its height [px]: blur."""


class Sides(NamedTuple):
    """Where patches are like a darker background: see `ShadowEdges` in shadows.hpp.

    Attributes
    ----------
    like, lit : (H, W) bool
        Pixels whose chroma is the background's, and which are darker; those of them that are not
        too dark for a shadow.
    slope : (H, W) float32
        Slope of the light [L/px].
    steepest, largest : (count,) float32
        Of each patch the steepest slope [L/px], and the largest deviation where it is darker [L].
    total, balance : (count,) int64
        Its pixels; how many more of them are brighter than like a darker background.
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
        From a part to the end of its shadow [px].
    scatter_px : float
        Standard deviation of the length from patch to patch [px].
    """

    level: float
    shift_px: np.ndarray
    scatter_px: float


def find_sides(
    lab: np.ndarray,
    bare: np.ndarray,
    chroma: float,
    limit: np.ndarray,
    labels: np.ndarray,
    count: int,
) -> Sides:
    """Find where patches are like a darker background.

    Parameters
    ----------
    lab, bare : (H, W, C) uint8
        Colours of the image and of the background.
    chroma : float
        Weight of a and b beside L.
    limit : (H, W) uint8
        Deviation up to which a pixel shows the background.
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    count : int
        How many numbers there are.
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
    away: np.ndarray,
    labels: np.ndarray,
    rise: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return which patches (count,) bool have no shadow: their dark side shows side faces, their
    light side the top of a high part.

    The camera sees the top farther outwards than the part's base. So the top is found at that shift
    outwards from each pixel of a side face, also from the side face of a hole. Shadows of a lamp
    point in the same direction everywhere, and parts are wider than side faces.

    Parameters
    ----------
    sides, away, labels
        As for `find_lamp`.
    rise : callable
        Returns the shift of the tops of parts in the image (n, 2), at points (n, 2) [px].
    """
    count = len(sides.total)
    faces = np.zeros(count, bool)
    bound, *_ = _two_sides(sides, away, labels)
    rows, columns = np.nonzero((bound > 0)[labels])
    patch = labels[rows, columns]
    for k in np.flatnonzero(bound > 0).tolist():
        y, x = rows[patch == k], columns[patch == k]
        ((dx, dy),) = rise(np.array([[np.mean(x), np.mean(y)]]))
        length = float(np.hypot(dx, dy))
        if length < SHORTEST_PX:
            continue
        here = np.s_[y.min() : y.max() + 1, x.min() : x.max() + 1]
        own, light = labels[here] == k, sides.lit[here] & (away[here] < bound[k])
        top = cv2.morphologyEx((own & light).astype(np.uint8), cv2.MORPH_OPEN, SQUARE)
        reach = int(np.ceil(length + FACE_SLACK_PX))
        end = np.rint(reach + np.array([dx, dy]) * (1 + FACE_SLACK_PX / length)).astype(int)
        outwards = np.zeros((2 * reach + 1,) * 2, np.uint8)
        cv2.line(outwards, (reach, reach), end.tolist(), 1)
        below = cv2.dilate(cv2.dilate(top, SQUARE), outwards, borderValue=0) > 0
        faces[k] = np.mean(below[own & (away[here] >= bound[k])]) > FACE
    return faces


def _two_sides(
    sides: Sides, away: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of each patch (count,) the deviation that parts its light side from its dark one, 0 if
    it has no two, and those of both."""
    bound, light, dark = np.empty((3, len(sides.total)), np.float32)
    _kernels.part_sides(away, sides.lit, sides.slope, sides.steepest, labels, bound, light, dark)
    return bound, light, dark


def find_lamp(
    sides: Sides, away: np.ndarray, labels: np.ndarray, faces: np.ndarray | None = None
) -> Lamp | None:
    """Find the one lamp of an image, if one casts shadows on the same side of most parts.

    A shadow ends as far from its part as the part and its shadow reach further than the part, in
    the direction of the shadow. It is measured where the part has another colour, or is darker.

    Parameters
    ----------
    sides : Sides
    away : (H, W) uint8
        Deviation of each pixel from the background, 0 where it shows it [L].
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    faces : (count,) bool, optional
        Patches that are known to have no shadow: see `find_faces`.
    """
    count = len(sides.total)
    large = sides.total >= LEAST_AREA_PX2
    large[0] = False
    if faces is not None:
        large &= ~faces
    fewest = max(FEWEST, AGREE * np.count_nonzero(large))
    cast = cv2.morphologyEx(sides.lit.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    places = cv2.findNonZero((away > 0).view(np.uint8))
    if places is None:
        return None
    columns, rows = places.reshape(-1, 2).T
    patch, shaded = labels[rows, columns], cast[rows, columns] > 0
    own = ~sides.lit[rows, columns]
    shade = np.bincount(patch[shaded], minlength=count)
    if np.count_nonzero(large & (shade > LEAST_CAST[0] * sides.total)) < fewest:
        return None
    grey = np.bincount(patch[own], minlength=count) < LEAST_PART * sides.total
    # Of a part as grey as a shadow the darker side is the part.
    bound, *_ = _two_sides(sides, away, labels)
    darker = (grey & (bound > 0))[patch] & (away[rows, columns] > bound[patch])
    own |= darker
    shaded &= ~darker
    shade, body = (
        np.bincount(patch[shaded], minlength=count),
        np.bincount(patch[own], minlength=count),
    )
    fraction = shade / np.maximum(sides.total, 1)
    clear = large & (fraction > LEAST_CAST[0]) & (fraction < LEAST_CAST[1])
    clear &= body > LEAST_PART * sides.total
    if np.count_nonzero(clear) < fewest:
        return None
    at = np.stack([columns, rows]).astype(float)
    middles = [
        np.stack([np.bincount(patch[which], line[which], count) for line in at], axis=1)
        / np.maximum(number, 1)[:, None]
        for which, number in ((shaded, shade), (own, body))
    ]
    way = (middles[0] - middles[1])[clear]
    way /= np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    alike = way @ way.T > ONE_LAMP
    number = np.count_nonzero(alike, axis=1)
    if np.max(number) < max(fewest, OF_ONE_LAMP * len(way)):
        return None
    one = alike[np.argmax(number)]
    clear[clear] = one
    mean = np.mean(way[one], axis=0)
    if np.hypot(*mean) < ONE_LAMP:
        return None
    unit = mean / np.hypot(*mean)
    along = unit @ at
    level = float(np.median(away[rows, columns][shaded]))
    reach, part = np.full((2, count), -np.inf)
    dark = own | (away[rows, columns] > 0.5 * level)
    np.maximum.at(reach, patch[dark], along[dark])
    np.maximum.at(part, patch[own], along[own])
    length = reach[clear] - part[clear]
    usual = float(np.median(length))
    spread = float(np.median(np.abs(length - usual)))
    if usual < SHORTEST_PX or spread > SPREAD * usual or level < DEEP:
        return None
    return Lamp(level, usual * unit, 1.5 * spread)


def take_out_shadows(
    sides: Sides,
    away: np.ndarray,
    labels: np.ndarray,
    plate_known: bool = False,
    faces: np.ndarray | None = None,
) -> np.ndarray:
    """Set `away` to 0 where an image deviates from the background because of a shadow. Return of
    which patches (count,) bool a part was removed as shadow.

    Parameters
    ----------
    sides : Sides
        Where patches are like a darker background.
    away : (H, W) uint8
        Deviation of each pixel from the background, 0 where it shows it [L].
    labels : (H, W) int32
        Number of the patch of each pixel, 0 outside.
    plate_known : bool
        Whether the background was learned: then what is neither like a darker plate nor faint is a
        part, and has edges as wide as parts have in this image.
    faces : (count,) bool, optional
        Patches that are known to have no shadow: see `find_faces`.
    """
    like, lit, slope, steepest, largest, total, balance = sides
    count = len(total)
    _clear_bright(away, like, labels, (balance > 0) & (total >= LEAST_AREA_PX2))
    width = largest / np.maximum(steepest, 1)
    large = np.flatnonzero((total >= LEAST_AREA_PX2) & (steepest > 0))
    cut = np.zeros(count, bool)
    if not len(large):
        return cut
    sharp = float(np.percentile(width[large], SHARP_PERCENT))
    if plate_known:
        sharp = max(sharp, _part_width(width, largest, total, balance, large))
    bound, light, dark = _two_sides(sides, away, labels)
    if faces is not None:
        bound[faces] = 0
    if np.any(bound > 0):
        around = cv2.dilate(away, np.ones((5, 5), np.uint8))
        fade, way = np.empty(count, np.float32), np.zeros((count, 2))
        _kernels.find_fade(away, around, lit, slope, labels, bound, light, fade, way)
        softness = np.where(fade > 0, light / np.maximum(sharp * fade, 1e-3), 0)
        bound = _of_shadows(bound, light, dark, softness, way, len(large))
        light_side = (lit & (away < bound[labels])).astype(np.uint8)
        shadow = cv2.morphologyEx(light_side, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
        if np.any(shadow) and _parts_are_thick(shadow, (away > 0) & ~shadow, labels):
            away[shadow] = 0
            cut[labels[shadow]] = True
    alone = (width > min(ALONE * sharp, WIDE_PX)) & (balance < -MOSTLY * total)
    if np.any(alone[large]):
        away[alone[labels]] = 0
    return cut & ~alone


def _part_width(
    width: np.ndarray,
    largest: np.ndarray,
    total: np.ndarray,
    balance: np.ndarray,
    large: np.ndarray,
) -> float:
    """Return the width of parts' edges [px] from those of patches (count,), of which `large` (n,)
    are looked at.

    An image may be out of focus, or moved in one direction: edges across that are as wide as they
    get. Slivers and faint patches do not count.
    """
    usual = np.sort(largest[large])[3 * len(large) // 4]
    clear = large[largest[large] >= CLEAR_EDGE * usual]
    parts = clear[balance[clear] >= -MOSTLY * total[clear]]
    if len(parts) >= FEWEST:
        return float(np.sort(width[parts])[WIDE_PERCENT * len(parts) // 100])
    return float(np.sort(width[clear])[len(clear) // 2])


def _clear_bright(
    away: np.ndarray, like: np.ndarray, labels: np.ndarray, bright: np.ndarray
) -> None:
    """Set the deviation to 0 in the shadows of parts brighter than the plate: all that is like a
    darker plate and reaches it."""
    if not np.any(bright):
        return
    shadow = (like & bright[labels]).astype(np.uint8)
    element = np.ones((3, 3), np.uint8)
    plate = cv2.morphologyEx((labels == 0).astype(np.uint8), cv2.MORPH_OPEN, element)
    count, places = cv2.connectedComponents(shadow | plate)
    reached = np.zeros(count, bool)
    reached[places[plate > 0]] = True
    away[(shadow > 0) & reached[places]] = 0


def _parts_are_thick(shadow: np.ndarray, parts: np.ndarray, labels: np.ndarray) -> bool:
    """Whether what casts shadows is as thick as they are, in most patches that have one."""
    thickness = np.zeros((2, labels.max() + 1), np.float32)
    for most, side in zip(thickness, (shadow, parts), strict=True):
        depth = cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, 3)
        np.maximum.at(most, labels[side], depth[side])
    cast, casts = thickness[:, thickness[0] > 0]
    return bool(np.median(casts / cast) > THICK)


def _of_shadows(
    bound: np.ndarray,
    light: np.ndarray,
    dark: np.ndarray,
    softness: np.ndarray,
    way: np.ndarray,
    patches: int,
) -> np.ndarray:
    """Return the deviations (count,) up to which what is like a darker plate is shadow.

    The light is the same for all parts: where many have a light side, soft or all on one side of
    their dark one, all have a shadow, of one depth.
    """
    seen = (bound > 0) & (softness > 0)
    if np.count_nonzero(seen) >= max(AGREE * patches, FEWEST):
        aligned = float(np.hypot(*np.mean(way[seen], axis=0)))
        usual = float(np.median(softness[seen]))
        if usual > (SOFT[1] if aligned > ALIGNED else SOFT[0]):
            depth = float(np.median(light[seen]))
            alike = (bound > 0) & (np.abs(light / depth - 1) < DEPTHS)
            return np.where(alike, bound, np.where(depth < LIGHTER * dark, 0.5 * (depth + dark), 0))
    return np.where(seen & (softness > SOFT[2]), bound, 0)
