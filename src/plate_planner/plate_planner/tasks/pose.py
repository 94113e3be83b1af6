"""Pose: which drift and which turning bring parts to their places and angles, and keep them.

Both are proportional to the error predicted for when the answer begins to act, as in `follow`:

    v = kp (place - x - T v_now)/T,    omega = kp (angle - theta - T omega_now)/T

within greatest values; v_now and omega_now are what was asked of the cycle that runs now.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import PoseTask

from ..estimation import rows_of
from .targets import UNMATCHED, match_targets, matched_rows
from .task import Assessment, DriftRequest, Situation, TaskRules

KP = 0.5
"""Fraction of the predicted error to correct in one cycle [-]."""

DRIFT_MAX = 0.015
"""Greatest drift to ask for [m/s]."""

SPIN_MAX = 0.8
"""Greatest turning to ask for [rad/s]: in the middle of the plate a part can turn at 1.2, near its
ends at half of that."""


@dataclass(frozen=True)
class PoseMemory:
    """What is remembered of a task of poses: which part has which, and what it was asked last.

    Attributes
    ----------
    match : tuple of str
        Id of the part that has each pose.
    place : (P, 2)
        Where it is to be [m, plate_home].
    ids : tuple of str
    spin : (M,)
        What was asked last [rad/s], of these parts.
    """

    match: tuple[str, ...] = ()
    place: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    ids: tuple[str, ...] = ()
    spin: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Poser(TaskRules):
    """The rules of posing for one task on one rig."""

    task: PoseTask
    rig: Rig

    @property
    def hold_s(self) -> float:
        """Done when all parts have been in their poses for this long [s]."""
        return self.task.hold_s

    @property
    def estimated(self) -> bool:
        """No: the estimator takes parts for points, which do not turn."""
        return False

    @property
    def bias_gain(self) -> float:
        """None is observed [-]."""
        return 0.0

    def assess(
        self, memory: PoseMemory | None, now: Situation
    ) -> tuple[PoseMemory | None, Assessment]:
        """Judge one image, and say what is wanted; see `TaskRules.assess`."""
        if not now.active:
            return memory, Assessment()
        parts = now.parts
        memory = self.begin(parts) if memory is None else memory
        error, angle = self.errors(memory, parts)
        distance = error + self.rig.parts.radius_m * np.abs(angle)  # the way of the rim
        turn = float(np.max(np.abs(angle), initial=0.0))
        count, problem = self.count(memory, parts), self.problem(memory, parts)
        memory, request = self.request(memory, parts, now.predicted, now.period)
        return memory, Assessment(
            request=request,
            torque=self.torque(memory, parts, now.period),
            goal_met=count == len(self.task.poses),
            count=count,
            distance=distance,
            to_go_m=float(np.sum(distance)),
            problem=problem,
            rms_error_m=float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
            max_error_m=float(np.max(error, initial=0.0)),
            turn_error=turn,
            outcome=f"{1e3 * np.max(error, initial=0.0):.1f} mm and {np.degrees(turn):.1f} degrees "
            "off at most",
        )

    def begin(self, parts: Parts) -> PoseMemory:
        """Give each part a pose of its class: one with a place to the nearest, as far as that goes;
        then the others, each where it is."""
        stays = np.array([pose.place is None for pose in self.task.poses])
        place = np.array([pose.place or (0.0, 0.0) for pose in self.task.poses])
        match = np.full(len(stays), UNMATCHED, dtype=object)
        for rows in (np.flatnonzero(~stays), np.flatnonzero(stays)):
            free = [k for k, part_id in enumerate(parts.ids) if part_id not in match]
            labels = tuple(self.task.poses[row].label for row in rows)
            match[rows] = match_targets(labels, place[rows], parts.take(free))
        for row in np.flatnonzero(stays & (match != UNMATCHED)):
            place[row] = parts.position[parts.ids.index(match[row])]
        return PoseMemory(tuple(match), place)

    def errors(self, memory: PoseMemory, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Distance from its place [m] and angle still to turn [rad] of each part (M,); 0 for one
        without a pose."""
        distance, angle = np.zeros(len(parts)), np.zeros(len(parts))
        pose, part = matched_rows(memory.match, parts)
        distance[part] = np.hypot(*(memory.place[pose] - parts.position[part]).T)
        angle[part] = _wrapped(self._angles[pose] - parts.angle[part])
        return distance, angle

    def count(self, memory: PoseMemory, parts: Parts) -> int:
        """How many parts are in their poses."""
        distance, angle = self.errors(memory, parts)
        there = distance <= self.task.tolerance_m
        there &= np.abs(angle) <= self.task.tolerance_rad
        return int(np.count_nonzero(there[matched_rows(memory.match, parts)[1]]))

    def problem(self, memory: PoseMemory, parts: Parts) -> str:
        """Say which part is too far from where it was to stay; empty if none is."""
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
            f"{parts.ids[worst]} is {1e3 * far:.1f} mm from where it was to turn, "
            f"allowed: {1e3 * self.task.tolerance_m:g} mm (tolerance_m); fewer parts, more "
            "room from the plate's ends, or a greater tolerance would do"
        )

    def request(
        self, memory: PoseMemory, parts: Parts, predicted: np.ndarray, period: float
    ) -> tuple[PoseMemory, DriftRequest]:
        """Return the drift wanted of each part, and the memory with the turning wanted.

        `predicted` (M, 2) [m] is where the parts will be when the answer begins to act.
        """
        drift, spin = np.zeros((len(parts), 2)), np.zeros(len(parts))
        pose, part = matched_rows(memory.match, parts)
        wanted = KP * (memory.place[pose] - predicted[part]) / period
        size = np.hypot(*wanted.T)[:, None]
        drift[part] = wanted * np.minimum(1, DRIFT_MAX / np.maximum(size, 1e-12))
        row = rows_of(parts.ids, memory.ids)
        turning = np.where(row >= 0, np.append(memory.spin, 0.0)[row], 0.0)
        missing = _wrapped(self._angles[pose] - parts.angle[part] - period * turning[part])
        spin[part] = np.clip(KP * missing / period, -SPIN_MAX, SPIN_MAX)
        return replace(memory, ids=parts.ids, spin=spin), DriftRequest(drift, drift)

    def torque(self, memory: PoseMemory, parts: Parts, period: float) -> np.ndarray:
        """Mean torques over a cycle (M,) [N m] that lead from the present turning to the wanted."""
        inertia = self.rig.parts.mass_kg * self.rig.parts.radius_m**2 / 2
        return np.asarray(inertia * (memory.spin - parts.spin) / period)

    @property
    def _angles(self) -> np.ndarray:
        return np.array([pose.angle for pose in self.task.poses])


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
