"""Assemble: which drift to ask of each part so that a pattern of places is filled."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import AssembleTask

from .targets import approach_drift, assign, hold_back, pass_by, speed_scaling
from .task import Assessment, DriftRequest, Situation, TaskRules


@dataclass(frozen=True)
class AssembleOptions:
    """Speeds and margins of the assembling rules.

    Attributes
    ----------
    drift_max : float
        Drift asked of the part with the longest way [m/s].
    least : float
        Least drift asked of a part with a shorter way, in multiples of drift_max [-].
    over : float
        Greatest welcome drift, in multiples of drift_max [-].
    approach : float
        Rate at which the asked drift falls with the distance still to go [1/s].
    band : float
        Where a part may stay: a square of this half side round its place [tolerance].
    """

    drift_max: float = 0.024
    least: float = 0.3
    over: float = 2.0
    approach: float = 1.5
    band: float = 0.3


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
        count = int(np.sum(error <= self.task.tolerance_m))
        return None, Assessment(
            request=self.request(now.parts, now.period),
            goal_met=count == len(self.task.place),
            count=count,
            distance=np.nan_to_num(distance),
            to_go_m=float(np.sum(error)),
            rms_error_m=float(np.sqrt(np.mean(error**2))) if len(error) else 0.0,
            max_error_m=float(np.max(error, initial=0.0)),
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
        options = self.options
        aim, placed = self._aim(parts)
        position = parts.position + period * parts.velocity
        fastest = options.over * options.drift_max
        band = options.band * self.task.tolerance_m
        speed = options.drift_max * speed_scaling(self.distance(parts), options.least)
        wanted = approach_drift(position, aim, band, speed, fastest, options.approach)
        free = ~placed[:, None]
        wanted = DriftRequest(
            np.where(free, -options.drift_max, wanted.low),
            np.where(free, options.drift_max, wanted.high),
        )
        wanted = pass_by(position, wanted, self.rig.parts.radius_m)
        return hold_back(position, aim, self.rig.plate.half, wanted, options.approach)

    def _aim(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Place (M, 2) [m] of each part, its own where it has none, and whether it has one (M,)."""
        place = np.array(self.task.place)
        row = assign(self.task.labels, place, parts)
        placed = row >= 0
        return np.where(placed[:, None], place[row], parts.position), placed
