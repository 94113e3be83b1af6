"""Files of part types. `save_part_types` writes a file. `add_type` learns a type from pictures and
adds it to a file. `load_bare` learns a bare plate, and `lesson_text` describes a learned type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from plate_core.files import draft
from plate_core.rig import PartType, load_part_types, read_part_types
from plate_core.yaml_fields import Fields

from ..camera.files import read_pictures, write_picture
from ..camera.lens import Calibration
from ..errors import CalibrationError, TeachError, check_size
from ..plate.home import PlateLocation, locate_plate
from ..plate.region import Region
from .background import Background, learn_plate
from .teaching import Example, Lesson, check_distinguishable, learn_type

OUT = Path("parts.yaml")
"""Default file of part types."""

MICRON = 6
"""Number of decimal digits of lengths in files of part types, which are in metres."""


def save_part_types(path: Path, types: Mapping[str, PartType]) -> None:
    """Write a file of part types in the format of `plate_core.rig.load_part_types`.

    Raises
    ------
    PlateError
        If a type is not valid, or if the file cannot be written. After an error, an existing file
        is unchanged.
    """
    data = {name: _as_data(part) for name, part in types.items()}
    read_part_types(Fields(data, path.name, TeachError))
    head = "# Part types; `ros2 run plate_vision teach` writes it. Outlines in metres.\n"
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
    with draft(path, "types") as file:
        file.write((head + text).encode())


def _as_data(part: PartType) -> dict[str, Any]:
    def round_ring(ring: Any) -> list[list[float]]:
        return [[round(float(x), MICRON), round(float(y), MICRON)] for x, y in ring]

    data = {
        "radius_m": round(part.radius_m, MICRON) if part.radius_m else None,
        "outline_m": None if part.radius_m else round_ring(part.outline),
        "holes_m": [round_ring(hole) for hole in part.holes] or None,
        "mass_kg": part.mass_kg,
        "mu": part.mu,
        "colour_lab": part.colour_lab and [round(value, 1) for value in part.colour_lab],
        "symmetry": part.symmetry,
        "scatter_m": round(part.scatter_m, MICRON) if part.scatter_m else None,
        "height_m": part.height_m or None,
        "picture": part.picture or None,
    }
    return {key: value for key, value in data.items() if value is not None}


def add_type(
    path: Path,
    name: str,
    examples: Sequence[Example],
    calibration: Calibration,
    background: Background | None,
    region: Region | None,
    height: float | None = None,
) -> Lesson:
    """Learn a type, and write it to a file of types. Write the picture of the type to another file.

    A type with the same name is replaced, but its mass and friction are kept. The height of the
    replaced type is also kept, unless another height [m] is given.

    Raises
    ------
    PlateError
        If the type cannot be learned (see `learn_type`), if it is too similar to another type (see
        `check_distinguishable`), or if a file cannot be written.
    """
    types = dict(load_part_types(path)) if path.exists() else {}
    known = types.get(name)
    if height is None:
        height = 0.0 if known is None else known.height_m
    lesson = learn_type(name, examples, calibration, background, region, height)
    check_distinguishable(lesson.part, types, calibration)
    if known is not None:
        part = replace(lesson.part, mass_kg=known.mass_kg, mu=known.mu)
        lesson = replace(lesson, part=part)
    types[name] = lesson.part
    write_picture(path.with_name(lesson.part.picture), lesson.picture)
    save_part_types(path, types)
    return lesson


def load_bare(
    path: Path, size_px: tuple[int, int], location: PlateLocation | None = None
) -> Background:
    """Learn the bare plate from its pictures. Markers on the plate are painted over.

    Raises
    ------
    TeachError
        If a picture does not have the given size (width, height), or if it does not show all
        markers of the plate.
    """
    pictures = []
    for name, picture in read_pictures(path):
        why = ", the size of the other pictures"
        check_size(f"bare plate: {name}:", picture.shape[1::-1], size_px, TeachError, why)
        if location is not None:
            try:
                _, picture = locate_plate(location, picture)
            except CalibrationError as error:
                raise TeachError(f"bare plate: {name}: {error}") from None
        pictures.append(picture)
    return learn_plate(np.stack(pictures))


def lesson_text(lesson: Lesson) -> str:
    """Return a summary of the learned type in one line."""
    part = lesson.part
    corners = "a disc" if part.radius_m else f"{len(part.outline)} corners"
    holes = f", {len(part.holes)} hole{'s' if len(part.holes) > 1 else ''}" if part.holes else ""
    symmetry = {0: "", 1: ", no symmetry"}.get(
        part.symmetry, f", symmetry of order {part.symmetry}"
    )
    mean, sd = lesson.size_m
    return (
        f"{part.name}: {corners}{holes}{symmetry}; {extent_text(part)} +- {100 * sd / mean:.1f} %, "
        f"outline +- {1e3 * part.scatter_m:.2f} mm, colour {colour_text(part)}; from "
        f"{lesson.count} example{'s' if lesson.count > 1 else ''}"
    )


def extent_text(part: PartType) -> str:
    """Return the dimensions of a type as text: its diameter, or the sides of the smallest rectangle
    around it."""
    if part.radius_m:
        return f"diameter {2e3 * part.radius_m:.2f} mm"
    width, length = sorted(cv2.minAreaRect(np.array(part.outline, np.float32))[1])
    return f"{1e3 * length:.2f} x {1e3 * width:.2f} mm"


def colour_text(part: PartType) -> str:
    """Return the colour of a type as text."""
    if part.colour_lab is None:
        return "not known"
    return "Lab " + " ".join(f"{value:.0f}" for value in part.colour_lab)
