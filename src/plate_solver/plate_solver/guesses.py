"""A table of first guesses, as in section 3.2.3 and figure 13 of the paper.

Random motions are piped through the force map at random places; a k-d tree over place and force
finds the motions that did something like what is asked now.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from plate_core import Rig

from .force_map import mean_force
from .harmonics import Harmonics
from .solution import Bounds

SIZE = 10_000
"""Entries: about 0.3 s to make. More do not make better guesses for several parts."""


class GuessTable:
    """Motions by (place, force).

    Parameters
    ----------
    rig : Rig
        Plate size and limits.
    family : Harmonics
        Motions to draw from.
    seed : int
        Seed of the table: the same seed makes the same table.
    """

    def __init__(self, rig: Rig, family: Harmonics, seed: int = 0, size: int = SIZE) -> None:
        rng = np.random.default_rng(seed)
        bounds = Bounds.of(rig)
        coefficients = rng.normal(size=(size, family.size, 3))
        coefficients[:, :, 2] /= bounds.arm_m
        position = rng.uniform(-rig.plate.half, rig.plate.half, (size, 2))
        still = np.zeros((1, 2))
        force = np.array(
            [
                mean_force(position[i : i + 1], still, family.twist @ coefficients[i])[0]
                for i in range(size)
            ]
        )
        self._coefficients = coefficients
        self._scale = np.concatenate([rig.plate.half, np.full(2, max(float(force.std()), 1e-12))])
        self._tree = cKDTree(np.hstack([position, force]) / self._scale)

    def nearest(self, position: np.ndarray, force: np.ndarray, count: int = 1) -> list[np.ndarray]:
        """Return coefficients (h, 3) for the parts' mean place and mean force, best first.

        Parameters
        ----------
        position, force : (M, 2)
            [m] in plate_home, [mu m g].
        """
        query = np.concatenate([position.mean(axis=0), force.mean(axis=0)]) / self._scale
        _, index = self._tree.query(query, k=list(range(1, count + 1)))
        return [self._coefficients[i] for i in index]
