"""How warm the motors are: I2t, with the force in place of the current."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Rig

AMBIENT_C = 25.0
"""Taken for the room's temperature [deg C]: what counts is the rise."""


@dataclass(frozen=True)
class ThermalState:
    """Windings' rise over that at the continuous force: tau w' = (f/f_c)^2 - w, w < 1 allowed.

    Attributes
    ----------
    rise : (4,)
        w at time `at` [-].
    load : (4,)
        Mean square force of the table that is played, over that of the continuous force [-].
    at : float
        [s].
    """

    rise: np.ndarray = field(default_factory=lambda: np.zeros(4))
    load: np.ndarray = field(default_factory=lambda: np.zeros(4))
    at: float = 0.0

    def at_time(self, rig: Rig, now: float) -> ThermalState:
        """Return the state at `now` [s]; a clock that was put back has only just begun."""
        decay = np.exp(-max(0.0, now - self.at) / rig.limits.thermal_time_s)
        return replace(self, rise=self.load + (self.rise - self.load) * decay, at=now)

    def under(self, load: np.ndarray) -> ThermalState:
        """Return the state from now on, under another load (4,)."""
        return replace(self, load=load)

    def allowed_load(self, rig: Rig, duration: float) -> np.ndarray:
        """Load (4,) that may last for a time [s] from now on, at least 1."""
        decay = np.exp(-duration / rig.limits.thermal_time_s)
        return np.asarray(np.maximum(1.0, (1 - self.rise * decay) / (1 - decay)))

    def celsius(self, rig: Rig) -> float:
        """Temperature of the warmest winding [deg C], as far as this model goes."""
        return AMBIENT_C + rig.limits.heat_rise_k * float(np.max(self.rise))
