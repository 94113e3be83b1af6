"""The region of the plate in an image. The region is a quadrilateral or the whole image. A lens may
bend the edges of the quadrilateral.

Image coordinates in this package: x_px to the right, y_px down, (0, 0) at the centre of the first
pixel, as in OpenCV.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .. import _kernels
from ..camera.lens import check_quadrilateral, cross_products
from ..errors import ImageError

SEAM_PX: float = _kernels.SEAM_PX
"""Minimum distance of a usable pixel from the plate's edge [px]. Nearer pixels show both the plate
and its surround."""

BOW_DEGREE = 4
"""Degree of the polynomial for a bent edge. The error of the polynomial is 0.05 px for a bulge of
20 px."""

SAMPLES = 1200
"""Approximate number of pixels on a regular grid to which the light is fitted. With a noise of 2
grey levels, the error of the surface is then 0.15 grey levels. The fit takes a tenth of the time in
which a hundred parts are detected."""


class Samples(NamedTuple):
    """Pixels of the plate for the fit of the light.

    Attributes
    ----------
    rows, columns : (K,) int
        Indices of the pixels.
    design : (6, K) float32
        Terms of a quadratic surface at the pixels.
    place : (3,) float32
        The image point [px] with u = v = 0, and the reciprocal of the length [px] of one unit of u
        and v.
    """

    rows: np.ndarray
    columns: np.ndarray
    design: np.ndarray
    place: np.ndarray


@dataclass(frozen=True, eq=False)
class Region:
    """The pixels that show the plate. A region is made once by `make_region` and used for many
    images.

    Attributes
    ----------
    size_px : (int, int)
        Width and height of the images [px].
    outline_px : (n, 2)
        Points around the plate [px].
    edges : (4, 3)
        Inward unit normal of each edge, and the signed distance of the image's origin from the edge
        [px], positive inside. (0, 3) for the whole image.
    bows : (4, BOW_DEGREE + 4)
        Edges bent by a lens; (0, BOW_DEGREE + 4) if no edge is bent. The first three numbers are
        the coefficients of 1, x, y for the place along the straight edge, which is -1 and 1 at the
        ends. The other numbers are the coefficients of a polynomial of this place, highest power
        first. The value of this polynomial is the inward distance of the bent edge from the
        straight edge [px].
    box : (x0, y0, x1, y1)
        Pixel range [px] that contains the region, half open.
    """

    size_px: tuple[int, int]
    outline_px: np.ndarray
    edges: np.ndarray
    bows: np.ndarray
    box: tuple[int, int, int, int]

    def depth(self, x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
        """Return the distances of points (...) from the nearest edge of the plate [px]. The
        distances are negative outside the plate."""
        x, y = np.broadcast_arrays(np.asarray(x_px, float), np.asarray(y_px, float))
        depth = _kernels.region_depth(self.edges, self.bows, x.ravel(), y.ravel())
        return np.asarray(depth.reshape(x.shape))

    @cached_property
    def usable(self) -> np.ndarray:
        """Whether a pixel shows the plate and is not at the plate's edge, (H, W) bool."""
        width, height = self.size_px
        x0, y0, x1, y1 = self.box
        usable = np.zeros((height, width), np.bool_)
        columns, rows = np.arange(x0, x1)[None, :], np.arange(y0, y1)[:, None]
        usable[y0:y1, x0:x1] = self.depth(columns, rows) >= SEAM_PX
        return usable

    def outside(self, step: int) -> np.ndarray:
        """Whether a pixel is not usable, for every `step`-th row and column of the box: bool. The
        result is cached."""
        known = self._outside_by_step
        if step not in known:
            x0, y0, x1, y1 = self.box
            known[step] = ~self.usable[y0:y1:step, x0:x1:step]
        return known[step]

    @cached_property
    def _outside_by_step(self) -> dict[int, np.ndarray]:
        return {}

    @cached_property
    def samples(self) -> Samples:
        """The pixels for the fit of the light. The arrays are empty if the region is too small."""
        x0, y0, x1, y1 = self.box
        step = max(1, int(np.sqrt((x1 - x0) * (y1 - y0) / SAMPLES)))
        rows, columns = np.mgrid[y0 + step // 2 : y1 : step, x0 + step // 2 : x1 : step]
        inside = self.depth(columns, rows) >= SEAM_PX
        rows, columns = rows[inside], columns[inside]
        place = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 2 / max(x1 - x0, y1 - y0)
        u, v = (columns - place[0]) * place[2], (rows - place[1]) * place[2]
        design = np.ascontiguousarray(quadratic_terms(u, v).T.astype(np.float32))
        return Samples(rows, columns, design, np.array(place, np.float32))


def quadratic_terms(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the terms (n, 6) of a quadratic surface at places u, v (n,)."""
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def make_region(size_px: tuple[int, int], outline_px: np.ndarray | None = None) -> Region:
    """Prepare the region of the plate.

    Parameters
    ----------
    size_px : (int, int)
        Width and height of the images [px].
    outline_px : (4, 2) or (4, n, 2), optional
        Corners of the plate in the image [px], in order around the plate. If a lens bends the
        edges: n points of each edge, from its first corner on, without its last corner. None: the
        whole image.

    Raises
    ------
    ImageError
        If the corners do not form a convex quadrilateral in the image, or if a value is not finite.
    """
    width, height = size_px
    no_bows = np.empty((0, BOW_DEGREE + 4))
    if outline_px is None:
        frame = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
        return Region(size_px, frame, np.empty((0, 3)), no_bows, (0, 0, width, height))
    points = np.asarray(outline_px, dtype=float)
    if points.ndim != 3 or points.shape[0] != 4 or points.shape[1] < 1 or points.shape[2] != 2:
        points = check_quadrilateral(points, "region", ImageError)[:, None]
    elif not np.all(np.isfinite(points)):
        raise ImageError("region: not all points are finite, allowed: finite pairs (x, y)")
    corners = check_quadrilateral(points[:, 0], "region", ImageError)
    low = np.maximum(np.floor(points.min(axis=(0, 1))).astype(int), 0)
    high = np.minimum(np.ceil(points.max(axis=(0, 1))).astype(int) + 1, size_px)
    if np.any(high - low < 2):
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        raise ImageError(
            f"region: spans x {left:g} to {right:g}, y {top:g} to {bottom:g} px, "
            f"allowed: inside the image of {width} x {height} px"
        )
    sides = np.roll(corners, -1, axis=0) - corners
    sense = np.sign(cross_products(sides, np.roll(sides, -1, axis=0))[0])
    length = np.linalg.norm(sides, axis=1)[:, None]
    normals = sense * np.stack([-sides[:, 1], sides[:, 0]], axis=1) / length
    offsets = -np.sum(normals * corners, axis=1)
    return Region(
        size_px,
        points.reshape(-1, 2),
        np.column_stack([normals, offsets]),
        _fit_bows(points, normals, offsets) if points.shape[1] > 1 else no_bows,
        (int(low[0]), int(low[1]), int(high[0]), int(high[1])),
    )


def _fit_bows(points: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return `Region.bows`, fitted to points (4, n, 2) [px] of the edges."""
    bows = []
    corners = np.roll(points[:, 0], -1, axis=0)
    for edge, end, normal, offset in zip(points, corners, normals, offsets, strict=True):
        line = np.concatenate([edge, end[None]])
        along = 2 * (end - edge[0]) / np.sum((end - edge[0]) ** 2)
        begin = -1 - along @ edge[0]
        bow = np.polyfit(begin + line @ along, line @ normal + offset, min(BOW_DEGREE, len(edge)))
        bows.append([begin, *along, *np.zeros(BOW_DEGREE + 1 - len(bow)), *bow])
    return np.array(bows)
