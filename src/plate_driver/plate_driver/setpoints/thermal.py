"""Thermal model of the motors: a first-order I2t model (squared current over time), with the force
in place of the current. The input is the mean square force of each table. The outputs are the
temperature rise and the load that the motors can still carry."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Rig

AMBIENT_C = 25.0
"""Assumed ambient temperature [deg C]. This value is used only for display, because the limits
depend only on the temperature rise."""


@dataclass(frozen=True)
class ThermalState:
    """Temperature rise w of the windings, as a fraction of the rise at the continuous force.

    The model is tau w' = (f/f_c)^2 - w, with the thermal time constant tau, the force f and the
    continuous force f_c. Allowed: w < 1.

    Attributes
    ----------
    rise : (4,)
        w at time `at` [-].
    load : (4,)
        Mean square force of the current table divided by the square of the continuous force [-].
    at : float
        Time of `rise` [s].
    """

    rise: np.ndarray = field(default_factory=lambda: np.zeros(4))
    load: np.ndarray = field(default_factory=lambda: np.zeros(4))
    at: float = 0.0

    def at_time(self, rig: Rig, now: float) -> ThermalState:
        """Return the state at `now` [s]. If the clock was set back, the state does not change."""
        decay = np.exp(-max(0.0, now - self.at) / rig.limits.thermal_time_s)
        return replace(self, rise=self.load + (self.rise - self.load) * decay, at=now)

    def under(self, load: np.ndarray) -> ThermalState:
        """Return the state with another load (4,)."""
        return replace(self, load=load)

    def allowed_load(self, rig: Rig, duration: float) -> np.ndarray:
        """Return the load (4,) that is allowed for `duration` [s] from now on. The result is at
        least 1."""
        decay = np.exp(-duration / rig.limits.thermal_time_s)
        return np.asarray(np.maximum(1.0, (1 - self.rise * decay) / (1 - decay)))

    def celsius(self, rig: Rig) -> float:
        """Estimated temperature of the warmest winding [deg C]."""
        return AMBIENT_C + rig.limits.heat_rise_k * float(np.max(self.rise))
