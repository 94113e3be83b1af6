"""Shadows: where the background is darker, its chroma kept, and fades into the plate.

A part ends at an edge as sharp as the image is; its shadow is lighter than the part, and its edge
is softer. So each patch is parted in a light and a dark side, and the light one is looked at.
"""

from __future__ import annotations

import cv2
import numpy as np

from plate_core.kernels import kernel

DARKEST = 0.45
"""Darkest shadow, relative to the plate [L]."""

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

EVEN = 0.3
"""Steepest slope of what is called even, relative to the steepest of the patch."""

LEAST_EVEN = 12
"""Even pixels that a part and a shadow have at least."""

LIGHTER = 0.8
"""Deviation of a shadow, relative to that of the part that casts it, at most."""

AGREE = 0.25
"""Fraction of the patches that have a shadow, from which on all are thought to have one."""

DARKER = 0.3
"""Of the even pixels of a patch so many are darker than what is called its dark side."""

HALFWAY = (0.3, 0.7)
"""Where a shadow's edge is looked at: its deviation relative to that of the whole shadow."""

LEAST_SEEN = 4
"""Pixels of a shadow's edge by which its width is known."""

MOSTLY = 0.7
"""Of a shadow that lies alone so much is like a darker plate, at least."""

ALONE = 3.0
"""Width of the edge of a shadow that lies alone, relative to sharp edges."""

WIDE_PX = 25.0
"""Width from which on the edge of a patch is that of a shadow, whatever else is seen [px]."""

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
    like, lit, slope, steepest, largest, total, balance = _edges(
        lab, bare, chroma, limit, away, labels, count
    )
    _clear_bright(away, like, labels, (balance > 0) & (total >= LEAST_AREA_PX2))
    width = largest / np.maximum(steepest, 1)
    large = np.flatnonzero((total >= LEAST_AREA_PX2) & (steepest > 0))
    if not len(large):
        return
    sharp = float(np.percentile(width[large], SHARP_PERCENT))
    bound, light, dark = _two_sides(away, lit, slope, steepest, labels, count)
    if np.any(bound > 0):
        around = cv2.dilate(away, np.ones((5, 5), np.uint8))
        fade, way = _fade(away, around, lit, slope, labels, bound, light)
        softness = np.where(fade > 0, light / np.maximum(sharp * fade, 1e-3), 0)
        bound = _of_shadows(bound, light, dark, softness, way, len(large))
        shadow = (lit & (away < bound[labels])).astype(np.uint8)
        away[cv2.morphologyEx(shadow, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0] = 0
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


@kernel(error_model="numpy")
def _edges(
    lab: np.ndarray,
    bare: np.ndarray,
    chroma: float,
    limit: np.ndarray,
    away: np.ndarray,
    labels: np.ndarray,
    count: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return which pixels are like a darker plate, which of them are no darker than a shadow, and
    the slope of the light at each [L/px]; of each patch the steepest slope and the largest
    deviation where it is darker, its area, and how much more of it is brighter than the plate than
    like a darker one."""
    balance = np.zeros(count, np.int64)
    height, width, channels = lab.shape
    like = np.zeros((height, width), np.bool_)
    lit = np.zeros((height, width), np.bool_)
    slope = np.zeros((height, width), np.float32)
    steepest = np.zeros(count, np.float32)
    largest = np.zeros(count, np.float32)
    total = np.zeros(count, np.int64)
    for y in range(height):
        for x in range(width):
            k = labels[y, x]
            if k == 0:
                continue
            total[k] += 1
            here, plate = np.float32(lab[y, x, 0]), np.float32(bare[y, x, 0])
            if here >= plate:
                balance[k] += 1
                continue
            left, right = np.float32(lab[y, max(x - 1, 0), 0]), lab[y, min(x + 1, width - 1), 0]
            up, down = np.float32(lab[max(y - 1, 0), x, 0]), lab[min(y + 1, height - 1), x, 0]
            across, along = right - left, down - up
            slope[y, x] = np.float32(0.5) * np.sqrt(across * across + along * along)
            if max(left, right, up, down) <= plate + limit[y, x]:  # else the edge of a highlight
                steepest[k] = max(steepest[k], slope[y, x])
                largest[k] = max(largest[k], plate - here)
            if channels == 3:
                factor = here / plate
                square = np.float32(0)
                for c in range(1, 3):
                    expected = 128 + factor * (np.float32(bare[y, x, c]) - 128)
                    square += (np.float32(lab[y, x, c]) - expected) ** 2
                if chroma * np.sqrt(square) > limit[y, x]:
                    continue
            balance[k] -= 1
            like[y, x] = True
            lit[y, x] = here >= DARKEST * plate
    return like, lit, slope, steepest, largest, total, balance


@kernel(error_model="numpy")
def _two_sides(
    away: np.ndarray,
    like: np.ndarray,
    slope: np.ndarray,
    steepest: np.ndarray,
    labels: np.ndarray,
    count: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of each patch the deviation that parts its light side from its dark one, 0 if there
    are no two; that of the light side, and that of the dark one or of all.

    It parts the even pixels best in two, as Otsu (1979) does.
    """
    height, width = labels.shape
    histogram = np.zeros((count, 256), np.int32)
    plain = np.zeros((count, 256), np.int32)
    for y in range(height):
        for x in range(width):
            k = labels[y, x]
            if k and slope[y, x] < EVEN * steepest[k]:
                histogram[k, away[y, x]] += 1
                plain[k, away[y, x]] += like[y, x]
    bound = np.zeros(count, np.float32)
    light = np.zeros(count, np.float32)
    dark = np.zeros(count, np.float32)
    for k in range(1, count):
        total, moment = 0, 0.0
        for level in range(256):
            total += histogram[k, level]
            moment += level * histogram[k, level]
        below, first, most = 0, 0.0, 0.0
        for level in range(255):
            below += histogram[k, level]
            first += level * histogram[k, level]
            if below < LEAST_EVEN or total - below < LEAST_EVEN:
                continue
            low, high = first / below, (moment - first) / (total - below)
            between = below * (total - below) * (high - low) ** 2
            if between > most:
                most = between
                bound[k], light[k] = 0.5 * (low + high), low
                if low > LIGHTER * high:
                    bound[k] = 0
        passed, level = 0, 255
        while level > 0 and passed < DARKER * total:
            passed += histogram[k, level]
            level -= 1
        dark[k] = level
        # What is shadow is like a darker plate.
        below, own = 0, 0
        for level in range(int(bound[k])):
            below += histogram[k, level]
            own += plain[k, level]
        if 2 * own < below:
            bound[k] = 0
    return bound, light, dark


@kernel(error_model="numpy")
def _fade(
    away: np.ndarray,
    around: np.ndarray,
    like: np.ndarray,
    slope: np.ndarray,
    labels: np.ndarray,
    bound: np.ndarray,
    level: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return of each patch the slope (count,) at the outer edge of its light side [L/px], 0 if it
    is not seen; and the direction (count, 2) from the dark side to the light one."""
    height, width = labels.shape
    side = np.zeros((len(bound), 2, 3), np.float64)
    slopes = np.zeros(len(bound), np.float32)
    seen = np.zeros(len(bound), np.int32)
    for y in range(height):
        for x in range(width):
            k = labels[y, x]
            if k == 0 or bound[k] == 0:
                continue
            one = side[k, 0 if like[y, x] and away[y, x] < bound[k] else 1]
            one[0] += 1
            one[1] += x
            one[2] += y
            if not like[y, x] or around[y, x] > bound[k]:
                continue
            if HALFWAY[0] * level[k] < away[y, x] < HALFWAY[1] * level[k]:
                slopes[k] += slope[y, x]
                seen[k] += 1
    way = np.zeros((len(bound), 2), np.float64)
    for k in range(len(bound)):
        slopes[k] = slopes[k] / seen[k] if seen[k] >= LEAST_SEEN else 0
        if side[k, 0, 0] > 0 and side[k, 1, 0] > 0:
            dx = side[k, 0, 1] / side[k, 0, 0] - side[k, 1, 1] / side[k, 1, 0]
            dy = side[k, 0, 2] / side[k, 0, 0] - side[k, 1, 2] / side[k, 1, 0]
            length = np.sqrt(dx * dx + dy * dy)
            if length > 0:
                way[k, 0], way[k, 1] = dx / length, dy / length
    return slopes, way
