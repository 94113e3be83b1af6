"""Assemble: which drift to ask of each part so that a pattern of places is filled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import AssembleTask

from .targets import OVER, approach_drift, assign, hold_back, pass_by, speed_scaling
from .task import Assessment, DriftRequest, Situation, TaskRules

BAND = 0.3
"""Where a part may stay: a square of this half side round its place [tolerance]."""


@dataclass(frozen=True)
class AssembleOptions:
    """Drift asked of the part with the longest way; up to `OVER` times this is welcome [m/s]."""

    drift_max: float = 0.024


@dataclass(frozen=True)
class Assembler(TaskRules):
    """The rules of assembling for one task on one rig."""

    task: AssembleTask
    rig: Rig
    options: AssembleOptions = field(default_factory=AssembleOptions)

    @property
    def hold_s(self) -> float:
        """Done when all parts have been in their places for this long [s]."""
        return self.task.hold_s

    def assess(self, memory: None, now: Situation) -> tuple[None, Assessment]:
        """Judge one image, and say what is wanted; nothing is remembered."""
        distance = self.distance(now.parts)
        error = distance[~np.isnan(distance)]
        worst = float(np.max(error, initial=0.0))
        count = int(np.sum(error <= self.task.tolerance_m))
        return None, Assessment(
            request=self.request(now.parts, now.period),
            goal_met=count == len(self.task.place),
            count=count,
            distance=np.nan_to_num(distance),
            to_go_m=float(np.sum(error)),
            rms_error_m=float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
            max_error_m=worst,
            outcome=f"every place has a part, the furthest {1e3 * worst:.1f} mm off",
        )

    def distance(self, parts: Parts) -> np.ndarray:
        """How far each part (M,) is from its place [m]; NaN for a part that has none."""
        aim, placed = self._aim(parts)
        return np.where(placed, np.hypot(*(parts.position - aim).T), np.nan)

    def request(self, parts: Parts, period: float) -> DriftRequest:
        """Return the drift wanted of each part.

        Parameters
        ----------
        parts : Parts
            Parts as seen, M of them; one without a place is only kept clear of the edges.
        period : float
            Length of a cycle [s]: the request acts one cycle after `parts` was seen.

        Returns
        -------
        DriftRequest
            Intervals (M, 2) [m/s, plate_home].
        """
        drift_max = self.options.drift_max
        aim, placed = self._aim(parts)
        position = parts.position + period * parts.velocity
        speed = drift_max * speed_scaling(self.distance(parts))
        wanted = approach_drift(
            position, aim, BAND * self.task.tolerance_m, speed, OVER * drift_max
        )
        free = ~placed[:, None]
        wanted = DriftRequest(
            np.where(free, -drift_max, wanted.low), np.where(free, drift_max, wanted.high)
        )
        wanted = pass_by(position, wanted, self.rig.parts.radius_m)
        return hold_back(position, aim, self.rig.plate.half, wanted)

    def _aim(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Place (M, 2) [m] of each part, its own where it has none, and whether it has one (M,)."""
        place = np.array(self.task.place)
        row = assign(self.task.labels, place, parts)
        placed = row >= 0
        return np.where(placed[:, None], place[row], parts.position), placed
