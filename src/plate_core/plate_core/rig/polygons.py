"""Geometry of polygons, given by their corners (n, 2) [m] in order. The last corner is connected to
the first."""

from __future__ import annotations

import numpy as np

APART_M2 = 1e-12
"""Minimum area of a polygon, times two [m2]."""


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


def contains(corner: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) are inside a polygon (n, 2). A point is inside if a ray from it
    crosses an odd number of edges."""
    after = np.roll(corner, -1, axis=0)
    x, y = point[..., 0, None], point[..., 1, None]
    crosses = (corner[:, 1] > y) != (after[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (y - corner[:, 1]) / (after[:, 1] - corner[:, 1])
        right = x < corner[:, 0] + fraction * (after[:, 0] - corner[:, 0])
    return np.asarray(np.sum(crosses & right, axis=-1) % 2 == 1)


def rim_distance(corner: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the distance (...) [m] of points (..., 2) from the edges of a polygon (n, 2) [m]."""
    edge = np.roll(corner, -1, axis=0) - corner
    offset = point[..., None, :] - corner
    fraction = np.clip(np.sum(offset * edge, axis=-1) / np.sum(edge**2, axis=-1), 0, 1)
    nearest = offset - fraction[..., None] * edge
    return np.asarray(np.min(np.hypot(nearest[..., 0], nearest[..., 1]), axis=-1))


def is_simple(corner: np.ndarray) -> bool:
    """Whether a polygon (n, 2) [m] has a positive area and none of its edges cross or touch."""
    if len(corner) < 3:
        return False
    after = np.roll(corner, -1, axis=0)
    if abs(np.sum(cross(corner, after))) < APART_M2:
        return False
    for i in range(len(corner)):
        for j in range(i + 2, len(corner) - (i == 0)):
            a, b, c, d = corner[i], after[i], corner[j], after[j]
            near = np.maximum(np.minimum(a, b), np.minimum(c, d)) <= np.minimum(
                np.maximum(a, b), np.maximum(c, d)
            )
            if (
                np.all(near)  # needed because collinear edges need not touch
                and cross(b - a, c - a) * cross(b - a, d - a) <= 0
                and cross(d - c, a - c) * cross(d - c, b - c) <= 0
            ):
                return False
    return True


def is_inside(inner: np.ndarray, outer: np.ndarray) -> bool:
    """Whether a polygon (n, 2) is inside another (k, 2): all its corners are inside, and no edges
    cross."""
    return bool(np.all(contains(outer, inner))) and not _cross_each_other(inner, outer)


def overlap(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two polygons (n, 2), (k, 2) have an area in common."""
    within = np.any(contains(one, other)) or np.any(contains(other, one))
    return bool(within) or _cross_each_other(one, other)


def _cross_each_other(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether an edge of a polygon (n, 2) crosses one of another (k, 2)."""
    a, b = one[:, None], np.roll(one, -1, axis=0)[:, None]
    c, d = other[None], np.roll(other, -1, axis=0)[None]
    crosses = (cross(b - a, c - a) * cross(b - a, d - a) < 0) & (
        cross(d - c, a - c) * cross(d - c, b - c) < 0
    )
    return bool(np.any(crosses))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products (...) of vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
