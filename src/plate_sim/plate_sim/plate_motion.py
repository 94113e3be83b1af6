"""PlateMotion: what the plate really does during one cycle; it need not close."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PPoly

from plate_core import PlateCycle


@dataclass(frozen=True)
class PlateMotion:
    """Realised motion of the plate over one cycle, in plate_home: quintic pieces.

    Integrators take it wherever they take a `PlateCycle`, for one cycle: both have `period`,
    `times`, `coefficients`, `pose`, `twist` and `accel`.

    Attributes
    ----------
    times : (k + 1,)
        Times [s] of the pieces' ends, from 0 to the period.
    coefficients : (k, 6, 3)
        Powers of the time since a piece's start [m, m, rad].
    """

    times: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def of_cycle(cls, cycle: PlateCycle) -> PlateMotion:
        """Return a cycle done exactly as commanded."""
        return cls(cycle.times, cycle.coefficients)

    @property
    def period(self) -> float:
        """Length of the cycle [s]."""
        return float(self.times[-1])

    def pose(self, t: np.ndarray | float) -> np.ndarray:
        """Pose (n, 3) [m, m, rad] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 0)

    def twist(self, t: np.ndarray | float) -> np.ndarray:
        """Twist (n, 3) [m/s, m/s, rad/s] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 1)

    def accel(self, t: np.ndarray | float) -> np.ndarray:
        """Acceleration (n, 3) [m/s2, m/s2, rad/s2] at times t (n,) [s] in [0, period]."""
        return self._evaluate(t, 2)

    def _evaluate(self, t: np.ndarray | float, order: int) -> np.ndarray:
        return np.asarray(self._splines[order](np.clip(np.atleast_1d(t), 0, self.period)))

    @cached_property
    def _splines(self) -> tuple[PPoly, PPoly, PPoly]:
        pose = PPoly(self.coefficients.transpose(1, 0, 2)[::-1], self.times)
        return pose, pose.derivative(), pose.derivative(2)
