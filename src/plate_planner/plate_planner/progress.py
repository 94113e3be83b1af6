"""How a task is getting on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """What can be told about a task after one image.

    Attributes
    ----------
    phase : str
        idle, running, done or failed.
    text : str
        The phase, and the reason of a failure.
    time_s : float
        Time since the task began, until now or its end [s].
    parts_total, parts_seen, parts_sorted : int
        Parts of the scenario, parts on the plate in this image, parts beyond the goal line.
    rms_error_m : float
        Distance of parts from their references, root mean square over parts and images [m].
    max_error_m : float
        The greatest such distance [m].
    period_s : float
        Length of a cycle [s].
    """

    phase: str
    text: str
    time_s: float
    parts_total: int
    parts_seen: int
    parts_sorted: int
    rms_error_m: float
    max_error_m: float
    period_s: float

    def values(self) -> dict[str, str]:
        """Return the numbers as diagnostics show them."""
        return {
            "parts_sorted": str(self.parts_sorted),
            "parts_seen": str(self.parts_seen),
            "parts_total": str(self.parts_total),
            "time_s": f"{self.time_s:.3f}",
            "rms_error_m": f"{self.rms_error_m:.6f}",
            "max_error_m": f"{self.max_error_m:.6f}",
            "period_s": f"{self.period_s:.4f}",
        }
