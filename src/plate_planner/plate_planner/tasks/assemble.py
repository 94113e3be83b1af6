"""Rules of an assembling task, in which parts fill a pattern of places. For each image, parts are
assigned to places of their class. The assignment minimises the sum of squared distances. The
assigned place is the target of the part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import Parts, Rig, Targets
from plate_core.tasks import AssembleTask

from .targets import GAP, assign, distance_weight
from .task import BAND, Assessment, Situation, TaskRules


@dataclass(frozen=True)
class Assembler(TaskRules):
    """Rules of an assembling task on one rig. The rules of this kind of task store no data between
    images."""

    task: AssembleTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Time for which all places must contain a part until the task is done [s]."""
        return self.task.hold_s

    @property
    def precise(self) -> bool:
        """True."""
        return True

    def assess(self, memory: None, now: Situation) -> tuple[None, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`."""
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
            outcome=f"every place has a part, maximum error {1e3 * worst:.1f} mm",
        )

    def distance(self, parts: Parts) -> np.ndarray:
        """Return the distance of each part from its assigned place (M,) [m]. The distance is NaN
        for a part without a place."""
        aim, placed = self._assign_places(parts)
        return np.where(placed, np.hypot(*(parts.position - aim).T), np.nan)

    def request(self, parts: Parts) -> Targets:
        """Return the targets of M parts. For a part without a place, the only target is to stay on
        the plate."""
        aim, placed = self._assign_places(parts)
        band, rows = BAND * self.task.tolerance_m, placed[:, None] & [True, True]
        weight = np.where(rows, distance_weight(aim - parts.position), 0.0)
        return Targets(aim - band, aim + band, weight, GAP * self.rig.parts.radius_m)

    def _assign_places(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Return the assigned place of each part (M, 2) [m], and whether the part has a place (M,).
        For a part without a place, the present position is returned instead."""
        position = np.array(self.task.place)
        row = assign(self.task.labels, position, parts)
        placed = row >= 0
        return np.where(placed[:, None], position[row], parts.position), placed
