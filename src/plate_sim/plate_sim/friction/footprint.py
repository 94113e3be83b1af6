"""Footprint of a rigid part. A footprint contains the contact points of the part with the plate,
the fraction of the weight on each point, and the inertia of the part.

Friction acts on the whole footprint. If the slip varies over the footprint, friction also rotates
the part (section 3.1.2 of the paper). For a disc, the module `disc` contains formulas for the
integral of the friction. For other shapes, the integral is approximated by a sum over quadrature
points. Gauss's product rule is used for parallelograms. All other shapes are cut into triangles,
for which a rule of degree 2 is used. Gauss's rule and the triangle rule are exact for polynomials
of degree 2. Therefore, mass, centre and inertia have no quadrature error.

The table contains the maximum error of the friction force [mu m g] and of the friction torque [mu m
g times the radius of gyration], for several numbers of points:

    points        12      24      48      96     192
    square     0.077   0.041   0.020   0.011   0.005
    bar 8 : 1  0.098   0.036   0.020   0.009   0.005
    L-shape    0.121   0.048   0.022   0.012   0.005
    triangle   0.106   0.057   0.031   0.014   0.008

The errors were computed by comparison with 2,500 points (function `friction_gap` of the tests), and
the maximum is over 2,000 slip motions. Half of these slip motions are rotations about a point of
the footprint. At this point, the direction of the slip is discontinuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral

import numpy as np
import shapely
from shapely import Polygon

from plate_core import PlateError

from . import quadrature
from .disc import disc_force

POINTS = 48
"""Approximate default number of quadrature points. With this number, the error of the friction is
at most 3 % of mu m g."""

MASS = 0.02
"""Default mass [kg]. The motion of a part on the plate does not depend on its mass."""

MAX_POINTS = 100_000
"""Maximum number of quadrature points."""

CELL = 0.2
"""Value of `Footprint.blur`, as a fraction of the size of the cell that a point represents. The
blur halves the error of the friction."""

ON_EDGE = 1e-9
"""A point counts as on the edge of a piece if it is within this distance of the edge, as a fraction
of the size of the piece. The tolerance is necessary because of rounding errors."""

CORNERS_OF_DISC = 96
"""Number of corners of the polygon that represents a disc in drawings."""


@dataclass(frozen=True)
class Footprint:
    """Contact of a rigid part with the plate. The frame has its origin in the centre of mass, and
    the part's axes.

    Attributes
    ----------
    mass : float
        Mass [kg].
    inertia : float
        Moment of inertia about the vertical axis through the centre of mass [kg m2].
    points : (n, 2)
        Contact points with the plate [m]. Empty for a disc with uniform pressure.
    weights : (n,)
        Fraction of the part's weight on each point. The sum of the fractions is 1.
    blur : (n,)
        Approximate size of the cell that each point represents [m]. Let s be the slip speed at the
        point, and c the angular velocity of the slip. The mean slip speed of the cell is assumed to
        be `sqrt(s^2 + (c blur)^2)`.
    outline : tuple of (k, 2)
        Corners of the convex polygons [m], counter-clockwise. For a disc, the corners are used only
        for drawing.
    radius : float
        Radius of a disc [m]. The radius is 0 for other shapes.
    """

    mass: float
    inertia: float
    points: np.ndarray
    weights: np.ndarray
    blur: np.ndarray
    outline: tuple[np.ndarray, ...]
    radius: float = 0.0

    @cached_property
    def corners(self) -> np.ndarray:
        """Corners (n, 5) of the outline, piece by piece. Empty for a disc.

        Each row contains the position of a corner [m], the outward normal of the side that begins
        at this corner, and a flag. The flag is 1 if this side belongs to the outline of the part,
        and 0 if it adjoins another piece of the part.
        """
        return np.empty((0, 5)) if self.radius else _corners(self.outline)

    @cached_property
    def reach(self) -> float:
        """Maximum distance [m] of the outline from the centre of mass."""
        return self.radius or float(max(np.hypot(*piece.T).max() for piece in self.outline))

    @cached_property
    def slim(self) -> float:
        """About half the minimum width of the part [m]. The value is computed as twice the area of
        the slimmest piece, divided by the perimeter of this piece."""
        return self.radius or min(
            2 * quadrature.area(piece) / np.linalg.norm(piece - np.roll(piece, 1, 0), axis=1).sum()
            for piece in self.outline
        )

    @property
    def even(self) -> bool:
        """Whether the footprint is a disc with uniform pressure. The friction of such a disc is
        computed without contact points."""
        return self.radius > 0 and not len(self.points)

    @cached_property
    def inertial(self) -> tuple[float, float, float, float, float]:
        """The square of the radius of gyration [m2], `radius` [m], `reach` [m], `slim` [m], and
        1/mass [1/kg]."""
        return self.gyration2, self.radius, self.reach, self.slim, 1 / self.mass

    @property
    def gyration2(self) -> float:
        """Square of the radius of gyration, which is the inertia divided by the mass [m2]."""
        return self.inertia / self.mass

    def friction(self, slip: np.ndarray) -> np.ndarray:
        """Return the friction of the plate on the part.

        Parameters
        ----------
        slip : (k, 3)
            Twist of the plate minus the twist of the part [m/s, m/s, rad/s], in the part's axes.
            The velocity of the plate is taken at the part's centre of mass.

        Returns
        -------
        (k, 3)
            Friction force [mu m g], and friction torque about the centre of mass [mu m g m].
        """
        slip = np.asarray(slip, dtype=float).reshape(-1, 1, 3)
        if self.even:
            return np.array([self._disc_friction(*row[0]) for row in slip]).reshape(-1, 3)
        x, y = self.points.T
        u, v = slip[..., 0] - slip[..., 2] * y, slip[..., 1] + slip[..., 2] * x
        blurred = slip[..., 2] * self.blur**2
        size = np.sqrt(u * u + v * v + slip[..., 2] * blurred)
        stress = self.weights / np.where(size > 0, size, np.inf)
        return np.stack(
            [(stress * u).sum(1), (stress * v).sum(1), (stress * (x * v - y * u + blurred)).sum(1)],
            1,
        )

    def _disc_friction(self, u: float, v: float, c: float) -> tuple[float, float, float]:
        s = float(np.hypot(u, v))
        if s == 0 and c == 0:
            return 0.0, 0.0, 0.0
        force, torque = disc_force(s, self.radius * abs(c))
        ratio = force / s if s > 0 else 0.0
        return ratio * u, ratio * v, float(np.copysign(self.radius * torque, c))


def disc(radius: float, *, mass: float = MASS) -> Footprint:
    """Return the footprint of a disc with the radius `radius` [m], the mass `mass` [kg] and uniform
    pressure."""
    radius, mass = _positive("radius", radius, "m"), _positive("mass", mass, "kg")
    corner = 2 * np.pi * np.arange(CORNERS_OF_DISC) / CORNERS_OF_DISC
    outline = radius * np.column_stack([np.cos(corner), np.sin(corner)])
    empty = np.empty(0)
    return Footprint(
        mass, 0.5 * mass * radius**2, np.empty((0, 2)), empty, empty, (outline,), radius
    )


def bar(length: float, width: float, *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of a rectangle with the sides `length` (along x) and `width` [m]."""
    half = 0.5 * np.array([_positive("length", length, "m"), _positive("width", width, "m")])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return polygon(corners, mass=mass, points=points)


def polygon(corners: np.ndarray, *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of a convex polygon (k, 2) [m]. The parameters are described in
    `union`."""
    return union([corners], mass=mass, points=points)


def union(polygons: Sequence[np.ndarray], *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of a part that consists of adjacent convex polygons. The density is
    uniform. For example, two bars form an L.

    Parameters
    ----------
    polygons : sequence of (k, 2)
        Corners in order [m]. The frame of the corners may have any position and orientation
        relative to the part. The centre of mass becomes the origin of the part's frame.
    mass : float
        Mass [kg].
    points : int
        Approximate number of quadrature points.

    Raises
    ------
    PlateError
        If a polygon is not convex, if two polygons overlap, or if a number is not positive.
    """
    mass = _positive("mass", mass, "kg")
    if not len(polygons):
        raise PlateError("union has no polygons, allowed: at least 1")
    shapes = [quadrature.convex(corners) for corners in polygons]
    areas = [quadrature.area(shape) for shape in shapes]
    for i in range(len(shapes)):
        for j in range(i):
            common = Polygon(shapes[i]).intersection(Polygon(shapes[j])).area
            if common > 1e-6 * min(areas[i], areas[j]):
                raise PlateError(
                    f"polygons {j} and {i} overlap by {common:.3g} m2, allowed: no overlap"
                )
    count = _points(points)
    rules = [
        quadrature.polygon_rule(shape, max(3, round(count * area / sum(areas))))
        for shape, area in zip(shapes, areas, strict=True)
    ]
    position = np.concatenate([rule[0] for rule in rules])
    weight = np.concatenate([rule[1] for rule in rules])
    fraction = weight / weight.sum()
    middle = fraction @ position
    position -= middle
    return Footprint(
        mass,
        mass * float(fraction @ (position**2).sum(1)),
        position,
        fraction,
        CELL * np.sqrt(weight),
        tuple(corners - middle for corners in shapes),
    )


def _positive(name: str, value: float, unit: str) -> float:
    if not 0 < value < np.inf:
        raise PlateError(f"{name} is {value!r} {unit}, allowed: a positive number")
    return float(value)


def _points(value: int) -> int:
    if not isinstance(value, Integral) or not 6 <= value <= MAX_POINTS:
        raise PlateError(f"points is {value!r}, allowed: a whole number, 6 to {MAX_POINTS}")
    return int(value)


def _corners(outline: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the array `Footprint.corners` for a list of convex pieces, each with corners (k, 2)
    [m]."""
    rows = []
    for i, piece in enumerate(outline):
        side = np.roll(piece, -1, axis=0) - piece
        out = np.column_stack([side[:, 1], -side[:, 0]]) / np.linalg.norm(side, axis=1)[:, None]
        # A side of a convex piece is hidden if three of its points are in another piece of the part
        # or on the edge of another piece.
        ends = shapely.points(piece + np.array([1e-3, 0.5, 1 - 1e-3])[:, None, None] * side)
        hidden = np.zeros(len(piece), dtype=bool)
        for other in (*outline[:i], *outline[i + 1 :]):
            gap = shapely.distance(Polygon(other), ends)
            hidden |= np.all(gap <= ON_EDGE * np.ptp(other, axis=0).max(), axis=0)
        rows.append(np.column_stack([piece, out, ~hidden]))
    return np.concatenate(rows)
