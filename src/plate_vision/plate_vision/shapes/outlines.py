"""Outlines of patches with an accuracy of a fraction of a pixel, their spectra, and fits of
polygons to them.

An outline consists of closed rings of points. The part is always on the left of a ring. In
plate_home, the outer ring is counter-clockwise, and the rings around holes are clockwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from .. import _kernels

HARMONICS: int = _kernels.HARMONICS
"""Number of harmonics of an outline's spectrum that are compared, starting with the 0th. A hexagon
differs from a disc in the 6th and 12th harmonic, and a square differs from it in the 4th, 8th, 12th
and 16th."""

POINTS = 64
"""Number of points on the contour of a patch. If a part has a diameter of 20 px, the points are 1
px apart."""

MIN_HOLE = 0.02
"""Minimum area of a hole, relative to the area of the part. Smaller holes are ignored, because
highlights may look like small holes."""

MIN_HOLE_POINTS = 12
"""Minimum number of points on a hole's contour."""

THREE, FIVE = np.ones((3, 3), np.uint8), np.ones((5, 5), np.uint8)
"""Kernels with which masks are eroded and dilated."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The measured contour of a patch or a part.

    Attributes
    ----------
    points : (n, 2)
        Points on the contour, including the contours of holes [m, plate_home].
    ends : (k,) int
        End index of each ring in `points`.
    area : float
        Area without the holes [m2].
    centre : (2,)
        Centroid of the area [m].
    spectrum : (HARMONICS,) complex
        Moments about the centroid: the integral of r^2 exp(-i k phi) over the area, with k = 0 to
        HARMONICS - 1 and the direction phi.
    """

    points: np.ndarray
    ends: np.ndarray
    area: float
    centre: np.ndarray
    spectrum: np.ndarray

    @property
    def rings(self) -> list[np.ndarray]:
        """The rings (k, 2) [m]. The outer ring comes first."""
        return np.split(self.points, self.ends[:-1])

    @cached_property
    def edges(self) -> np.ndarray:
        """Edges (e, 5) of the outline's polygon: start x, y [m], unit vector along the edge, length
        [m]."""
        return np.asarray(_kernels.outline_edges(self.points, self.ends))

    @cached_property
    def filled(self) -> Outline:
        """The outline without holes."""
        return self if len(self.ends) == 1 else make_outline([self.points[: self.ends[0]]])

    @cached_property
    def form(self) -> np.ndarray:
        """Magnitudes (HARMONICS - 1,) of the spectrum without holes: harmonics 1 and higher,
        relative to the 0th. These magnitudes do not depend on rotation and size."""
        size = np.abs(self.filled.spectrum)
        return np.asarray(size[1:] / size[0])

    @property
    def hole_fraction(self) -> float:
        """Area of the holes, relative to the area inside the outer ring [-]."""
        return 1 - self.area / self.filled.area

    @property
    def reach(self) -> float:
        """Maximum distance of the contour from the centre [m]."""
        return float(np.max(np.hypot(*(self.points - self.centre).T)))


def make_outline(rings: Sequence[np.ndarray]) -> Outline:
    """Measure rings (k, 2) [m] with any sense of rotation. The first ring is around the part, and
    the other rings are around its holes."""
    points = np.concatenate(rings).astype(float)
    ends = np.cumsum([len(ring) for ring in rings])
    spectrum = np.empty(HARMONICS, complex)
    area, x, y = _kernels.measure_outline(points, ends, spectrum)
    return Outline(points, ends, area, np.array([x, y]), spectrum)


def patch_rings(
    mask: np.ndarray, window: np.ndarray, count: int = POINTS
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the rings (k, 2) [px of the window] around a patch and its holes, and the patch's
    colour: the medians of blue, green, red (3,).

    Each point is at the place where the image has the mean of the part's and the surround's colour.

    Parameters
    ----------
    mask : (h + 2, w + 2) uint8
        1 in the patch, 0 elsewhere and in a frame of one pixel.
    window : (h, w, 3) or (h, w) uint8
        The image in the window.
    count : int
        Number of points of the outer ring. The rings of holes have the same density of points.
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
    length, outer_area = len(contours[outer]), cv2.contourArea(contours[outer])
    for i in [outer, *(i for i in range(len(contours)) if tree[0, i, 3] == outer)]:
        ring = contours[i][:, 0]
        number = count if i == outer else max(round(count * len(ring) / length), MIN_HOLE_POINTS)
        small = i != outer and cv2.contourArea(contours[i]) < MIN_HOLE * outer_area
        if len(ring) >= 4 and not small:
            points = np.empty((number, 2))
            _kernels.find_edge(field, ring, i != outer, points)
            rings.append(points)
    return rings, colour if len(colour) == 3 else np.repeat(colour, 3)


def distances(edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (n, 3): the signed distance of each point (n, 2) from a polygon's edges (e, 5), and
    the gradient of this distance, which is a unit vector."""
    found: np.ndarray = _kernels.distances(edges, points)
    return found


class PoseFit(NamedTuple):
    """Fit of a polygon to points.

    Attributes
    ----------
    pose : (3,)
        Pose of the polygon: x, y [m], angle [rad].
    swell : float
        Growth of the outline, which is the mean signed distance of the points from the polygon,
        positive outside [m].
    residual : float
        Root mean square residual [m].
    """

    pose: np.ndarray
    swell: float
    residual: float

    @classmethod
    def of(cls, fit: np.ndarray) -> PoseFit:
        """Convert the result (5,) of a kernel."""
        return cls(fit[:3], fit[3], fit[4])


def fit_pose(
    edges: np.ndarray,
    points: np.ndarray,
    pose: np.ndarray,
    unit: float,
    fit_angle: bool,
    steps: int,
    gate: float = np.inf,
) -> PoseFit:
    """Fit a polygon to points by Gauss-Newton steps. The polygon's outline may grow or shrink
    evenly.

    Parameters
    ----------
    edges : (e, 5)
        Edges of the polygon in its own frame [m] (see `Outline.edges`).
    points : (n, 2)
        Points on a contour [m].
    pose : (3,)
        Starting pose: x, y [m], angle [rad].
    unit : float
        Distance above which a point has less weight [m]. This distance should be one or two pixels.
    fit_angle : bool
        Whether the angle is fitted. False for a disc.
    steps : int
        Maximum number of Gauss-Newton steps.
    gate : float
        Distance above which points are ignored [m]. If the gate is finite, the outline does not
        grow or shrink.
    """
    return PoseFit.of(_kernels.fit_pose(edges, points, pose, unit, fit_angle, steps, np.inf, gate))
