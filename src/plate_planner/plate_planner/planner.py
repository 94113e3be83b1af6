"""Planner of a task. The planner computes the request to the solver once per plate cycle.

The inputs are the parts in the images, the cycles that were sent and started, and the scenario. The
estimator predicts the states of the parts. The task rules return drifts or targets. The supervision
decides whether the task continues. All functions are pure; the time is an argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from plate_core import (
    NAMELESS,
    CycleRequest,
    Parts,
    PlateCycle,
    PlateError,
    Rig,
    Targets,
    part_class,
)
from plate_core.tasks import (
    FeedMode,
    FeedOrder,
    FeedTask,
    MoveTask,
    PartTarget,
    Scenario,
    check_scenario,
    edge_doubts,
    pick_problem,
    target_problem,
)

from .estimation import MISSED_IMAGES, Coast, Estimator
from .supervision import (
    STOP,
    Failure,
    Findings,
    LastSeen,
    Phase,
    Progress,
    Reason,
    TaskLimits,
    TaskState,
    begin,
    bystanders_text,
    evaluate,
    is_bystander,
    loss_of,
    missing_parts,
    outlook,
    shortfall_text,
    started,
    stopped,
    without_surplus,
)
from .tasks import CROWD, Assessment, DriftInterval, Situation, TaskOptions, TaskRules, rules_for

NOTHING = CycleRequest.make(Parts.make((), np.zeros((0, 2))))
"""Empty request: the plate rests."""

TAKEN_COAST = Coast(parts=1, unknown=1)
"""Value of `MISSED_IMAGES` for tasks in which parts are added and removed. It is small, because a
part that is not detected may have been picked."""

IN_MOTION_S = 0.1
"""Length of cycles that start from a moving plate [s]. If images are not taken at cycle starts and
`answer_s` is at least this length, all cycles start from rest."""

MAX_GAP_S = 10.0
"""Maximum difference between the stamps of two images of a running task [s]. An interruption of
images of this length would end the task. Therefore a larger difference means that the clock was
set."""


@dataclass(frozen=True)
class PlannerOptions(TaskOptions):
    """Options of the planner. The options of each task are in `TaskOptions`.

    Attributes
    ----------
    default_period : float
        Length of a cycle that is assumed until two images determine it [s].
    start_timeout_s : float
        Maximum time from the start of the task until all parts are detected [s].
    unseen_timeout_s : float
        Maximum time without a detection before a part counts as lost [s].
    stuck_timeout_s : float
        Maximum time without progress before the task counts as stuck [s].
    answer_s : float
        Time before the next cycle start at which the request is sent [s]. It is used if images are
        not taken at cycle starts. It covers the computing times of solver and driver, and the
        connection.
    image_age_s : float or None
        Age of an image at its stamp [s]. If None, the age is estimated from the motion of the
        parts.
    """

    default_period: float = 0.1
    start_timeout_s: float = 10.0
    unseen_timeout_s: float = 1.0
    stuck_timeout_s: float = 30.0
    answer_s: float = 0.08
    image_age_s: float | None = None


@dataclass(frozen=True)
class PlannerState:
    """State of the planner between two images.

    Attributes
    ----------
    task : TaskState
    estimator : Estimator
    memory
        Memory of the task rules; None before the task begins.
    known : tuple of str
        Ids in the last image that showed all parts.
    last : mapping of str to LastSeen
        Last detected position of each part on the plate. Empty if parts are added and removed.
    answer : (CycleRequest, Progress) or None
        The last result. If the same image arrives again, this result is returned again. None before
        the first image.
    due : float
        Time of the next request [s]. Infinite until a cycle start is reported.
    kept : bool
        Whether the last image was ignored: see `TaskRules.keeps_last`.
    """

    task: TaskState
    estimator: Estimator
    memory: Any = None
    known: tuple[str, ...] = ()
    last: Mapping[str, LastSeen] = field(default_factory=dict)
    answer: tuple[CycleRequest, Progress] | None = None
    due: float = np.inf
    kept: bool = False


@dataclass(frozen=True)
class Planner:
    """Planner for one scenario on one rig.

    Begin with `state = planner.start(planner.initial())`. The next calls depend on the camera. If
    the camera is triggered at cycle starts, call `state, request, progress = planner.plan(state,
    parts, t)` for every image. If the camera is free-running, call `state = planner.see(state,
    parts, t)` for every image, `state = planner.started(state, cycle, t)` for every cycle that the
    plate begins, and at the time `state.due` call `state, request, progress =
    planner.answer(state)`.
    """

    rig: Rig
    scenario: Scenario
    options: PlannerOptions = field(default_factory=PlannerOptions)

    def __post_init__(self) -> None:
        check_scenario(self.scenario, self.rig)
        self.rules.check(self.scenario)

    @cached_property
    def rules(self) -> TaskRules:
        """Rules of the task. The rules are cached, because they contain tables of paths and
        bins."""
        return rules_for(self.scenario.task, self.rig, self.options)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings on requests that are infeasible on this rig, with remedies. The warnings
        are shown before the start."""
        slow = outlook(self.rig, self.scenario.count, self.scenario.time_limit_s)
        warnings = (*self.rules.warnings(), *edge_doubts(self.scenario, self.rig))
        return (*warnings, slow) if slow else warnings

    @property
    def limits(self) -> TaskLimits:
        """Time limits of the task."""
        endless = self.rules.endless
        return TaskLimits(
            time_limit_s=self.scenario.time_limit_s,
            hold_s=np.inf if endless else self.rules.hold_s,
            start_timeout_s=self.options.start_timeout_s,
            unseen_timeout_s=self.options.unseen_timeout_s,
            stuck_timeout_s=np.inf if endless else self.options.stuck_timeout_s,
            nearer_m=self.rules.nearer_m,
        )

    def initial(self, estimator: Estimator | None = None) -> PlannerState:
        """Return the idle state of a planner. `estimator` may be the estimator of an earlier
        planner."""
        options = self.options
        if estimator is None:
            estimator = Estimator.of(self.rig, options.default_period, options.image_age_s)
        return PlannerState(TaskState(), estimator, known=estimator.seen.ids)

    def start(self, state: PlannerState) -> PlannerState:
        """Start or restart the task. The time of the task begins when two images have shown all
        parts."""
        return replace(state, task=started(), memory=None, last={})

    def stop(self, state: PlannerState, why: Failure = STOP) -> PlannerState:
        """Stop the task. From the next image on, the planner requests no motion. A running task is
        aborted with the reason `why`."""
        stamp = state.estimator.stamp
        return replace(state, task=stopped(state.task, stamp if np.isfinite(stamp) else None, why))

    def retarget(
        self, state: PlannerState, targets: Sequence[PartTarget]
    ) -> tuple[Planner, PlannerState, tuple[str, ...]]:
        """Change the targets of some parts in a running `move` task.

        Returns
        -------
        planner : Planner
            Planner with the new targets, which replaces this planner.
        state : PlannerState
        refused : tuple of str
            Reasons why targets were refused. The other targets are accepted.

        Raises
        ------
        PlateError
            If no `move` task runs.
        """
        task = self.scenario.task
        if not isinstance(task, MoveTask) or state.task.phase is not Phase.RUNNING:
            raise PlateError("targets: no task of kind move runs")
        known = {*state.known, *state.estimator.seen.ids}
        force, refused = {target.id: target for target in task.targets}, []
        for target in targets:
            problem = f"{target.id[:50]} is unknown, allowed: {', '.join(sorted(known))}"
            if target.id in known:
                problem = target_problem(target, self.scenario, self.rig)
            if problem:
                refused.append(f"targets: {problem}")
            else:
                force[target.id] = target
        if tuple(force.values()) == task.targets:
            return self, state, tuple(refused)
        scenario = replace(self.scenario, task=replace(task, targets=tuple(force.values())))
        t = state.estimator.stamp
        task_state = replace(state.task, met_since=None, nearest_m=np.inf, nearest_at=t)
        return replace(self, scenario=scenario), replace(state, task=task_state), tuple(refused)

    def order(self, state: PlannerState, order: FeedOrder) -> Planner:
        """Return a planner with another order for a running `feed` task. The result replaces this
        planner.

        Raises
        ------
        PlateError
            If no `feed` task runs, or if the order does not fit the rig or the recipe.
        """
        task = self.scenario.task
        if not isinstance(task, FeedTask) or state.task.phase is not Phase.RUNNING:
            raise PlateError("feed_orders: no task of kind feed runs")
        known = [group.label for group in self.scenario.parts]
        for pick in order.picks:
            problem = (
                pick_problem(pick, self.rig)
                if pick.label in known
                else (f"class is {pick.label[:50]!r}, allowed: {', '.join(known)}")
            )
            if problem:
                raise PlateError(f"feed_orders: {problem}")
        if order.mode is FeedMode.PURGE and task.chute is None:
            raise PlateError("feed_orders: mode is purge, which requires a chute in the recipe")
        return replace(self, scenario=replace(self.scenario, task=replace(task, order=order)))

    def record_cycle(
        self, state: PlannerState, cycle: PlateCycle, arrival: float, requested: float | None = None
    ) -> PlannerState:
        """Record a cycle that arrived from the solver at `arrival` [s, the time of the stamps].

        `requested` is the start of the cycle at which the image of its request was taken [s].
        Default: the start of the running cycle. Until a cycle is recorded, the planner assumes that
        the parts follow the requests.
        """
        return replace(state, estimator=state.estimator.record_cycle(cycle, arrival, requested))

    def started(
        self, state: PlannerState, cycle: PlateCycle, begin: float, triggered: bool = False
    ) -> PlannerState:
        """Record that the plate began a cycle at `begin` [s, the time of the stamps]. `triggered`
        states whether images are taken at cycle starts although starts are reported."""
        due = begin + max(cycle.period - self.options.answer_s, 0.0)
        estimator = state.estimator.started(cycle, begin, triggered)
        return replace(state, estimator=estimator, due=due)

    def see(self, state: PlannerState, parts: Parts, t: float) -> PlannerState:
        """Record the detected parts of an image and its stamp [s].

        If the stamp is earlier than the last stamp, a running task restarts. If it is more than
        `MAX_GAP_S` later, the task ends.
        """
        clock = state.estimator.clock
        if state.task.phase is not Phase.RUNNING or clock.stamp is None:
            pass
        elif clock.went_back(t):
            state = self.start(state)
        elif t - clock.stamp > MAX_GAP_S:
            gap = f"no parts for {t - clock.stamp:.0f} s according to the image stamps"
            state = self.stop(
                state, Failure(Reason.NO_PARTS, f"{gap}; check whether the camera's clock was set")
            )
        kept = state.task.active and self.rules.keeps_last(state.memory)
        parts = state.estimator.seen if kept else parts
        coast = TAKEN_COAST if self.rules.open_ended else MISSED_IMAGES
        return replace(state, estimator=state.estimator.update(parts, t, coast), kept=kept)

    def plan(
        self, state: PlannerState, parts: Parts, t: float
    ) -> tuple[PlannerState, CycleRequest, Progress]:
        """Return the request for an image that was taken at the start of a cycle.

        Parameters
        ----------
        state : PlannerState
        parts : Parts
            Detected parts.
        t : float
            Stamp of the image [s]. If it is equal to the last stamp, the last request is returned
            again, or `NOTHING` if the task has ended since then. An earlier stamp means that the
            source of the images was restarted. In this case a running task restarts.

        Returns
        -------
        state : PlannerState
        request : CycleRequest
            Request for these parts. The request is `NOTHING` if the plate should rest.
        progress : Progress
        """
        if state.answer is not None and t == state.estimator.clock.stamp:
            request, progress = state.answer
            return state, request if state.task.active else NOTHING, progress
        return self.answer(self.see(state, parts, t))

    def answer(self, state: PlannerState) -> tuple[PlannerState, CycleRequest, Progress]:
        """Return the request for the next cycle from the images recorded so far. The result is the
        same as in `plan`."""
        estimator = state.estimator
        there, last = estimator.parts, state.last
        if self.rules.open_ended:  # parts may be removed at any time
            there = self._without_doubles(there, estimator.seen)
        else:
            there = self._without_doubles(there, estimator.seen, NAMELESS)
            last = self._last_seen(last, there, estimator.stamp)
        present = without_surplus(self._on_plate(there), self._labels)
        state = replace(state, last=last, due=np.inf)
        state, assessment = self._advance(state, present)
        request = NOTHING
        going_on = state.task.active and not state.task.held(estimator.stamp, self.limits)
        if going_on and assessment.request is not None and len(present):
            state, request = self._request(state, present, assessment.request)
        progress = self._progress(state, present, assessment)
        return replace(state, answer=(request, progress)), request, progress

    @property
    def _labels(self) -> tuple[str, ...]:
        """Classes of the task's parts."""
        return tuple(group.label for group in self.scenario.parts)

    def _mine(self, ids: Sequence[str]) -> set[str]:
        """Return the ids without the ids of objects that do not belong to the task."""
        return {name for name in ids if not is_bystander(name, self._labels)}

    def _on_plate(self, parts: Parts) -> Parts:
        """Return the parts whose centres are on the plate. The other parts have left the plate."""
        keep = np.all(np.abs(parts.position) <= self.rig.plate.half, axis=1)
        return parts if np.all(keep) else parts.take(np.flatnonzero(keep))

    def _without_doubles(
        self, parts: Parts, seen: Parts, classes: tuple[str, ...] | None = None
    ) -> Parts:
        """Return the parts without each undetected part at whose position another part is detected.
        Both are the same part, which was hidden and has a new id. `classes` limits this to some
        classes."""
        label = [part_class(name) for name in parts.ids]
        missing = [name not in seen.ids for name in parts.ids]
        if classes is not None:
            missing = [
                hidden and each in classes for hidden, each in zip(missing, label, strict=True)
            ]
        if not any(missing):
            return parts
        reach = np.array([self.rig.part_type(each).reach_m for each in label])
        away = np.hypot(*(parts.position[:, None] - seen.position[None]).transpose(2, 0, 1))
        double = np.array(missing) & np.any(away < reach[:, None], axis=1)
        return parts.take(np.flatnonzero(~double)) if np.any(double) else parts

    def _last_seen(
        self, before: Mapping[str, LastSeen], parts: Parts, t: float
    ) -> Mapping[str, LastSeen]:
        """Return the last position and stamp of each part. If a part has left the plate, this is
        its first position outside the plate."""
        half = self.rig.plate.half
        off = {name for name, at in before.items() if np.any(np.abs(at.position) > half)}
        on = np.all(np.abs(parts.position) <= half, axis=1)
        seen = zip(parts.ids, parts.position.tolist(), on, strict=True)
        now = {i: LastSeen((x, y), t) for i, (x, y), back in seen if back or i not in off}
        return {**before, **now}

    def _advance(self, state: PlannerState, parts: Parts) -> tuple[PlannerState, Assessment]:
        """Update the state of the task, and evaluate it by its rules."""
        t, count = state.estimator.stamp, self.scenario.count
        comes_and_goes = self.rules.open_ended
        missing = () if comes_and_goes else missing_parts(self.scenario, state.known, parts)
        seen = set(state.estimator.seen.ids)
        mine = self._mine(parts.ids)  # other objects do not prevent the start
        again = comes_and_goes or self._mine(state.known) == mine <= seen
        task = begin(state.task, t, missing, again, self.limits, self.others(parts))
        estimator = self._observe(state, parts, task.active and not state.task.active)
        now = self._situation(estimator, state, parts, task.active)
        memory, assessment = self.rules.assess(state.memory, now)
        began = t if task.began is None else task.began
        findings = Findings(
            missing if assessment.missing is None else assessment.missing,
            assessment.goal_met,
            assessment.to_go_m,
            assessment.problem,
            lambda: shortfall_text(estimator.request, self.rig, parts, assessment.distance, count),
            "; ".join(filter(None, (assessment.outcome, self.others(parts)))),
            lambda name: loss_of(name, state.last.get(name), began, self.rig, count, parts),
            not missing_parts(self.scenario, state.known, self._on_plate(estimator.seen)),
            estimator.at_rest,
            estimator.unanswered_problem,
        )
        task = evaluate(task, t, findings, self.limits)
        known = state.known if missing else parts.ids
        return replace(
            state, task=task, estimator=estimator, memory=memory, known=known
        ), assessment

    def others(self, parts: Parts) -> str:
        """Return a text on unknown objects on the plate. The text is empty for tasks in which parts
        are added and removed, because these tasks count unknown objects themselves."""
        return "" if self.rules.open_ended else bystanders_text(parts, self._labels)

    def _observe(self, state: PlannerState, parts: Parts, begins: bool) -> Estimator:
        """Update the drift bias by the prediction error. Reset the drift bias when a task
        begins."""
        estimator, rules = state.estimator, self.rules
        if begins:
            estimator = estimator.begin_task()
        axes = rules.bias_axes(state.memory, parts, estimator.stamp - estimator.period / 2)
        limit = rules.bias_limit(state.memory, parts, estimator.period)
        predicted = estimator.predict(parts)
        return estimator.observe(parts, predicted, axes, rules.bias_gain, limit)

    def _situation(
        self, estimator: Estimator, state: PlannerState, parts: Parts, active: bool
    ) -> Situation:
        """Return the input of the task rules."""
        period, start, place = estimator.period, estimator.next_start, estimator.bias.place
        axes = self.rules.bias_axes(state.memory, parts, start - period / 2)
        return Situation(
            parts=parts,
            stamp=estimator.stamp,
            start=start,
            rests=estimator.next_rest,
            period=period,
            motion_known=estimator.log.known,
            latency_known=estimator.latency_known or not estimator.log.free_running,
            predicted=place + period * estimator.bias.along(axes),
            shortfall=np.hypot(*(estimator.by_request(parts) - place).T)
            / (start - estimator.stamp),
            active=active,
            seen=self._on_plate(estimator.seen),
            taken=estimator.taken,
            kept=state.kept,
            late=estimator.log.longest_delay,
            resting_since=estimator.resting_since,
        )

    def _request(
        self,
        state: PlannerState,
        parts: Parts,
        content: DriftInterval | Targets,
    ) -> tuple[PlannerState, CycleRequest]:
        """Build the request for the solver. Store the drift that it requests in the estimator."""
        estimator, period = state.estimator, state.estimator.period
        targets = content if isinstance(content, Targets) else None
        if isinstance(content, Targets):
            content = DriftInterval.towards(parts.position, content)
        axes = self.rules.bias_axes(state.memory, parts, estimator.next_start + period / 2)
        content = content.less(estimator.bias.along(axes))
        force, tolerance = content.force(parts, self.rig, period)
        mass = np.array([self.rig.part_type(part_class(name)).mass_kg for name in parts.ids], float)
        drift = parts.velocity + force * period / mass[:, None]
        start = estimator.start_of(parts)
        state = replace(state, estimator=estimator.with_request(parts.ids, drift, force))
        in_time = not estimator.log.free_running or self.options.answer_s < IN_MOTION_S
        plate = estimator.next_plate if in_time and len(parts) <= CROWD else None
        return state, CycleRequest.make(
            parts, force, tolerance, None, period, start, targets, plate
        )

    def _progress(self, state: PlannerState, present: Parts, assessment: Assessment) -> Progress:
        estimator, task = state.estimator, state.task
        doing = ""
        if task.active:
            doing = "; ".join(filter(None, (assessment.doing, self.others(present))))
        return Progress(
            phase=task.phase,
            text=f"{task.text}: {doing}" if doing else task.text,
            time_s=task.elapsed(estimator.stamp),
            parts_total=max(self.scenario.count, assessment.total),
            parts_seen=len(present),
            parts_sorted=assessment.count,
            to_go_m=assessment.to_go_m,
            rms_error_m=assessment.rms_error_m,
            max_error_m=assessment.max_error_m,
            turn_error=assessment.turn_error,
            speed_scaling=assessment.speed_scaling,
            pace=assessment.pace,
            period_s=estimator.period,
            image_age_s=estimator.hypotheses.latency,
        )
