"""Polygonal paths with a speed profile. The paths give the reference position of a part as a
function of time.

The input is a `PathTask` with corners, laps, and speeds at fractions of the length. Between two
entries of the speed profile, the speed is a linear function of the arc length. Therefore, the arc
length at a given time can be computed by a formula, without integration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plate_core.tasks import PathTask


@dataclass(frozen=True)
class PolygonPath:
    """Polygonal path that begins at its first corner.

    Between two entries of the speed profile, the speed v is a linear function of the arc length s,
    with the slope k. Let v_0 and s_0 be the values at the first of these entries, and t the time
    since then. From dv/ds = k follow v = v_0 exp(k t) and s = s_0 + (v - v_0)/k.

    Attributes
    ----------
    corner : (n, 2)
        Corners [m, plate_home]. The last corner of a closed path is a copy of its first corner.
    arc : (n,)
        Length of the path up to each corner [m].
    speed : float
        Maximum speed along the path [m/s].
    laps : float
        Number of laps. 1 for an open path.
    profile : (k, 3)
        Each row is an entry of the speed profile: arc length [m], speed [m/s], and time since the
        start of the lap [s].
    """

    corner: np.ndarray
    arc: np.ndarray
    speed: float
    laps: float
    profile: np.ndarray

    @classmethod
    def from_task(cls, task: PathTask) -> PolygonPath:
        """Create a path from the task of a scenario."""
        corner = np.array(task.waypoint, dtype=float)
        if task.closed:
            corner = np.vstack([corner, corner[:1]])
        arc = np.append(0.0, np.cumsum(np.hypot(*np.diff(corner, axis=0).T)))
        profile = task.profile or ((0.0, task.speed), (1.0, task.speed))
        return cls(corner, arc, task.speed, task.laps, _make_profile(profile, float(arc[-1])))

    @property
    def length(self) -> float:
        """Length of one lap [m]."""
        return float(self.arc[-1])

    @cached_property
    def duration(self) -> float:
        """Time from the first corner to the end of the last lap [s]."""
        laps, fraction = divmod(self.laps, 1.0)
        return float(laps * self._lap_time + self._time_at(fraction * self.length))

    def position(self, t: np.ndarray | float) -> np.ndarray:
        """Return the reference position (..., 2) [m, plate_home] at times t (...) [s].

        The position is the first corner for t < 0, and the end of the path after the last lap.
        """
        along = self._arc_length_at(t)
        return np.stack([np.interp(along, self.arc, axis) for axis in self.corner.T], axis=-1)

    def heading(self, t: np.ndarray | float) -> np.ndarray:
        """Return the direction of the path (..., 2) at the reference positions of the times t (...)
        [s]."""
        edge = np.searchsorted(self.arc, self._arc_length_at(t), side="right") - 1
        edge = np.clip(edge, 0, len(self.arc) - 2)
        return np.asarray((np.diff(self.corner, axis=0) / np.diff(self.arc)[:, None])[edge])

    @property
    def _lap_time(self) -> float:
        return float(self.profile[-1, 2])

    def _time_at(self, along: float) -> float:
        """Return the time [s] from the start of a lap to an arc length [m]."""
        s, v, t = self.profile.T
        i = int(np.clip(np.searchsorted(s, along, side="right") - 1, 0, len(s) - 2))
        speed = np.interp(along, s, v)
        return float(t[i] + (along - s[i]) / _log_mean(v[i], speed))

    def _arc_length_at(self, t: np.ndarray | float) -> np.ndarray:
        """Return the arc length from the start of the lap to the reference position (...) [m]. The
        end of a lap counts as the start of the next lap."""
        since = np.clip(np.asarray(t, dtype=float), 0, self.duration)
        if self.laps != 1:
            since = np.mod(since, self._lap_time)
        s, v, begin = self.profile.T
        i = np.clip(np.searchsorted(begin, since, side="right") - 1, 0, len(s) - 2)
        slope = np.diff(v)[i] / np.diff(s)[i]
        since = since - begin[i]
        return np.asarray(s[i] + v[i] * since * _expm1_over(slope * since))


def _make_profile(pairs: tuple[tuple[float, float], ...], length: float) -> np.ndarray:
    """Return the array `PolygonPath.profile` (k, 3). `pairs` contains the entries of the profile:
    fraction of the length, and speed [m/s]."""
    fraction, speed = np.array(pairs).T
    step = length * np.diff(fraction) / _log_mean(speed[:-1], speed[1:])
    return np.column_stack([length * fraction, speed, np.append(0.0, np.cumsum(step))])


def _log_mean(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the mean speed on a segment of a path, (b - a)/log(b/a). On the segment, the speed is
    a linear function of the arc length, from a to b."""
    ratio = np.log(np.asarray(b) / a)
    return np.asarray(a * _expm1_over(ratio))


def _expm1_over(x: np.ndarray) -> np.ndarray:
    """Return (exp(x) - 1)/x. The result is 1 for x = 0."""
    small = np.abs(x) < 1e-12
    return np.asarray(np.where(small, 1.0, np.expm1(x) / np.where(small, 1.0, x)))
