"""First guesses of the parts' centres: cheap, to about a pixel, also where parts touch.

Dark blobs are eroded. What is then as large as one part is one; in what is larger, every piece of
edge votes for the point one radius inside it: a Hough transform for one radius.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel

from ..plate.light import LitPlate, bare

COARSE_RADIUS_PX = 3.5
"""Least radius [px] that a part keeps when rows and columns are skipped for speed."""

EROSION = 0.5
"""Rim taken off every dark blob, in part radii: cuts the neck between parts that touch, and
removes the thin dark line of a plate that is displaced a little."""

MIN_CORE = 0.1
"""Smallest eroded blob, relative to that of a whole part: what is left of a part of which hardly
half is on the plate, a quarter in a corner, or which is 0.8 as large as expected."""

MAX_CORE = 1.5
"""Largest eroded blob that is taken for one part."""

MIN_SLOPE = 0.03
"""Change of darkness [1/px], by Sobel, that is an edge: seven times what noise makes."""

MIN_VOTES = (0.12, 0.02)
"""Least fraction of a whole rim's votes that make a part; and where no other is near, as in the
middle of seven that are packed: of its rim only the gaps are seen, and those are blurred."""

MIN_TARGET = 0.1
"""Least darkness of the place that is voted for: keeps bright places from collecting votes."""

SEPARATION = (1.3, 1.6)
"""Least distance of two centres, in part radii, for each of these: parts that touch have 2, the
middle of four in a square 1.4."""

SPREAD = 0.2
"""Votes are counted together over this many radii to either side: how well a radius is known."""


def find_seeds(
    plate: LitPlate, box: tuple[int, int, int, int], threshold: float, radius_px: float
) -> np.ndarray:
    """Find the centres (n, 2) [px] of dark blobs; some may be no part.

    Parameters
    ----------
    plate : LitPlate
    box : (int, int, int, int)
        Pixels x0, y0, x1, y1, half open, that hold the plate.
    threshold : float
        Fraction of the plate's brightness below which a pixel is dark.
    radius_px : float
        Radius of a part [px].
    """
    stride = max(1, int(radius_px / COARSE_RADIUS_PX))
    grid = (box[0], box[1], stride)
    # What is outside counts as dark while eroding: a part is not eroded from the plate's edge.
    outside = ~plate.usable[box[1] : box[3] : stride, box[0] : box[2] : stride]
    if outside.size == 0:
        return np.empty((0, 2))
    dark = _dark(plate, threshold, grid, outside)
    core = cv2.erode(dark, _disc(round(EROSION * radius_px / stride))) > outside
    whole = np.pi * ((1 - EROSION) * radius_px / stride) ** 2
    seeds, boxes, merged = _blobs(core, np.flatnonzero(core), MIN_CORE * whole, MAX_CORE * whole)
    seeds = seeds * stride + box[:2]
    if not len(boxes):
        return seeds
    # Around a core is what was eroded, with the edges that vote.
    pad = round(radius_px) + stride
    low, size_px = np.repeat(box[:2], 2), np.repeat(plate.grey.shape[::-1], 2)
    boxes = np.clip(boxes * stride + low + (-pad, pad, -pad, pad), 0, size_px)
    return np.concatenate([seeds, _split(plate, merged, grid, boxes, radius_px)])


@lru_cache(maxsize=16)
def _disc(radius: int) -> np.ndarray:
    """Return a round structuring element of a radius [px]."""
    reach = np.arange(-radius, radius + 1)
    return (np.hypot(reach[:, None], reach[None, :]) <= radius + 0.3).astype(np.uint8)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _dark(
    plate: LitPlate, threshold: float, grid: tuple[int, int, int], outside: np.ndarray
) -> np.ndarray:
    """Return 1 (h, w) where there is less than a fraction of the light, or no plate, on a coarse
    grid: its first x, first y, and step [px]."""
    grey, light = plate.grey, plate.light.copy()
    light[:6] *= np.float32(threshold)
    dark = outside.astype(np.uint8)
    for row in range(dark.shape[0]):
        y = grid[1] + row * grid[2]
        for column in range(dark.shape[1]):
            x = grid[0] + column * grid[2]
            dark[row, column] |= grey[y, x] < bare(light, x, y)
    return dark


@kernel(error_model="numpy")
def _blobs(
    core: np.ndarray, places: np.ndarray, least: float, most: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centres x, y (n, 2) of the blobs in `core` (h, w) of `least` to `most` pixels; the
    boxes x0, x1, y0, y1 (m, 4), half open, of larger ones, and a mask (h, w) of these.

    `places` are the indices of the pixels in blobs; `core` is False everywhere afterwards.
    """
    height, width = core.shape
    xs, ys = np.empty(len(places), np.int64), np.empty(len(places), np.int64)
    centres, boxes = np.empty((len(places), 2)), np.empty((len(places), 4), np.int64)
    merged = np.zeros_like(core)
    whole, large = 0, 0
    for place in places:
        y, x = divmod(place, width)
        if not core[y, x]:
            continue
        core[y, x] = False
        xs[0], ys[0], size, done = x, y, 1, 0
        while done < size:
            for row in range(max(ys[done] - 1, 0), min(ys[done] + 2, height)):
                for column in range(max(xs[done] - 1, 0), min(xs[done] + 2, width)):
                    if core[row, column]:
                        core[row, column] = False
                        xs[size], ys[size] = column, row
                        size += 1
            done += 1
        if size > most:
            x0, x1, y0, y1 = xs[:size].min(), xs[:size].max(), ys[:size].min(), ys[:size].max()
            boxes[large] = x0, x1 + 1, y0, y1 + 1
            large += 1
            for k in range(size):
                merged[ys[k], xs[k]] = True
        elif size >= least:
            centres[whole] = xs[:size].mean(), ys[:size].mean()
            whole += 1
    return centres[:whole], boxes[:large], merged


def _split(
    plate: LitPlate,
    merged: np.ndarray,
    grid: tuple[int, int, int],
    boxes: np.ndarray,
    radius_px: float,
) -> np.ndarray:
    """Return the centres (n, 2) [px] of parts in dark areas that are too large for one.

    They may be where `merged` (h, w) is true, on a grid (first x, first y, step [px]); `boxes`
    (m, 4) are the pixels x0, x1, y0, y1, half open, around each of these areas.
    """
    found = np.empty((0, 2))
    side = 2 * (2 * max(1, round(SPREAD * radius_px)) + 1,)
    for x0, x1, y0, y1 in boxes.tolist():
        votes = np.zeros((y1 - y0, x1 - x0), np.float32)
        _vote(plate, (x0, y0), radius_px, votes)
        votes = cv2.boxFilter(votes, -1, side, normalize=False, borderType=cv2.BORDER_CONSTANT)
        # Boxes may overlap, so that a part is found in two of them.
        for x, y in _peaks(votes, (x0, y0), merged, grid, radius_px):
            if _nearest(found, x, y) > radius_px**2:
                found = np.vstack([found, (x, y)])
    return found


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _vote(plate: LitPlate, corner: tuple[int, int], radius: float, votes: np.ndarray) -> None:
    """Let every piece of edge vote; `votes` (h, w) begins at the pixel `corner`.

    A vote weighs as much as the edge rises, relative to the darkness it votes for: so the votes of
    a whole rim add up to its length [px], however blurred it is.
    """
    grey, light, usable = plate
    height, width = grey.shape
    rows, columns = votes.shape
    x0, y0 = corner
    for y in range(max(y0, 1), min(y0 + rows, height - 1)):
        for x in range(max(x0, 1), min(x0 + columns, width - 1)):
            a, b, c = int(grey[y - 1, x - 1]), int(grey[y - 1, x]), int(grey[y - 1, x + 1])
            d, f = int(grey[y, x - 1]), int(grey[y, x + 1])
            g, h, i = int(grey[y + 1, x - 1]), int(grey[y + 1, x]), int(grey[y + 1, x + 1])
            right, down = a + 2 * d + g - c - 2 * f - i, a + 2 * b + c - g - 2 * h - i
            rise = np.sqrt(np.float32(right * right + down * down))
            here = 8 * bare(light, x, y)
            if rise < MIN_SLOPE * here:
                continue
            if not (usable[y - 1, x - 1] and usable[y - 1, x + 1]):
                continue
            if not (usable[y + 1, x - 1] and usable[y + 1, x + 1]):
                continue
            to_x = int(np.rint(x + radius * right / rise))
            to_y = int(np.rint(y + radius * down / rise))
            if not (x0 <= to_x < x0 + columns and y0 <= to_y < y0 + rows):
                continue
            dark = 1 - grey[min(max(to_y, 0), height - 1), min(max(to_x, 0), width - 1)] / here * 8
            votes[to_y - y0, to_x - x0] += rise / here / max(dark, MIN_TARGET)


@kernel(error_model="numpy")
def _peaks(
    votes: np.ndarray,
    corner: tuple[int, int],
    merged: np.ndarray,
    grid: tuple[int, int, int],
    radius: float,
) -> np.ndarray:
    """Return the centres (n, 2) [px]: the most votes first, then the most far enough away."""
    rim = 2 * np.pi * radius
    rows, columns = votes.shape
    x0, y0 = corner
    ys, xs = np.nonzero(votes > MIN_VOTES[1] * rim)
    inside = np.zeros(len(ys), np.bool_)
    for k in range(len(ys)):
        column, row = (xs[k] + x0 - grid[0]) // grid[2], (ys[k] + y0 - grid[1]) // grid[2]
        inside[k] = (
            0 <= row < merged.shape[0] and 0 <= column < merged.shape[1] and merged[row, column]
        )
    ys, xs = ys[inside], xs[inside]
    count = np.empty(len(ys))
    for k in range(len(ys)):
        count[k] = votes[ys[k], xs[k]]
    found = np.empty((len(ys), 2))
    size = 0
    while len(count):
        best = np.argmax(count)
        if count[best] <= 0:
            break
        x, y = xs[best], ys[best]
        weak = count[best] < MIN_VOTES[0] * rim
        count[best] = 0
        if weak and _nearest(found[:size], x + x0, y + y0) < (SEPARATION[1] * radius) ** 2:
            continue
        # The middle of the peak: among pixels with nearly as many votes.
        weight = sx = sy = 0.0
        for j in range(max(y - 1, 0), min(y + 2, rows)):
            for i in range(max(x - 1, 0), min(x + 2, columns)):
                more = max(votes[j, i] - 0.5 * votes[y, x], 0.0)
                weight += more
                sx += more * i
                sy += more * j
        found[size, 0], found[size, 1] = x0 + sx / weight, y0 + sy / weight
        size += 1
        for k in range(len(count)):
            if (xs[k] - x) ** 2 + (ys[k] - y) ** 2 <= (SEPARATION[0] * radius) ** 2:
                count[k] = 0
    return found[:size]


@kernel(error_model="numpy")
def _nearest(centre: np.ndarray, x: float, y: float) -> float:
    """Return the squared distance [px2] of a point from the nearest of centres (n, 2)."""
    least = np.inf
    for k in range(len(centre)):
        least = min(least, (centre[k, 0] - x) ** 2 + (centre[k, 1] - y) ** 2)
    return least
