"""Variation of friction between parts and over the plate.

Friction varies from part to part. Friction also varies over the plate, as a smooth field that moves
with the plate.

The field is evaluated only once per cycle at the position of each part, although the plate moves by
up to 1 cm under the part. To measure this error, the field was also evaluated 200 times per cycle,
in 34 cycles of each of two scenarios with a variation of 10 %. After a cycle, the positions differ
by 0.02 mm in sort_4 and by 0.08 mm in sort_10 (maximum over the parts, median over the cycles). The
largest difference in any cycle is 0.2 mm. In random cycles that use the whole stroke, it is 0.3 mm.
An error of the friction coefficient mu of 1 to 3 % has the same effect. For comparison, the field
itself displaces the most affected part by 0.1 to 0.2 mm per cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from plate_core.rig import to_plate

from .disturbances import Disturbances

WAVELENGTH = 0.1
"""Wavelength of the variation of friction over the plate [m]. The length of the plate is a few
wavelengths."""

WAVES = 32
"""Number of plane waves whose sum is the field. With this number, the field has nearly the same
statistics in all directions and at all places."""


@dataclass(frozen=True)
class FrictionField:
    """Friction of the parts and of the plate's surface in a run.

    Attributes
    ----------
    unit : (M,)
        Relative deviation of each part's friction from the nominal friction, divided by `spread`.
        The value is from -1 to 1.
    spread : float
        Maximum relative deviation of friction between parts.
    patches : float
        Maximum relative deviation of friction between places of the plate.
    wave : (K, 2)
        Wave vectors of the field [rad/m], in the plate's frame.
    phase : (K,)
        Phases of the waves [rad].
    """

    unit: np.ndarray
    spread: float
    patches: float
    wave: np.ndarray
    phase: np.ndarray

    @classmethod
    def draw(
        cls, disturbances: Disturbances, count: int, rng: np.random.Generator
    ) -> FrictionField:
        """Generate a random field of the plate and random friction of `count` parts. The random
        numbers do not depend on `friction_spread` and `friction_patches`."""
        unit = rng.uniform(-1, 1, count)
        direction, phase = rng.uniform(0, 2 * pi, (2, WAVES))
        wave = 2 * pi / WAVELENGTH * np.column_stack([np.cos(direction), np.sin(direction)])
        return cls(unit, disturbances.friction_spread, disturbances.friction_patches, wave, phase)

    @property
    def part(self) -> np.ndarray:
        """Friction of each part (M,), divided by the nominal friction. The field of the plate is
        not included."""
        return 1 + self.spread * self.unit

    def friction(
        self, mu: float | np.ndarray, position: np.ndarray, pose: np.ndarray
    ) -> np.ndarray:
        """Return the friction coefficients (M,) of parts.

        Let u be the deviation of a part (`unit`), and p its place in the frame of the plate. Let
        k_j be the K wave vectors, and f_j the phases of the waves. The friction coefficient is

            mu (1 + spread u) (1 + share erf(h / sqrt(2))), h = sqrt(2/K) sum_j cos(k_j . p + f_j).

        Parameters
        ----------
        mu : float or (M,)
            Nominal friction coefficient: one number for all parts, or one number for each part.
        position : (M, 2)
            Positions of the parts [m, plate_home].
        pose : (3,)
            Pose of the plate [m, m, rad].
        """
        if self.patches == 0:
            return np.asarray(mu * self.part)
        # SciPy is imported here, because the import takes 0.2 s and few simulations need it.
        from scipy.special import erf

        place = to_plate(pose, position)
        # `height` is a sum of many waves. Therefore its distribution is approximately normal, with
        # variance 1. The function erf converts `height` to a value that is uniformly distributed
        # from -1 to 1.
        height = np.sqrt(2 / len(self.phase)) * np.cos(place @ self.wave.T + self.phase).sum(1)
        return np.asarray(mu * self.part * (1 + self.patches * erf(height / np.sqrt(2))))
