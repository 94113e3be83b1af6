"""Common colours (red, green, blue; 0 to 255) of pictures, films and RViz markers.

`part_colour` and `class_colour` return the colours of a class. `lab_to_srgb` converts measured CIE
L, a, b colours for display.
"""

from __future__ import annotations

from typing import Final

import numpy as np

__all__ = [
    "FORCE", "INK", "PLATE", "TURNING", "VELOCITY", "Colour", "class_colour", "lab_to_srgb",
    "part_colour",
]  # fmt: skip

Colour = tuple[int, int, int]

INK: Final[Colour] = (34, 34, 34)
"""Colour of outlines and text."""

PLATE: Final[Colour] = (217, 217, 204)

FORCE: Final[Colour] = (79, 99, 111)
"""Arrows of forces."""

VELOCITY: Final[Colour] = (125, 79, 158)
"""Arrows of velocities."""

TURNING: Final[tuple[Colour, Colour]] = ((224, 130, 20), (31, 119, 180))
"""Colours of counter-clockwise and clockwise rotations."""

_FACES: Final = {"black": (26, 26, 26), "grey": (168, 168, 168)}

_CLASSES: Final = {"black": (201, 54, 76), "grey": (31, 119, 180)}

WHITE_XYZ: Final = np.array([0.95047, 1.0, 1.08883])
"""X, Y, Z of the white point D65."""

RGB_OF_XYZ: Final = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.969266, 1.8760108, 0.041556],
     [0.0556434, -0.2040259, 1.0572252]]
)  # fmt: skip
"""Matrix from X, Y, Z to linear red, green, blue of sRGB."""

_OTHERS: Final = ((224, 130, 20), (46, 125, 74), (180, 70, 150), (130, 100, 20))


def part_colour(label: str) -> Colour:
    """Return the fill colour of parts of a class: black or grey for the classes `black` and `grey`,
    otherwise `class_colour`."""
    return _FACES.get(label, class_colour(label))


def class_colour(label: str) -> Colour:
    """Return the colour of a class. The colour is used for the trails, targets and names of the
    class's parts."""
    return _CLASSES.get(label) or _OTHERS[sum(label.encode()) % len(_OTHERS)]


def lab_to_srgb(lab: np.ndarray) -> np.ndarray:
    """Convert CIE L, a, b (..., 3) under D65 to sRGB (..., 3), 0 to 255. Colours outside the sRGB
    gamut are clipped."""
    lab = np.asarray(lab, dtype=float)
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], axis=-1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * WHITE_XYZ
    linear = np.clip(xyz @ RGB_OF_XYZ.T, 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
