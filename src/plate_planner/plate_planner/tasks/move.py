"""Rules of a moving task. Parts have individual targets, which may change while the task runs.

As in `pose`, each cycle minimises the sum of squared weighted distances to the targets. A part
without a target should stay at its home. The home of a part is its position at the start of the
task or at its first detection. When the remaining distances of the other parts become short, the
relative weight of a part without a target decreases. The part then moves aside for the other parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from plate_core import AngleTargets, Parts, Rig, Targets, part_class
from plate_core.rig import PartType
from plate_core.tasks import MoveTask

from ..estimation import rows_of
from .targets import GAP, distance_weight
from .task import BAND, Assessment, Situation, TaskRules

HOME = 2.0
"""Weight of a part without a target, divided by the weight of parts with a target [-]. With this
weight, the part stays at its home while the distances of the other parts are long."""

MAX_HOME_WEIGHT = 0.2
"""Maximum weight of a part without a target [-]. With this maximum, the part moves aside when the
distances of the other parts are short."""

HOME_BAND_M = 5e-3
"""A part without a target has no error while it is within this distance of its home [m]."""


@dataclass(frozen=True)
class MoveMemory:
    """Homes (x, y) [m, plate_home] of the parts. The home of a part is its position at the start of
    the task or at its first detection."""

    home: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class RemainingMotion:
    """Remaining motion of M parts.

    Attributes
    ----------
    requested : (M,) bool
        Whether each part has a target.
    aim : (M, 2)
        Target of each part, or the home of a part without a target [m, plate_home].
    distance : (M,)
        Distance of each part from `aim` [m].
    missing : (M,)
        Remaining rotation of each part [rad]. 0 if no angle is requested.
    turned : (M,) bool
        Whether an angle is requested for each part.
    """

    requested: np.ndarray
    aim: np.ndarray
    distance: np.ndarray
    missing: np.ndarray
    turned: np.ndarray


@dataclass(frozen=True)
class Mover(TaskRules):
    """Rules of a moving task on one rig."""

    task: MoveTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Time for which all parts must be at their targets until the task is done [s]."""
        return self.task.hold_s

    @property
    def endless(self) -> bool:
        """Whether the task runs until it is canceled."""
        return self.task.until_canceled

    @property
    def precise(self) -> bool:
        """True."""
        return True

    def assess(
        self, memory: MoveMemory | None, now: Situation
    ) -> tuple[MoveMemory | None, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`."""
        if not now.active:
            return memory, Assessment()
        parts, before = now.parts, {} if memory is None else memory.home
        places = zip(parts.ids, parts.position.tolist(), strict=True)
        memory = MoveMemory({name: before.get(name, (x, y)) for name, (x, y) in places})
        remaining = self.remaining(memory, parts)
        reached = remaining.requested & (remaining.distance <= self.task.tolerance_m)
        reached &= np.abs(remaining.missing) <= self.task.tolerance_rad
        reach = np.array([part.reach_m for part in self._part_types(parts)])
        distance = np.where(
            remaining.requested, remaining.distance + reach * np.abs(remaining.missing), 0.0
        )
        error, count = remaining.distance[remaining.requested], int(np.count_nonzero(reached))
        ids = [target.id for target in self.task.targets]
        to_go = float(np.sum(distance))
        text = f"{count} of {len(ids)} at their targets, {1e3 * to_go:.0f} mm to go"
        return memory, Assessment(
            request=self.request(parts, remaining),
            goal_met=count == len(ids),
            count=count,
            distance=distance,
            to_go_m=to_go,
            missing=tuple(name for name in ids if name not in parts.ids) or None,
            rms_error_m=float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
            max_error_m=float(np.max(error, initial=0.0)),
            turn_error=float(np.max(np.abs(remaining.missing), initial=0.0)),
            outcome=text,
            doing="; ".join([text, *self._obstruction_texts(parts, remaining, reached)]),
        )

    def remaining(self, memory: MoveMemory, parts: Parts) -> RemainingMotion:
        """Return the remaining motion of M parts."""
        row = rows_of(parts.ids, tuple(target.id for target in self.task.targets))
        aim = np.array([memory.home[name] for name in parts.ids]).reshape(-1, 2)
        missing, turned = np.zeros(len(parts)), np.zeros(len(parts), bool)
        for part, k in enumerate(row):
            if k < 0:
                continue
            target = self.task.targets[k]
            aim[part] = target.place
            if target.angle is not None:
                turned[part] = True
                period = 2 * np.pi / max(self._part_types(parts)[part].symmetry, 1)
                missing[part] = (target.angle - parts.angle[part] + period / 2) % period
                missing[part] -= period / 2
        return RemainingMotion(row >= 0, aim, np.hypot(*(aim - parts.position).T), missing, turned)

    def request(self, parts: Parts, remaining: RemainingMotion) -> Targets:
        """Return the targets of M parts for the request to the solver."""
        reach = np.array([part.reach_m for part in self._part_types(parts)])
        left = np.maximum(remaining.distance, reach * np.abs(remaining.missing))
        left = np.where(remaining.requested, left, 0.0)
        counts = distance_weight(np.column_stack([left, 0 * left]))
        weight = np.where(remaining.requested, counts, min(HOME * counts, MAX_HOME_WEIGHT))
        band = np.where(remaining.requested, BAND * self.task.tolerance_m, HOME_BAND_M)[:, None]
        angles = None
        if np.any(remaining.turned):
            goal, slack = parts.angle + remaining.missing, BAND * self.task.tolerance_rad
            angles = AngleTargets(goal - slack, goal + slack, counts * reach * remaining.turned)
        gap = GAP * self.rig.parts.radius_m
        return Targets(
            remaining.aim - band, remaining.aim + band, weight[:, None] * np.ones(2), gap, angles
        )

    def _obstruction_texts(
        self, parts: Parts, remaining: RemainingMotion, reached: np.ndarray
    ) -> list[str]:
        """Return a text for each part that occupies the target of another part."""
        reach = np.array([part.reach_m for part in self._part_types(parts)])
        texts = []
        for k in np.flatnonzero(remaining.requested & ~reached):
            distance = np.hypot(*(parts.position - remaining.aim[k]).T)
            on = distance < reach + reach[k]
            on[k] = False
            name = parts.ids[k]
            texts += [f"{parts.ids[j]} is on the target of {name}" for j in np.flatnonzero(on)]
        return texts

    def _part_types(self, parts: Parts) -> list[PartType]:
        return [self.rig.part_type(part_class(name)) for name in parts.ids]
