"""Footprints: where a rigid part touches the plate, with what share of its weight, and its inertia.

Friction acts all over a footprint, so a slip that differs from place to place also turns the part
(section 3.1.2 of the paper). For a disc that integral is known (`disc`). For others it is
a sum over quadrature points: Gauss's rule for parallelograms, triangles of degree 2 for the rest.
Both are exact for polynomials of degree 2: mass, centre and inertia have no quadrature error.

The friction force and torque are in error by at most, in mu m g (times the radius of gyration):

    points        12      24      48      96     192
    square     0.077   0.041   0.020   0.011   0.005
    bar 8 : 1  0.098   0.036   0.020   0.009   0.005
    L-shape    0.121   0.048   0.022   0.012   0.005
    triangle   0.106   0.057   0.031   0.014   0.008

(`friction_gap` of the tests, to 2,500 points, greatest of 2,000 slips, half of them turns about a
point of the footprint, where the slip's direction jumps.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral

import numpy as np

from plate_core import PlateError

from . import quadrature
from .disc import disc_force

POINTS = 48
"""Default number of quadrature points, about: friction within 3 % of mu m g at worst."""

MASS = 0.02
"""Default mass [kg]. It drops out of the motion on the plate."""

MOST_POINTS = 100_000
"""More quadrature points than this are taken for a mistake."""

CELL = 0.2
"""Blur of a point, as a share of its cell's size: half the error of none, see `Footprint.blur`."""

CORNERS_OF_DISC = 96
"""Corners of the polygon that a disc's outline is drawn as."""


@dataclass(frozen=True)
class Footprint:
    """Contact of a rigid part with the plate. Frame: origin in the centre of mass, part's axes.

    Attributes
    ----------
    mass : float
        [kg].
    inertia : float
        About the vertical axis through the centre of mass [kg m2].
    points : (n, 2)
        Where the part presses on the plate [m]; none if it does so evenly, all over a disc.
    weights : (n,)
        Share of the part's weight on each point; their sum is 1.
    blur : (n,)
        Each point stands for a cell about so large [m]: in a part that turns by the slip c, the
        cell's mean slip is `sqrt(|slip at the point|^2 + (c blur)^2)`.
    outline : tuple of (k, 2)
        Corners of the convex polygons that it consists of [m], counter-clockwise; of a disc, to
        draw it only.
    radius : float
        Of a disc [m], whose rim is round; else 0.
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
        """Corners (n, 5) of the outline, piece by piece; none of a disc.

        Each has its place [m], the outward normal of the side that begins there, and 1 if that side
        is part of the rim, 0 if another piece of the part begins at it.
        """
        return np.empty((0, 5)) if self.radius else _corners(self.outline)

    @cached_property
    def reach(self) -> float:
        """Greatest distance [m] of the rim from the centre of mass."""
        return self.radius or float(max(np.hypot(*piece.T).max() for piece in self.outline))

    @cached_property
    def slim(self) -> float:
        """About half the least width [m]: twice the area of the slimmest piece by its rim."""
        return self.radius or min(
            2 * quadrature.area(piece) / np.linalg.norm(piece - np.roll(piece, 1, 0), axis=1).sum()
            for piece in self.outline
        )

    @property
    def even(self) -> bool:
        """Whether it is a disc that presses evenly on the plate: friction needs no points then."""
        return self.radius > 0 and not len(self.points)

    @cached_property
    def inertial(self) -> tuple[float, float, float, float, float]:
        """Square of the radius of gyration [m2], radius, reach, slim [m], 1/mass [1/kg]."""
        return self.gyration2, self.radius, self.reach, self.slim, 1 / self.mass

    @property
    def gyration2(self) -> float:
        """Inertia by mass [m2]: the square of the radius of gyration."""
        return self.inertia / self.mass

    def friction(self, slip: np.ndarray) -> np.ndarray:
        """Friction that the plate gives the part.

        Parameters
        ----------
        slip : (k, 3)
            Twist of the plate less that of the part [m/s, m/s, rad/s]: velocity of the surface
            at the centre of mass, and spin; in the part's axes.

        Returns
        -------
        (k, 3)
            Force [mu m g] and torque about the centre of mass [mu m g times metre].
        """
        slip = np.asarray(slip, dtype=float).reshape(-1, 1, 3)
        if self.even:
            return np.array([self._disc_friction(*row[0]) for row in slip]).reshape(-1, 3)
        x, y = self.points.T
        u, v = slip[..., 0] - slip[..., 2] * y, slip[..., 1] + slip[..., 2] * x
        turn = slip[..., 2] * self.blur**2
        size = np.sqrt(u * u + v * v + slip[..., 2] * turn)
        share = self.weights / np.where(size > 0, size, np.inf)
        return np.stack(
            [(share * u).sum(1), (share * v).sum(1), (share * (x * v - y * u + turn)).sum(1)], 1
        )

    def _disc_friction(self, u: float, v: float, c: float) -> tuple[float, float, float]:
        s = float(np.hypot(u, v))
        if s == 0 and c == 0:
            return 0.0, 0.0, 0.0
        force, turn = disc_force(s, self.radius * abs(c))
        share = force / s if s > 0 else 0.0
        return share * u, share * v, float(np.copysign(self.radius * turn, c))


def disc(radius: float, *, mass: float = MASS) -> Footprint:
    """Return the footprint of a disc [m] that presses evenly on the plate."""
    radius, mass = _positive("radius", radius, "m"), _positive("mass", mass, "kg")
    corner = 2 * np.pi * np.arange(CORNERS_OF_DISC) / CORNERS_OF_DISC
    outline = radius * np.column_stack([np.cos(corner), np.sin(corner)])
    none = np.empty(0)
    return Footprint(mass, 0.5 * mass * radius**2, np.empty((0, 2)), none, none, (outline,), radius)


def bar(length: float, width: float, *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of a rectangle [m], its length along x."""
    half = 0.5 * np.array([_positive("length", length, "m"), _positive("width", width, "m")])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return polygon(corners, mass=mass, points=points)


def polygon(corners: np.ndarray, *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of a convex polygon (k, 2) [m]; see `union`."""
    return union([corners], mass=mass, points=points)


def union(polygons: Sequence[np.ndarray], *, mass: float = MASS, points: int = POINTS) -> Footprint:
    """Return the footprint of convex polygons that lie side by side, such as an L of two bars; of
    uniform density.

    Parameters
    ----------
    polygons : sequence of (k, 2)
        Corners in order [m], in axes of your choice; the part's origin will be its centre of mass.
    mass : float
        [kg].
    points : int
        Number of quadrature points, about.

    Raises
    ------
    PlateError
        If a polygon is not convex, two overlap, or a number is not positive.
    """
    mass = _positive("mass", mass, "kg")
    if not len(polygons):
        raise PlateError("union has no polygons, allowed: at least 1")
    shapes = [quadrature.convex(corners) for corners in polygons]
    areas = [quadrature.area(shape) for shape in shapes]
    for i in range(len(shapes)):
        for j in range(i):
            common = quadrature.area(quadrature.clip(shapes[i], shapes[j]))
            if common > 1e-6 * min(areas[i], areas[j]):
                raise PlateError(
                    f"polygons {j} and {i} overlap by {common:.3g} m2, allowed: side by side"
                )
    count = _points(points)
    rules = [
        quadrature.polygon_rule(shape, max(3, round(count * area / sum(areas))))
        for shape, area in zip(shapes, areas, strict=True)
    ]
    place = np.concatenate([rule[0] for rule in rules])
    weight = np.concatenate([rule[1] for rule in rules])
    share = weight / weight.sum()
    middle = share @ place
    place -= middle
    return Footprint(
        mass,
        mass * float(share @ (place**2).sum(1)),
        place,
        share,
        CELL * np.sqrt(weight),
        tuple(corners - middle for corners in shapes),
    )


def _positive(name: str, value: float, unit: str) -> float:
    if not 0 < value < np.inf:
        raise PlateError(f"{name} is {value!r} {unit}, allowed: a positive number")
    return float(value)


def _points(value: int) -> int:
    if not isinstance(value, Integral) or not 6 <= value <= MOST_POINTS:
        raise PlateError(f"points is {value!r}, allowed: a whole number, 6 to {MOST_POINTS}")
    return int(value)


def _corners(outline: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return `Footprint.corners` of convex pieces, each (k, 2)."""
    rows = []
    for i, piece in enumerate(outline):
        side = np.roll(piece, -1, axis=0) - piece
        out = np.column_stack([side[:, 1], -side[:, 0]]) / np.linalg.norm(side, axis=1)[:, None]
        others = [other for j, other in enumerate(outline) if j != i]
        ends = (piece + 1e-3 * side, piece + 0.5 * side, piece + (1 - 1e-3) * side)
        hidden = [
            any(all(_holds(other, end[k]) for end in ends) for other in others)
            for k in range(len(piece))
        ]
        rows.append(np.column_stack([piece, out, np.logical_not(hidden)]))
    return np.concatenate(rows)


def _holds(piece: np.ndarray, place: np.ndarray) -> bool:
    """Whether a place lies in a convex piece, or on its rim."""
    side = np.roll(piece, -1, axis=0) - piece
    arm = place - piece
    size = np.ptp(piece, axis=0).max()
    return bool(np.all(side[:, 0] * arm[:, 1] - side[:, 1] * arm[:, 0] >= -1e-9 * size * size))
