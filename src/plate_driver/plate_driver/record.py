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
    troubles : tuple of str
        What went wrong, each once.
    """

    cycles: int = 0
    refused: int = 0
    scaled: int = 0
    rests: int = 0
    worst: float = 0.0
    factor: float = 1.0
    troubles: tuple[str, ...] = ()

    def accepted(self, fit: Fit) -> Record:
        """Count a cycle that was sent."""
        new = replace(
            self,
            cycles=self.cycles + 1,
            worst=max(self.worst, fit.asked.worst),
            factor=min(self.factor, fit.factor),
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
        return replace(self, worst=0.0, factor=1.0, troubles=())

    def _with(self, trouble: str) -> Record:
        if trouble in self.troubles:
            return self
        return replace(self, troubles=(*self.troubles, trouble))

    def values(self) -> dict[str, str]:
        """Return the report, name to value."""
        return {
            "cycles": str(self.cycles),
            "refused": str(self.refused),
            "scaled": str(self.scaled),
            "rests": str(self.rests),
            "worst_limit_share": f"{self.worst:.4f}",
            "factor": f"{self.factor:.4f}",
        }
