"""A library of rotations: unit twists about many centres on and around the plate.

The average force on a part at rest is a mean of unit vectors, one for each twist the plate goes
through, whatever its speed. So the library is all there is to know of what a plate can do, and any
motion's forces are a mean of its columns (equations (5), (9)); what twists it leaves out lie near
ones that it has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .centres import curl_matrix, grid, rotation_matrix, unit_twists

COLUMNS, ROWS = 30, 16
"""Centres along and across the plate. Twice as many in each direction gain 6 % of force."""

REACH = (1.1, 1.2)
"""Half sides of the grid of centres, in half sides of the plate: from farther away, and between
here and there, rotations differ little from each other and from translations."""

TRANSLATIONS = 8
"""Directions of translation."""


@dataclass(frozen=True)
class Library:
    """Rotations and translations, each of which may be run either way.

    Attributes
    ----------
    centre : (C, 2)
        Centres of rotation [m], plate_home.
    direction : (D, 2)
        Unit vectors of the translations.
    twist : (C + D, 3)
        Unit twists: the plate's fastest corner moves at 1 m/s.
    """

    centre: np.ndarray
    direction: np.ndarray
    twist: np.ndarray

    @classmethod
    def about(cls, centre: np.ndarray, half: np.ndarray, translations: int = 0) -> Library:
        """Build from centres (C, 2) and evenly spread directions; `half` (2,): half sides [m]."""
        angle = np.pi * np.arange(translations) / max(translations, 1)
        direction = np.column_stack([np.cos(angle), np.sin(angle)])
        shifts = np.column_stack([direction, np.zeros(translations)])
        return cls(centre, direction, np.vstack([unit_twists(centre, half), shifts]))

    @classmethod
    def around(cls, half: np.ndarray, columns: int = COLUMNS, rows: int = ROWS) -> Library:
        """Build from a grid of centres that covers the plate and a little more."""
        centre = grid(np.multiply(REACH, half), columns, rows)
        return cls.about(centre, half, TRANSLATIONS)

    def forces(self, position: np.ndarray) -> np.ndarray:
        """Return unit forces (2 M, C + D) on parts at rest: x of all, then y of all."""
        shifts = np.repeat(self.direction.T, len(position), axis=0)
        return np.hstack([rotation_matrix(position, self.centre), shifts])

    def curls(self, position: np.ndarray) -> np.ndarray:
        """Return curls (M, C + D) [1/m], equation (12)."""
        none = np.zeros((len(position), len(self.direction)))
        return np.hstack([curl_matrix(position, self.centre), none])

    def clearance(self, position: np.ndarray) -> np.ndarray:
        """Return how far (C + D,) [m] each centre is from the nearest part; shifts have none."""
        arm = position[:, None] - self.centre
        nearest = np.hypot(arm[..., 0], arm[..., 1]).min(axis=0)
        return np.concatenate([nearest, np.full(len(self.direction), np.inf)])
