"""Sinusoidal motions that press against the rig's limits: for steering on the cycle map.

On the cycle map amplitude matters, and scaling a motion down to its limits would undo what a step
has gained. So a motion may exceed the limits a little on the way, each excess is an error of its
own, and only what is left in the end is scaled away.
"""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .. import _kernels
from ..limits import Limits
from .basis import SinusoidBasis, SinusoidFamily

EXCESS_M: float = _kernels.EXCESS_M
"""An excess of a whole limit counts as a displacement error of so much [m]."""

AIM: float = _kernels.AIM
"""Fraction of a limit above which there is excess: what is found ends a little higher."""


class LimitedSinusoids(SinusoidFamily):
    """`SinusoidFamily` that may exceed limits by a factor of `most`, at a price.

    Parameters
    ----------
    basis : SinusoidBasis
    limits : Limits
    most : float
        1 keeps the limits.
    plate : (3, 3), optional
        State in which the plate begins, as `PlateCycle.state`; at rest if left out.
    """

    def __init__(
        self, basis: SinusoidBasis, limits: Limits, most: float, plate: np.ndarray | None = None
    ) -> None:
        super().__init__(basis, limits)
        self._most = most
        self.plate = np.zeros((3, 3)) if plate is None else plate

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of steps (n,) [s], and these."""
        pose, twist, dt = super().samples(parameters)
        settling = self.basis.settling
        return pose + settling[0] @ self.plate, twist + settling[1] @ self.plate, dt

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle."""
        return self.basis.cycle(self.coefficients(parameters), self.plate)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale down what exceeds the limits by more than `most`."""
        return parameters * min(1.0, self._most / max(self.use(parameters), 1e-300))

    def nearest(self, twist: np.ndarray) -> np.ndarray:
        """Return the parameters whose twist is nearest to samples (n, 3), by least squares."""
        own = self.basis.inverse @ (twist - self.basis.settling[1] @ self.plate)
        return (own / self._scale).ravel()
