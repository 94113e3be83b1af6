"""Posing: which drift and which turning bring parts to their places and angles, and keep them.

Both are proportional to the error foreseen for when the answer begins to act, as in `pd`:

    v = kp (place - x - T v_now)/T,    omega = kp (angle - theta - T omega_now)/T

within greatest values; v_now and omega_now are what was asked of the cycle that runs now.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import PoseTask

from .assignment import UNMATCHED, match_paths
from .requests import DriftRequest


@dataclass(frozen=True)
class PoseOptions:
    """Gains and bounds of the posing rules.

    Attributes
    ----------
    kp : float
        Share of the foreseen error to correct in one cycle [-].
    drift_max : float
        Greatest drift to ask for [m/s].
    spin_max : float
        Greatest turning to ask for [rad/s]: in the middle of the plate a part can turn at 1.2, near
        its ends at half of that.
    force_share_max : float
        Greatest component of the force to ask for [mu m g].
    """

    kp: float = 0.5
    drift_max: float = 0.015
    spin_max: float = 0.8
    force_share_max: float = 1.0


@dataclass(frozen=True)
class PoseState:
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
class Poser:
    """The rules of posing for one task on one rig."""

    task: PoseTask
    rig: Rig

    def begin(self, parts: Parts) -> PoseState:
        """Give each part a pose of its class: one with a place to the nearest, as far as that goes;
        then the others, each where it is."""
        stays = np.array([pose.place is None for pose in self.task.poses])
        place = np.array([pose.place or (0.0, 0.0) for pose in self.task.poses])
        match = np.full(len(stays), UNMATCHED, dtype=object)
        for rows in (np.flatnonzero(~stays), np.flatnonzero(stays)):
            free = [k for k, part_id in enumerate(parts.ids) if part_id not in match]
            left = parts.take(free)
            labels = tuple(self.task.poses[row].label for row in rows)
            match[rows] = match_paths(labels, place[rows], left)
        for row in np.flatnonzero(stays & (match != UNMATCHED)):
            place[row] = parts.position[parts.ids.index(match[row])]
        return PoseState(tuple(match), place)

    def errors(self, state: PoseState, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Distance from its place [m] and angle still to turn [rad] of each part (M,); 0 for one
        without a pose."""
        distance, angle = np.zeros(len(parts)), np.zeros(len(parts))
        pose, part = self._rows(state, parts)
        distance[part] = np.hypot(*(state.place[pose] - parts.position[part]).T)
        angle[part] = _wrapped(self._angles[pose] - parts.angle[part])
        return distance, angle

    def count(self, state: PoseState, parts: Parts) -> int:
        """How many parts are in their poses."""
        distance, angle = self.errors(state, parts)
        there = distance <= self.task.tolerance_m
        there &= np.abs(angle) <= self.task.tolerance_rad
        return int(np.count_nonzero(there[self._rows(state, parts)[1]]))

    def problem(self, state: PoseState, parts: Parts) -> str:
        """Say which part is too far from where it was to stay; empty if none is."""
        distance, _ = self.errors(state, parts)
        pose, part = self._rows(state, parts)
        stays = np.array([self.task.poses[row].place is None for row in pose], dtype=bool)
        if not np.any(stays):
            return ""
        worst = part[stays][np.argmax(distance[part[stays]])]
        far = float(distance[worst])
        if far <= self.task.tolerance_m:
            return ""
        return (
            f"{parts.ids[worst]} is {1e3 * far:.1f} mm from where it was to turn, "
            f"allowed: {1e3 * self.task.tolerance_m:g} mm"
        )

    def request(
        self,
        state: PoseState,
        parts: Parts,
        ahead: np.ndarray,
        period: float,
        options: PoseOptions,
    ) -> tuple[PoseState, DriftRequest]:
        """Return the drift wanted of each part, and the state with the turning wanted.

        `ahead` (M, 2) [m] is where the parts will be when the answer begins to act.
        """
        drift = np.zeros((len(parts), 2))
        pose, part = self._rows(state, parts)
        wanted = options.kp * (state.place[pose] - ahead[part]) / period
        size = np.hypot(*wanted.T)[:, None]
        drift[part] = wanted * np.minimum(1, options.drift_max / np.maximum(size, 1e-12))
        before = dict(zip(state.ids, state.spin, strict=True))
        turning = np.array([before.get(i, 0.0) for i in parts.ids])
        spin = np.zeros(len(parts))
        missing = _wrapped(self._angles[pose] - parts.angle[part] - period * turning[part])
        spin[part] = np.clip(options.kp * missing / period, -options.spin_max, options.spin_max)
        state = replace(state, ids=parts.ids, spin=spin)
        return state, DriftRequest(drift, drift)

    def torque(self, state: PoseState, parts: Parts, period: float) -> np.ndarray:
        """Mean torques over a cycle (M,) [N m] that lead from the present turning to the wanted."""
        inertia = self.rig.parts.mass_kg * self.rig.parts.radius_m**2 / 2
        return np.asarray(inertia * (state.spin - parts.spin) / period)

    @property
    def _angles(self) -> np.ndarray:
        return np.array([pose.angle for pose in self.task.poses])

    def _rows(self, state: PoseState, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Rows of poses, and of the parts that are seen and have them: two index arrays (K,)."""
        row = {part_id: i for i, part_id in enumerate(parts.ids)}
        pairs = [(k, row[i]) for k, i in enumerate(state.match) if i in row]
        rows = np.array(pairs, dtype=int).reshape(-1, 2)
        return rows[:, 0], rows[:, 1]


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles in [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
