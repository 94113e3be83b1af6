"""Assemble: where each part is to go so that a pattern of places is filled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import Parts, Rig, Targets
from plate_core.tasks import AssembleTask

from .targets import GAP, assign, way_weight
from .task import Assessment, Situation, TaskRules

BAND = 0.3
"""Where a part may stay: a square of this half side round its place [tolerance]."""


@dataclass(frozen=True)
class Assembler(TaskRules):
    """The rules of assembling for one task on one rig."""

    task: AssembleTask
    rig: Rig

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
            request=self.request(now.parts),
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

    def request(self, parts: Parts) -> Targets:
        """Return the place of each part, as seen (M); one without is only kept on the plate."""
        aim, placed = self._aim(parts)
        band, rows = BAND * self.task.tolerance_m, placed[:, None] & [True, True]
        weight = np.where(rows, way_weight(aim - parts.position), 0.0)
        return Targets(aim - band, aim + band, weight, GAP * self.rig.parts.radius_m)

    def _aim(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Place (M, 2) [m] of each part, its own where it has none, and whether it has one (M,)."""
        place = np.array(self.task.place)
        row = assign(self.task.labels, place, parts)
        placed = row >= 0
        return np.where(placed[:, None], place[row], parts.position), placed
