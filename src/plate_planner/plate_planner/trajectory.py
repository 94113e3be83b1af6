"""Polygons at constant speed: where a part should be at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core.scenario import PathTask


@dataclass(frozen=True)
class PolygonPath:
    """A polygon that is run through at constant speed, from rest at its first corner.

    Attributes
    ----------
    corner : (n, 2)
        Corners [m, plate_home]; for a closed path the last is the first again.
    arc : (n,)
        Length of the path up to each corner [m].
    speed : float
        Speed along the path [m/s].
    laps : float
        Times round; 1 for an open path.
    """

    corner: np.ndarray
    arc: np.ndarray
    speed: float
    laps: float

    @classmethod
    def from_task(cls, task: PathTask) -> PolygonPath:
        """Build the path that a scenario asks for."""
        corner = np.array(task.waypoint, dtype=float)
        if task.closed:
            corner = np.vstack([corner, corner[:1]])
        arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
        return cls(corner, arc, task.speed, task.laps)

    @property
    def length(self) -> float:
        """Length of one lap [m]."""
        return float(self.arc[-1])

    @property
    def duration(self) -> float:
        """Time from the first corner to the end of the last lap [s]."""
        return self.laps * self.length / self.speed

    def position(self, t: np.ndarray | float) -> np.ndarray:
        """Reference position (..., 2) [m, plate_home] at times t (...) [s].

        Before t = 0 it is the first corner, after the duration the end.
        """
        along = self._along(t)
        return np.stack([np.interp(along, self.arc, axis) for axis in self.corner.T], axis=-1)

    def velocity(self, t: np.ndarray | float) -> np.ndarray:
        """Reference velocity (..., 2) [m/s] at times t (...) [s]: zero before and after the path.

        At a corner it is that of the edge that begins there.
        """
        edge = np.searchsorted(self.arc, self._along(t), side="right") - 1
        edge = np.clip(edge, 0, len(self.arc) - 2)
        direction = np.diff(self.corner, axis=0) / np.diff(self.arc)[:, None]
        moving = (np.asarray(t) >= 0) & (np.asarray(t) < self.duration)
        return self.speed * direction[edge] * moving[..., None]

    def lap(self, t: float) -> int:
        """Number of laps completed at time t [s]."""
        return int(np.floor(np.clip(t, 0, self.duration) * self.speed / self.length + 1e-9))

    def _along(self, t: np.ndarray | float) -> np.ndarray:
        """Arc length within the lap (...) [m]; the end of a lap is the start of the next."""
        total = np.clip(np.asarray(t, dtype=float), 0, self.duration) * self.speed
        return total if self.laps == 1 else np.mod(total, self.length)
