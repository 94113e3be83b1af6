"""Variation of friction between parts and over the plate.

Friction varies from part to part. It also varies over the plate, as a smooth field that is fixed to
the plate. The field is evaluated once per cycle at the position of each part, although the plate
moves by up to 1 cm under the part. This was compared with 200 evaluations per cycle in 34 cycles of
each of two scenarios with a variation of 10 %. After a cycle, the positions differ by 0.02 mm in
sort_4 and by 0.08 mm in sort_10 (maximum over the parts, median over the cycles). The largest
difference in any cycle is 0.2 mm, and 0.3 mm in random cycles that use the whole stroke. An error
of mu of 1 to 3 % has the same effect. For comparison: the field displaces the most affected part by
0.1 to 0.2 mm per cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from plate_core.rig import to_plate

from .disturbances import Disturbances

WAVELENGTH = 0.1
"""Wavelength of the variation of friction over the plate [m]. The plate is a few wavelengths
long."""

WAVES = 32
"""Number of waves in the field. With this number, the field is nearly isotropic and homogeneous."""


@dataclass(frozen=True)
class FrictionField:
    """Friction of the parts and of the plate's surface in a run.

    Attributes
    ----------
    unit : (M,)
        Relative deviation of each part's friction divided by `spread`, -1 to 1.
    spread : float
        Maximum relative deviation of friction between parts.
    share : float
        Maximum relative deviation of friction over the plate.
    wave : (K, 2)
        Wave vectors of the field [rad/m], in the plate's frame.
    phase : (K,)
        Phases of the waves [rad].
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
        """Draw the field of the plate and the friction of `count` parts. The random numbers do not
        depend on `friction_spread` and `friction_patches`."""
        unit = rng.uniform(-1, 1, count)
        direction, phase = rng.uniform(0, 2 * pi, (2, WAVES))
        wave = 2 * pi / WAVELENGTH * np.column_stack([np.cos(direction), np.sin(direction)])
        return cls(unit, disturbances.friction_spread, disturbances.friction_patches, wave, phase)

    @property
    def part(self) -> np.ndarray:
        """Friction of each part (M,), divided by the nominal friction."""
        return 1 + self.spread * self.unit

    def friction(
        self, mu: float | np.ndarray, position: np.ndarray, pose: np.ndarray
    ) -> np.ndarray:
        """Return the friction coefficients (M,) of parts.

        For a part with the deviation u at the place p on the plate, with K waves k_j and phases
        f_j, the friction coefficient is

            mu (1 + spread u) (1 + share erf(h / sqrt(2))), h = sqrt(2/K) sum_j cos(k_j . p + f_j).

        Parameters
        ----------
        mu : float or (M,)
            Nominal coefficient, of all parts or of each part.
        position : (M, 2)
            Parts [m], plate_home.
        pose : (3,)
            Pose of the plate [m, m, rad].
        """
        if self.share == 0:
            return np.asarray(mu * self.part)
        # SciPy is imported here, because the import takes 0.2 s and few simulations need it.
        from scipy.special import erf

        place = to_plate(pose, position)
        # `height` is a sum of many waves. Therefore its distribution is approximately normal, with
        # variance 1. The function erf converts `height` to a value that is uniformly distributed
        # from -1 to 1.
        height = np.sqrt(2 / len(self.phase)) * np.cos(place @ self.wave.T + self.phase).sum(1)
        return np.asarray(mu * self.part * (1 + self.share * erf(height / np.sqrt(2))))
