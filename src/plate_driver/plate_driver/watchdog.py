"""Watchdog: tells when plate cycles have ceased to come. The motors rest by themselves then."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Watchdog:
    """Counts down from the last table sent; time is an argument, so it has no clock of its own.

    Attributes
    ----------
    fed_at : float or None
        When the last table was sent, on a clock that never runs back [s]; None: the plate rests.
    hold_s : float
        How long the plate goes on without a new one [s].
    """

    fed_at: float | None = None
    hold_s: float = 0.0

    def fed(self, now: float, hold_s: float) -> Watchdog:
        """Return the watchdog after a table was sent at `now` [s] that is played for `hold_s`."""
        return Watchdog(now, hold_s)

    def rested(self) -> Watchdog:
        """Return the watchdog of a plate at rest."""
        return replace(self, fed_at=None)

    def tripped(self, now: float) -> bool:
        """Tell whether what was sent last is over."""
        return self.fed_at is not None and now - self.fed_at > self.hold_s
