"""Following: which drift to ask of each part so that it stays on its path."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import FollowTask

from .assignment import UNMATCHED, match_paths, rematch_paths
from .disturbance import Disturbance
from .pd import FollowOptions, pd_drift
from .requests import DriftRequest, stay_within
from .trajectory import PolygonPath

EDGE = (0.70, 0.85)
"""Where parts without a path are held back from the edges [share of the half side]."""

LACKING, SLOW_DOWN = 0.1, 0.7
"""A cycle that lacks more than this share of a path's speed takes this share of the pace [-]."""

NEGLIGIBLE = 0.3e-3
"""Drift that a cycle may always lack [m/s]: solver and filter leave 0.2 mm/s, no reason to slow
down on a slow path."""

SPEED_UP = 0.1
"""Growth of the pace in one cycle, after it was slow: smoother than the errors that slow it [-]."""


@dataclass(frozen=True)
class FollowState:
    """What following remembers from image to image.

    Attributes
    ----------
    match : tuple of str
        Id of the part of each path.
    began : float
        Stamp at which the references leave their first corners [s].
    anchor, progress : float
        A stamp [s], and how far on their paths the references are then [s at full pace].
    paces : (float, float)
        Seconds on the path per second, before the anchor and after it: 1 is full pace.
    disturbance : Disturbance
        What parts do otherwise than foretold.
    square_sum, samples : float, int
        Sum of squared distances from the references [m2], and their number.
    max_error_m : float
        The greatest of these distances [m].
    """

    match: tuple[str, ...] = ()
    began: float = 0.0
    anchor: float = 0.0
    progress: float = 0.0
    paces: tuple[float, float] = (1.0, 1.0)
    disturbance: Disturbance = field(default_factory=lambda: Disturbance.none(0))
    square_sum: float = 0.0
    samples: int = 0
    max_error_m: float = 0.0

    @property
    def rms_error_m(self) -> float:
        """Root mean square distance from the references so far [m]."""
        return float(np.sqrt(self.square_sum / self.samples)) if self.samples else 0.0

    def path_time(self, t: float) -> float:
        """How far the references are on their paths at a stamp t [s], in seconds at full pace."""
        since = t - self.anchor
        return self.progress + since * self.paces[0 if since < 0 else 1]


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
        time = state.path_time(t)
        return np.array([path.position(time) for path in self.paths])

    def begin(self, parts: Parts, start: float) -> FollowState:
        """Match parts to paths; the references leave at `start` [s]."""
        disturbance = Disturbance.none(len(self.paths))
        state = FollowState(began=start, anchor=start, disturbance=disturbance)
        return replace(state, match=match_paths(self._labels, self.reference(state, start), parts))

    def measure(
        self,
        state: FollowState,
        parts: Parts,
        t: float,
        start: float,
        short: np.ndarray,
        options: FollowOptions,
    ) -> FollowState:
        """Take one image into the match, the error statistics and the pace.

        Its answer begins to act at `start` [s]; `short` (M,) [m/s] is what the present cycle gives
        of drift less than what was asked of it.
        """
        reference = self.reference(state, t)
        match = rematch_paths(state.match, self._labels, reference, parts, self.task.max_error_m)
        state = replace(state, match=match)
        path, part = self._rows(state, parts)
        error = reference[path] - parts.position[part]
        distance = np.hypot(*error.T)
        worst = float(np.max(distance, initial=0.0))
        state = replace(
            state,
            square_sum=state.square_sum + float(np.sum(distance**2)),
            samples=state.samples + len(distance),
            max_error_m=max(state.max_error_m, worst),
        )
        lacking = float(np.max((short[part] - NEGLIGIBLE) / self._speeds[path], initial=0.0))
        return self._pace(state, worst, lacking, start, options)

    def observe(
        self,
        state: FollowState,
        parts: Parts,
        t: float,
        ahead: np.ndarray,
        start: float,
        age: float | None,
        options: FollowOptions,
    ) -> FollowState:
        """Take one image into the disturbance.

        `ahead` (M, 2) [m] is where the parts should be at `start` [s] by all that is known, `age`
        [s] how old the images are then taken to be; None as long as that is not known.
        """
        path, part = self._rows(state, parts)
        seen, foretold = np.full((2, len(self.paths), 2), np.nan)
        seen[path], foretold[path] = parts.position[part], ahead[part]
        period, gain = start - t, options.observer_gain
        axes, most = self._axes(state, t - period / 2), options.disturbance_max * self._speeds
        disturbance = state.disturbance.see(seen, t, age, period, axes, gain, most)
        return replace(state, disturbance=disturbance.foretell(foretold, start, age))

    def _pace(
        self, state: FollowState, worst: float, lacking: float, t: float, options: FollowOptions
    ) -> FollowState:
        """Choose the pace from stamp t on: until then the references do as was said before."""
        share = worst / self.task.max_error_m
        room = (options.slow_to - share) / (options.slow_to - options.slow_from)
        most = state.paces[1] * SLOW_DOWN if lacking > LACKING else state.paces[1] + SPEED_UP
        pace = float(np.clip(room, 0, min(1.0, most)))
        return replace(state, anchor=t, progress=state.path_time(t), paces=(state.paces[1], pace))

    def to_go(self, state: FollowState, t: float) -> float:
        """Length of the longest way still to go [m], at greatest speed."""
        time = state.path_time(t)
        return max(max(path.duration - time, 0) * path.speed for path in self.paths)

    def errors(self, state: FollowState, parts: Parts, t: float) -> np.ndarray:
        """Distance of each part (M,) from its reference [m]; 0 for a part without one."""
        result = np.zeros(len(parts))
        path, part = self._rows(state, parts)
        result[part] = np.hypot(*(parts.position[part] - self.reference(state, t)[path]).T)
        return result

    def finished(self, state: FollowState, t: float) -> bool:
        """Whether all references have come to the end of their last lap."""
        return state.path_time(t) >= max(path.duration for path in self.paths) - 1e-6

    def missing(self, state: FollowState, parts: Parts) -> tuple[str, ...]:
        """Ids of the parts that have a path and are not seen."""
        return tuple(i for i in state.match if i not in parts.ids and i != UNMATCHED)

    def problem(self, state: FollowState, parts: Parts, t: float, options: FollowOptions) -> str:
        """Say which part is too far off its path; empty if none is, or it is too early to say."""
        if t - state.began < options.settle_s:
            return ""
        error = self.errors(state, parts, t)
        if not len(error) or np.max(error) <= self.task.max_error_m:
            return ""
        worst = int(np.argmax(error))
        return (
            f"{parts.ids[worst]} is {error[worst] * 1e3:.1f} mm off its path, "
            f"allowed: {self.task.max_error_m * 1e3:g} mm"
        )

    def request(
        self,
        state: FollowState,
        parts: Parts,
        ahead: np.ndarray,
        start: float,
        period: float,
        options: FollowOptions,
    ) -> DriftRequest:
        """Return the drift wanted of each part; parts without a path are only kept on the plate.

        `ahead` (M, 2) [m] is where the parts will be at `start` [s], when the answer begins to act
        for `period` [s].
        """
        low, high = self._keep_on_plate(parts)
        path, part = self._rows(state, parts)
        before, after = (
            state.disturbance.along(self._axes(state, start + k * period / 2))[path]
            for k in (-1, 1)
        )
        low[part] = high[part] = pd_drift(
            ahead[part] + before * period,
            self.reference(state, start)[path],
            self.reference(state, start + period)[path],
            period,
            options.kp,
            after,
            options.speed_ratio_max * self._speeds[path],
        )
        return DriftRequest(low, high)

    @property
    def _labels(self) -> list[str]:
        return [path.label for path in self.task.paths]

    @cached_property
    def _speeds(self) -> np.ndarray:
        """Greatest speed of each path (P,) [m/s]."""
        return np.array([path.speed for path in self.paths])

    def _axes(self, state: FollowState, t: float) -> np.ndarray:
        """Unit vectors along and across each path (P, 2, 2), in rows, at a stamp t [s]."""
        time = state.path_time(t)
        along = np.array([path.heading(time) for path in self.paths])
        return np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=1)

    def _rows(self, state: FollowState, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
        """Rows of paths, and of the parts that are seen on them: two index arrays (K,)."""
        row = {part_id: i for i, part_id in enumerate(parts.ids)}
        pairs = [(k, row[i]) for k, i in enumerate(state.match) if i in row]
        rows = np.array(pairs, dtype=int).reshape(-1, 2)
        return rows[:, 0], rows[:, 1]

    def _keep_on_plate(self, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
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
