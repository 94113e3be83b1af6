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

(`friction_gap` to 2,500 points, greatest of 2,000 slips, half of them turns about a point of the
footprint, where the slip's direction jumps.)
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

ROUNDING = 1e-9
"""Shares that differ by less than this are equal."""


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
        cell's mean slip is `sqrt(|slip at the point|^2 + (c blur)^2)`. 0 for a real foot.
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


def disc(radius: float, *, mass: float = MASS, inertia: float | None = None) -> Footprint:
    """Return the footprint of a disc [m] that presses evenly on the plate."""
    radius, mass = _positive("radius", radius, "m"), _positive("mass", mass, "kg")
    corner = 2 * np.pi * np.arange(CORNERS_OF_DISC) / CORNERS_OF_DISC
    outline = radius * np.column_stack([np.cos(corner), np.sin(corner)])
    inertia = 0.5 * mass * radius**2 if inertia is None else _positive("inertia", inertia, "kg m2")
    none = np.empty(0)
    return Footprint(mass, inertia, np.empty((0, 2)), none, none, (outline,), radius)


def bar(
    length: float,
    width: float,
    *,
    mass: float = MASS,
    points: int = POINTS,
    inertia: float | None = None,
) -> Footprint:
    """Return the footprint of a rectangle [m], its length along x."""
    half = 0.5 * np.array([_positive("length", length, "m"), _positive("width", width, "m")])
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return polygon(corners, mass=mass, points=points, inertia=inertia)


def polygon(
    corners: np.ndarray,
    *,
    mass: float = MASS,
    points: int = POINTS,
    inertia: float | None = None,
    centre: np.ndarray | None = None,
) -> Footprint:
    """Return the footprint of a convex polygon (k, 2) [m]; see `union`."""
    return union([corners], mass=mass, points=points, inertia=inertia, centre=centre)


def union(
    polygons: Sequence[np.ndarray],
    *,
    mass: float = MASS,
    points: int = POINTS,
    inertia: float | None = None,
    centre: np.ndarray | None = None,
) -> Footprint:
    """Return the footprint of convex polygons that lie side by side, such as an L of two bars.

    Parameters
    ----------
    polygons : sequence of (k, 2)
        Corners in order [m], in axes of your choice; the part's origin will be its centre of mass.
    mass : float
        [kg].
    points : int
        Number of quadrature points, about.
    inertia : float, optional
        About the centre of mass [kg m2]; that of uniform density if missing.
    centre : (2,), optional
        Centre of mass in your axes [m]; the centroid if missing. The pressure then rises linearly
        over the footprint such that its centre lies below the centre of mass.

    Raises
    ------
    PlateError
        If a polygon is not convex, two overlap, a number is not positive, or the part would tip
        over or lift an edge.
    """
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
    return _build(place, weight, tuple(shapes), mass, inertia, centre)


def on_feet(footprint: Footprint, feet: np.ndarray, weights: np.ndarray | None = None) -> Footprint:
    """Return a part that touches the plate only in some points of its footprint.

    Parameters
    ----------
    footprint : Footprint
        Gives outline, mass and inertia.
    feet : (n, 2)
        n >= 3 points [m], in the frame of `footprint`: origin in the centre of mass.
    weights : (n,), optional
        Share of the weight on each. If missing, equal but for a linear change over the footprint
        that puts their centre under the centre of mass.

    Raises
    ------
    PlateError
        If there are fewer than three feet, or they do not bear the part where its weight is.
    """
    feet = quadrature.places("feet", feet, 3)
    if weights is None:
        share = _tilted(feet, np.full(len(feet), 1 / len(feet)), np.zeros(2))
    else:
        share = np.array(weights, dtype=float)
        if share.shape != (len(feet),):
            raise PlateError(f"weights have shape {share.shape}, allowed: ({len(feet)},)")
        if not (np.all(share >= 0) and 0 < share.sum() < np.inf):
            raise PlateError(f"weights are {share.tolist()}, allowed: at least 0, not all 0")
        share = share / share.sum()
        off = np.abs(share @ feet).max()
        if off > 1e-6 * np.abs(feet).max():
            raise PlateError(
                f"weights have their centre {off:.3g} m from the centre of mass, allowed: 0"
            )
    return Footprint(
        footprint.mass, footprint.inertia, feet, share, np.zeros(len(feet)), footprint.outline,
        footprint.radius,
    )  # fmt: skip


def friction_gap(one: Footprint, other: Footprint, slips: int = 4000) -> float:
    """Greatest difference of friction between two footprints, such as one and a finer one.

    Over seeded slips: half of them of any direction, half turns about points of the footprint.
    In mu m g, the torque by radius of gyration.
    """
    rng = np.random.default_rng(0)
    arm = np.sqrt(other.gyration2)
    slip = rng.normal(size=(slips, 3)) / [1, 1, arm]
    pivot = other.points[rng.integers(len(other.points), size=slips // 2)]
    slip[: slips // 2] = np.column_stack([pivot[:, 1], -pivot[:, 0], np.ones(len(pivot))])
    gap = 0.0
    for part in np.array_split(slip, 1 + slips * len(other.points) // 10**7):
        unlike = (one.friction(part) - other.friction(part)) / [1, 1, arm]
        gap = max(gap, float(np.linalg.norm(unlike, axis=1).max()))
    return gap


def _build(
    place: np.ndarray,
    area: np.ndarray,
    outline: tuple[np.ndarray, ...],
    mass: float,
    inertia: float | None,
    centre: np.ndarray | None,
) -> Footprint:
    """Return a footprint from points (n, 2) [m] that stand for areas (n,) [m2]."""
    mass = _positive("mass", mass, "kg")
    weight = area / area.sum()
    middle = weight @ place
    if centre is not None:
        middle = quadrature.places("centre", np.reshape(centre, (1, -1)), 1)[0]
    place = place - middle
    if inertia is None:
        inertia = mass * float(weight @ (place**2).sum(1))
    share = weight if centre is None else _tilted(place, weight, np.zeros(2))
    return Footprint(
        mass,
        _positive("inertia", inertia, "kg m2"),
        place,
        share,
        CELL * np.sqrt(area),
        tuple(corners - middle for corners in outline),
    )


def _tilted(place: np.ndarray, weight: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Multiply weights (n,) by a linear function of place such that their centre is `centre`."""
    middle = weight @ place
    arm = place - middle
    spread = (weight[:, None] * arm).T @ arm
    if np.linalg.det(spread) <= ROUNDING * np.trace(spread) ** 2:
        raise PlateError("feet lie on a line, allowed: three that span a triangle")
    share = weight * (1 + arm @ np.linalg.solve(spread, centre - middle))
    if share.min() < -ROUNDING:
        k = int(np.argmin(share))
        raise PlateError(
            f"pressure would be negative at {place[k].tolist()} m from the centre of mass: "
            "the part tips or lifts an edge, allowed: a centre of mass further inside"
        )
    return np.maximum(share, 0) / np.maximum(share, 0).sum()


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
