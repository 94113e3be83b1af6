"""The real world's dirt: what a rig has and a model leaves out. All of it off by default.

Friction varies over the plate as a smooth field fixed in it, and between parts. It is read once per
cycle, where each part then is, though the plate swings by up to 1 cm under it: the worst part of a
cycle so ends 0.02 mm (4 parts) to 0.08 mm (10 parts) from where it would if friction were read 200
times (medians of 34 cycles of sort_4 and sort_10, +-10 %), at most 0.2 mm, or 0.3 mm in random
cycles that use the whole stroke. As much comes from mu wrong by 1 to 3 %; the field itself moves
that part by 0.1 to 0.2 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import pi

import numpy as np
from scipy.special import erf

from plate_core import PlateError
from plate_core.rig import to_plate

from .ground import STATIC, TILT, Ground

WAVELENGTH = 0.1
"""Length [m] of the waves in which friction varies over the plate: a few of them along it."""

WAVES = 32
"""Waves in the field: enough that no direction and no place stands out."""

RANGES: dict[str, tuple[float, float]] = {
    "friction_spread": (0.0, 0.9),
    "friction_patches": (0.0, 0.9),
    "static_ratio": STATIC,
    "tilt_x": (-TILT, TILT),
    "tilt_y": (-TILT, TILT),
    "latency": (0.0, 1.0),
    "missed_images": (0.0, 0.95),
    "missed_parts": (0.0, 1.0),
    "false_parts": (0.0, 1.0),
}
"""Allowed values."""


@dataclass(frozen=True)
class Dirt:
    """How dirty the world is.

    Attributes
    ----------
    friction_spread : float
        Friction differs between parts by up to this share, evenly.
    friction_patches : float
        Friction differs over the plate by up to this share, evenly, in waves of `WAVELENGTH`.
    static_ratio : float
        Static over dynamic friction.
    tilt_x, tilt_y : float
        How far the plate leans [rad]: parts are pulled along +x and +y if positive.
    latency : float
        An image is this old [s] when it is delivered. Its stamp is the time of delivery, as a
        camera's driver gives it that does not know better.
    blur : bool
        Whether motion blurs images over the rig's exposure.
    missed_images : float
        Share of images that are never delivered.
    missed_parts : float
        Share of parts that an image does not show.
    false_parts : float
        False parts, over true ones, that an image shows: reflections and specks.

    Raises
    ------
    PlateError
        If a value is out of range.
    """

    friction_spread: float = 0.0
    friction_patches: float = 0.0
    static_ratio: float = 1.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    latency: float = 0.0
    blur: bool = True
    missed_images: float = 0.0
    missed_parts: float = 0.0
    false_parts: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise PlateError(f"{name} is {value!r}, allowed: {low:g} to {high:g}")
        if not isinstance(self.blur, bool):
            raise PlateError(f"blur is {self.blur!r}, allowed: true or false")
        self.ground  # the two tilts together, too  # noqa: B018

    @property
    def ground(self) -> Ground:
        """Return the plate that this dirt makes."""
        return Ground(self.static_ratio, (self.tilt_x, self.tilt_y))

    @property
    def told(self) -> str:
        """What differs from a clean world: `latency 0.05, tilt_x 0.01`; `none`."""
        unlike = [
            f"{f.name} {getattr(self, f.name)}"
            for f in fields(self)
            if getattr(self, f.name) != f.default
        ]
        return ", ".join(unlike) or "none"


CLEAN = Dirt()
"""A world without dirt."""


@dataclass(frozen=True)
class Surface:
    """Where friction is more and where less, drawn once for a run.

    Attributes
    ----------
    part : (M,)
        Friction of each part over the nominal one.
    share : float
        How far friction goes up and down over the plate.
    wave : (K, 2)
        Waves of the field [rad/m], in the plate's frame.
    phase : (K,)
        Their phases [rad].
    """

    part: np.ndarray
    share: float
    wave: np.ndarray
    phase: np.ndarray

    @classmethod
    def draw(cls, dirt: Dirt, count: int, rng: np.random.Generator) -> Surface:
        """Draw the friction of `count` parts and of the plate; the same numbers at any share."""
        spread = rng.uniform(-1, 1, count)
        direction, phase = rng.uniform(0, 2 * pi, (2, WAVES))
        wave = 2 * pi / WAVELENGTH * np.column_stack([np.cos(direction), np.sin(direction)])
        return cls(1 + dirt.friction_spread * spread, dirt.friction_patches, wave, phase)

    def friction(self, mu: float, position: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return the friction coefficients (M,) of parts.

        Parameters
        ----------
        mu : float
            Nominal coefficient.
        position : (M, 2)
            Parts [m], plate_home.
        pose : (3,)
            Of the plate [m, m, rad].
        """
        if self.share == 0:
            return np.asarray(mu * self.part)
        place = to_plate(pose, position)
        # A sum of many waves is normal, of variance 1: erf makes it even from -1 to 1.
        height = np.sqrt(2 / len(self.phase)) * np.cos(place @ self.wave.T + self.phase).sum(1)
        return np.asarray(mu * self.part * (1 + self.share * erf(height / np.sqrt(2))))
