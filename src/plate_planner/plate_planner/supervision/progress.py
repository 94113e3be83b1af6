"""Progress of a task. The progress is computed once per image or cycle. The progress is published
in task_status, in action feedback and in diagnostics."""

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
        Text about the phase and the running task. When the task has ended, the text contains the
        duration, the result or the reason of the end, and a remedy.
    time_s : float
        Time from the start of the task until now, or until its end if it has ended [s].
    parts_total, parts_seen, parts_sorted : int
        `parts_total` is the number of parts in the scenario, or the number of parts that the task
        counts if this number is larger. `parts_seen` is the number of parts on the plate in this
        image. `parts_sorted` is the number of parts at their goals.
    to_go_m : float
        Distance to the goal, summed over the parts [m]. For a path-following task, the maximum
        remaining path length [m].
    rms_error_m : float
        Root mean square error [m]. For a path-following task, the errors are the distances of the
        parts from their references, in all images so far. For assembling and posing tasks, the
        errors are the distances of the parts from their targets, in this image.
    max_error_m : float
        Maximum of the errors whose root mean square is `rms_error_m` [m].
    turn_error : float
        Maximum error of a part's angle in this image, for a posing task [rad].
    speed_scaling : float
        Present speed of the references divided by the speed of their paths, for a path-following
        task [-].
    pace : float
        Mean of `speed_scaling` since the references began to move, for a path-following task [-].
    period_s : float
        Length of a cycle [s].
    image_age_s : float
        Assumed time from the exposure of an image to the time in its stamp [s].
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
        """Convert the values to texts for the diagnostics."""
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
