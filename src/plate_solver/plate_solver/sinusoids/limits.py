"""Sinusoidal motions close to the limits of the rig, for the search on the cycle map.

On the cycle map, the displacement depends on the amplitude. If each step of the search were scaled
down to the limits, the step would bring no progress. Therefore motions may exceed the limits
slightly during the search. Each violation is an additional error, and the final motion is scaled
down to the limits.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from ..limits import Limits
from .basis import SinusoidBasis, SinusoidFamily


class LimitedSinusoids(SinusoidFamily):
    """Family of sinusoidal motions that may use up to `most` times the limits.

    Parameters
    ----------
    basis : SinusoidBasis
    limits : Limits
    most : float
        Largest permitted utilisation of any rig limit (1: exactly at the limit).
    plate : (3, 3), optional
        Initial state of the plate, as `PlateCycle.state`. Default: at rest.
    """

    def __init__(
        self, basis: SinusoidBasis, limits: Limits, max_use: float, plate: np.ndarray | None = None
    ) -> None:
        super().__init__(basis, limits)
        self._max_use = max_use
        self.plate = np.zeros((3, 3)) if plate is None else plate

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of the steps, and the step lengths (n,)
        [s]."""
        pose, twist, dt = super().samples(parameters)
        settling = self.basis.settling
        return pose + settling[0] @ self.plate, twist + settling[1] @ self.plate, dt

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle."""
        return self.basis.cycle(self.coefficients(parameters), self.plate)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale the parameters down if the utilisation of a rig limit exceeds `most`."""
        return parameters * min(1.0, self._max_use / max(self.use(parameters), 1e-300))

    def nearest(self, twist: np.ndarray) -> np.ndarray:
        """Return the parameters whose twists are closest to the sampled twists (n, 3), by least
        squares."""
        own = self.basis.inverse @ (twist - self.basis.settling[1] @ self.plate)
        return (own / self._scale).ravel()
