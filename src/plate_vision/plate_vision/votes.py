"""The centres of parts that touch: every piece of edge votes for the point one radius inside it."""

from __future__ import annotations

import numpy as np
from numba import njit

from .brightness import bare

MIN_SLOPE = 0.03
"""Change of darkness [1/px], by Sobel, that is an edge: seven times what noise makes."""

MIN_VOTES = (0.12, 0.02)
"""Least share of a whole rim's votes that make a part; and where no other is near, as in the middle
of seven that are packed: of its rim only the gaps are seen, and those are blurred."""

MIN_TARGET = 0.1
"""Least darkness of the place that is voted for: keeps bright places from collecting votes."""

SEPARATION = (1.3, 1.6)
"""Least distance of two centres, in part radii, for each of these: parts that touch have 2, the
middle of four in a square 1.4."""

SPREAD = 0.2
"""Votes are counted together over this many radii to either side: how well a radius is known."""


def split(
    grey: np.ndarray,
    light: np.ndarray,
    usable: np.ndarray,
    merged: np.ndarray,
    grid: tuple[int, int, int],
    boxes: np.ndarray,
    radius_px: float,
) -> np.ndarray:
    """Return the centres (n, 2) [px] of parts in dark areas that are too large for one.

    Parameters
    ----------
    grey : (H, W) uint8
        Image [grey levels].
    light : (9,)
        The bare plate, of `fit_brightness`.
    usable : (H, W) bool
        Pixels that show the plate.
    merged : (h, w) bool
        Where the centres may be, on a coarse grid.
    grid : (int, int, int)
        The grid's first x, first y, and step [px].
    boxes : (m, 4) int
        Pixels x0, x1, y0, y1, half open, around each of these areas.
    radius_px : float
        Of a part.
    """
    found = np.empty((0, 2))
    for x0, x1, y0, y1 in boxes.tolist():
        votes = np.zeros((y1 - y0, x1 - x0), np.float32)
        _vote(grey, light, usable, x0, y0, radius_px, votes)
        _count(votes, max(1, round(SPREAD * radius_px)))
        # Boxes may overlap, so that a part is found in two of them.
        for x, y in _peaks(votes, merged, grid, x0, y0, radius_px):
            if _nearest(found, x, y) > radius_px**2:
                found = np.vstack([found, (x, y)])
    return found


@njit(cache=True, fastmath=True, error_model="numpy")
def _vote(
    grey: np.ndarray,
    light: np.ndarray,
    usable: np.ndarray,
    x0: int,
    y0: int,
    radius: float,
    votes: np.ndarray,
) -> None:
    """Let every piece of edge vote; `votes` (h, w) begins at pixel x0, y0.

    A vote weighs as much as the edge rises, relative to the darkness it votes for: so the votes of
    a whole rim add up to its length [px], however blurred it is.
    """
    height, width = grey.shape
    rows, columns = votes.shape
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


@njit(cache=True, fastmath=True, error_model="numpy")
def _count(votes: np.ndarray, spread: int) -> None:
    """Add to every vote those up to `spread` pixels away along x and y, in place."""
    rows, columns = votes.shape
    line = np.empty(max(rows, columns), np.float32)
    for y in range(rows):
        line[:columns] = votes[y]
        for x in range(columns):
            votes[y, x] = line[max(x - spread, 0) : min(x + spread + 1, columns)].sum()
    for x in range(columns):
        line[:rows] = votes[:, x]
        for y in range(rows):
            votes[y, x] = line[max(y - spread, 0) : min(y + spread + 1, rows)].sum()


@njit(cache=True, error_model="numpy")
def _peaks(
    votes: np.ndarray,
    merged: np.ndarray,
    grid: tuple[int, int, int],
    x0: int,
    y0: int,
    radius: float,
) -> np.ndarray:
    """Return the centres (n, 2) [px]: the most votes first, then the most far enough away."""
    rim = 2 * np.pi * radius
    rows, columns = votes.shape
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


@njit(cache=True, error_model="numpy")
def _nearest(centre: np.ndarray, x: float, y: float) -> float:
    """Return the squared distance [px2] of a point from the nearest of centres (n, 2)."""
    least = np.inf
    for k in range(len(centre)):
        least = min(least, (centre[k, 0] - x) ** 2 + (centre[k, 1] - y) ** 2)
    return least
