"""Where friction is more and where less: between parts, and over the plate.

Friction varies over the plate as a smooth field fixed in it, and between parts. It is read once per
cycle, where each part then is, though the plate swings by up to 1 cm under it: the worst part of a
cycle so ends 0.02 mm (4 parts) to 0.08 mm (10 parts) from where it would if friction were read 200
times (medians of 34 cycles of sort_4 and sort_10, +-10 %), at most 0.2 mm, or 0.3 mm in random
cycles that use the whole stroke. As much comes from mu wrong by 1 to 3 %; the field itself moves
that part by 0.1 to 0.2 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.special import erf

from plate_core.rig import to_plate

from .disturbances import Disturbances

WAVELENGTH = 0.1
"""Length [m] of the waves in which friction varies over the plate: a few of them along it."""

WAVES = 32
"""Waves in the field: enough that no direction and no place stands out."""


@dataclass(frozen=True)
class FrictionField:
    """Where friction is more and where less, drawn once for a run.

    Attributes
    ----------
    unit : (M,)
        How much more friction each part has than the nominal one, from -1 to 1 times `spread`.
    spread : float
        How far friction goes up and down between parts.
    share : float
        How far friction goes up and down over the plate.
    wave : (K, 2)
        Waves of the field [rad/m], in the plate's frame.
    phase : (K,)
        Their phases [rad].
    """

    unit: np.ndarray
    spread: float
    share: float
    wave: np.ndarray
    phase: np.ndarray

    @classmethod
    def draw(
        cls, disturbances: Disturbances, count: int, rng: np.random.Generator
    ) -> FrictionField:
        """Draw the friction of `count` parts and of the plate; the same numbers at any share."""
        unit = rng.uniform(-1, 1, count)
        direction, phase = rng.uniform(0, 2 * pi, (2, WAVES))
        wave = 2 * pi / WAVELENGTH * np.column_stack([np.cos(direction), np.sin(direction)])
        return cls(unit, disturbances.friction_spread, disturbances.friction_patches, wave, phase)

    @property
    def part(self) -> np.ndarray:
        """Friction of each part over the nominal one (M,)."""
        return 1 + self.spread * self.unit

    def friction(
        self, mu: float | np.ndarray, position: np.ndarray, pose: np.ndarray
    ) -> np.ndarray:
        """Return the friction coefficients (M,) of parts.

        Parameters
        ----------
        mu : float or (M,)
            Nominal coefficient, of all parts or of each.
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
