"""Where the plate is in the image: a quadrilateral, with edges that a lens may bend; or all of it.

Image coordinates everywhere in this package: x_px to the right, y_px down, the centre of the first
pixel is (0, 0), as in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit

from .errors import ImageError

MIN_AREA_PX2 = 100.0
"""Smallest plate [px2]: below that no part of a useful size fits."""

SEAM_PX = 1.0
"""Pixels nearer than this [px] to the plate's edge mix plate and background: they are not used."""

BOW_DEGREE = 4
"""Degree of the polynomial for a bent edge: within 0.05 px of one that bulges by 20 px."""

BOW_REACH = 1.05
"""How far beyond its ends, in half lengths, a bent edge is followed."""

STRAIGHT = np.empty((0, BOW_DEGREE + 3))
"""No bent edges."""

Points = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)  # equal only to itself: so it can be the key of a cache
class Region:
    """The pixels of one image size that show the plate.

    Attributes
    ----------
    edges : (4, 3)
        Inward unit normal of each edge, and the distance of the image's origin from it [px],
        positive inside; (0, 3) for the whole image.
    box : (x0, y0, x1, y1)
        Pixel ranges [px] that hold the region, half open.
    bows : (4, BOW_DEGREE + 3)
        Of edges that a lens bends: three numbers by which 1, x, y give the place along the straight
        edge, -1 and 1 at its ends; then the polynomial of that place which gives how far the edge
        is inside the straight one [px], highest power first. (0, BOW_DEGREE + 3) if none is bent.
    """

    edges: np.ndarray
    box: tuple[int, int, int, int]
    bows: np.ndarray

    def depth(self, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
        """Distance from the nearest edge of the plate [px], negative outside.

        Parameters
        ----------
        x_px, y_px : (...)
            Image points [px]; they broadcast.
        """
        x, y = np.broadcast_arrays(np.asarray(x_px, float), np.asarray(y_px, float))
        return _depth(self.edges, self.bows, x.ravel(), y.ravel()).reshape(x.shape)


@njit(cache=True)
def _depth(edges: np.ndarray, bows: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return `Region.depth` (n,) of points (n,)."""
    depth = np.full(len(x), np.inf)
    for i in range(len(x)):
        for edge in range(len(edges)):
            inside = edges[edge, 0] * x[i] + edges[edge, 1] * y[i] + edges[edge, 2]
            if len(bows):
                place = bows[edge, 0] + bows[edge, 1] * x[i] + bows[edge, 2] * y[i]
                place = min(max(place, -BOW_REACH), BOW_REACH)
                bow = 0.0
                for factor in bows[edge, 3:]:
                    bow = bow * place + factor
                inside -= bow
            depth[i] = min(depth[i], inside)
    return depth


@lru_cache(maxsize=16)
def make_region(height_px: int, width_px: int, edges: tuple[Points, ...] | None) -> Region:
    """Build the region of an image.

    Parameters
    ----------
    height_px, width_px : int
        Image size [px].
    edges : four times n pairs, optional
        Points [px] of the plate's edges in the image, each edge from one corner to just before the
        next, in either sense of rotation: the corners alone if the edges are straight. Checked by
        `check_region`. The whole image if None.

    Raises
    ------
    ImageError
        If the corners are outside the image.
    """
    if edges is None:
        return Region(np.empty((0, 3)), (0, 0, width_px, height_px), STRAIGHT)
    points = np.array(edges, dtype=float)
    polygon = points[:, 0]
    low = np.maximum(np.floor(points.min(axis=(0, 1))).astype(int), 0)
    high = np.ceil(points.max(axis=(0, 1))).astype(int) + 1
    high = np.minimum(high, (width_px, height_px))
    if np.any(high - low < 2):
        raise ImageError(
            f"region_px: spans x {polygon[:, 0].min():g} to {polygon[:, 0].max():g}, "
            f"y {polygon[:, 1].min():g} to {polygon[:, 1].max():g} px, "
            f"allowed: inside the image of {width_px} x {height_px} px"
        )
    sides = np.roll(polygon, -1, axis=0) - polygon
    sense = np.sign(_cross(sides, np.roll(sides, -1, axis=0))[0])
    length = np.linalg.norm(sides, axis=1)[:, None]
    normals = sense * np.stack([-sides[:, 1], sides[:, 0]], axis=1) / length
    offsets = -np.sum(normals * polygon, axis=1)
    box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
    bows = _bows(points, normals, offsets) if points.shape[1] > 1 else STRAIGHT
    return Region(np.column_stack([normals, offsets]), box, bows)


def _bows(points: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Fit `Region.bows` to points (4, n, 2) [px] of the edges."""
    bows = []
    corners = np.roll(points[:, 0], -1, axis=0)
    for edge, end, normal, offset in zip(points, corners, normals, offsets, strict=True):
        line = np.concatenate([edge, end[None]])
        along = 2 * (end - edge[0]) / np.sum((end - edge[0]) ** 2)
        at = -1 - along @ edge[0]
        bow = np.polyfit(at + line @ along, line @ normal + offset, min(BOW_DEGREE, len(edge)))
        bows.append([at, *along, *np.zeros(BOW_DEGREE + 1 - len(bow)), *bow])
    return np.array(bows)


def region_of(height_px: int, width_px: int, region_px: np.ndarray | None) -> Region:
    """Return the region of an image by corners (4, 2) or points of edges (4, n, 2) [px].

    What has been judged once is not judged again.

    Raises
    ------
    ImageError
        As `check_region` and `make_region`.
    """
    if region_px is None:
        return make_region(height_px, width_px, None)
    points = np.asarray(region_px, dtype=float)
    return _known_region(height_px, width_px, points.shape, points.tobytes())


@lru_cache(maxsize=16)
def _known_region(height_px: int, width_px: int, shape: tuple[int, ...], points: bytes) -> Region:
    return make_region(height_px, width_px, check_region(np.frombuffer(points).reshape(shape)))


def check_region(region_px: np.ndarray) -> tuple[Points, ...]:
    """Return corners (4, 2) or points of edges (4, n, 2) [px] as `make_region` takes them.

    Raises
    ------
    ImageError
        If the corners are not those of a convex quadrilateral, or a value is not finite.
    """
    points = np.asarray(region_px, dtype=float)
    if points.ndim == 3 and points.shape[0] == 4 and points.shape[1] > 0 and points.shape[2] == 2:
        if not np.all(np.isfinite(points)):
            raise ImageError("region_px: not all points are finite, allowed: finite pairs (x, y)")
        check_quadrilateral(points[:, 0], "region_px")
    else:
        points = check_quadrilateral(points, "region_px")[:, None]
    return tuple(tuple((x, y) for x, y in edge) for edge in points.tolist())


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


@lru_cache(maxsize=16)
def usable_pixels(region: Region, height_px: int, width_px: int) -> np.ndarray:
    """Return which pixels (height, width) show the plate, clear of its edge: bool, read-only."""
    x0, y0, x1, y1 = region.box
    usable = np.zeros((height_px, width_px), np.bool_)
    columns, rows = np.arange(x0, x1)[None, :], np.arange(y0, y1)[:, None]
    usable[y0:y1, x0:x1] = region.depth(columns, rows) >= SEAM_PX
    usable.setflags(write=False)
    return usable
