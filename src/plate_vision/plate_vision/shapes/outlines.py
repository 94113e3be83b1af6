"""Outlines of patches to a fraction of a pixel, what is compared of them, and fits of polygons.

An outline's rings run with the part on their left: around it counter-clockwise, around its holes
clockwise, as seen in plate_home, where y points to the left of x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from plate_core.kernels import SAME_ROUNDING, inner_kernel, kernel

HARMONICS = 17
"""Of an outline's spectrum that are compared, from 0: a hexagon differs from a disc in the 6th and
12th, a square in the 4th, 8th, 12th and 16th."""

POINTS = 64
"""To which the rim of a patch is thinned out: 1 px apart for a part of 20 px."""

LEAST_HOLE = 0.02
"""Smallest hole, relative to the part: a highlight may seem to be one."""

FEWEST_POINTS = 12
"""Of a hole's rim."""

REACH_PX = 2.5
"""How far to both sides of a patch's rim the image is looked at for its edge [px]."""

STEPS = 11
"""Places along that way."""

LEAST_STEP = 0.25
"""Least difference of both ends of that way, relative to part and surroundings, that is an edge:
where parts touch there is none, and the patch's rim counts."""

CLIP = 16.0
"""Most that a point adds to the square of a distance [squares of the unit, and of a tenth of the
part]: one that is far off counts, but not for all."""

STILL = 0.003
"""A fit that moves less than that is done [units of the fit, pixels mostly]."""

LEAST_ERROR = 0.1
"""Least deviation of a point from a type's outline, RMS [units]."""

TOGETHER = 2.0
"""Neighbours on a rim that are off together."""

MARGIN_PX = 4
"""Pixels around a patch that belong to its window."""

THREE, FIVE = np.ones((3, 3), np.uint8), np.ones((5, 5), np.uint8)
"""By which masks shrink and grow."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The measured rim of a patch, or of a part.

    Attributes
    ----------
    points : (n, 2)
        On its rim, holes included [m], plate_home.
    ends : (k,) int
        How many points there are up to the end of each ring.
    area : float
        Less the holes [m2].
    centre : (2,)
        Of that area [m].
    spectrum : (HARMONICS,) complex
        Second moments of area about the centre, by direction: the integral of r2 exp(-i k phi).
    """

    points: np.ndarray
    ends: np.ndarray
    area: float
    centre: np.ndarray
    spectrum: np.ndarray

    @property
    def rings(self) -> list[np.ndarray]:
        """The rings (k, 2) [m], the one around it first."""
        return np.split(self.points, self.ends[:-1])

    @cached_property
    def edges(self) -> np.ndarray:
        """Edges (e, 5) of its polygon: start x, y [m], unit vector along it, length [m]."""
        return np.asarray(_edges(self.points, self.ends))

    @cached_property
    def filled(self) -> Outline:
        """The same without holes."""
        return self if len(self.ends) == 1 else make_outline([self.points[: self.ends[0]]])

    @cached_property
    def form(self) -> np.ndarray:
        """Its spectrum without holes, from 1, relative to the 0th: (HARMONICS - 1,), the same
        however it is turned, and whatever its size."""
        size = np.abs(self.filled.spectrum)
        return np.asarray(size[1:] / size[0])

    @property
    def hole_share(self) -> float:
        """Area of its holes, relative to that without them."""
        return 1 - self.area / self.filled.area

    @property
    def reach(self) -> float:
        """Greatest distance of its rim from its centre [m]."""
        return float(np.max(np.hypot(*(self.points - self.centre).T)))


def make_outline(rings: Sequence[np.ndarray]) -> Outline:
    """Measure rings (k, 2) [m]: the first around the part, the others around its holes, any sense
    of rotation."""
    points = np.concatenate(rings).astype(float)
    ends = np.cumsum([len(ring) for ring in rings])
    area, x, y, spectrum = _measure(points, ends)
    return Outline(points, ends, area, np.array([x, y]), spectrum)


def patch_rings(
    mask: np.ndarray, window: np.ndarray, count: int = POINTS
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the rings (k, 2) [px, of the window] around a patch and its holes, and its colour:
    medians of blue, green, red (3,).

    Each point lies where the image is halfway between the part and what is beside it there.

    Parameters
    ----------
    mask : (h + 2, w + 2) uint8
        1 in the patch, with a frame of 0.
    window : (h, w, 3) or (h, w) uint8
        The image there.
    count : int
        Points of the outer ring; those of holes are as near to each other.
    """
    contours, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    inner = cv2.erode(mask, THREE)[1:-1, 1:-1]
    around = cv2.dilate(mask, FIVE)[1:-1, 1:-1]
    pixels = window.reshape(*window.shape[:2], -1)
    field, colour = _contrast(pixels, mask[1:-1, 1:-1], inner, around)
    outer = max(
        (i for i in range(len(contours)) if tree[0, i, 3] < 0), key=lambda i: len(contours[i])
    )
    rings = []
    length, whole = len(contours[outer]), cv2.contourArea(contours[outer])
    for i in [outer, *(i for i in range(len(contours)) if tree[0, i, 3] == outer)]:
        ring = contours[i][:, 0]
        share = count if i == outer else max(round(count * len(ring) / length), FEWEST_POINTS)
        small = i != outer and cv2.contourArea(contours[i]) < LEAST_HOLE * whole
        if len(ring) >= 4 and not small:
            rings.append(_edge(field, ring, i != outer, share))
    return rings, colour if len(colour) == 3 else np.repeat(colour, 3)


@kernel(error_model="numpy")
def _contrast(
    pixels: np.ndarray, mask: np.ndarray, inner: np.ndarray, around: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much pixels (h, w, c) are like a patch, 1, and unlike what is around it, 0: (h, w)
    float32; and the patch's colour (c,), the median.

    In `mask`, `inner` and `around` (h, w) is 1 what is of the patch, what is so for sure, and what
    may be.
    """
    height, width, channels = pixels.shape
    counts = np.zeros((2, channels, 256), np.int32)
    core = inner if np.any(inner) else mask
    for y in range(height):
        for x in range(width):
            if core[y, x]:
                for k in range(channels):
                    counts[0, k, pixels[y, x, k]] += 1
            elif not around[y, x]:
                for k in range(channels):
                    counts[1, k, pixels[y, x, k]] += 1
    middle = np.zeros((2, channels))
    for i in range(2):
        total = np.sum(counts[i, 0])
        for k in range(channels):
            passed = 0
            for level in range(256):
                passed += counts[i, k, level]
                if 2 * passed >= total:
                    middle[i, k] = level if total else 255 - middle[0, k]
                    break
    way = middle[0] - middle[1]
    square = max(np.sum(way * way), 1.0)
    field = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            along = 0.0
            for k in range(channels):
                along += (pixels[y, x, k] - middle[1, k]) * way[k]
            field[y, x] = along / square
    return field, middle[0]


@inner_kernel()
def _sample(field: np.ndarray, x: float, y: float) -> float:
    """Return a field (h, w) at a place between its pixels."""
    height, width = field.shape
    x = min(max(x, 0.0), width - 1.001)
    y = min(max(y, 0.0), height - 1.001)
    i, j = int(x), int(y)
    u, v = x - i, y - j
    return (1 - v) * ((1 - u) * field[j, i] + u * field[j, i + 1]) + v * (
        (1 - u) * field[j + 1, i] + u * field[j + 1, i + 1]
    )


@kernel(error_model="numpy")
def _edge(field: np.ndarray, ring: np.ndarray, hole: bool, count: int) -> np.ndarray:
    """Return `count` points, evenly spaced, where a field crosses half its way near a ring (k, 2)
    of the outermost pixels of a patch, or of the pixels around a hole, in a frame of one pixel."""
    number, ring = len(ring), ring - 1.0
    twice = 0.0
    for i in range(number):
        j = (i + 1) % number
        twice += ring[i, 0] * ring[j, 1] - ring[j, 0] * ring[i, 1]
    sense = 1.0 if (twice > 0) != hole else -1.0
    moved = np.empty((number, 2))
    for i in range(number):
        before, after = ring[(i - 2) % number], ring[(i + 2) % number]
        x, y = sense * (after[1] - before[1]), sense * (before[0] - after[0])
        length = np.sqrt(x * x + y * y)
        if length == 0:
            moved[i] = ring[i]
            continue
        x, y = x / length, y / length
        # The patch ends between the middles of two pixels.
        step = 0.5 / max(abs(x), abs(y))
        first = _sample(
            field, ring[i, 0] + (step - REACH_PX) * x, ring[i, 1] + (step - REACH_PX) * y
        )
        last = _sample(
            field, ring[i, 0] + (step + REACH_PX) * x, ring[i, 1] + (step + REACH_PX) * y
        )
        best = step
        if first - last > LEAST_STEP:
            half, gap, old = 0.5 * (first + last), np.inf, first
            for k in range(1, STEPS):
                at = step - REACH_PX + 2 * REACH_PX * k / (STEPS - 1)
                new = _sample(field, ring[i, 0] + at * x, ring[i, 1] + at * y)
                if old >= half > new:
                    cross = at - 2 * REACH_PX / (STEPS - 1) * (half - new) / (old - new)
                    if abs(cross - step) < gap:
                        gap, best = abs(cross - step), cross
                old = new
        moved[i, 0], moved[i, 1] = ring[i, 0] + best * x, ring[i, 1] + best * y
    way = np.zeros(number + 1)
    for i in range(number):
        j = (i + 1) % number
        way[i + 1] = way[i] + np.hypot(moved[j, 0] - moved[i, 0], moved[j, 1] - moved[i, 1])
    thinned = np.empty((count, 2))
    i = 0
    for k in range(count):
        at = way[number] * k / count
        while way[i + 1] <= at and i < number - 1:
            i += 1
        u = (at - way[i]) / max(way[i + 1] - way[i], 1e-9)
        j = (i + 1) % number
        thinned[k] = (1 - u) * moved[i] + u * moved[j]
    return thinned


@kernel(error_model="numpy")
def _measure(points: np.ndarray, ends: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    """Turn rings of points (n, 2) to their sense, in place; return area, centre x, y and spectrum
    (HARMONICS,)."""
    whole, x, y, first = 0.0, 0.0, 0.0, 0
    start = points[0].copy()
    for end in ends:
        twice, mx, my = 0.0, 0.0, 0.0
        for i in range(first, end):
            j = i + 1 if i + 1 < end else first
            ax, ay = points[i, 0] - start[0], points[i, 1] - start[1]
            bx, by = points[j, 0] - start[0], points[j, 1] - start[1]
            cross = ax * by - bx * ay
            twice += cross
            mx += cross * (ax + bx) / 3
            my += cross * (ay + by) / 3
        if (twice > 0) != (first == 0):
            points[first:end] = points[first:end][::-1].copy()
            twice, mx, my = -twice, -mx, -my
        whole, x, y, first = whole + twice, x + mx, y + my, end
    x, y = start[0] + x / whole, start[1] + y / whole
    spectrum = np.zeros(HARMONICS, np.complex128)
    first = 0
    for end in ends:
        for i in range(first, end):
            j = i + 1 if i + 1 < end else first
            ax, ay = points[i, 0] - x, points[i, 1] - y
            bx, by = points[j, 0] - x, points[j, 1] - y
            mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
            square = mx * mx + my * my
            if square == 0:
                continue
            turn = complex(mx, -my) / np.sqrt(square)
            # r4 / 4 d(phi), and r2 d(phi) is twice the area of the triangle.
            term = complex(0.25 * square * (ax * by - bx * ay), 0.0)
            for k in range(HARMONICS):
                spectrum[k] += term
                term *= turn
        first = end
    return 0.5 * whole, x, y, spectrum


@kernel(error_model="numpy")
def _edges(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    edges, count, first = np.empty((len(points), 5)), 0, 0
    for end in ends:
        for i in range(first, end):
            j = i + 1 if i + 1 < end else first
            x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            length = np.sqrt(x * x + y * y)
            if length > 0:
                edges[count, :2] = points[i]
                edges[count, 2], edges[count, 3] = x / length, y / length
                edges[count, 4] = length
                count += 1
        first = end
    return edges[:count]


@inner_kernel()
def edge_distance(edges: np.ndarray, x: float, y: float) -> tuple[float, float, float]:
    """Return the signed distance of a point from edges (e, 5), see `Outline.edges`: positive
    outside; and the unit vector (x, y) along which it grows. One of negative length is a circle of
    that radius about its start."""
    least, near, right, down = np.inf, 0, 0.0, 0.0
    for i in range(len(edges)):
        dx, dy = x - edges[i, 0], y - edges[i, 1]
        if edges[i, 4] < 0:
            out = 1 + edges[i, 4] / max(np.sqrt(dx * dx + dy * dy), 1e-12)
            dx, dy = out * dx, out * dy
            distance = dx * dx + dy * dy
        else:
            ux, uy = edges[i, 2], edges[i, 3]
            across = ux * dy - uy * dx
            along = min(max(dx * ux + dy * uy, 0.0), edges[i, 4])
            dx, dy = dx - along * ux, dy - along * uy
            # Of two edges that meet where it is nearest, the one further to its side tells which.
            distance = dx * dx + dy * dy - 1e-6 * across * across
        if distance < least:
            least, near, right, down = distance, i, dx, dy
    least = right * right + down * down
    vx, vy = x - edges[near, 0], y - edges[near, 1]
    ux, uy = edges[near, 2], edges[near, 3]
    if edges[near, 4] < 0:
        # The way out, and a right angle from it.
        size = max(np.sqrt(vx * vx + vy * vy), 1e-12)
        ux, uy = -vy / size, vx / size
        side = 1.0 if size > -edges[near, 4] else -1.0
    else:
        side = 1.0 if ux * vy - uy * vx < 0 else -1.0
    if least < 1e-20:
        return 0.0, uy, -ux
    length = np.sqrt(least)
    return side * length, side * right / length, side * down / length


@inner_kernel(fastmath=SAME_ROUNDING)
def rim_distance(edges: np.ndarray, x: float, y: float) -> float:
    """Return the distance of a point from edges (e, 5)."""
    least = 1e30
    for i in range(len(edges)):
        vx, vy = x - edges[i, 0], y - edges[i, 1]
        ux, uy = edges[i, 2], edges[i, 3]
        along = min(max(vx * ux + vy * uy, 0.0), edges[i, 4])
        dx, dy = vx - along * ux, vy - along * uy
        least = min(least, dx * dx + dy * dy)
    return np.sqrt(least)


@kernel(error_model="numpy")
def distances(edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the signed distances of points (n, 2) from a polygon's edges (e, 5), and the unit
    vectors along which they grow: (n, 3)."""
    found = np.empty((len(points), 3))
    for i in range(len(points)):
        found[i] = edge_distance(edges, points[i, 0], points[i, 1])
    return found


@kernel(error_model="numpy")
def fit_pose(
    edges: np.ndarray,
    points: np.ndarray,
    pose: np.ndarray,
    unit: float,
    turns: bool,
    steps: int,
    hopeless: float = np.inf,
    gate: float = np.inf,
) -> np.ndarray:
    """Lay a polygon onto points by Gauss-Newton steps, and say how far they are from it.

    Parameters
    ----------
    edges : (e, 5)
        Of the polygon, in its own frame [m], see `Outline.edges`.
    points : (n, 2)
        On a rim [m].
    pose : (3,)
        Where to begin: x, y [m], angle [rad].
    unit : float
        Distance [m] from which on points count less: that of a pixel or two.
    turns : bool
        Whether its angle matters: not that of a disc.
    steps : int
        Most Gauss-Newton steps.
    hopeless : float
        If the points are further away than that after two steps, RMS [m], it goes no further.
    gate : float
        Points further away than that are of something else [m]; it is then not swollen.

    Returns
    -------
    (5,)
        x, y [m], angle [rad]; how far the points are outside on average [m]; root mean square of
        the rest [m].
    """
    x, y, angle, swell = pose[0], pose[1], pose[2], 0.0
    lever = np.sqrt(np.sum((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2) / len(points))
    number = len(points)
    rest, worst = 0.0, CLIP * (unit * unit + lever * lever / 100)
    for step in range(steps + 1):
        c, s = np.cos(angle), np.sin(angle)
        a = np.zeros((4, 4))
        g = np.zeros(4)
        rest = 0.0
        row = np.zeros(4)
        for i in range(number):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            qx, qy = c * dx + s * dy, -s * dx + c * dy
            distance, nx, ny = edge_distance(edges, qx, qy)
            error = distance - swell
            if abs(error) > gate:
                continue
            rest += min(error * error, worst)
            weight = min(1.0, unit / max(abs(error), 1e-12))
            row[0] = -(c * nx - s * ny)
            row[1] = -(s * nx + c * ny)
            row[2] = (nx * qy - ny * qx) if turns else 0.0
            row[3] = -1.0
            for j in range(4):
                g[j] += weight * row[j] * error
                for k in range(4):
                    a[j, k] += weight * row[j] * row[k]
        if step == steps or (step >= 2 and rest > number * hopeless * hopeless):
            break
        if not turns:
            a[2, 2] = 1.0
        if gate < np.inf:
            a[3, :3], a[:3, 3], a[3, 3], g[3] = 0.0, 0.0, 1.0, 0.0
        for j in range(4):
            a[j, j] += 1e-9 * a[j, j] + 1e-15
        change = np.linalg.solve(a, g)
        x, y, angle, swell = x - change[0], y - change[1], angle - change[2], swell - change[3]
        moved = max(abs(change[0]), abs(change[1]), lever * abs(change[2]), abs(change[3]))
        if moved < STILL * unit:
            break
    return np.array([x, y, angle, swell, np.sqrt(rest / number)])


@kernel(error_model="numpy")
def turn_scatter(
    edges: np.ndarray, points: np.ndarray, fit: np.ndarray, full: float, unit: float, gate: float
) -> float:
    """Return how sure a fitted angle is, as a standard deviation [rad]: by how much worse a polygon
    lies on points when it is turned by a pixel; infinite if it does not.

    Arguments as those of `fit_pose`; `fit` (5,) is what that returns, `full` the mean square by
    which points on the polygon's rim leave it per turn [m2/rad2]. If the points show less of that,
    corners are blurred or hidden, and noise looks like corners.
    """
    x, y, swell = fit[0], fit[1], fit[3]
    lever = np.mean((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2)
    step, most = unit / np.sqrt(lever), CLIP * unit * unit
    squares, number = np.zeros(3), 0
    for i in range(len(points)):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        for k in range(3):
            turn = fit[2] + (0.0, step, -step)[k]
            c, s = np.cos(turn), np.sin(turn)
            error = edge_distance(edges, c * dx + s * dy, -s * dx + c * dy)[0] - swell
            if k == 0:
                if abs(error) > gate:
                    break
                number += 1
            squares[k] += min(error * error, most)
    if not number:
        return np.inf
    squares /= number
    rest = max(squares[0], (LEAST_ERROR * unit) ** 2)
    bend = (squares[1] + squares[2] - 2 * squares[0]) / (2 * step * step)
    if bend <= 0:
        return np.inf
    return np.sqrt(TOGETHER * rest / (number * bend) * max(full / bend, 1.0))
