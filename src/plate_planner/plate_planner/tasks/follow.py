"""Rules of a path-following task. Once per cycle, a PD controller computes the drift of each part.

The request for image k takes effect in cycle k+1. Therefore, the controller uses the error that is
predicted for the start of cycle k+1. Let T be the length of a cycle, t the time of image k, x_ref
the reference position and x_pred the predicted position at t + T. The controller requests the mean
drift over cycle k+1:

    v_des = (x_ref(t + 2T) - x_ref(t + T))/T + kp (x_ref(t + T) - x_pred)/T

With kp = 1, the whole predicted error is corrected in one cycle. If one of the solver's last
results began n cycles late, kp is divided by 1 + n. The reason is that the plate may repeat a cycle
n times before the next result begins, and all repetitions together must correct the error only
once.

The solver changes the drift of a part from the present drift to the requested drift. The change of
the drift is the D term of the controller, with a gain of 1. The drift bias is the observed
difference between the motion of the parts and the model. The prediction includes the bias, and the
planner subtracts the bias from the request.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from plate_core import Parts, Rig, ScenarioError
from plate_core.tasks import AssembleTask, FollowTask, Scenario

from .assemble import Assembler
from .drift import DriftInterval
from .path import PolygonPath
from .targets import UNMATCHED, match_targets, matched_rows, rematch_targets, stay_within
from .task import Assessment, Situation, TaskRules

EDGE = (0.70, 0.85)
"""Start and end of a zone near each edge of the plate, as fractions of the half side. In this zone,
parts without a path move inwards, with a speed that increases towards the edge."""

LACKING = 0.1
"""Maximum difference between the requested and the predicted drift in a cycle (shortfall), as a
fraction of the path's speed. If the shortfall is larger, the references slow down."""

SLOW_DOWN = 0.7
"""Factor by which the speed scaling of the references decreases after a cycle whose shortfall
exceeds `LACKING` [-]."""

MIN_SCALING = 0.05
"""A shortfall of drift does not reduce the speed scaling of the references below this value [-].
Without this minimum, the task could get stuck, because a shortfall may persist while the references
stand still. For position errors there is no such minimum, because they decrease while the
references stand still."""

NEGLIGIBLE = 0.3e-3
"""A shortfall of drift up to this value never slows down the references [m/s]. Solver and filter
cause a shortfall of about 0.2 mm/s, which must not slow down a slow path."""

SLOW_START = 0.1
"""Speed scaling of the references until the image latency is known [-]. With an unknown latency,
errors increase with the speed."""

SPEED_UP = 0.1
"""Maximum increase of the references' speed scaling per cycle [-]. The decrease can be faster."""

CORNER_ACCEL = 0.12
"""Maximum acceleration of the references at corners, starts and ends of paths [mu g]. The
references slow down before these points so that the acceleration is not exceeded."""

CLOSE = 4
"""Number of points per cycle at which the paths ahead are checked for corners."""


BIAS_MAX = 1.0
"""Maximum drift bias of a part along and across its path, as a fraction of the path's speed."""

SPEED_RATIO_MAX = 3.0
"""Maximum requested drift of a part, divided by the speed of its path."""

SLOW_FROM = 0.15
"""If the error of a part exceeds this fraction of max_error_m, the references slow down."""

SLOW_TO = 0.5
"""If the error of a part exceeds this fraction of max_error_m, the references stop."""

APPROACH_M = 1e-3
"""Minimum tolerance with which the parts must reach the starts of their paths [m]. The tolerance is
`SLOW_FROM` * max_error_m if this value is larger. With such an error, the references can start at
full speed."""

KEPT_MPS = (0.08, 0.08, 0.04, 0.02, 0.02, 0.01)
"""Speeds that one, two, three, four, five, and six or more parts reached on circles [m/s]. The
values were measured in docs/results.md, section (f), and in the scenario follow_8."""

REACHED = 0.3
"""Fraction of the speed bound a T/16 that two parts reached in simulations with shaking ratios of 3
and 5 [-]. See `Follower._speed_bound`."""

PERIOD_S = 0.1
"""Length T of a cycle for a small number of parts [s]. The speed bound a T/16 is computed with this
length."""

SLOWED = 0.95
"""Fraction of the speed of the paths [-]. If the mean speed of the references is below it, the text
of the result states their mean speed."""


@dataclass(frozen=True)
class FollowOptions:
    """Gains of the path controller.

    Attributes
    ----------
    kp : float
        Fraction of the predicted position error that is corrected in one cycle [-].
    observer_gain : float
        Gain of the drift bias observer [-]. The gain is the weight of the newest prediction error.
    """

    kp: float = 0.8
    observer_gain: float = 0.7

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "kp": (0.0, 2.0),
        "observer_gain": (0.0, 1.0),
    }
    """Allowed range of each option."""


def pd_drift(
    predicted: np.ndarray,
    reference: np.ndarray,
    reference_after: np.ndarray,
    period: float,
    kp: float,
    speed_max: np.ndarray,
) -> np.ndarray:
    """Return the requested mean drift of the parts over the cycle in which the request takes
    effect.

    Parameters
    ----------
    predicted : (M, 2)
        Predicted positions at the start of the cycle [m, plate_home].
    reference, reference_after : (M, 2)
        Reference positions at the start and at the end of the cycle [m, plate_home].
    period : float
        Length of a cycle [s].
    kp : float
        Fraction of the error that is corrected in the cycle [-].
    speed_max : (M,)
        Maximum magnitude of the requested drift [m/s].

    Returns
    -------
    (M, 2)
        Drift [m/s, plate_home].
    """
    drift = (reference_after - reference + kp * (reference - predicted)) / period
    magnitude = np.hypot(*drift.T)
    return drift * np.minimum(1, speed_max / np.maximum(magnitude, 1e-12))[:, None]


@dataclass(frozen=True)
class FollowMemory:
    """Data that the rules of a path-following task store between images.

    Attributes
    ----------
    match : tuple of str
        Id of the part of each path.
    began : float
        Time at which the references leave the first corners of their paths [s].
    anchor, progress : float
        `anchor` is a time [s]. `progress` is the path time of the references at the time `anchor`:
        the time that they would have needed at full speed [s].
    scaling : (float, float)
        Speed scaling of the references before and after the time `anchor` [-]. The speed scaling is
        the increase of path time per time. 1 is full speed.
    leading : bool
        Whether parts are still moving to the starts of their paths. In this case, the references do
        not move.
    approach_s : float
        Duration of the motion to the starts of the paths [s].
    square_sum, samples : float, int
        Sum of the squared distances of the parts from their references [m2], and the number of
        these distances.
    max_error_m : float
        Maximum distance of a part from its reference so far [m].
    fixed : bool
        Whether another program sets `anchor`, `progress` and `scaling`. In this case, images do not
        change them.
    """

    match: tuple[str, ...] = ()
    began: float = 0.0
    anchor: float = 0.0
    progress: float = 0.0
    scaling: tuple[float, float] = (1.0, 1.0)
    leading: bool = False
    approach_s: float = 0.0
    square_sum: float = 0.0
    samples: int = 0
    max_error_m: float = 0.0
    fixed: bool = False

    @property
    def rms_error_m(self) -> float:
        """Root mean square distance of the parts from their references so far [m]."""
        return float(np.sqrt(self.square_sum / self.samples)) if self.samples else 0.0

    def path_time(self, t: float) -> float:
        """Return the path time of the references at the time t [s]. The path time is the time that
        the references would have needed at full speed [s]."""
        since = t - self.anchor
        return self.progress + since * self.scaling[0 if since < 0 else 1]

    def pace(self, t: float) -> float:
        """Return the mean speed of the references until the time t [s], divided by the speed of
        their paths."""
        return self.path_time(t) / (t - self.began) if t > self.began else 1.0


@dataclass(frozen=True)
class Follower(TaskRules):
    """Rules of a path-following task on one rig."""

    task: FollowTask
    rig: Rig
    options: FollowOptions = field(default_factory=FollowOptions)

    @property
    def hold_s(self) -> float:
        """Time for which the goal must be met [s]. The value is 0, because the task is done when
        the references reach the ends of their paths."""
        return 0.0

    @property
    def nearer_m(self) -> float:
        """Minimum decrease of the distance that counts as progress [m]. The value is 0, because the
        references have no noise."""
        return 0.0

    @property
    def bias_gain(self) -> float:
        """Gain of the drift bias observer, from the option `observer_gain` [-]."""
        return self.options.observer_gain

    @cached_property
    def paths(self) -> list[PolygonPath]:
        """Paths in the order of the task."""
        return [PolygonPath.from_task(path) for path in self.task.paths]

    def assess(
        self, memory: FollowMemory | None, now: Situation
    ) -> tuple[FollowMemory | None, Assessment]:
        """Evaluate one image and return the request, see `TaskRules.assess`."""
        if not now.active:
            found = Assessment()
        else:
            memory = self._begin_or_continue(memory, now)
            if memory.leading:
                return memory, self._assess_approach(memory, now)
            memory, parts = self.measure(memory, now), now.parts
            error = self.errors(memory, parts, now.stamp)
            found = Assessment(
                request=self._make_request(memory, now),
                goal_met=self.finished(memory, now.stamp),
                distance=error,
                to_go_m=self.to_go(memory, now.stamp),
                problem=self.problem(memory, parts, now.stamp),
                missing=_undetected_ids(memory, parts),
                outcome=self.outcome(memory, now.stamp),
            )
        if memory is None:
            return None, found
        return memory, replace(
            found,
            rms_error_m=memory.rms_error_m,
            max_error_m=memory.max_error_m,
            speed_scaling=memory.scaling[1],
            pace=memory.pace(now.stamp),
        )

    def _begin_or_continue(self, memory: FollowMemory | None, now: Situation) -> FollowMemory:
        """Return the memory at the beginning of the task. The task begins again at each image while
        parts move to the starts of their paths, and until the length of a cycle is known."""
        early = memory is None or now.stamp < memory.began - now.period / 2
        if memory is not None and not memory.leading and not (early and now.motion_known):
            return memory
        # If no cycle has run yet, begin the references one cycle later. The exact period is known
        # only after the first cycle.
        start = now.start if now.motion_known else now.start + now.period
        restarted = self.begin(now.parts, start)
        if not now.latency_known:
            restarted = replace(restarted, scaling=(SLOW_START, SLOW_START))
        led = 0.0 if memory is None else memory.approach_s
        if memory is not None and memory.leading:
            led += max(start - memory.began, 0.0)
        far = (
            np.nan_to_num(self._approach_rules.distance(now.parts))
            > self._approach_rules.task.tolerance_m
        )
        leading = (memory is None or memory.leading) and bool(np.any(far))
        return replace(restarted, leading=leading, approach_s=led)

    def _assess_approach(self, memory: FollowMemory, now: Situation) -> Assessment:
        """Return the assessment of an image while parts move to the starts of their paths. The
        motion to the starts uses the rules of an assembling task."""
        found = self._approach_rules.assess(None, now)[1]
        return replace(
            found,
            goal_met=False,
            to_go_m=found.to_go_m + self.to_go(memory, memory.began),
            missing=_undetected_ids(memory, now.parts),
            rms_error_m=0.0,
            max_error_m=0.0,
        )

    @cached_property
    def _approach_rules(self) -> Assembler:
        """Rules for the motion of the parts to the starts of their paths."""
        starts = tuple(path.waypoint[0] for path in self.task.paths)
        near = max(SLOW_FROM * self.task.max_error_m, APPROACH_M)
        return Assembler(AssembleTask(tuple(self._labels), starts, near, 0.0), self.rig)

    def check(self, scenario: Scenario) -> None:
        """Raise a `ScenarioError` if a path takes longer at its speed than the time limit."""
        k = int(np.argmax([path.duration for path in self.paths]))
        takes, limit = self.paths[k].duration, scenario.time_limit_s
        if takes > limit:
            raise ScenarioError(
                f"{scenario.where}: task: paths: path {k + 1} takes {takes:.3g} s at its speed, "
                f"allowed: at most time_limit_s, which is {limit:g}"
            )

    def warnings(self) -> tuple[str, ...]:
        """Return a warning if paths are faster than the speeds that parts reached in measurements
        (`KEPT_MPS`), or faster than any motion of the plate allows."""
        count, fastest = len(self.paths), float(np.max(self._path_speeds))
        kept = min(KEPT_MPS[min(count, len(KEPT_MPS)) - 1], REACHED * self._speed_bound)
        if fastest <= kept:
            return ()
        parts, reach = ("part", "reaches") if count == 1 else ("parts", "reach")
        reached = f"{reach} about {kept:.2g} m/s"
        why = f"{count} {parts} on this rig {reached}: the references will be slowed down"
        if fastest > self._speed_bound:
            why = (
                f"no motion of this plate moves a part faster than {self._speed_bound:.2g} m/s "
                f"(a T/16); {count} {parts} {reached}"
            )
        return (f"speed_mps is {fastest:g}; {why}",)

    @property
    def _speed_bound(self) -> float:
        """Upper bound a T/16 of the mean speed of a part [m/s]. a is the maximum acceleration of
        the plate, and T the length of a cycle. No motion of the plate moves a part faster."""
        return self.rig.gamma * self.rig.friction.accel * PERIOD_S / 16

    def begin(self, parts: Parts, start: float) -> FollowMemory:
        """Assign parts to paths. The references start to move at the time `start` [s]."""
        memory = FollowMemory(began=start, anchor=start)
        target = self.reference(memory, start)
        return replace(memory, match=match_targets(self._labels, target, parts))

    def measure(self, memory: FollowMemory, now: Situation) -> FollowMemory:
        """Return the memory after an image. The assignment of parts to paths, the error statistics
        and the speed scaling are updated."""
        reference = self.reference(memory, now.stamp)
        match = rematch_targets(
            memory.match, self._labels, reference, now.parts, self.task.max_error_m
        )
        path, part = matched_rows(match, now.parts)
        distance = np.hypot(*(reference[path] - now.parts.position[part]).T)
        worst = float(np.max(distance, initial=0.0))
        measured = replace(
            memory,
            match=match,
            square_sum=memory.square_sum + float(np.sum(distance**2)),
            samples=memory.samples + len(distance),
            max_error_m=max(memory.max_error_m, worst),
        )
        if memory.fixed:
            return measured
        lacking = (now.shortfall[part] - NEGLIGIBLE) / self._path_speeds[path]
        before, time = memory.scaling[1], memory.path_time(now.start)
        after = before
        if now.latency_known:
            after = self._next_scaling(before, worst, float(np.max(lacking, initial=0.0)))
            after = min(after, self._max_scaling_before_corners(time, now.period))
        # The references keep their previous speed until the start of the cycle that results from
        # this request.
        return replace(measured, anchor=now.start, progress=time, scaling=(before, after))

    def _next_scaling(self, before: float, worst: float, lacking: float) -> float:
        """Return the next speed scaling of the references. `worst` is the maximum error of a part
        [m]. `lacking` is the maximum shortfall of drift, as a fraction of the path's speed.

        Let e be the error divided by `max_error_m`. The scaling is (SLOW_TO - e) / (SLOW_TO -
        SLOW_FROM), limited to 0 to 1. The change from the previous scaling `before` is also
        limited.
        """
        factor = (SLOW_TO - worst / self.task.max_error_m) / (SLOW_TO - SLOW_FROM)
        upper = max(before * SLOW_DOWN, MIN_SCALING) if lacking > LACKING else before + SPEED_UP
        return float(np.clip(factor, 0, min(1.0, upper)))

    def _max_scaling_before_corners(self, time: float, period: float) -> float:
        """Return the maximum speed scaling of the references at the path time `time` [s]. With this
        scaling, no corner ahead requires an acceleration above `CORNER_ACCEL`.

        With the scaling s, the path time p advances by dp = s dt. Let a be the maximum deceleration
        of a part and v the speed of the path. Then s ds/dp = a/v. Therefore s^2 may be larger by 2
        a/v for each second of path time before a corner.
        """
        accel, fastest = CORNER_ACCEL * self.rig.friction.accel, float(np.max(self._path_speeds))
        ahead = np.arange(0.0, fastest / (2 * accel) + period, period / CLOSE)
        change = np.zeros(len(ahead))
        for path in self.paths:
            before, middle, after = (
                path.position(time + ahead + shift) for shift in (-period, 0.0, period)
            )
            change = np.maximum(change, np.hypot(*(after - 2 * middle + before).T))
        slow = accel * period**2 / np.maximum(change, 1e-12)
        return float(np.sqrt(np.min(slow**2 + 2 * accel / fastest * ahead)))

    def reference(self, memory: FollowMemory, t: float) -> np.ndarray:
        """Return the reference position on each path (P, 2) [m, plate_home] at the time t [s]."""
        time = memory.path_time(t)
        return np.array([path.position(time) for path in self.paths])

    def to_go(self, memory: FollowMemory, t: float) -> float:
        """Return the maximum remaining path length [m]. The remaining length of a path is its
        remaining path time multiplied by its maximum speed."""
        time = memory.path_time(t)
        return max(max(path.duration - time, 0) * path.speed for path in self.paths)

    def errors(self, memory: FollowMemory, parts: Parts, t: float) -> np.ndarray:
        """Return the distance of each part (M,) from its reference [m]. The distance is 0 for a
        part without a path."""
        result = np.zeros(len(parts))
        path, part = matched_rows(memory.match, parts)
        result[part] = np.hypot(*(parts.position[part] - self.reference(memory, t)[path]).T)
        return result

    def finished(self, memory: FollowMemory, t: float) -> bool:
        """Whether all references have reached the ends of their last laps."""
        return memory.path_time(t) >= max(path.duration for path in self.paths) - 1e-6

    def problem(self, memory: FollowMemory, parts: Parts, t: float) -> str:
        """Return a text about the part that is farthest from its reference, with a remedy. The text
        is empty if no error exceeds `max_error_m`."""
        error = self.errors(memory, parts, t)
        if not len(error) or np.max(error) <= self.task.max_error_m:
            return ""
        worst = int(np.argmax(error))
        x, y = parts.position[worst]
        return (
            f"{parts.ids[worst]} at ({x:.3f}, {y:.3f}) m is {error[worst] * 1e3:.1f} mm off its "
            f"path, allowed: {self.task.max_error_m * 1e3:g} mm (max_error_m); reduce speed_mps or "
            "use fewer parts"
        )

    def outcome(self, memory: FollowMemory, t: float) -> str:
        """Return a text that summarises the errors of the parts and the mean speed of the
        references until the time t [s]."""
        text = (
            f"error {1e3 * memory.rms_error_m:.2f} mm RMS, maximum {1e3 * memory.max_error_m:.2f}"
        )
        if memory.approach_s > 0:
            text += f"; {memory.approach_s:.1f} s of the time to reach the starts of the paths"
        pace = memory.pace(t)
        if pace >= SLOWED:
            return text
        fastest = 1e3 * float(np.max(self._path_speeds))
        return (
            f"{text}; slowed down to {100 * pace:.0f} % of the requested speed: speed_mps is "
            f"{1e-3 * fastest:g}, advised: {1e-3 * fastest * pace:.2g}"
        )

    def bias_axes(self, memory: FollowMemory | None, parts: Parts, t: float) -> np.ndarray:
        """Return unit vectors (M, 2, 2), in rows, along and across each part's path."""
        axes = super().bias_axes(memory, parts, t)
        if memory is not None:
            path, part = matched_rows(memory.match, parts)
            time = memory.path_time(t)
            along = np.array([reference.heading(time) for reference in self.paths])
            across = np.column_stack([-along[:, 1], along[:, 0]])
            axes[part] = np.stack([along, across], axis=1)[path]
        return axes

    def bias_limit(self, memory: FollowMemory | None, parts: Parts, period: float) -> np.ndarray:
        """Return the maximum drift bias of each part (M,) [m/s]. The maximum is 0 for parts without
        a path."""
        limit = np.zeros(len(parts))
        if memory is not None:
            path, part = matched_rows(memory.match, parts)
            limit[part] = BIAS_MAX * self._path_speeds[path]
        return limit

    def _make_request(self, memory: FollowMemory, now: Situation) -> DriftInterval:
        """Return the requested drift of each part. For parts without a path, the only request is to
        stay on the plate."""
        speed, half = float(np.max(self._path_speeds)), self.rig.plate.half
        intervals = [
            stay_within(now.parts.position[:, k], half[k], *EDGE, speed, 2 * speed)
            for k in range(2)
        ]
        low, high = (np.column_stack(ends) for ends in zip(*intervals, strict=True))
        path, part = matched_rows(memory.match, now.parts)
        # While the latency is unknown, prediction errors may be larger than the motion of the
        # parts.
        scaling = 1.0 if now.latency_known else memory.scaling[1]
        # A cycle may be executed 1 + `late` times before the cycle of the next result begins. The
        # sum of these executions must give one correction.
        times = 1 + now.late
        low[part] = high[part] = pd_drift(
            now.predicted[part],
            self.reference(memory, now.start)[path],
            self.reference(memory, now.start + now.period)[path],
            now.period,
            self.options.kp / times,
            max(SPEED_RATIO_MAX / times, 1.0) * scaling * self._path_speeds[path],
        )
        return DriftInterval(low, high)

    @property
    def _labels(self) -> list[str]:
        return [path.label for path in self.task.paths]

    @cached_property
    def _path_speeds(self) -> np.ndarray:
        """Maximum speed of each path (P,) [m/s]."""
        return np.array([path.speed for path in self.paths])


def _undetected_ids(memory: FollowMemory, parts: Parts) -> tuple[str, ...]:
    """Return the ids of parts that are assigned to paths but not contained in `parts`."""
    return tuple(i for i in memory.match if i not in parts.ids and i != UNMATCHED)
