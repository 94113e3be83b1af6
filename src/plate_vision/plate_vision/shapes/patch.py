"""A patch of an image that differs from the background: one part, or several parts that were not
separated.

`Patch` contains the mask of the patch and the covered fraction of each pixel. The outline of the
patch is the contour where one half is covered. The outline has sub-pixel accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

HALF = 0.5
"""Covered fraction of a pixel at the outline."""

MAX_SHIFT_PX = 1.5
"""Maximum distance between the edge of the mask and the outline [px]."""

SMOOTH_PX = 0.8
"""Blur that is applied before the outline is located [px]. With this blur, the gradient at the edge
of a sharp part is smooth enough for a Newton step."""

MARGIN_PX = 4
"""Width of the margin around a patch in its window [px]."""

MIN_HOLE_PX2 = 6.0
"""Minimum area of a hole that is reported [px2]. Smaller holes are noise."""


@dataclass(frozen=True, eq=False)
class Patch:
    """One patch of an image.

    Image coordinates: x_px to the right, y_px down, the centre of the first pixel is (0, 0).

    Attributes
    ----------
    mask : (h, w) bool
        Pixels of the patch in a window of the image, without holes.
    corner : (int, int)
        Image column and row x0, y0 of the window's first pixel [px].
    cover : (h, w) float32
        Fraction of each pixel that the part covers, 0 to 1. At the contour, `cover` is more
        accurate than `mask`.
    whole : bool
        Whether the patch is complete. A patch is incomplete if the border of the image or of the
        region cuts it.
    group : bool
        Whether the patch seems to consist of several parts that were not separated.
    """

    mask: np.ndarray
    corner: tuple[int, int]
    cover: np.ndarray
    whole: bool = True
    group: bool = False

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the image that the patch's window covers."""
        (x0, y0), (height, width) = self.corner, self.mask.shape
        return np.s_[y0 : y0 + height, x0 : x0 + width]

    def overlaps(self, other: Patch) -> bool:
        """Whether any pixel belongs to both this patch and another patch."""
        ends = [np.add(patch.corner, patch.mask.shape[::-1]) for patch in (self, other)]
        low, high = np.maximum(self.corner, other.corner), np.minimum(*ends)
        if np.any(high <= low):
            return False
        mask, other_mask = (
            patch.mask[low[1] - y : high[1] - y, low[0] - x : high[0] - x]
            for patch, (x, y) in ((self, self.corner), (other, other.corner))
        )
        return bool(np.any(mask & other_mask))

    def window_with_margin(self, margin: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Return the rows and columns of an image (H, W, ...) in the patch's window with a margin
        [px] around it."""
        rows, columns = self.window
        return (
            slice(max(rows.start - margin, 0), min(rows.stop + margin, shape[0])),
            slice(max(columns.start - margin, 0), min(columns.stop + margin, shape[1])),
        )

    def windowed(self, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], np.ndarray]:
        """Return the rows and columns of an image (H, W, ...) in the patch's window with a margin
        of `MARGIN_PX`, and the patch's mask (h, w) uint8 there."""
        window = rows, columns = self.window_with_margin(MARGIN_PX, shape)
        mask = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
        (x, y), (height, width) = self.corner, self.mask.shape
        top, left = y - rows.start, x - columns.start
        mask[top : top + height, left : left + width] = self.mask
        return window, mask

    @cached_property
    def area_px2(self) -> float:
        """Area without holes [px2]."""
        return float(np.sum(self.cover, dtype=float))

    @cached_property
    def centre_px(self) -> np.ndarray:
        """Centre (2,) of the area without holes [px]."""
        cover = self.cover
        x = cover.sum(axis=0, dtype=float) @ np.arange(cover.shape[1])
        y = cover.sum(axis=1, dtype=float) @ np.arange(cover.shape[0])
        return np.array([x, y]) / max(self.area_px2, 1e-9) + self.corner

    @property
    def radius_px(self) -> float:
        """Radius of the disc of the same area [px]."""
        return float(np.sqrt(self.area_px2 / np.pi))

    @cached_property
    def outline(self) -> np.ndarray:
        """Points (k, 2) around the patch [px], one for each pixel of the contour, with sub-pixel
        accuracy."""
        return self._contours[0]

    @cached_property
    def holes(self) -> list[np.ndarray]:
        """Points (k, 2) around each hole [px]."""
        return self._contours[1]

    @cached_property
    def _contours(self) -> tuple[np.ndarray, list[np.ndarray]]:
        framed = np.pad(self.mask.astype(np.uint8), 2)
        cover = cv2.GaussianBlur(np.pad(self.cover, 2), (0, 0), SMOOTH_PX)
        contours, family = cv2.findContours(framed, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return np.empty((0, 2)), []
        outer = [i for i in range(len(contours)) if family[0][i][3] < 0]
        largest = max(outer, key=lambda i: cv2.contourArea(contours[i]))
        holes = [
            contours[i]
            for i in range(len(contours))
            if family[0][i][3] >= 0 and cv2.contourArea(contours[i]) >= MIN_HOLE_PX2
        ]
        fall = cv2.Sobel(cover, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(cover, cv2.CV_32F, 0, 1) / 8
        origin = np.array(self.corner) - 2
        return (
            _refine_contour(contours[largest], cover, fall) + origin,
            [_refine_contour(hole, cover, fall) + origin for hole in holes],
        )


def _refine_contour(
    contour: np.ndarray, cover: np.ndarray, slope: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Move each point of a contour (k, 1, 2) to the nearest place where the cover (h, w) is 0.5, by
    one Newton step. Return the new points (k, 2). `slope` is the gradient of the cover along x and
    y [1/px]."""
    x, y = contour[:, 0].T
    steep = np.stack([slope[0][y, x], slope[1][y, x]], axis=1)
    square = np.sum(steep**2, axis=1, keepdims=True)
    shift = (HALF - cover[y, x])[:, None] * steep / np.maximum(square, 1e-6)
    length = np.hypot(*shift.T)[:, None]
    shift *= np.minimum(1, MAX_SHIFT_PX / np.maximum(length, 1e-9))
    return np.asarray(contour[:, 0] + shift)
