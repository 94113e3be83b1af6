"""Intervals of drift that tasks request, and the mean forces that produce these drifts.

A drift is the mean velocity of a part over a cycle. The inputs are the parts with their present
drifts. The outputs are intervals of drifts, and intervals of mean forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import Parts, Rig, Targets, part_class

APPROACH = 1.5
"""Requested drift towards a target, divided by the distance from the target [1/s]."""

MAX_DRIFT = 0.05
"""Maximum drift towards a target [m/s]. A plate cannot move many parts faster at the same time."""


@dataclass(frozen=True)
class DriftInterval:
    """Requested drift of M parts. Any drift from `low` (M, 2) to `high` (M, 2) [m/s, plate_home] is
    accepted."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def towards(cls, position: np.ndarray, targets: Targets) -> DriftInterval:
        """Return the requested drift towards the targets, for parts at the positions `position` (M,
        2) [m].

        v = APPROACH (target - position), limited to `MAX_DRIFT`. If a target does not restrict an
        axis, any drift up to `MAX_DRIFT` along this axis is accepted.
        """
        low, high = (
            np.where(
                targets.weight > 0,
                np.clip(APPROACH * (end - position), -MAX_DRIFT, MAX_DRIFT),
                free,
            )
            for end, free in ((targets.low, -MAX_DRIFT), (targets.high, MAX_DRIFT))
        )
        return cls(low, high)

    @property
    def centre(self) -> np.ndarray:
        """Mean of `low` and `high` (M, 2) [m/s]."""
        return (self.low + self.high) / 2

    def less(self, bias: np.ndarray) -> DriftInterval:
        """Return the interval, from which the drift bias `bias` (M, 2) [m/s] is subtracted."""
        return DriftInterval(self.low - bias, self.high - bias)

    def force(self, parts: Parts, rig: Rig, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean force over one cycle that changes the present drift v of each part to the
        requested drift.

        The force is F = m (v_requested - v)/T, limited to mu m g. The solver computes the resulting
        drift v + F T/m with the same v. Therefore, an error of the measured v has no effect, unless
        F is limited.

        Parameters
        ----------
        parts : Parts
            M parts with their present drifts v.
        rig : Rig
        period : float
            Length of a cycle, T [s].

        Returns
        -------
        force, tolerance : (M, 2)
            Middle and half width of the interval of forces [N].
        """
        types = [rig.part_type(part_class(name)) for name in parts.ids]
        gain = np.array([[part.mass_kg] for part in types]) / period
        bound = gain * period * np.array([[part.mu] for part in types]) * rig.friction.gravity
        return (
            np.clip(gain * (self.centre - parts.velocity), -bound, bound),
            gain * (self.high - self.low) / 2,
        )
