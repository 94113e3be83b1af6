"""Progress of a task, which is computed once per image or cycle. It is published in task_status,
action feedback and diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .phase import Phase


@dataclass(frozen=True)
class Progress:
    """Progress of a task after one image.

    Attributes
    ----------
    phase : Phase
    text : str
        Description of the phase, with a text on the running task. At the end, it contains the time,
        the result or the reason, and a remedy.
    time_s : float
        Time from the start of the task until now or until its end [s].
    parts_total, parts_seen, parts_sorted : int
        `parts_total` is the larger of two numbers: the parts in the scenario, and the parts that
        the task counts. `parts_seen` is the number of parts on the plate in this image.
        `parts_sorted` is the number of parts at their goals.
    to_go_m : float
        Distance to the goal, summed over parts [m]. For a path-following task, it is the maximum
        remaining path length.
    rms_error_m : float
        Root mean square error [m]. For a path-following task, the errors are the distances of the
        parts from their references, in all images. For assembling and posing tasks, they are the
        distances from the targets in this image.
    max_error_m : float
        Maximum of the distances whose root mean square is `rms_error_m` [m].
    turn_error : float
        Maximum angle error in this image, for a posing task [rad].
    speed_scaling : float
        Speed of the references relative to full speed, for a path-following task [-].
    pace : float
        Mean of `speed_scaling` since the references began to move, for a path-following task [-].
    period_s : float
        Length of a cycle [s].
    image_age_s : float
        Assumed age of images at their stamps [s].
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
        """Whether the task has ended, with or without success."""
        return self.phase.is_end

    def values(self) -> dict[str, str]:
        """Return the values as texts for diagnostics."""
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
