"""Which plate cycle ran when: what the solver has sent, on the time of the images' stamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from plate_core import PlateCycle

HANDOVER_S = 4e-3
"""Time from a cycle's publication until the device has it [s]: two hops and the driver."""

SNAP = 0.25
"""An image at most this share of a cycle from its expected end was taken at its end."""

MEMORY_S = 1.5
"""How far back runs are kept [s]: longer than an image may be old, and a longest cycle."""


LEAST_PERIOD_S = 0.005
"""A cycle shorter than this is none that a driver would play [s]."""


@dataclass(frozen=True)
class PlateLog:
    """The plate's runs, oldest first.

    Attributes
    ----------
    runs : tuple of (begin [s], PlateCycle)
        Each ends where the next begins; before the first the plate rests.
    heard : tuple of (arrival [s], PlateCycle), or None
        The newest cycle sent that has not begun.
    """

    runs: tuple[tuple[float, PlateCycle], ...] = ()
    heard: tuple[float, PlateCycle] | None = None

    @property
    def known(self) -> bool:
        """Whether any cycle has run."""
        return bool(self.runs)

    @property
    def end(self) -> float:
        """When the last run ends [s]."""
        begin, cycle = self.runs[-1]
        return begin + cycle.period

    @property
    def period(self) -> float:
        """Length of the last run [s]."""
        return self.runs[-1][1].period

    def hear(self, cycle: PlateCycle, arrival: float) -> PlateLog:
        """Take in a cycle that was sent, and when [s, the time of the stamps]."""
        if cycle.period < LEAST_PERIOD_S:
            return self
        return replace(self, heard=(arrival, cycle))

    def advance(self, t: float) -> PlateLog:
        """Return the log at an image's stamp t [s]: a cycle begins there.

        At a cycle's end the newest one follows, if it was there in time, else the same again.
        """
        log = self
        if self.runs and t < self.runs[-1][0]:
            log = PlateLog()  # time began anew
        elif self.runs and t > self.end + MEMORY_S:
            log = PlateLog(heard=self.heard)  # nothing has been seen for long
        if not log.runs:
            return log._begin(t, None)
        while log.end <= t - SNAP * log.period:
            log = log._begin(log.end, log.runs[-1][1])
        if log.end <= t + SNAP * log.period:
            log = log._begin(t, log.runs[-1][1])
        kept = tuple(run for run in log.runs if run[0] + run[1].period > t - MEMORY_S)
        return replace(log, runs=kept)

    def _begin(self, t: float, same: PlateCycle | None) -> PlateLog:
        if self.heard is not None and self.heard[0] + HANDOVER_S <= t:
            return PlateLog((*self.runs, (t, self.heard[1])))
        return self if same is None else replace(self, runs=(*self.runs, (t, same)))

    def between(self, begin: float, end: float) -> Iterator[tuple[PlateCycle, float, float]]:
        """Yield the pieces of runs from `begin` to `end` [s]: cycle, and from when to when in it.

        Where nothing ran there is no piece.
        """
        for k, (start, cycle) in enumerate(self.runs):
            stop = self.runs[k + 1][0] if k + 1 < len(self.runs) else start + cycle.period
            a, b = max(begin, start), min(end, stop, start + cycle.period)
            if b > a:
                yield cycle, a - start, b - start
