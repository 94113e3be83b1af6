"""Draws the plate and the parts into an image. Only the pixels that change are computed.

A table contains for each pixel the point of the plate's plane that the pixel shows. The table takes
lens distortion and perspective into account. If an edge crosses a pixel, the pixel's value is a
mean of the grey values on both sides. Their weights are the fractions of the pixel that both sides
cover. The covered fractions are approximated as linear functions of the distance between the
pixel's centre and the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from plate_core.rig import PartType

from .. import _kernels
from ..friction.outline import convex_pieces

SPOT_GRID = 25
"""Number of grid points per axis in the search for the point of a part that is farthest from its
outline."""


class Outlines(NamedTuple):
    """Outlines of M parts. Each outline consists of adjacent convex polygons, followed by the
    polygons of its holes.

    Attributes
    ----------
    edges : (e, 3)
        Outward normal of each polygon edge, and distance of this edge from the part's centre [m].
    pieces : (p + 1,)
        Index of the first edge of every polygon, and the total number of edges.
    first, hole : (M,)
        `first` is the index of each part's first polygon, and `hole` is the index of its first
        hole. For a disc, which has no polygons, both are equal.
    end : (M,)
        Index of the last polygon of each part, plus 1.
    reach : (M,)
        Maximum distance of the outline from the part's centre [m].
    spot : (M, 4)
        Columns 0 and 1 contain the point of the part that is farthest from its outline [m, part's
        frame]. Column 2 contains the distance of this point from the outline [m]. Column 3 contains
        the area of the part [m2].
    """

    edges: np.ndarray
    pieces: np.ndarray
    first: np.ndarray
    hole: np.ndarray
    end: np.ndarray
    reach: np.ndarray
    spot: np.ndarray

    def discs(self, radius: np.ndarray) -> Outlines:
        """Return the outlines of n discs with the radii `radius` (n,) [m]."""
        no_edges = np.zeros(len(radius), np.int64)
        return self._replace(first=no_edges, hole=no_edges, end=no_edges, reach=radius)

    def take(self, rows: np.ndarray) -> Outlines:
        """Return the outlines of the parts with the indices `rows` (k,)."""
        return Outlines(self.edges, self.pieces, *(array[rows] for array in self[2:]))


class Sprites(NamedTuple):
    """Placement and appearance of n shapes, in the order in which they are drawn.

    Attributes
    ----------
    window : (n, 4)
        Rectangle of the image that contains each shape: first row, last row + 1, first column, last
        column + 1.
    scale : (n,)
        Scale of the image at the shape [px/m].
    copies : (n,)
        Number of positions that are averaged to draw motion blur.
    path : (s, n, 2)
        Positions [m, plate_home] at equal intervals over the exposure.
    radius : (n,)
        Radius of a disc, or of a circle that contains the polygons [m].
    cos_sin : (n, 2)
        Cosine and sine of the angle of each shape.
    grey : (n,)
        Grey values at full brightness.
    opacity : (n,)
        Opacity, 0 to 1.
    """

    window: np.ndarray
    scale: np.ndarray
    copies: np.ndarray
    path: np.ndarray
    radius: np.ndarray
    cos_sin: np.ndarray
    grey: np.ndarray
    opacity: np.ndarray

    def take(self, rows: np.ndarray) -> Sprites:
        """Return the shapes with the indices `rows` (k,), in this order."""
        path = np.ascontiguousarray(self.path[:, rows])
        return Sprites(*(path if array is self.path else array[rows] for array in self))


def concatenate_outlines(groups: Sequence[Outlines]) -> Outlines:
    """Concatenate several groups of outlines. Groups with the same array of edges share one copy of
    this array."""
    first = groups[0]
    if all(other.edges is first.edges for other in groups):
        rows = zip(*(other[2:] for other in groups), strict=True)
        return Outlines(first.edges, first.pieces, *(np.concatenate(row) for row in rows))
    edges, pieces, moved = [], [np.zeros(1, np.int64)], []
    known: dict[int, int] = {}
    count, polygons = 0, 0
    for group in groups:
        if id(group.edges) not in known:
            known[id(group.edges)] = polygons
            edges.append(group.edges)
            pieces.append(group.pieces[1:] + count)
            count, polygons = count + len(group.edges), polygons + len(group.pieces) - 1
        begin = known[id(group.edges)]
        moved.append(
            (group.first + begin, group.hole + begin, group.end + begin, group.reach, group.spot)
        )
    rows = zip(*moved, strict=True)
    return Outlines(
        np.concatenate(edges), np.concatenate(pieces), *(np.concatenate(row) for row in rows)
    )


def make_outlines(types: Sequence[PartType]) -> Outlines:
    """Return the outlines of parts of these types."""
    edges: list[np.ndarray] = [np.empty((0, 3))]
    pieces, rows = [0], []
    for part in types:
        solid = [] if part.radius_m else convex_pieces(part.polygon)
        holes = [piece for hole in part.holes for piece in convex_pieces(np.array(hole))]
        begin = len(pieces) - 1
        for polygon in (*solid, *holes):
            edges.append(polygon_edges(polygon))
            pieces.append(pieces[-1] + len(polygon))
        rows.append((begin, begin + len(solid), len(pieces) - 1))
    first, hole, end = np.array(rows, np.int64).reshape(-1, 3).T.copy()
    reach = np.array([part.reach_m for part in types])
    spot = np.array([_highlight_circle(part) for part in types])
    return Outlines(np.concatenate(edges), np.array(pieces), first, hole, end, reach, spot)


def _highlight_circle(part: PartType) -> tuple[float, float, float, float]:
    """Return the row of `Outlines.spot` for a part type (4,). The farthest point is searched for on
    a grid with `SPOT_GRID` points per axis."""
    axis = part.reach_m * np.linspace(-1, 1, SPOT_GRID)
    position = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    shape = shapely.Polygon(part.polygon, part.holes)
    inside = shapely.contains_xy(shape, *position.T)
    depth = np.where(inside, shapely.distance(shape.boundary, shapely.points(position)), 0.0)
    best = int(np.argmax(depth))
    return float(position[best, 0]), float(position[best, 1]), float(depth[best]), part.area_m2


def polygon_edges(corner: np.ndarray) -> np.ndarray:
    """Return the edges (k, 3) of a convex polygon with the corners (k, 2) in counter-clockwise
    order. The edges have the form of `Outlines.edges`."""
    side = np.roll(corner, -1, axis=0) - corner
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / np.hypot(*side.T)[:, None]
    return np.column_stack([normal, np.sum(normal * corner, axis=1)])


def expose(canvas, bank, noise, image):
    """Add `noise` times the standard normal random numbers `bank` (n,) to the canvas (n,). Write
    the rounded result to the image (n,), uint8."""
    _kernels.expose(canvas, bank, noise, image)


def draw_plate(canvas, light, places, pixels, poses, copies, travel, half, scale, grey):
    """Repaint background and plate in some pixels of the image. The fraction of each pixel that the
    plate covers is averaged over the exposure.

    Parameters
    ----------
    canvas : (n,)
        Grey values. The grey values are modified.
    light : (n,)
        Fraction of full light in each pixel.
    places : (n, 2)
        Point of the plate's plane that each pixel shows [m, plate_home].
    pixels : (p,)
        Indices of the pixels to repaint.
    poses : (s, 3)
        Poses of the plate [m, m, rad], at equal intervals over the exposure.
    copies : int
        Number of interpolated poses that are averaged to draw motion blur.
    travel : float
        Maximum path length of a point of the plate during the exposure [m].
    half : (2,)
        Half sides of the plate [m].
    scale : float
        Scale of the image [px/m].
    grey : (2,)
        Grey values of background and plate at full brightness.
    """
    _kernels.draw_plate(canvas, light, places, pixels, poses, copies, travel, half, scale, *grey)


def draw_parts(canvas, light, places, sprites, outlines):
    """Draw shapes into the image, one after the other, with their opacities.

    Parameters
    ----------
    canvas : (height, width)
        Grey values. The grey values are modified.
    light : (height, width)
        Fraction of full light in each pixel.
    places : (height, width, 2)
        Point of the plate's plane that each pixel shows [m, plate_home].
    sprites : Sprites
        Placement and appearance of the n shapes.
    outlines : Outlines
        Outlines of the n shapes.
    """
    _kernels.draw_parts(canvas, light, places, *sprites, *outlines[:5])
