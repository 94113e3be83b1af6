"""Part types: outline, mass, friction, colour and symmetry, read from a YAML file.

The origin of a part's frame is the centroid of its area. This point is the centre of mass if the
part has uniform thickness. At angle 0, the part has the orientation of its outline in the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import read_only
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
from .polygons import is_simple, moments

if TYPE_CHECKING:
    from shapely import Geometry

MAX_CORNERS = 32
"""Maximum number of corners of an outline or a hole. A user must simplify a contour with more
corners."""

MAX_HOLES = 8
"""Maximum number of holes of a part."""

ROUND_CORNERS = 96
"""Number of corners of a polygon that approximates a disc."""

MAX_M = 1.0
"""Maximum magnitude of a corner's coordinate in the file [m]."""

MAX_HEIGHT_M = 0.1
"""Maximum height of a part above the plate [m]. A taller part topples on a shaking plate."""

MIN_M2 = 1e-8
"""Minimum area of a part or hole [m2]."""

NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]*[a-z][a-z0-9]*)*")
"""Pattern of a type's name, such as `nut` or `nut_m4`. A name must not end with _ and digits,
because a part's id is the name of its type followed by _ and a number."""

MAX_NAME = 32
"""Maximum length of a name [characters]."""

TAKEN = ("black", "grey", *NAMELESS)
"""Reserved names. These names are the classes of round parts on rigs without types, and the classes
of objects that match no type."""

CENTRED = 0.03
"""Maximum distance between the centre of a disc and the centre of its area without holes, and
between corners of a symmetric outline that a rotation must map onto each other. Both are fractions
of the part's reach (maximum distance between centre and edge). They cover errors of manufacture and
measurement."""

Polygon = tuple[tuple[float, float], ...]
"""Corners (x, y) [m], counter-clockwise."""

PART_TYPE = Section(
    "types (optional), NAME",
    "A type of part with a name such as `nut`. Instead of this section, `types` can be the path of "
    "a YAML file with part types, relative to the rig file's folder.",
    (
        Key(
            "outline_m", Numbers((None, 2), -MAX_M, MAX_M), "3 to "
            f"{MAX_CORNERS} corners [x, y] of the outline, in order.", None, "or `radius_m`",
        ),
        Key("radius_m", Number(1e-4, MAX_M), "Radius of a round part.", None, "or `outline_m`"),
        Key(
            "holes_m", Several(Numbers((None, 2), -MAX_M, MAX_M), MAX_HOLES), "Corners "
            "[x, y] of each hole, in order.", None, "no holes",
        ),
        Key("mass_kg", Number(1e-6, 10), "Mass of the part.", None, "the mass in `parts`"),
        Key(
            "mu", Number(0.01, 2), "Friction coefficient between the part and the plate.", None,
            "the coefficient in `friction`",
        ),
        Key(
            "colour_lab", Numbers((3,), -128, 128), "Colour of the part under the plate's light: "
            "CIE L (0 to 100), a, b.", None, "unknown",
        ),
        Key(
            "symmetry", Whole(0, 64), "Order of the part's rotational symmetry: 1 for a bracket, 6 "
            "for a hexagon, 0 for a disc.", None, "computed from the outline",
        ),
        Key(
            "scatter_m", Number(0, MAX_M), "Root mean square deviation of real parts from this "
            "outline.", 0.0,
        ),
        Key(
            "height_m", Number(0, MAX_HEIGHT_M), "Height of the part above the plate. 0 if the "
            "part is flat or the height is unknown.",
            0.0,
        ),
        Key(
            "picture", Text(), "Name of a picture of the part, a file in the same folder.", "",
            "no picture",
        ),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PartType:
    """One type of part.

    Attributes
    ----------
    name : str
    outline : Polygon
        Corners [m], counter-clockwise, relative to the centroid of the area without holes. Empty
        for a disc.
    radius_m : float
        Radius of a disc [m]. 0 for other parts.
    holes : tuple of Polygon
        Corners of each hole [m], counter-clockwise.
    mass_kg, mu : float or None
        Mass [kg] and friction coefficient [-]. None: the default value of the rig.
    colour_lab : tuple of 3 float, or None
        Colour in CIE L, a, b. None if unknown.
    symmetry : int
        Order of rotational symmetry. 0 for a disc.
    scatter_m : float
        RMS deviation of the outlines of individual parts from `outline` [m].
    picture : str
        Name of a picture file, or empty.
    height_m : float
        Height above the plate [m]. 0 if flat or unknown.
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
        """Corners (n, 2) of the outline [m]. For a disc, a polygon of equal area with
        `ROUND_CORNERS` corners. Read-only."""
        return read_only(np.array(self.outline) if self.outline else disc_polygon(self.radius_m))

    @cached_property
    def reach_m(self) -> float:
        """Maximum distance between the edge of the part and its centre [m]."""
        return self.radius_m or float(np.max(np.hypot(*self.polygon.T)))

    @cached_property
    def area_m2(self) -> float:
        """Area inside the outline without the holes [m2]."""
        return float(self._moments[0])

    @cached_property
    def spread_m2(self) -> np.ndarray:
        """Second moments of the area, divided by the area: the means of x x, x y; y x, y y (2, 2)
        [m2]. The trace is the squared radius of gyration. Read-only."""
        area, _, second = self._moments
        return read_only(np.asarray(second / area))

    def placed(self, position: np.ndarray, angle: float) -> Geometry:
        """Return the part at a pose [m, rad] for calculations with shapely. The result is the
        outline without holes, or the centre of a disc. A disc extends `radius_m` beyond its
        centre."""
        from shapely import Point, Polygon

        if self.radius_m:
            return Point(position)
        cos, sin = np.cos(angle), np.sin(angle)
        return Polygon(self.polygon @ np.array([[cos, sin], [-sin, cos]]) + position)

    @property
    def _moments(self) -> tuple[float, np.ndarray, np.ndarray]:
        return moments(self.polygon, [np.array(hole) for hole in self.holes])


def load_part_types(path: str | Path) -> Mapping[str, PartType]:
    """Read a file of part types, such as the output of `ros2 run plate_vision teach`.

    Raises
    ------
    RigError
        If a key is missing or unknown, or its value is not allowed. The message states the key.
    """
    return read_part_types(read_yaml(Path(path), RigError))


def read_part_types(fields: Fields) -> Mapping[str, PartType]:
    """Read a mapping of names to part types. The function raises the same errors as
    `load_part_types`."""
    types, names = {}, fields.keys()
    for name in names:
        if not NAME.fullmatch(name) or len(name) > MAX_NAME or name in TAKEN:
            raise RigError(
                f"{fields.where}: name of a type is {name!r}, allowed: lower-case letters, digits "
                "and _, such as nut or nut_m4; the first character is a letter, and each word "
                f"after _ contains a letter; at most {MAX_NAME} characters; reserved names: "
                f"{', '.join(TAKEN)} (classes of parts without a type)"
            )
        types[name] = _read_part_type(name, fields.child(name))
    return types


def _read_part_type(name: str, fields: Fields) -> PartType:
    # Shapely is imported here, so that the stop command does not wait for this import.
    from shapely import Polygon

    outline, radius, holes = np.empty((0, 2)), 0.0, fields.value(PART_TYPE["holes_m"]) or []
    if fields.one_of("outline_m", "radius_m") == "radius_m":
        radius = fields.value(required(PART_TYPE["radius_m"]))
        body = disc_polygon(radius)
    else:
        outline = fields.value(required(PART_TYPE["outline_m"]))
        body = outline = _read_polygon(fields, "outline_m", outline)
    holes = [_read_polygon(fields, "holes_m", hole) for hole in holes]
    if not Polygon(body, holes).is_valid:
        raise fields.fail("holes_m", "holes that are completely inside the part and do not overlap")
    area, centre, _ = moments(body, holes)
    if area < MIN_M2:
        raise fields.fail("holes_m", "holes that leave some area of the part")
    if radius and np.hypot(*centre) > CENTRED * radius:
        raise fields.fail(
            "holes_m",
            "for a disc, holes that balance around its centre; for other holes use outline_m",
        )
    if not radius:
        outline, holes = outline - centre, [hole - centre for hole in holes]
    colour = fields.value(PART_TYPE["colour_lab"])
    symmetry = fields.value(PART_TYPE["symmetry"])
    if symmetry is None:
        symmetry = 0 if radius else symmetry_order(outline)
    if (symmetry == 0) != bool(radius):
        raise fields.fail("symmetry", "0 for a disc, 1 or more for other parts")
    part = PartType(
        name=name,
        outline=_to_polygon(outline),
        radius_m=radius,
        holes=tuple(_to_polygon(hole) for hole in holes),
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


def _read_polygon(fields: Fields, key: str, corner: np.ndarray) -> np.ndarray:
    """Return the corners (n, 2) of a polygon in counter-clockwise order. Raise an error if the
    corners are not a valid polygon."""
    if not 3 <= len(corner) <= MAX_CORNERS or not is_simple(corner):
        raise fields.fail(
            key, f"3 to {MAX_CORNERS} corners in order around a polygon whose edges do not cross"
        )
    area = moments(corner)[0]
    if abs(area) < MIN_M2:
        raise fields.fail(key, f"a polygon with an area of at least {MIN_M2:g} m2")
    return corner if area > 0 else corner[::-1]


def _to_polygon(corner: np.ndarray) -> Polygon:
    return tuple((float(x), float(y)) for x, y in corner)


def disc_polygon(radius: float) -> np.ndarray:
    """Return the `ROUND_CORNERS` corners (n, 2) [m] of a regular polygon with the area of a
    disc."""
    angle = 2 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    step = 2 * np.pi / ROUND_CORNERS
    corner_radius = radius * np.sqrt(step / np.sin(step))
    return np.asarray(corner_radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def symmetry_order(outline: np.ndarray) -> int:
    """Return the order of rotational symmetry of a polygon (n, 2) about the origin. The corners
    must coincide after the rotation, within `CENTRED` of the polygon's reach."""
    near = CENTRED * np.max(np.hypot(*outline.T))
    before, after = np.roll(outline, 1, axis=0) - outline, np.roll(outline, -1, axis=0) - outline
    crosses = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    height = np.abs(crosses) / np.linalg.norm(after - before, axis=1)
    outline = outline[height > near / 3]  # remove corners that are nearly on a straight edge
    for count in range(len(outline), 1, -1):
        c, s = np.cos(2 * np.pi / count), np.sin(2 * np.pi / count)
        turned = outline @ np.array([[c, s], [-s, c]])
        gap = np.hypot(*(turned[:, None] - outline).transpose(2, 0, 1))
        if np.all(np.min(gap, axis=1) < near):
            return count
    return 1
