"""Geometry of polygons, given by their corners (n, 2) [m] in order. The last corner is connected to
the first corner."""

from __future__ import annotations

import numpy as np

APART_M2 = 1e-12
"""Twice the minimum area of a valid polygon [m2]."""


def moments(
    outline: np.ndarray, holes: list[np.ndarray] | tuple[np.ndarray, ...] = ()
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return area [m2], centroid (2,) [m] and second moments of area (2, 2) [m4] about the origin
    of a polygon (n, 2) minus its holes (k, 2). All polygons are counter-clockwise."""
    area, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    for sign, corner in [(1, outline), *((-1, hole) for hole in holes)]:
        after = np.roll(corner, -1, axis=0)
        twice = corner[:, 0] * after[:, 1] - after[:, 0] * corner[:, 1]
        both = corner + after
        area += sign * float(np.sum(twice)) / 2
        first += sign * (twice @ both) / 6
        pairs = (
            both[:, :, None] * both[:, None, :]
            + corner[:, :, None] * corner[:, None, :]
            + after[:, :, None] * after[:, None, :]
        )
        second += sign * np.tensordot(twice, pairs, 1) / 24
    return area, first / area, second


def is_simple(corner: np.ndarray) -> bool:
    """Whether a polygon (n, 2) [m] has a positive area and no repeated corner, and its edges
    neither cross nor touch, except neighbours at their common corner."""
    # Shapely is imported here, so that the stop command does not wait for this import.
    from shapely import Polygon

    if len(np.unique(corner, axis=0)) < max(len(corner), 3):
        return False
    polygon = Polygon(corner)
    return bool(polygon.is_valid and 2 * polygon.area >= APART_M2)
