"""Rules of a posing task, in which parts move to places and rotate to angles.

As in `assemble`, each cycle minimises the sum of squared weighted distances to the places. A
rotation counts as a distance, namely the arc length at the edge of the part. A part with a
rotational symmetry rotates to the nearest equivalent angle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import AngleTargets, Parts, Rig, Targets, part_class
from plate_core.tasks import Pose, PoseTask

from .targets import GAP, UNMATCHED, distance_weight, match_by_cost, matched_rows
from .task import BAND, Assessment, Situation, TaskRules

STAY = 1.0
"""Minimum weight of a part that must stay at its position [-]. For comparison, the distance by
which a part is too close to an edge has the weight 1."""


@dataclass(frozen=True)
class PoseMemory:
    """Assignment of parts to poses.

    Attributes
    ----------
    match : tuple of str
        Id of the part that is assigned to each pose.
    position : (P, 2)
        Position of each pose [m, plate_home]. NaN accepts any position.
    """

    match: tuple[str, ...] = ()
    position: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


@dataclass(frozen=True)
class Poser(TaskRules):
    """Rules of a posing task on one rig."""

    task: PoseTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Time for which all parts must be in their poses until the task is done [s]."""
        return self.task.hold_s

    @property
    def precise(self) -> bool:
        """Whether at least one part must be at a certain position."""
        return not self.task.anywhere or any(pose.place is not None for pose in self.task.poses)

    def assess(
        self, memory: PoseMemory | None, now: Situation
    ) -> tuple[PoseMemory | None, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`."""
        if not now.active:
            return memory, Assessment()
        parts = now.parts
        memory = self.begin(parts) if memory is None else memory
        error, angle = self.errors(memory, parts)
        reach = np.array([self._reach(part_class(name)) for name in parts.ids])
        distance = error + reach * np.abs(angle)
        max_angle = float(np.max(np.abs(angle), initial=0.0))
        count = self.count(memory, parts)
        return memory, Assessment(
            request=self.request(memory, parts),
            goal_met=count == len(self.task.poses),
            count=count,
            distance=distance,
            to_go_m=float(np.sum(distance)),
            problem=self.problem(memory, parts),
            rms_error_m=float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
            max_error_m=float(np.max(error, initial=0.0)),
            turn_error=max_angle,
            outcome=f"maximum error {1e3 * np.max(error, initial=0.0):.1f} mm and "
            f"{np.degrees(max_angle):.1f} degrees",
        )

    def begin(self, parts: Parts) -> PoseMemory:
        """Assign a part of the correct class to each pose. The assignment minimises the sum of the
        squared distances and the squared arc lengths."""
        poses = self.task.poses
        position = np.array([(np.nan, np.nan) if p.place is None else p.place for p in poses])
        offset = position[:, None] - parts.position
        arc = np.array(
            [self._reach(p.label) * self._remaining_rotation(p, parts.angle) for p in poses]
        )
        square = np.nan_to_num(np.sum(offset**2, axis=2)) + arc.reshape(len(poses), len(parts)) ** 2
        match = match_by_cost(tuple(pose.label for pose in poses), square, parts)
        for row in np.flatnonzero(np.isnan(position[:, 0])):
            if match[row] != UNMATCHED and not self.task.anywhere:
                position[row] = parts.position[parts.ids.index(match[row])]
        return PoseMemory(match, position)

    def errors(self, memory: PoseMemory, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Return two arrays (M,). The arrays contain the distance of each part from its place [m],
        and the remaining rotation of each part [rad]. Distance and rotation are 0 for a part
        without a pose."""
        distance, angle = np.zeros(len(parts)), np.zeros(len(parts))
        pose, part = matched_rows(memory.match, parts)
        to_pose = np.hypot(*(memory.position[pose] - parts.position[part]).T)
        distance[part] = np.nan_to_num(to_pose)
        for k, row in zip(pose, part, strict=True):
            angle[row] = self._remaining_rotation(self.task.poses[k], parts.angle[row])
        return distance, angle

    def count(self, memory: PoseMemory, parts: Parts) -> int:
        """Return the number of parts that have reached their poses."""
        distance, angle = self.errors(memory, parts)
        reached = distance <= self.task.tolerance_m
        reached &= np.abs(angle) <= self.task.tolerance_rad
        return int(np.count_nonzero(reached[matched_rows(memory.match, parts)[1]]))

    def problem(self, memory: PoseMemory, parts: Parts) -> str:
        """Return a text about the part that is farthest from the position at which it must stay.
        The text is empty if all such parts are within the tolerance."""
        distance, _ = self.errors(memory, parts)
        pose, part = matched_rows(memory.match, parts)
        stays = np.array([self.task.poses[row].place is None for row in pose], dtype=bool)
        if not np.any(stays):
            return ""
        worst = part[stays][np.argmax(distance[part[stays]])]
        far = float(distance[worst])
        if far <= self.task.tolerance_m:
            return ""
        return (
            f"{parts.ids[worst]} is {1e3 * far:.1f} mm from the place at which it must rotate, "
            f"allowed: {1e3 * self.task.tolerance_m:g} mm (tolerance_m); use fewer parts, a larger "
            "distance from the plate's ends, a larger tolerance, or anywhere: true"
        )

    def request(self, memory: PoseMemory, parts: Parts) -> Targets:
        """Return the targets of M parts for the request to the solver. For a part without a pose,
        the only target is to stay on the plate."""
        _, missing = self.errors(memory, parts)
        aim, weight = parts.position.copy(), np.zeros((len(parts), 2))
        turned = np.zeros(len(parts))
        pose, part = matched_rows(memory.match, parts)
        placed = np.isfinite(memory.position[pose, 0])
        aim[part[placed]] = memory.position[pose[placed]]
        reach = np.array([self._reach(self.task.poses[k].label) for k in pose])
        arcs = reach * missing[part]
        counts = distance_weight(
            np.vstack([aim - parts.position, np.column_stack([arcs, 0 * arcs])])
        )
        stays = np.array([self.task.poses[k].place is None for k in pose], dtype=bool)
        weight[part[placed]] = np.where(stays[placed], max(STAY, counts), counts)[:, None]
        turned[part] = counts * reach
        band, angle_band = BAND * self.task.tolerance_m, BAND * self.task.tolerance_rad
        goal = parts.angle + missing
        angles = AngleTargets(goal - angle_band, goal + angle_band, turned)
        gap = GAP * self.rig.parts.radius_m
        return Targets(aim - band, aim + band, weight, gap, angles)

    def _reach(self, label: str) -> float:
        """Return the reach of parts of a class [m]: the maximum distance of the edge from the
        centre."""
        return self.rig.part_type(label).reach_m

    def _remaining_rotation(self, pose: Pose, angle: np.ndarray) -> np.ndarray:
        """Return the rotations (...) [rad] that parts with the angles `angle` (...) [rad] still
        need. The goal is the nearest angle that is equivalent to the angle of the pose."""
        period = 2 * np.pi / max(self.rig.part_type(pose.label).symmetry, 1)
        return np.asarray((pose.angle - angle + period / 2) % period - period / 2)
