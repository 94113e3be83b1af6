"""Part types: outline, mass, friction and looks, read from a file of them.

A part has a frame of its own: its origin is the centre of its area, where its mass is if it is
evenly thick; at an angle of 0 it lies as its outline is written.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import RigError
from ..parts import NAMELESS
from ..yaml_fields import (
    Fields,
    Key,
    Number,
    Numbers,
    Section,
    Several,
    Text,
    Whole,
    read_yaml,
    required,
)
from .polygons import cross, is_inside, is_simple, moments, overlap

MOST_CORNERS = 32
"""Of an outline, and of a hole: more are a contour that nobody simplified."""

MOST_HOLES = 8
"""Of a part."""

ROUND_CORNERS = 96
"""Corners of the polygon that stands for a disc where one is needed."""

LARGEST_M = 1.0
"""No corner is further from the centre [m]."""

MAX_HEIGHT_M = 0.1
"""Maximum height of a part above the plate [m]: a taller one topples on a plate that shakes."""

SMALLEST_M2 = 1e-8
"""Least area of a part or hole [m2]."""

NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]*[a-z][a-z0-9]*)*")
"""Of a type: as `nut` or `nut_m4`; a number alone after the last _ would be taken for a part's."""

LONGEST = 32
"""Letters of a name."""

TAKEN = ("black", "grey", *NAMELESS)
"""The classes of round parts on rigs without types, and of what is of no type."""

CENTRED = 0.03
"""Distances of less than this fraction of a part's reach are of its making."""

Polygon = tuple[tuple[float, float], ...]
"""Corners (x, y) [m], counter-clockwise."""

PART_TYPE = Section(
    "types (may be left out), NAME",
    "A type of part, with a name as `nut`. Either `outline_m` or `radius_m`.",
    (
        Key(
            "outline_m", Numbers((None, 2), -LARGEST_M, LARGEST_M), "Corners [x, y] of its "
            f"outline, in order, 3 to {MOST_CORNERS}.", None, "a disc of `radius_m`",
        ),
        Key("radius_m", Number(1e-4, LARGEST_M), "Radius of a disc.", None, "see `outline_m`"),
        Key(
            "holes_m", Several(Numbers((None, 2), -LARGEST_M, LARGEST_M), MOST_HOLES), "Corners "
            "[x, y] of each of its holes.", None, "no holes",
        ),
        Key("mass_kg", Number(1e-6, 10), "Its mass.", None, "that in `parts`"),
        Key("mu", Number(0.01, 2), "Friction between it and plate.", None, "that in `friction`"),
        Key(
            "colour_lab", Numbers((3,), -128, 128), "Its colour under the plate's light, CIE L, a, "
            "b: L from 0, black, to 100.", None, "not known",
        ),
        Key(
            "symmetry", Whole(0, 64), "It looks the same in so many directions: 1 for a bracket, 6 "
            "for a hexagon, 0 for a disc.", None, "found from the outline",
        ),
        Key(
            "scatter_m", Number(0, LARGEST_M), "How far outlines of parts of this type are from "
            "this one, root mean square.", 0.0,
        ),
        Key(
            "height_m", Number(0, MAX_HEIGHT_M), "Its height above the plate; 0: flat, or unknown.",
            0.0,
        ),
        Key("picture", Text(), "A picture of it, beside the file.", "", "none"),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PartType:
    """One type of part.

    Attributes
    ----------
    name : str
    outline : Polygon
        Corners [m], counter-clockwise, about the centre of its area less its holes; of a disc none.
    radius_m : float
        Of a disc; else 0.
    holes : tuple of Polygon
        Corners [m], counter-clockwise.
    mass_kg, mu : float or None
        None: as the rig's parts.
    colour_lab : tuple of 3 float, or None
        CIE L, a, b; None: not known.
    symmetry : int
        In how many directions it looks the same; 0: in all.
    scatter_m : float
        How far outlines of parts of this type are from this one, RMS [m].
    picture : str
        Name of a file, or nothing.
    height_m : float
        Height above the plate [m]; 0: flat, or unknown.
    """

    name: str
    outline: Polygon = ()
    radius_m: float = 0.0
    holes: tuple[Polygon, ...] = ()
    mass_kg: float | None = None
    mu: float | None = None
    colour_lab: tuple[float, float, float] | None = None
    symmetry: int = 1
    scatter_m: float = 0.0
    picture: str = ""
    height_m: float = 0.0

    @cached_property
    def polygon(self) -> np.ndarray:
        """Corners (n, 2) of the outline [m]; of a disc `ROUND_CORNERS` with its area."""
        if self.outline:
            return np.array(self.outline)
        return disc_polygon(self.radius_m)

    @cached_property
    def reach_m(self) -> float:
        """Greatest distance of its rim from its centre [m]."""
        return self.radius_m or float(np.max(np.hypot(*self.polygon.T)))

    @cached_property
    def area_m2(self) -> float:
        """Of the outline, less the holes [m2]."""
        return float(self._moments[0])

    @cached_property
    def spread_m2(self) -> np.ndarray:
        """Mean of x x, x y; y x, y y over its area (2, 2) [m2]: its trace is the square of the
        radius of gyration."""
        area, _, second = self._moments
        return np.asarray(second / area)

    @property
    def _moments(self) -> tuple[float, np.ndarray, np.ndarray]:
        return moments(self.polygon, [np.array(hole) for hole in self.holes])


def load_part_types(path: str | Path) -> Mapping[str, PartType]:
    """Read a file of part types, such as `ros2 run plate_vision teach` writes.

    Raises
    ------
    RigError
        If a key is missing or unknown, or its value is not allowed: the message names it.
    """
    return read_part_types(read_yaml(Path(path), RigError))


def read_part_types(fields: Fields) -> Mapping[str, PartType]:
    """Read a mapping of names to part types; errors as `load_part_types`."""
    types, names = {}, fields.keys()
    for name in names:
        if not NAME.fullmatch(name) or len(name) > LONGEST or name in TAKEN:
            raise RigError(
                f"{fields.where}: type {name!r}, allowed: small letters and digits, at most "
                f"{LONGEST}, as nut or nut_m4, no number alone after the last _, and not "
                f"{', '.join(TAKEN)}, which are classes of parts of no type"
            )
        types[name] = _part_type(name, fields.child(name))
    return types


def _part_type(name: str, fields: Fields) -> PartType:
    outline, radius, holes = np.empty((0, 2)), 0.0, fields.value(PART_TYPE["holes_m"]) or []
    if fields.one_of("outline_m", "radius_m") == "radius_m":
        radius = fields.value(required(PART_TYPE["radius_m"]))
        body = disc_polygon(radius)
    else:
        outline = fields.value(required(PART_TYPE["outline_m"]))
        body = outline = _ordered(fields, "outline_m", outline)
    holes = [_ordered(fields, "holes_m", hole) for hole in holes]
    for index, hole in enumerate(holes):
        others = [body, *holes[:index]]
        if not is_inside(hole, body) or any(overlap(hole, other) for other in others[1:]):
            raise fields.fail("holes_m", "holes wholly in the part, and none in another")
    area, centre, _ = moments(body, holes)
    if area < SMALLEST_M2:
        raise fields.fail("holes_m", "holes smaller than the part")
    if radius and np.hypot(*centre) > CENTRED * radius:
        raise fields.fail("holes_m", "in a disc, holes about its centre; else write `outline_m`")
    if not radius:
        outline, holes = outline - centre, [hole - centre for hole in holes]
    colour = fields.value(PART_TYPE["colour_lab"])
    symmetry = fields.value(PART_TYPE["symmetry"])
    if symmetry is None:
        symmetry = 0 if radius else symmetry_of(outline)
    if (symmetry == 0) != bool(radius):
        raise fields.fail("symmetry", "0 for a disc, and only for one")
    part = PartType(
        name=name,
        outline=_pairs(outline),
        radius_m=radius,
        holes=tuple(_pairs(hole) for hole in holes),
        mass_kg=fields.value(PART_TYPE["mass_kg"]),
        mu=fields.value(PART_TYPE["mu"]),
        colour_lab=None
        if colour is None
        else (float(colour[0]), float(colour[1]), float(colour[2])),
        symmetry=symmetry,
        scatter_m=fields.value(PART_TYPE["scatter_m"]),
        picture=fields.value(PART_TYPE["picture"]),
        height_m=fields.value(PART_TYPE["height_m"]),
    )
    fields.finish()
    return part


def _ordered(fields: Fields, key: str, corner: np.ndarray) -> np.ndarray:
    """Return a polygon's corners (n, 2) counter-clockwise, once it is one."""
    if not 3 <= len(corner) <= MOST_CORNERS or not is_simple(corner):
        raise fields.fail(
            key, f"3 to {MOST_CORNERS} corners, in order, of a polygon no two edges of which cross"
        )
    area = moments(corner)[0]
    if abs(area) < SMALLEST_M2:
        raise fields.fail(key, f"a polygon of at least {SMALLEST_M2:g} m2")
    return corner if area > 0 else corner[::-1]


def _pairs(corner: np.ndarray) -> Polygon:
    return tuple((float(x), float(y)) for x, y in corner)


def disc_polygon(radius: float) -> np.ndarray:
    """Return `ROUND_CORNERS` corners (n, 2) [m] of a polygon with a disc's area."""
    turn = 2 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    step = 2 * np.pi / ROUND_CORNERS
    own = radius * np.sqrt(step / np.sin(step))
    return np.asarray(own * np.stack([np.cos(turn), np.sin(turn)], axis=1))


def symmetry_of(outline: np.ndarray) -> int:
    """Return in how many directions a polygon (n, 2), centred, looks the same: its corners then
    fall on each other, within `CENTRED` of its reach."""
    near = CENTRED * np.max(np.hypot(*outline.T))
    before, after = np.roll(outline, 1, axis=0) - outline, np.roll(outline, -1, axis=0) - outline
    height = np.abs(cross(before, after)) / np.linalg.norm(after - before, axis=1)
    outline = outline[height > near / 3]  # without corners on a straight edge
    for count in range(len(outline), 1, -1):
        c, s = np.cos(2 * np.pi / count), np.sin(2 * np.pi / count)
        turned = outline @ np.array([[c, s], [-s, c]])
        gap = np.hypot(*(turned[:, None] - outline).transpose(2, 0, 1))
        if np.all(np.min(gap, axis=1) < near):
            return count
    return 1
