"""Watchdog: plate cycles that stop coming must bring the plate to rest."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Watchdog:
    """Counts down from the last table sent; time is an argument, so it has no clock of its own.

    Attributes
    ----------
    fed_at : float or None
        When the last table was sent [s]; None while there is nothing to bring to rest.
    patience : float
        How long the plate may go on without a new one [s].
    """

    fed_at: float | None = None
    patience: float = 0.0

    def fed(self, now: float, period: float, hold_cycles: int) -> Watchdog:
        """Return the watchdog after a table of `period` [s] was sent at time `now` [s]."""
        return Watchdog(now, hold_cycles * period)

    def rested(self) -> Watchdog:
        """Return the watchdog after the rest table was sent."""
        return Watchdog()

    def synchronised(self, now: float) -> Watchdog:
        """Return the watchdog for a clock that was set: started, or put back, since the feeding."""
        if self.fed_at is not None and (self.fed_at == 0 or now < self.fed_at):
            return replace(self, fed_at=now)
        return self

    def tripped(self, now: float) -> bool:
        """Tell whether the plate must be brought to rest."""
        return self.fed_at is not None and now - self.fed_at > self.patience
