"""Quadrature rules for convex polygons, exact for polynomials of degree 2 or more.

`polygon_rule` returns points and areas for a polygon. For a parallelogram, the function uses
Gauss's product rule. Other polygons are cut into triangles, with three points in each triangle. The
other functions compute areas and intersections.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateError

ALIKE = 1e-9
"""Two lengths count as equal if their relative difference is at most this value."""

NEAR, FAR = 1 / 6, 2 / 3
"""Barycentric coordinates of the three points of a quadrature rule on a triangle. The rule has the
degree 2, and the points have equal weights."""


def polygon_rule(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return about `count` points (n, 2) [m] in a convex polygon, and their areas (n,) [m2].

    For a parallelogram, the rule is a product of two Gauss rules. Other polygons are cut into
    triangles with three points each.
    """
    size = np.ptp(corners, axis=0).max()
    skew = np.abs(corners[0] + corners[2 % len(corners)] - corners[1] - corners[-1]).max()
    if len(corners) == 4 and skew <= ALIKE * size:
        return _parallelogram(corners, count)
    triangles = [corners[[0, k, k + 1]] for k in range(1, len(corners) - 1)]
    while 3 * len(triangles) < count - 1:
        # Bisect the largest triangle at its longest side, because this avoids narrow triangles.
        triangles.sort(key=area)
        largest = triangles.pop()
        side = np.linalg.norm(np.roll(largest, -1, axis=0) - largest, axis=1)
        a, b, c = np.roll(largest, -int(np.argmax(side)), axis=0)
        middle = 0.5 * (a + b)
        triangles += [np.array([a, middle, c]), np.array([middle, b, c])]
    mix = np.full((3, 3), NEAR) + (FAR - NEAR) * np.eye(3)
    position = np.concatenate([mix @ triangle for triangle in triangles])
    return position, np.repeat([area(triangle) / 3 for triangle in triangles], 3)


def _parallelogram(corners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    first, second = corners[1] - corners[0], corners[3] - corners[0]
    ratio = np.linalg.norm(first) / np.linalg.norm(second)
    max_columns = max(2, count // 2)
    columns = int(np.clip(round(np.sqrt(count * ratio)), 2, max_columns))
    rows = max(2, round(count / columns))
    u, uw = np.polynomial.legendre.leggauss(columns)
    v, vw = np.polynomial.legendre.leggauss(rows)
    u, v = (a.ravel() for a in np.meshgrid(0.5 * (1 + u), 0.5 * (1 + v)))
    weight = 0.25 * np.outer(vw, uw).ravel()
    return corners[0] + np.outer(u, first) + np.outer(v, second), weight * area(corners)


def area(corners: np.ndarray) -> float:
    """Return the area [m2] of a polygon (k, 2). The area is positive if the corners are
    counter-clockwise."""
    if len(corners) < 3:
        return 0.0
    x, y = (corners - corners[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def convex(corners: np.ndarray) -> np.ndarray:
    """Check that corners (k, 2) [m] form a convex polygon in counter-clockwise order, and return a
    copy of them.

    Raises
    ------
    PlateError
        If the corners do not form a convex polygon.
    """
    corners = places("corners", corners, 3)
    if area(corners) < 0:
        corners = corners[::-1].copy()
    side = np.roll(corners, -1, axis=0) - corners
    after = np.roll(side, -1, axis=0)
    crosses = side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]
    size = np.ptp(corners, axis=0).max()
    around = np.arctan2(crosses, (side * after).sum(1)).sum()
    if area(corners) <= ALIKE * size**2:
        raise PlateError(f"corners {corners.tolist()} enclose no area, allowed: a convex polygon")
    if crosses.min() < -ALIKE * size**2 or around > 3 * np.pi:
        k = (int(np.argmin(crosses)) + 1) % len(corners)
        raise PlateError(
            f"polygon is not convex at {corners[k].tolist()}, allowed: a convex polygon "
            "(divide other shapes into convex polygons, and pass these to `union`)"
        )
    return corners


def places(name: str, array: np.ndarray, min_count: int) -> np.ndarray:
    """Check that points (n, 2) [m] are finite, and that n is at least `min_count`. Return a copy
    with the type float."""
    array = np.array(array, dtype=float)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < min_count:
        raise PlateError(
            f"{name} has shape {array.shape}, allowed: (n, 2) with n at least {min_count}"
        )
    if not np.isfinite(array).all():
        bad = array[~np.isfinite(array).all(axis=1)][0]
        raise PlateError(f"{name} has {bad.tolist()}, allowed: finite numbers")
    return array
