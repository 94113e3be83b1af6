"""Assembling: which drift to ask of each part so that a pattern of places is filled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import AssembleTask

from .places import approach_drift, assign, hold_back, paces, pass_by
from .requests import DriftRequest


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
    force_share_max : float
        Greatest component of the force to ask for [mu m g].
    """

    drift_max: float = 0.024
    least: float = 0.3
    over: float = 2.0
    approach: float = 1.5
    band: float = 0.3
    force_share_max: float = 1.0


@dataclass(frozen=True)
class Assembly:
    """The rules of assembling for one task on one rig."""

    task: AssembleTask
    rig: Rig

    def distance(self, parts: Parts) -> np.ndarray:
        """How far each part (M,) is from its place [m]; NaN for a part that has none."""
        aim, placed = self._aim(parts)
        return np.where(placed, np.hypot(*(parts.position - aim).T), np.nan)

    def request(self, parts: Parts, period: float, options: AssembleOptions) -> DriftRequest:
        """Return the drift wanted of each part.

        Parameters
        ----------
        parts : Parts
            Parts as seen, M of them; one without a place is only kept clear of the edges.
        period : float
            Length of a cycle [s]: the request acts one cycle after `parts` was seen.
        options : AssembleOptions

        Returns
        -------
        DriftRequest
            Intervals (M, 2) [m/s, plate_home].
        """
        aim, placed = self._aim(parts)
        position = parts.position + period * parts.velocity
        speed, rate = options.drift_max, options.approach
        band = options.band * self.task.tolerance_m
        pace = speed * paces(self.distance(parts), options.least)
        wanted = approach_drift(position, aim, band, pace, options.over * speed, rate)
        free = ~placed[:, None]
        wanted = DriftRequest(
            np.where(free, -speed, wanted.low), np.where(free, speed, wanted.high)
        )
        wanted = pass_by(position, wanted, self.rig.parts.radius_m)
        return hold_back(position, aim, self.rig.plate.half, wanted, rate)

    def _aim(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Place (M, 2) [m] of each part, its own where it has none, and whether it has one (M,)."""
        place = np.array(self.task.place)
        row = assign(self.task.labels, place, parts)
        placed = row >= 0
        return np.where(placed[:, None], place[row], parts.position), placed
