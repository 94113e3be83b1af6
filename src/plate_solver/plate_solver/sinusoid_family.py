"""Sinusoidal motions as a family: scaled coefficients are the parameters."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from .harmonics import Harmonics
from .solution import Bounds


class SinusoidFamily:
    """`Harmonics` with limits, as a family for `steer`: theta is scaled by a length."""

    def __init__(self, basis: Harmonics, bounds: Bounds) -> None:
        self.basis = basis
        self._bounds = bounds
        self._scale = np.array([1.0, 1.0, 1 / bounds.arm_m])

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.basis.dt

    def coefficients(self, parameters: np.ndarray) -> np.ndarray:
        """Return coefficients (h, 3) of parameters (3 h,)."""
        return parameters.reshape(-1, 3) * self._scale

    def parameters(self, coefficients: np.ndarray) -> np.ndarray:
        """Return parameters (3 h,) of coefficients (h, 3)."""
        return (coefficients / self._scale).ravel()

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3)."""
        coefficients = self.coefficients(parameters)
        return self.basis.pose @ coefficients, self.basis.twist @ coefficients

    def pull_back(
        self, parameters: np.ndarray, by_twist: np.ndarray, by_pose: np.ndarray | None
    ) -> np.ndarray:
        """Return derivatives (R, 3 h) by the parameters."""
        rows = len(by_twist)
        jacobian = np.empty((rows, self.basis.size, 3))
        for axis in range(3):
            jacobian[:, :, axis] = by_twist[:, :, axis] @ self.basis.twist
            if by_pose is not None and axis < 2:
                jacobian[:, :, axis] += by_pose[:, :, axis] @ self.basis.pose
        return (jacobian * self._scale).reshape(rows, -1)

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Scale to the full amplitude that the limits allow."""
        return self.parameters(self.basis.saturated(self.coefficients(parameters), self._bounds))

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return no errors: limits are kept by scaling."""
        return np.zeros(0)

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return no derivatives."""
        return np.zeros((0, len(parameters)))

    def cycle(self, parameters: np.ndarray) -> PlateCycle:
        """Return the motion as a plate cycle."""
        return self.basis.cycle(self.coefficients(parameters))

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """Return random admissible parameters."""
        return self.parameters(self.basis.random(rng, self._bounds))
