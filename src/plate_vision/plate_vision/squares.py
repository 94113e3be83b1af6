"""Corners of dark squares to hundredths of a pixel: where lines along their edges meet.

Corners themselves are rounded by blur: what looks for them there (OpenCV's refinement) finds them a
quarter of a pixel inside at a blur of 1 px. An edge stays where it is.
"""

from __future__ import annotations

import cv2
import numpy as np

SAMPLES = 24
"""Places along each edge where it is crossed."""

SPAN = (0.15, 0.85)
"""Part of an edge that is looked at [sides]: its ends are rounded."""

REACH_PX = 4.0
"""How far to both sides of where an edge should be it is looked for [px]."""

STEP_PX = 0.5
"""Distance of two samples across an edge [px]."""

LEAST_CONTRAST = 25.0
"""Least difference of grey levels across an edge."""

OUTLIER_PX = 0.5
"""Crossings this far from their line [px] are left out: dirt, a part that lies there."""

LEAST_CROSSINGS = 6
"""Of an edge that are needed."""

ROUNDS = 2
"""How often edges are looked for, each time around where they were found."""


def square_corners(grey: np.ndarray, corners_px: np.ndarray) -> np.ndarray:
    """Find squares, dark on bright, near to where they should be.

    Parameters
    ----------
    grey : (H, W) uint8
    corners_px : (n, 4, 2)
        Corners in order around each square [px], right to `REACH_PX`.

    Returns
    -------
    (n, 4, 2)
        The same corners [px]; NaN for a square of which an edge is not seen.
    """
    corners = np.array(corners_px, dtype=float).reshape(-1, 4, 2)
    for _ in range(ROUNDS):
        corners = _look(grey, corners)
    return corners


def _look(grey: np.ndarray, corners: np.ndarray) -> np.ndarray:
    along = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    x, y = np.moveaxis(along / np.maximum(length, 1e-9), 2, 0)
    outward = np.stack([y, -x], axis=2)
    middle = corners.mean(axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * (corners - middle), axis=2))[..., None]
    share = np.linspace(*SPAN, SAMPLES)
    across = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    foot = corners[:, :, None] + share[:, None] * along[:, :, None]
    place = foot[..., None, :] + across[:, None] * outward[:, :, None, None]
    crossing = _crossings(_values(grey, place), across)
    line = _lines(share, crossing)  # offset at the edge's beginning, and its growth to the end
    first = corners + line[..., :1] * outward
    last = corners + along + line.sum(axis=2, keepdims=True) * outward
    return _meet(np.roll(first, 1, axis=1), np.roll(last, 1, axis=1), first, last)


def _values(grey: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Grey levels (n, 4, s, k) at places (n, 4, s, k, 2) [px]; NaN outside of the image."""
    rows = (place.shape[0] * place.shape[1], place.shape[2] * place.shape[3])
    x, y = np.moveaxis(np.nan_to_num(place, nan=-9.0).astype(np.float32), -1, 0)
    value = np.asarray(
        cv2.remap(
            grey,
            x.reshape(rows),
            y.reshape(rows),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )
    size = np.array(grey.shape[::-1]) - 1
    inside = np.all((place >= 0) & (place <= size), axis=-1)
    return np.where(inside, value.reshape(place.shape[:-1]).astype(float), np.nan)


def _crossings(value: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Where profiles (n, 4, s, k) rise through the middle of an edge's levels (n, 4, s); NaN."""
    with np.errstate(all="ignore"):
        dark = np.median(value.min(axis=3), axis=2, keepdims=True)[..., None]
        bright = np.median(value.max(axis=3), axis=2, keepdims=True)[..., None]
        level = 0.5 * (dark + bright)
        rises = (value[..., :-1] < level) & (value[..., 1:] >= level)
        rises &= bright - dark >= LEAST_CONTRAST
        share = (level - value[..., :-1]) / (value[..., 1:] - value[..., :-1])
    place = np.where(rises, across[:-1] + STEP_PX * np.nan_to_num(share), np.inf)
    nearest = np.argmin(np.abs(place), axis=3)[..., None]
    found = np.take_along_axis(place, nearest, axis=3)[..., 0]
    return np.where(np.isfinite(found), found, np.nan)


def _lines(share: np.ndarray, crossing: np.ndarray) -> np.ndarray:
    """Fit a + b share to crossings (n, 4, s) without outliers: (n, 4, 2); NaN if too few."""
    middle = np.nanmedian(np.where(np.isnan(crossing).all(axis=2, keepdims=True), 0, crossing), 2)
    weight = np.isfinite(crossing) & (np.abs(crossing - middle[..., None]) < 4 * OUTLIER_PX)
    line = _fit(share, crossing, weight)
    weight &= np.abs(crossing - line[..., :1] - line[..., 1:] * share) < OUTLIER_PX
    line = _fit(share, crossing, weight)
    return np.where(weight.sum(axis=2, keepdims=True) >= LEAST_CROSSINGS, line, np.nan)


def _fit(share: np.ndarray, crossing: np.ndarray, weight: np.ndarray) -> np.ndarray:
    count = np.maximum(weight.sum(axis=2), 1)
    value = np.where(weight, crossing, 0)
    x = np.where(weight, share, 0)
    mean_x, mean = x.sum(axis=2) / count, value.sum(axis=2) / count
    spread = np.maximum((x * x).sum(axis=2) - count * mean_x**2, 1e-9)
    growth = ((x * value).sum(axis=2) - count * mean_x * mean) / spread
    return np.stack([mean - growth * mean_x, growth], axis=2)


def _meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Where lines through a, b and through c, d (n, 4, 2) meet; NaN for the whole square if one
    line is missing."""
    u, v, w = b - a, d - c, c - a
    cross = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    with np.errstate(all="ignore"):
        t = (w[..., 0] * v[..., 1] - w[..., 1] * v[..., 0]) / cross
        point = a + t[..., None] * u
    whole = np.all(np.isfinite(point), axis=(1, 2), keepdims=True)
    return np.where(whole, point, np.nan)
