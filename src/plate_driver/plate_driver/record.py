"""What the driver did, counted for the diagnostics."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .limits import Fit


@dataclass(frozen=True)
class Record:
    """Counts since the start; peaks and reasons since the last report.

    Attributes
    ----------
    cycles, refused, scaled, rests : int
        Plate cycles accepted, refused, accepted but scaled down, and times the watchdog brought
        the plate to rest.
    worst : float
        Greatest share of a limit that any cycle asked for.
    factor : float
        Smallest factor that a cycle was scaled with.
    late : float
        Longest that a cycle came after the last one's end [s].
    since : int
        Cycles accepted before this report.
    troubles : tuple of str
        What went wrong, each once.
    """

    cycles: int = 0
    refused: int = 0
    scaled: int = 0
    rests: int = 0
    worst: float = 0.0
    factor: float = 1.0
    late: float = 0.0
    since: int = 0
    troubles: tuple[str, ...] = ()

    def accepted(self, fit: Fit, late: float = 0.0) -> Record:
        """Count a cycle that was sent, so much after the last one's end [s]."""
        new = replace(
            self,
            cycles=self.cycles + 1,
            worst=max(self.worst, fit.asked.worst),
            factor=min(self.factor, fit.factor),
            late=max(self.late, late),
        )
        if fit.factor < 1:
            return replace(new, scaled=self.scaled + 1)._with("a cycle was scaled down")
        return new

    def refusal(self) -> Record:
        """Count a cycle that was not."""
        return replace(self, refused=self.refused + 1)._with("a cycle was refused")

    def rest(self) -> Record:
        """Count a stop because cycles ceased to come."""
        return replace(self, rests=self.rests + 1)._with("cycles ceased to come")

    def trouble(self, trouble: str) -> Record:
        """Note what a transport says."""
        return self._with(trouble)

    def reported(self) -> Record:
        """Begin the next report."""
        return replace(self, worst=0.0, factor=1.0, late=0.0, since=self.cycles, troubles=())

    def _with(self, trouble: str) -> Record:
        if trouble in self.troubles:
            return self
        return replace(self, troubles=(*self.troubles, trouble))

    def values(self, period_s: float) -> dict[str, str]:
        """Return the report of the last `period_s`, name to value."""
        return {
            "rate_hz": f"{(self.cycles - self.since) / period_s:.2f}",
            "late_ms": f"{self.late * 1e3:.1f}",
            "cycles": str(self.cycles),
            "refused": str(self.refused),
            "scaled": str(self.scaled),
            "rests": str(self.rests),
            "worst_limit_share": f"{self.worst:.4f}",
            "factor": f"{self.factor:.4f}",
        }
