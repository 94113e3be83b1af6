"""Following: which drift to ask of each part so that it stays on its path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plate_core import PartSet, Rig
from plate_core.scenario import FollowTask

from .assignment import UNMATCHED, match_paths, rematch_paths
from .pd import FollowOptions, pd_drift, predict
from .requests import DriftRequest, stay_within
from .trajectory import PolygonPath

EDGE = (0.70, 0.85)
"""Where parts without a path are held back from the edges [share of the half side]."""


@dataclass(frozen=True)
class FollowState:
    """What following remembers from image to image.

    Attributes
    ----------
    match : tuple of str
        Id of the part of each path.
    path_start : float
        Stamp at which the references leave their first corners [s].
    square_sum, samples : float, int
        Sum of squared distances from the references [m2], and their number.
    max_error_m : float
        The greatest of these distances [m].
    """

    match: tuple[str, ...] = ()
    path_start: float = 0.0
    square_sum: float = 0.0
    samples: int = 0
    max_error_m: float = 0.0

    @property
    def rms_error_m(self) -> float:
        """Root mean square distance from the references so far [m]."""
        return float(np.sqrt(self.square_sum / self.samples)) if self.samples else 0.0


@dataclass(frozen=True)
class Follower:
    """The rules of following for one task on one rig."""

    task: FollowTask
    rig: Rig

    @cached_property
    def paths(self) -> list[PolygonPath]:
        """The paths, in the order of the task."""
        return [PolygonPath.from_task(path) for path in self.task.paths]

    def reference(self, state: FollowState, t: float) -> np.ndarray:
        """Where the part of each path should be (P, 2) [m, plate_home] at a stamp t [s]."""
        return np.array([path.position(t - state.path_start) for path in self.paths])

    def begin(self, parts: PartSet, t: float, period: float) -> FollowState:
        """Match parts to paths; the references leave when the first answer begins to act."""
        state = FollowState(path_start=t + period)
        return replace(state, match=match_paths(self._labels, self.reference(state, t), parts))

    def measure(self, state: FollowState, parts: PartSet, t: float) -> FollowState:
        """Take one image into the match and into the error statistics."""
        reference = self.reference(state, t)
        match = rematch_paths(state.match, self._labels, reference, parts, self.task.max_error_m)
        state = replace(state, match=match)
        path, part = self._rows(state, parts)
        error = np.hypot(*(parts.position[part] - reference[path]).T)
        return replace(
            state,
            square_sum=state.square_sum + float(np.sum(error**2)),
            samples=state.samples + len(error),
            max_error_m=float(np.max(error, initial=state.max_error_m)),
        )

    def finished(self, state: FollowState, t: float) -> bool:
        """Whether all references have come to the end of their last lap."""
        return t - state.path_start >= max(path.duration for path in self.paths) - 1e-6

    def missing(self, state: FollowState, parts: PartSet) -> tuple[str, ...]:
        """Ids of the parts that have a path and are not seen."""
        return tuple(i for i in state.match if i not in parts.ids and i != UNMATCHED)

    def problem(self, state: FollowState, parts: PartSet, t: float, options: FollowOptions) -> str:
        """Say which part is too far off its path; empty if none is, or it is too early to say."""
        if t - state.path_start < options.settle_s:
            return ""
        path, part = self._rows(state, parts)
        error = np.hypot(*(parts.position[part] - self.reference(state, t)[path]).T)
        if not len(error) or np.max(error) <= self.task.max_error_m:
            return ""
        worst = int(np.argmax(error))
        return (
            f"{parts.ids[part[worst]]} is {error[worst] * 1e3:.1f} mm off its path, "
            f"allowed: {self.task.max_error_m * 1e3:g} mm"
        )

    def request(
        self,
        state: FollowState,
        parts: PartSet,
        asked: np.ndarray,
        t: float,
        period: float,
        options: FollowOptions,
    ) -> DriftRequest:
        """Return the drift wanted of each part; parts without a path are only kept on the plate.

        `asked` (M, 2) [m/s] is what was asked of the present cycle, NaN where nothing was.
        """
        low, high = self._keep_on_plate(parts)
        path, part = self._rows(state, parts)
        velocity = parts.velocity[part]
        predicted = predict(parts.position[part], velocity, asked[part], period, options.trust)
        wanted = pd_drift(
            predicted,
            self.reference(state, t + period)[path],
            self.reference(state, t + 2 * period)[path],
            period,
            options.kp,
            options.speed_ratio_max * np.array([self.paths[k].speed for k in path]),
        )
        low[part] = high[part] = velocity + options.kd * (wanted - velocity)
        return DriftRequest(low, high)

    @property
    def _labels(self) -> list[str]:
        return [path.label for path in self.task.paths]

    def _rows(self, state: FollowState, parts: PartSet) -> tuple[np.ndarray, np.ndarray]:
        """Rows of paths, and of the parts that are seen on them: two index arrays (K,)."""
        row = {part_id: i for i, part_id in enumerate(parts.ids)}
        pairs = [(k, row[i]) for k, i in enumerate(state.match) if i in row]
        rows = np.array(pairs, dtype=int).reshape(-1, 2)
        return rows[:, 0], rows[:, 1]

    def _keep_on_plate(self, parts: PartSet) -> tuple[np.ndarray, np.ndarray]:
        """Intervals (M, 2) [m/s] that leave a part free in the middle of the plate."""
        speed = max(path.speed for path in self.task.paths)
        columns = [
            stay_within(parts.position[:, k], self.rig.plate.half[k], *EDGE, speed, 2 * speed)
            for k in range(2)
        ]
        return (
            np.column_stack([low for low, _ in columns]),
            np.column_stack([high for _, high in columns]),
        )
