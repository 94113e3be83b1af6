"""Converts an action of the kind `motion` to a motion of the plate. The action contains
coefficients of sinusoids, and the motion is within the limits of the rig."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle, Rig
from plate_core.motion import control_points
from plate_solver import EQUAL_WEIGHT, Limits, limit_uses
from plate_solver.sinusoids import sinusoid_basis

HARMONICS = 4
"""Number of harmonics of each motion. The harmonics have 10, 20, 30 and 40 Hz. The motions start
and end at rest."""

PERIOD_S = 0.1
"""Period of each motion [s]."""

CYCLE_USE = 0.999
"""Maximum fraction of the rig's limits that a motion may use. The fraction is computed from upper
bounds of the motion's peaks."""


class Motions:
    """Converts actions to motions that begin and end at rest (equation (13) of the paper). The
    velocities along x, y and theta are weighted sums of the same 6 functions of time.

    Attributes
    ----------
    size : int
        Number of values in an action.
    basis : SinusoidBasis
        Functions of time.
    scale : (6, 3)
        Coefficients of the functions of time if all values of an action are 1 [m/s, rad/s].
    """

    def __init__(self, rig: Rig) -> None:
        self.basis = sinusoid_basis(HARMONICS, PERIOD_S, True)
        self._limits = Limits.of(rig, 1.0)
        spline = self.basis.spline.reshape(len(self.basis.times) - 1, 6, -1)
        self._bounds = [control_points(self.basis.times, spline, order, 1) for order in range(3)]
        self.size = 3 * self.basis.size
        self.scale = np.ones((self.basis.size, 3))
        alone = self._use(np.eye(self.size).reshape(self.size, -1, 3))
        self.scale = CYCLE_USE / alone.reshape(-1, 3)

    def cycle(self, action: np.ndarray) -> tuple[PlateCycle, float]:
        """Convert an action (size,) to a motion. Return the motion, and the fraction of the rig's
        limits that it uses."""
        (cycle,), used = self.cycles(action[None])
        return cycle, float(used[0])

    def cycles(self, actions: np.ndarray) -> tuple[list[PlateCycle], np.ndarray]:
        """Convert N actions to motions. Return the motions, and the fraction of the rig's limits
        that each motion uses (N,), at most 1.

        Parameters
        ----------
        actions : (N, size)
            Values from -1 to 1. For each function of time, an action contains three values, for x,
            y and theta. If one value is 1 and all others are 0, the motion just reaches a limit. If
            the motion for several values exceeds a limit, all values of the action are scaled down.
        """
        coefficients = self.scale * actions.reshape(len(actions), -1, 3)
        used = self._use(coefficients)
        # The utilisation of the limits is not exactly proportional to the coefficients, because
        # rotations have a quadratic effect. Therefore the scaling is repeated. Usually one
        # repetition is sufficient.
        while (beyond := used > CYCLE_USE).any():
            coefficients[beyond] *= (CYCLE_USE**2 / used[beyond])[:, None, None]
            used[beyond] = self._use(coefficients[beyond])
        return self.basis.cycles(coefficients), used

    def _use(self, coefficients: np.ndarray) -> np.ndarray:
        """Return the fractions of the rig's limits (N,) that N motions with the coefficients (N, h,
        3) use. Each fraction is an upper bound over all limits."""
        pose, twist, accel = (bound @ coefficients for bound in self._bounds)
        return limit_uses(pose, twist, accel, EQUAL_WEIGHT, self._limits, False)
