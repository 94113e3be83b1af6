"""Where the plate is in the image: a convex quadrilateral, or the whole image.

Image coordinates everywhere in this package: x_px to the right, y_px down, the centre of the first
pixel is (0, 0), as in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .errors import ImageError

MIN_AREA_PX2 = 100.0
"""Smallest plate [px2]: below that no part of a useful size fits."""

SEAM_PX = 1.0
"""Pixels nearer than this [px] to the plate's edge mix plate and background: they are not used."""


@dataclass(frozen=True, eq=False)  # equal only to itself: so it can be the key of a cache
class Region:
    """The pixels of one image size that show the plate.

    Attributes
    ----------
    normals : (4, 2)
        Inward unit normals of the edges; (0, 2) for the whole image.
    offsets : (4,)
        Distance of the image's origin from the edges [px], positive inside.
    box : (x0, y0, x1, y1)
        Pixel ranges [px] that hold the region, half open.
    """

    normals: np.ndarray
    offsets: np.ndarray
    box: tuple[int, int, int, int]

    def depth(self, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
        """Distance from the nearest edge of the plate [px], negative outside.

        Parameters
        ----------
        x_px, y_px : (...)
            Image points [px]; they broadcast.
        """
        depth = np.full(np.broadcast_shapes(np.shape(x_px), np.shape(y_px)), np.inf)
        for (nx, ny), offset in zip(self.normals, self.offsets, strict=True):
            depth = np.minimum(depth, nx * x_px + ny * y_px + offset)
        return depth


@lru_cache(maxsize=16)
def make_region(
    height_px: int,
    width_px: int,
    corners: tuple[tuple[float, float], ...] | None,
) -> Region:
    """Build the region of an image.

    Parameters
    ----------
    height_px, width_px : int
        Image size [px].
    corners : four pairs, optional
        Corners of the plate in the image [px], checked by `check_quadrilateral`, in either sense
        of rotation; the whole image if None.

    Raises
    ------
    ImageError
        If the corners are outside the image.
    """
    if corners is None:
        return Region(np.empty((0, 2)), np.empty(0), (0, 0, width_px, height_px))
    polygon = np.array(corners, dtype=float)
    low = np.maximum(np.floor(polygon.min(axis=0)).astype(int), 0)
    high = np.ceil(polygon.max(axis=0)).astype(int) + 1
    high = np.minimum(high, (width_px, height_px))
    if np.any(high - low < 2):
        raise ImageError(
            f"region_px: spans x {polygon[:, 0].min():g} to {polygon[:, 0].max():g}, "
            f"y {polygon[:, 1].min():g} to {polygon[:, 1].max():g} px, "
            f"allowed: inside the image of {width_px} x {height_px} px"
        )
    edges = np.roll(polygon, -1, axis=0) - polygon
    sense = np.sign(_cross(edges, np.roll(edges, -1, axis=0))[0])
    normals = sense * np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    normals /= np.linalg.norm(edges, axis=1)[:, None]
    offsets = -np.sum(normals * polygon, axis=1)
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    return Region(normals, offsets, box)


def check_quadrilateral(polygon: np.ndarray, name: str) -> np.ndarray:
    """Return `polygon` (4, 2) [px] if it is convex and large enough for a plate.

    Raises
    ------
    ImageError
        If not: the message says what is wrong.
    """
    if polygon.shape != (4, 2) or not np.all(np.isfinite(polygon)):
        raise ImageError(f"{name}: got {polygon.tolist()}, allowed: four finite pairs (x, y) in px")
    edges = np.roll(polygon, -1, axis=0) - polygon
    turns = _cross(edges, np.roll(edges, -1, axis=0))
    if not (np.all(turns > 0) or np.all(turns < 0)):
        raise ImageError(
            f"{name}: got {polygon.tolist()} px, allowed: four corners in order around a convex "
            "quadrilateral, no three of them in line"
        )
    x, y = polygon.T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))
    if area < MIN_AREA_PX2:
        raise ImageError(f"{name}: spans {area:.3g} px2, allowed: at least {MIN_AREA_PX2:g} px2")
    return polygon


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the z components (n,) of the cross products of planar vectors (n, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
