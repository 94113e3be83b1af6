"""Clocks of the driver, as functions that do not depend on ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Clocks"]


@dataclass(frozen=True)
class Clocks:
    """Clocks of the driver.

    Attributes
    ----------
    steady_s : callable
        Function that returns the time on the steady clock [s].
    stamp_ns : callable
        Function that returns the time on the clock that stamps images [ns]. This clock may be
        simulated.
    simulated : callable
        Function that returns whether simulated time is used. Simulated time is never used with real
        motors, because the motors heat up in real time.
    """

    steady_s: Callable[[], float]
    stamp_ns: Callable[[], int]
    simulated: Callable[[], bool]

    def playback_s(self) -> float:
        """Return the time used for playback and for the motors' temperature [s]."""
        return 1e-9 * self.stamp_ns() if self.simulated() else self.steady_s()
