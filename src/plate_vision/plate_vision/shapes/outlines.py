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

from .. import _kernels

HARMONICS: int = _kernels.HARMONICS
"""Of an outline's spectrum that are compared, from 0: a hexagon differs from a disc in the 6th and
12th, a square in the 4th, 8th, 12th and 16th."""

POINTS = 64
"""To which the rim of a patch is thinned out: 1 px apart for a part of 20 px."""

LEAST_HOLE = 0.02
"""Smallest hole, relative to the part: a highlight may seem to be one."""

FEWEST_POINTS = 12
"""Of a hole's rim."""

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
        return np.asarray(_kernels.outline_edges(self.points, self.ends))

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
    spectrum = np.empty(HARMONICS, complex)
    area, x, y = _kernels.measure_outline(points, ends, spectrum)
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
    inner = cv2.erode(mask, THREE)
    around = cv2.dilate(mask, FIVE)
    pixels = window.reshape(*window.shape[:2], -1)
    field, colour = np.empty(window.shape[:2], np.float32), np.empty(pixels.shape[2])
    _kernels.contrast(pixels, mask, inner, around, field, colour)
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
            points = np.empty((share, 2))
            _kernels.find_edge(field, ring, i != outer, points)
            rings.append(points)
    return rings, colour if len(colour) == 3 else np.repeat(colour, 3)


def distances(edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the signed distances of points (n, 2) from a polygon's edges (e, 5), and the unit
    vectors along which they grow: (n, 3)."""
    found: np.ndarray = _kernels.distances(edges, points)
    return found


def fit_pose(
    edges: np.ndarray,
    points: np.ndarray,
    pose: np.ndarray,
    unit: float,
    turns: bool,
    steps: int,
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
    gate : float
        Points further away than that are of something else [m]; it is then not swollen.

    Returns
    -------
    (5,)
        x, y [m], angle [rad]; how far the points are outside on average [m]; root mean square of
        the rest [m].
    """
    fit: np.ndarray = _kernels.fit_pose(edges, points, pose, unit, turns, steps, np.inf, gate)
    return fit
