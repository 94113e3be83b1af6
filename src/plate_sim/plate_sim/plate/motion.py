"""Actual motion of the plate during one cycle, described by quintic pieces. It can be
non-periodic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import CycleError, PlateCycle, Rig
from plate_core.motion import evaluate_pieces, plate_state, quintic_pieces

ROUNDING_S = 1e-12
"""Two times count as equal if they differ by at most this value [s]."""


@dataclass(frozen=True)
class PlateMotion:
    """Actual motion of the plate over one cycle in plate_home, described by quintic pieces.

    If only one cycle is simulated, integrators accept a `PlateMotion` in place of a `PlateCycle`.
    `PlateMotion` and `PlateCycle` both have the members `period`, `times`, `coefficients`, `pose`,
    `twist` and `accel`.

    Attributes
    ----------
    times : (k + 1,)
        Times [s] of the pieces' ends, from 0 to the period.
    coefficients : (k, 6, 3)
        Coefficients of the powers of the time since the start of a piece [m, m, rad].
    """

    times: np.ndarray
    coefficients: np.ndarray

    def __post_init__(self) -> None:
        # Make the arrays read-only, like the arrays of a cycle.
        times = np.array(self.times, dtype=float)
        times.setflags(write=False)
        object.__setattr__(self, "times", times)

    @classmethod
    def of_cycle(cls, cycle: PlateCycle) -> PlateMotion:
        """Return a motion in which the plate follows the commanded cycle exactly."""
        return cls(cycle.times, cycle.coefficients)

    @classmethod
    def of_motors(cls, rig: Rig, times: np.ndarray, motors: np.ndarray) -> PlateMotion:
        """Compute the motion of the plate from the motions of the four motors.

        Parameters
        ----------
        times : (k + 1,)
            Times [s], increasing from 0.
        motors : (k + 1, 3, 4)
            Travel [m], speed [m/s] and acceleration [m/s2] of the motors at these times. Between
            these times, the motion is a quintic polynomial.

        Raises
        ------
        CycleError
            If the motions of the four motors contradict each other, a value is not finite, or the
            times do not increase from 0.
        """
        times = np.asarray(times, dtype=float)
        if not (np.all(np.isfinite(motors)) and np.all(np.isfinite(times))):
            raise CycleError("motor motion: a value is not finite")
        if times[0] != 0 or np.any(np.diff(times) <= 0):
            raise CycleError("motor motion: times must start at 0 and increase")
        return cls(times, quintic_pieces(times, *plate_state(rig, *np.moveaxis(motors, 1, 0))))

    @classmethod
    def section(cls, motion: PlateCycle | PlateMotion, begin: float, end: float) -> PlateMotion:
        """Return the section of a motion from the time `begin` to the time `end` [s]. `begin` and
        `end` are within the motion."""
        times = motion.times
        # If a knot is equal to `begin` or `end` up to rounding errors, omit the knot.
        first = int(np.searchsorted(times, begin + ROUNDING_S, "right")) - 1
        last = int(np.searchsorted(times, end - ROUNDING_S, "left"))
        knots = np.concatenate([[begin], times[first + 1 : last], [end]])
        coefficients = np.array(motion.coefficients[first:last])
        # Shift the origin of the first piece's polynomial to `begin` by Horner's scheme.
        for k in range(5):
            for j in range(4, k - 1, -1):
                coefficients[0, j] += (begin - times[first]) * coefficients[0, j + 1]
        return cls(knots - begin, coefficients)

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
        inside = np.clip(np.atleast_1d(t), 0, self.period)
        return evaluate_pieces(self.times, self.coefficients, inside, order)
