"""How a task is getting on: what progress and diagnostics show."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .phase import Phase


@dataclass(frozen=True)
class Progress:
    """What can be told about a task after one image.

    Attributes
    ----------
    phase : Phase
    text : str
        The phase, and what there is to tell while it runs; of an end the time, the result or the
        reason, and what would help.
    time_s : float
        Time since the task began, until now or its end [s].
    parts_total, parts_seen, parts_sorted : int
        Parts of the scenario, or more if more are sorted; parts on the plate in this image, parts
        that are where they belong.
    to_go_m : float
        Distance to the goal, summed over parts [m]; following: the longest way left.
    rms_error_m : float
        Following: distance of parts from their references, root mean square over parts and images;
        assembling and posing: of parts from their places in this image [m].
    max_error_m : float
        The greatest such distance [m].
    turn_error : float
        Posing: the greatest angle that is missing in this image [rad].
    speed_scaling : float
        Following: speed of the references, 1 is full speed [-].
    pace : float
        And on average since they began to move [-].
    period_s : float
        Length of a cycle [s].
    image_age_s : float
        How old images are taken to be at their stamps [s].
    """

    phase: Phase
    text: str
    time_s: float
    parts_total: int
    parts_seen: int
    parts_sorted: int
    to_go_m: float
    rms_error_m: float
    max_error_m: float
    turn_error: float
    speed_scaling: float
    pace: float
    period_s: float
    image_age_s: float

    @property
    def ended(self) -> bool:
        """Whether the task has come to an end, good or bad."""
        return self.phase.is_end

    def values(self) -> dict[str, str]:
        """Return the numbers as diagnostics show them."""
        return {
            "parts_sorted": str(self.parts_sorted),
            "parts_seen": str(self.parts_seen),
            "parts_total": str(self.parts_total),
            "time_s": f"{self.time_s:.3f}",
            "to_go_m": f"{self.to_go_m:.6f}",
            "rms_error_m": f"{self.rms_error_m:.6f}",
            "max_error_m": f"{self.max_error_m:.6f}",
            "turn_error_deg": f"{math.degrees(self.turn_error):.2f}",
            "speed_scaling": f"{self.speed_scaling:.3f}",
            "pace": f"{self.pace:.3f}",
            "period_s": f"{self.period_s:.4f}",
            "image_age_s": f"{self.image_age_s:.4f}",
        }
