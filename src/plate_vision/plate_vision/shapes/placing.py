"""Where a part may lie in a group: all places and turns are tried."""

from __future__ import annotations

import numpy as np

from plate_core.kernels import inner_kernel, kernel

NEAR_PX = 1.3
"""How near the group's rim is to a part's where it is the same [px]."""

OUTSIDE_PX = 1.6
"""How far outside a part may seem to be [px]."""

MOST_OUTSIDE = 0.06
"""Largest fraction of a part outside the group."""

BARRED = -30_000
"""Less than any number of points on a rim."""


@inner_kernel()
def _level(field: np.ndarray, to_px: np.ndarray, place: np.ndarray, pose: np.ndarray) -> float:
    """Return a field (h, w) at the pixel nearest to a place (2,) of a part; far outside it beside
    the window."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u = pose[0] + c * place[0] - s * place[1]
    v = pose[1] + s * place[0] + c * place[1]
    i = int(np.floor(to_px[0, 0] * u + to_px[0, 1] * v + to_px[0, 2] + 0.5))
    j = int(np.floor(to_px[1, 0] * u + to_px[1, 1] * v + to_px[1, 2] + 0.5))
    if i < 0 or j < 0 or j >= field.shape[0] or i >= field.shape[1]:
        return -99.0
    return field[j, i]


@inner_kernel()
def _is_outside(free: float) -> int:
    """Return 1 for a point of a part that is not where it is free, else 0."""
    return 1 if free < -OUTSIDE_PX else 0


@inner_kernel()
def _is_on_rim(border: float) -> int:
    """Return 1 for a point of a part's rim that is on the group's, -1 if it is outside, else 0."""
    if border < -OUTSIDE_PX:
        return -1
    return 1 if border < NEAR_PX else 0


@kernel(error_model="numpy")
def support(
    free: np.ndarray,
    border: np.ndarray,
    to_px: np.ndarray,
    rim: np.ndarray,
    inner: np.ndarray,
    pose: np.ndarray,
) -> tuple[float, float]:
    """Return which fraction of a part's rim is on the group's, less that which is outside, and
    which of its inner points is not where it is free."""
    seen = out = 0
    for k in range(len(rim)):
        seen += _is_on_rim(_level(border, to_px, rim[k], pose))
    for k in range(len(inner)):
        out += _is_outside(_level(free, to_px, inner[k], pose))
    return seen / len(rim), out / len(inner)


@inner_kernel()
def _farthest(points: np.ndarray, place: np.ndarray) -> float:
    """Return how far the farthest of points (n, 2) is from a place (2,)."""
    most = 0.0
    for k in range(len(points)):
        most = max(most, np.hypot(points[k, 0] - place[0], points[k, 1] - place[1]))
    return most


@inner_kernel()
def _offsets(
    points: np.ndarray, to_px: np.ndarray, pole: np.ndarray, c: float, s: float, out: np.ndarray
) -> None:
    """Write how far points (n, 2) of a part at a turn are from its pole, (n, 2) whole pixels."""
    for k in range(len(points)):
        x, y = points[k, 0] - pole[0], points[k, 1] - pole[1]
        u, v = c * x - s * y, s * x + c * y
        out[k, 0] = int(np.floor(to_px[0, 0] * u + to_px[0, 1] * v + 0.5))
        out[k, 1] = int(np.floor(to_px[1, 0] * u + to_px[1, 1] * v + 0.5))


@inner_kernel()
def _add_rows(
    field: np.ndarray, offsets: np.ndarray, row: int, begin: int, total: np.ndarray
) -> None:
    """Add to `total` (w,), for places along a row of a field, what it is at all points of a part
    that lies there."""
    width = len(total)
    for k in range(len(offsets)):
        first = begin + offsets[k, 0]
        values = field[row + offsets[k, 1], first : first + width]
        for i in range(width):
            total[i] += values[i]


@kernel(error_model="numpy")
def search(
    free: np.ndarray,
    border: np.ndarray,
    to_px: np.ndarray,
    rim: np.ndarray,
    inner: np.ndarray,
    pole: np.ndarray,
    depth: float,
    turns: np.ndarray,
    stride: int,
) -> np.ndarray:
    """Return for each place (n, 4) where a part's widest place may be: x, y [m], the angle [rad]
    at which most of its rim is seen, and how much.

    A part at a turn is a set of offsets in pixels, the same at all places, so that what it covers
    is counted for a whole row of places at once.
    """
    height, width = free.shape
    scale = max(np.hypot(to_px[0, 0], to_px[0, 1]), np.hypot(to_px[1, 0], to_px[1, 1]))
    reach = max(_farthest(rim, pole), _farthest(inner, pole))
    margin = 2 + int(scale * reach)  # no part leaves it
    framed = (height + 2 * margin, width + 2 * margin)
    outside = np.full(framed, _is_outside(-np.inf), np.int16)
    on_rim = np.full(framed, _is_on_rim(-np.inf), np.int16)
    begin, end = np.full(height, width), np.zeros(height, np.int64)  # of each row's places
    for j in range(height):
        for i in range(width):
            outside[margin + j, margin + i] = _is_outside(free[j, i])
            on_rim[margin + j, margin + i] = _is_on_rim(border[j, i])
            if free[j, i] >= depth:
                begin[j], end[j] = min(begin[j], i), i + 1
    most = int(2 * MOST_OUTSIDE * len(inner))
    best, best_turn = np.zeros((height, width), np.int16), np.zeros((height, width), np.int64)
    counts = np.empty(width, np.int16)
    inner_px, rim_px = np.empty((len(inner), 2), np.int64), np.empty((len(rim), 2), np.int64)
    for turn in range(len(turns)):
        c, s = np.cos(turns[turn]), np.sin(turns[turn])
        _offsets(inner, to_px, pole, c, s, inner_px)
        _offsets(rim, to_px, pole, c, s, rim_px)
        for j in range(0, height, stride):
            if begin[j] >= end[j]:
                continue
            count = counts[: end[j] - begin[j]]
            count[:] = 0
            _add_rows(outside, inner_px, margin + j, margin + begin[j], count)
            fits = False
            for k in range(len(count)):
                i = begin[j] + k
                if i % stride == 0 and free[j, i] >= depth and count[k] <= most:
                    count[k], fits = 0, True
                else:
                    count[k] = BARRED
            if not fits:
                continue
            _add_rows(on_rim, rim_px, margin + j, margin + begin[j], count)
            for k in range(len(count)):
                if count[k] > best[j, begin[j] + k]:
                    best[j, begin[j] + k], best_turn[j, begin[j] + k] = count[k], turn
    a, b, c0 = to_px[0]
    d, e, f0 = to_px[1]
    det = a * e - b * d
    found, number = np.empty((np.count_nonzero(best), 4)), 0
    for j in range(height):
        for i in range(width):
            if best[j, i] == 0:
                continue
            angle = turns[best_turn[j, i]]
            u = (e * (i - c0) - b * (j - f0)) / det
            v = (a * (j - f0) - d * (i - c0)) / det
            c, s = np.cos(angle), np.sin(angle)
            found[number, 0] = u - c * pole[0] + s * pole[1]
            found[number, 1] = v - s * pole[0] - c * pole[1]
            found[number, 2], found[number, 3] = angle, best[j, i] / len(rim)
            number += 1
    return found
