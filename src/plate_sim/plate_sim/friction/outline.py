"""Footprints of part types. This module cuts outlines of any shape into convex pieces. The contact
points of shapes with holes are on a grid."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import shapely

from plate_core.rig import PartType, moments

from . import quadrature
from .footprint import CELL, MASS, POINTS, Footprint, disc, union

GRID = 4
"""Number of grid points per cell along each axis. The fraction of a cell that is inside the part is
estimated with these points."""

STRAIGHT = 1e-9
"""A corner of an outline is ignored if its sides are nearly parallel. The criterion is that their
cross product is below this fraction of the square of the part's size."""


def footprint_of(part: PartType) -> Footprint:
    """Return the footprint of a part type with uniform pressure. Part types that differ only in
    name and appearance share one footprint. In a hole, the part has no contact with the plate and
    no mass. Other parts cannot enter a hole.
    """
    return _footprint(replace(part, name="", mu=None, colour_lab=None, picture=""))


@lru_cache(maxsize=64)
def _footprint(part: PartType) -> Footprint:
    mass = MASS if part.mass_kg is None else part.mass_kg
    if part.radius_m and not part.holes:
        return disc(part.radius_m, mass=mass)
    if not part.holes:
        return union(convex_pieces(part.polygon), mass=mass)
    holes = [np.array(hole) for hole in part.holes]
    position, area = _cells(part.polygon, holes)
    weight = area / area.sum()
    # Transform the grid points so that their first and second moments are equal to the moments of
    # the part. With this transformation, the centre of mass and the inertia are exact.
    position = position - weight @ position
    true_area, _, second = moments(part.polygon, holes)
    root = np.linalg.cholesky((weight[:, None] * position).T @ position)
    position = position @ np.linalg.inv(root).T @ np.linalg.cholesky(second / true_area).T
    outline = (part.polygon,) if part.radius_m else tuple(convex_pieces(part.polygon))
    inertia = mass * float(np.trace(part.spread_m2))
    return Footprint(mass, inertia, position, weight, CELL * np.sqrt(area), outline, part.radius_m)


def _cells(outline: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Cut the area of a shape into square cells. For each cell, return the centre (n, 2) [m] and
    the area (n,) [m2] of the portion that is inside the shape."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    side = np.sqrt(moments(outline, holes)[0] / POINTS)
    count = np.ceil((high - low) / side).astype(int)
    axes = [
        a + (b - a) * (np.arange(n * GRID) + 0.5) / (n * GRID)
        for a, b, n in zip(low, high, count, strict=True)
    ]
    point = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    part = shapely.contains_xy(shapely.Polygon(outline, holes), *point.T)
    cell = (np.arange(count[0] * GRID) // GRID)[:, None] * count[1]
    cell = (cell + np.arange(count[1] * GRID) // GRID).ravel()[part]
    number = np.bincount(cell, minlength=count.prod())
    kept = number > 0
    position = [np.bincount(cell, point[part, axis], count.prod())[kept] for axis in range(2)]
    return np.stack(position, axis=1) / number[kept, None], number[kept] * np.prod(
        (high - low) / (count * GRID)
    )


def convex_pieces(outline: np.ndarray) -> list[np.ndarray]:
    """Cut a simple polygon into few convex polygons. The corners (n, 2) of the polygon are in
    counter-clockwise order.

    First, the polygon is cut into triangles by ear clipping (Meisters 1975). Then pieces with a
    common diagonal are merged if the merged polygon is convex (Hertel and Mehlhorn 1983). The
    number of pieces is at most four times the minimum.
    """
    pieces = _triangles(outline)
    merged = True
    while merged:
        merged = False
        for i in range(len(pieces)):
            for j in range(i):
                both = _joined(pieces[i], pieces[j])
                if both is not None and _is_convex(outline[both]):
                    pieces[j] = both
                    pieces.pop(i)
                    merged = True
                    break
            if merged:
                break
    return [quadrature.convex(outline[piece]) for piece in pieces]


def _triangles(outline: np.ndarray) -> list[list[int]]:
    rest, triangles = list(range(len(outline))), []
    while len(rest) > 3:
        ears = [k for k in range(len(rest)) if _is_ear(outline, rest, k)]
        if not ears:  # all remaining corners are on a line
            break
        corners = [[rest[k - 1], rest[k], rest[(k + 1) % len(rest)]] for k in ears]
        best = int(np.argmax([_slimness(outline[corner]) for corner in corners]))
        triangles.append(corners[best])
        rest.pop(ears[best])
    return [*triangles, rest] if _double_area(*outline[rest[:3]]) > 0 else triangles


def _slimness(triangle: np.ndarray) -> float:
    """Return the area of a triangle with the corners (3, 2), divided by its squared perimeter. The
    value is small for narrow triangles."""
    length = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).sum()
    return float(_double_area(*triangle) / length**2)


def _is_ear(outline: np.ndarray, rest: list[int], k: int) -> bool:
    """Return whether corner k of the remaining polygon is an ear, which can be cut off."""
    a, b, c = (outline[rest[i % len(rest)]] for i in (k - 1, k, k + 1))
    if _double_area(a, b, c) <= STRAIGHT * np.ptp(outline, axis=0).max() ** 2:
        return False
    others = [outline[i] for i in rest if not any(outline[i] is x for x in (a, b, c))]
    return not any(
        min(_double_area(a, b, p), _double_area(b, c, p), _double_area(c, a, p)) >= 0
        for p in others
        if not (np.array_equal(p, a) or np.array_equal(p, b) or np.array_equal(p, c))
    )


def _joined(one: list[int], other: list[int]) -> list[int] | None:
    """Return the union of two pieces as indices of corners if both share a diagonal. Otherwise
    return None."""
    for i, a in enumerate(one):
        b = one[(i + 1) % len(one)]
        for j, c in enumerate(other):
            if c == b and other[(j + 1) % len(other)] == a:
                first = [one[(i + 1 + k) % len(one)] for k in range(len(one))]
                second = [other[(j + 1 + k) % len(other)] for k in range(len(other))]
                return [*first, *second[1:-1]]
    return None


def _is_convex(corner: np.ndarray) -> bool:
    before, after = np.roll(corner, 1, axis=0), np.roll(corner, -1, axis=0)
    areas = [_double_area(*three) for three in zip(before, corner, after, strict=True)]
    return min(areas) > STRAIGHT * float(np.ptp(corner, axis=0).max()) ** 2


def _double_area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return twice the area of a triangle. The area is positive if the corners are
    counter-clockwise."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
