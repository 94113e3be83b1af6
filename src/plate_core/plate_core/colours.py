"""Colours (red, green, blue; 0 to 255) of pictures, films and RViz markers: one palette for all."""

from __future__ import annotations

from typing import Final

__all__ = [
    "FORCE", "INK", "PLATE", "TURNING", "VELOCITY", "Colour", "class_colour", "part_colour",
]  # fmt: skip

Colour = tuple[int, int, int]

INK: Final[Colour] = (34, 34, 34)
"""Outlines and words."""

PLATE: Final[Colour] = (217, 217, 204)

FORCE: Final[Colour] = (79, 99, 111)
"""Arrows of forces."""

VELOCITY: Final[Colour] = (125, 79, 158)
"""Arrows of velocities."""

TURNING: Final[tuple[Colour, Colour]] = ((224, 130, 20), (31, 119, 180))
"""Of what turns counter-clockwise, and clockwise."""

_FACES: Final = {"black": (26, 26, 26), "grey": (168, 168, 168)}

_CLASSES: Final = {"black": (201, 54, 76), "grey": (31, 119, 180)}

_OTHERS: Final = ((224, 130, 20), (46, 125, 74), (180, 70, 150), (130, 100, 20))


def part_colour(label: str) -> Colour:
    """Return what parts of a class look like; classes that name no shade look like their colour."""
    return _FACES.get(label, class_colour(label))


def class_colour(label: str) -> Colour:
    """Return the colour of what belongs to a class: its trails, targets and names."""
    return _CLASSES.get(label) or _OTHERS[sum(label.encode()) % len(_OTHERS)]
