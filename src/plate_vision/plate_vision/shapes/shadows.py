"""Shadows: where the background is darker, its chroma kept, and fades into the plate.

A part ends at an edge as sharp as the image is; its shadow is lighter than the part, and its edge
is softer. So each patch is parted in a light and a dark side, and the light one is looked at.
"""

from __future__ import annotations

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


def take_out_shadows(
    lab: np.ndarray,
    bare: np.ndarray,
    chroma: float,
    limit: np.ndarray,
    away: np.ndarray,
    labels: np.ndarray,
    count: int,
) -> None:
    """Set to 0 where the deviation of an image from the background is that of a shadow.

    Parameters
    ----------
    lab, bare : (H, W, C) uint8
        Colours of the image and of the background.
    chroma : float
        Weight of a and b beside L.
    limit, away : (H, W) uint8
        Deviation up to which a pixel shows the background; that of each pixel, 0 up to there.
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
    _clear_bright(away, like, labels, (balance > 0) & (total >= LEAST_AREA_PX2))
    width = largest / np.maximum(steepest, 1)
    large = np.flatnonzero((total >= LEAST_AREA_PX2) & (steepest > 0))
    if not len(large):
        return
    sharp = float(np.percentile(width[large], SHARP_PERCENT))
    bound, light, dark = np.empty((3, count), np.float32)
    _kernels.part_sides(away, lit, slope, steepest, labels, bound, light, dark)
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
    alone = (width > min(ALONE * sharp, WIDE_PX)) & (balance < -MOSTLY * total)
    if np.any(alone[large]):
        away[alone[labels]] = 0


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
