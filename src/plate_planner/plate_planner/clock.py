"""The plate's period, from the stamps of successive images."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import median_low

PERIOD_RANGE_S = (0.005, 1.0)
"""Periods that a plate may have [s]: the design has 0.02 to 0.2, with room to either side."""

REMEMBERED = 3
"""Intervals remembered: the median of three is not deceived by one lost image."""


@dataclass(frozen=True)
class CycleClock:
    """Stamps seen so far.

    Attributes
    ----------
    stamp : float or None
        The last stamp [s].
    intervals : tuple of float
        The last plausible differences of successive stamps [s].
    period : float
        What the length of a cycle is taken to be [s].
    """

    stamp: float | None
    intervals: tuple[float, ...]
    period: float

    @classmethod
    def starting(cls, default_period: float) -> CycleClock:
        """Return a clock that has seen nothing yet."""
        return cls(None, (), default_period)

    def tick(self, t: float) -> CycleClock:
        """Take in the next stamp [s]; going back or a long gap leaves the period as it was."""
        step = None if self.stamp is None else t - self.stamp
        if step is None or not PERIOD_RANGE_S[0] <= step <= PERIOD_RANGE_S[1]:
            return replace(self, stamp=t)
        intervals = (*self.intervals, step)[-REMEMBERED:]
        return CycleClock(t, intervals, median_low(intervals))

    def went_back(self, t: float) -> bool:
        """Whether a stamp [s] is earlier than the last: the source was started again."""
        return self.stamp is not None and t < self.stamp
