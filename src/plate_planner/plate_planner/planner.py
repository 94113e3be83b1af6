"""Planner of a task. Once per cycle of the plate, the planner computes a request to the solver.

The inputs are the parts in the images, the cycles that were sent to the plate and that the plate
has begun, and the scenario. The estimator predicts the states of the parts. The task rules compute
requested drifts or targets. The supervision decides whether the task continues. All functions are
pure. The time is an argument of the functions.
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
    edge_warnings,
    pick_problem,
    target_problem,
)

from .estimation import MISSED_IMAGES, Coast, Estimator, rows_of
from .supervision import (
    STOP,
    Agreement,
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
"""Empty request, for which the plate rests."""

TAKEN_COAST = Coast(parts=1, unknown=1)
"""Value that replaces `MISSED_IMAGES` in tasks in which parts are added and removed. The value is
small, because a part that is not detected may have been picked."""

IN_MOTION_S = 0.1
"""Length of cycles that start from a moving plate [s]. If images are not taken at cycle starts and
`answer_s` is at least this length, all cycles start from rest."""

MIN_RATIO = 6.0
"""Minimum ratio of the longest distance of a part from its target to the mean prediction error, at
which a motion begins before an image shows the result of the last motion [-]. The value was tuned
in 22 simulations of `assemble_letters` in the gym's world `held_out`. The median plate time is 7.0
s with 3, 6.3 s with 4, and 6.1 s with 6. Without this rule, it is above 15 s."""

MAX_GAP_S = 10.0
"""Maximum difference between the stamps of two consecutive images of a running task [s]. Such a
long interruption of images would have ended the task. Therefore, a larger difference means that a
clock was set."""


@dataclass(frozen=True)
class PlannerOptions(TaskOptions):
    """Options of the planner. The options of the single tasks are in `TaskOptions`.

    Attributes
    ----------
    default_period : float
        Length of a cycle that is assumed until the interval between two images is known [s].
    start_timeout_s : float
        Maximum time from the start of the task until all parts are detected [s].
    unseen_timeout_s : float
        Maximum time without a detection before a part counts as lost [s].
    stuck_timeout_s : float
        Maximum time without progress before the task counts as stuck [s].
    answer_s : float
        Time from a request to the start of the next cycle [s]. The option `answer_s` is used if
        images are not taken at cycle starts. The time must be sufficient for the computations of
        solver and driver, and for the connection to the motors.
    image_age_s : float or None
        Time from the exposure of an image to the time in its stamp [s]. If None, this time is
        estimated from the motion of the parts.
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
        Data that the task rules store between images. None before the task begins.
    known : tuple of str
        Ids of the parts in the last image that showed all parts.
    last : mapping of str to LastSeen
        Last detected position of each part. Empty in tasks in which parts are added and removed.
    last_result : (CycleRequest, Progress) or None
        Result of the last call of `Planner.next_request`. If the same image arrives again, this
        result is returned again. None before the first image.
    due : float
        Time at which the next request must be computed [s]. Infinite until a cycle start is
        reported.
    kept : bool
        Whether the last image was ignored, see `TaskRules.keeps_last`.
    agreement : Agreement
        Agreement of the parts' motion with its prediction since the start of the task.
    """

    task: TaskState
    estimator: Estimator
    memory: Any = None
    known: tuple[str, ...] = ()
    last: Mapping[str, LastSeen] = field(default_factory=dict)
    last_result: tuple[CycleRequest, Progress] | None = None
    due: float = np.inf
    kept: bool = False
    agreement: Agreement = field(default_factory=Agreement)


@dataclass(frozen=True)
class Planner:
    """Planner for one scenario on one rig.

    First call `state = planner.start(planner.initial())`. The following calls depend on the camera.
    If the camera is triggered at cycle starts, call `state, request, progress = planner.plan(state,
    parts, t)` for every image. If the camera is free-running, call `state = planner.see(state,
    parts, t)` for every image, and `state = planner.started(state, cycle, t)` for every cycle that
    the plate begins. At the time `state.due`, call `state, request, progress =
    planner.next_request(state)`.
    """

    rig: Rig
    scenario: Scenario
    options: PlannerOptions = field(default_factory=PlannerOptions)

    def __post_init__(self) -> None:
        check_scenario(self.scenario, self.rig)
        self.rules.check(self.scenario)

    @cached_property
    def rules(self) -> TaskRules:
        """Rules of the task. The object is cached, because it contains tables that take time to
        compute."""
        return rules_for(self.scenario.task, self.rig, self.options)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about requests of the scenario that are infeasible on this rig. Each
        warning contains a remedy. The warnings are shown before the task starts."""
        slow = outlook(self.rig, self.scenario.count, self.scenario.time_limit_s)
        warnings = (*self.rules.warnings(), *edge_warnings(self.scenario, self.rig))
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
        """Return the state of a planner that runs no task. `estimator` can be the estimator of an
        earlier planner."""
        options = self.options
        if estimator is None:
            estimator = Estimator.of(self.rig, options.default_period, options.image_age_s)
        return PlannerState(TaskState(), estimator, known=estimator.seen.ids)

    def start(self, state: PlannerState) -> PlannerState:
        """Return the state after the task was started or restarted. The time limit of the task
        applies from the image at which two images have shown all parts."""
        return replace(state, task=started(), memory=None, last={}, agreement=Agreement())

    def stop(self, state: PlannerState, why: Failure = STOP) -> PlannerState:
        """Return the state after the task was stopped. From the next image on, the planner requests
        no motion. A running task is aborted with the reason `why`."""
        stamp = state.estimator.stamp
        return replace(state, task=stopped(state.task, stamp if np.isfinite(stamp) else None, why))

    def retarget(
        self, state: PlannerState, targets: Sequence[PartTarget]
    ) -> tuple[Planner, PlannerState, tuple[str, ...]]:
        """Change the targets of some parts in a running `move` task.

        Returns
        -------
        planner : Planner
            Planner with the new targets. The caller must use this new planner from now on.
        state : PlannerState
        refused : tuple of str
            Reasons why single targets were refused. All other targets are accepted.

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
        """Return a planner with another order for the running `feed` task. The caller must use the
        returned planner in place of this planner.

        Raises
        ------
        PlateError
            If no `feed` task runs, or the order is infeasible with this rig or this recipe.
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
        """Record a cycle from the solver that arrived at the time `arrival` [s, in the time of the
        image stamps].

        `requested` is the start time of the cycle during which the image for this cycle's request
        was taken [s]. Default: the start of the running cycle. Until the first cycle is recorded,
        the planner assumes that the parts move as requested.
        """
        return replace(state, estimator=state.estimator.record_cycle(cycle, arrival, requested))

    def started(
        self, state: PlannerState, cycle: PlateCycle, begin: float, triggered: bool = False
    ) -> PlannerState:
        """Record that the plate began a cycle at the time `begin` [s, in the time of the image
        stamps]. `triggered` states whether images are taken at cycle starts."""
        due = begin + max(cycle.period - self.options.answer_s, 0.0)
        estimator = state.estimator.started(cycle, begin, triggered)
        return replace(state, estimator=estimator, due=due)

    def see(self, state: PlannerState, parts: Parts, t: float) -> PlannerState:
        """Record the detected parts of an image. `t` is the stamp of the image [s].

        If the stamp is earlier than the last stamp, a running task restarts. If the stamp is later
        than the last stamp by more than `MAX_GAP_S`, a running task ends.
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
        agreement = state.agreement.seeing(parts, t)
        estimator = state.estimator.update(parts, t, coast)
        return replace(state, estimator=estimator, kept=kept, agreement=agreement)

    def plan(
        self, state: PlannerState, parts: Parts, t: float
    ) -> tuple[PlannerState, CycleRequest, Progress]:
        """Record an image that was taken at the start of a cycle, and return the request for the
        next cycle.

        Parameters
        ----------
        state : PlannerState
        parts : Parts
            Detected parts.
        t : float
            Stamp of the image [s]. If the stamp is equal to the last stamp, the last request is
            returned again, or `NOTHING` if the task has ended since then. If the stamp is earlier
            than the last stamp, the source of the images was restarted. In this case, a running
            task restarts too.

        Returns
        -------
        state : PlannerState
        request : CycleRequest
            Request for these parts. The request is `NOTHING` if the plate should rest.
        progress : Progress
        """
        if state.last_result is not None and t == state.estimator.clock.stamp:
            request, progress = state.last_result
            return state, request if state.task.active else NOTHING, progress
        return self.next_request(self.see(state, parts, t))

    def next_request(self, state: PlannerState) -> tuple[PlannerState, CycleRequest, Progress]:
        """Compute the request for the next cycle from the images that were recorded so far. The
        returned values are the same as in `plan`."""
        estimator = state.estimator
        parts, last = estimator.parts, state.last
        if self.rules.open_ended:  # in an open-ended task, parts may be removed at any time
            parts = self._remove_duplicates(parts, estimator.seen)
        else:
            parts = self._remove_duplicates(parts, estimator.seen, NAMELESS)
            detected = parts.take(np.flatnonzero(rows_of(parts.ids, estimator.seen.ids) >= 0))
            last = self._update_last_seen(last, detected, estimator.stamp)
        present = without_surplus(self._on_plate(parts), self._labels)
        state = replace(state, last=last, due=np.inf)
        state, assessment = self._advance_task(state, present)
        request = NOTHING
        going_on = state.task.active and not state.task.held(estimator.stamp, self.limits)
        going_on &= not self._rests_for_image(state.estimator, assessment)
        if going_on and assessment.request is not None and len(present):
            state, request = self._make_request(state, present, assessment.request)
        progress = self._make_progress(state, present, assessment)
        return replace(state, last_result=(request, progress)), request, progress

    def _rests_for_image(self, estimator: Estimator, assessment: Assessment) -> bool:
        """Whether the plate rests for one cycle, so that the next request is based on an image of
        resting parts.

        The plate rests if the parts are so close to their targets that the prediction error of one
        cycle is larger than a fraction 1/`MIN_RATIO` of the longest distance. Otherwise, the parts
        would move around their targets.
        """
        distance = float(np.max(assessment.distance, initial=0.0))
        near = distance < MIN_RATIO * estimator.prediction_error
        return self.rules.precise and near and estimator.moves_before_answer

    @property
    def _labels(self) -> tuple[str, ...]:
        """Classes of the parts in the scenario."""
        return tuple(group.label for group in self.scenario.parts)

    def _task_ids(self, ids: Sequence[str]) -> set[str]:
        """Return those of the ids `ids` that belong to parts of the task. Ids of unknown objects
        are omitted."""
        return {name for name in ids if not is_bystander(name, self._labels)}

    def _on_plate(self, parts: Parts) -> Parts:
        """Return the parts whose centres are on the plate. All other parts have left the plate."""
        keep = np.all(np.abs(parts.position) <= self.rig.plate.half, axis=1)
        return parts if np.all(keep) else parts.take(np.flatnonzero(keep))

    def _remove_duplicates(
        self, parts: Parts, seen: Parts, classes: tuple[str, ...] | None = None
    ) -> Parts:
        """Remove each undetected part at whose predicted position another part is detected. The two
        parts are assumed to be the same part, which was hidden and has a new id. If `classes` is
        given, only parts of these classes are removed."""
        label = [part_class(name) for name in parts.ids]
        missing = rows_of(parts.ids, seen.ids) < 0
        if classes is not None:
            missing &= np.isin(label, classes)
        if not np.any(missing):
            return parts
        reach = np.array([self.rig.part_type(class_name).reach_m for class_name in label])
        distance = np.hypot(*(parts.position[:, None] - seen.position[None]).transpose(2, 0, 1))
        double = missing & np.any(distance < reach[:, None], axis=1)
        return parts.take(np.flatnonzero(~double)) if np.any(double) else parts

    def _update_last_seen(
        self, before: Mapping[str, LastSeen], parts: Parts, t: float
    ) -> Mapping[str, LastSeen]:
        """Return the last position and stamp of each part, given the detected parts. If a part has
        left the plate, its first position outside the plate is used instead."""
        half = self.rig.plate.half
        off = {name for name, last in before.items() if np.any(np.abs(last.position) > half)}
        on = np.all(np.abs(parts.position) <= half, axis=1)
        seen = zip(parts.ids, parts.position.tolist(), on, strict=True)
        now = {i: LastSeen((x, y), t) for i, (x, y), back in seen if back or i not in off}
        return {**before, **now}

    def _advance_task(self, state: PlannerState, parts: Parts) -> tuple[PlannerState, Assessment]:
        """Update the state of the task, and evaluate the task by its rules."""
        t, count = state.estimator.stamp, self.scenario.count
        comes_and_goes = self.rules.open_ended
        missing = () if comes_and_goes else missing_parts(self.scenario, state.known, parts)
        seen = set(state.estimator.seen.ids)
        # parts that the task does not move cannot prevent the start of the task
        own_ids = self._task_ids(parts.ids)
        is_agreed = comes_and_goes or self._task_ids(state.known) == own_ids <= seen
        task = begin(state.task, t, missing, is_agreed, self.limits, self.others(parts))
        estimator = self._update_drift_bias(state, parts, task.active and not state.task.active)
        now = self._make_situation(estimator, state, parts, task.active)
        memory, assessment = self.rules.assess(state.memory, now)
        began = t if task.began is None else task.began
        findings = Findings(
            missing if assessment.missing is None else assessment.missing,
            assessment.goal_met,
            assessment.to_go_m,
            assessment.problem,
            lambda: state.agreement.explained(
                shortfall_text(estimator.request, self.rig, parts, assessment.distance, count)
            ),
            "; ".join(filter(None, (assessment.outcome, self.others(parts)))),
            lambda name: self._loss_of(name, state, began, parts),
            not missing_parts(self.scenario, state.known, self._on_plate(estimator.seen)),
            estimator.at_rest,
            estimator.unanswered_problem,
        )
        task = evaluate(task, t, findings, self.limits)
        known = state.known if missing else parts.ids
        return replace(
            state, task=task, estimator=estimator, memory=memory, known=known
        ), assessment

    def _loss_of(self, name: str, state: PlannerState, began: float, parts: Parts) -> Failure:
        """Return the failure of a task in which a part is lost. `began` is the start of the task
        [s], and `parts` are the parts in the image."""
        count = self.scenario.count
        reason, text = loss_of(name, state.last.get(name), began, self.rig, count, parts)
        return Failure(reason, state.agreement.explained(text))

    def others(self, parts: Parts) -> str:
        """Return a text that lists unknown objects on the plate. The text is empty for tasks in
        which parts are added and removed, because these tasks count unknown objects themselves."""
        return "" if self.rules.open_ended else bystanders_text(parts, self._labels)

    def _update_drift_bias(self, state: PlannerState, parts: Parts, begins: bool) -> Estimator:
        """Update the drift bias by the prediction error. Reset the drift bias when a task
        begins."""
        estimator, rules = state.estimator, self.rules
        if begins:
            estimator = estimator.begin_task()
        axes = rules.bias_axes(state.memory, parts, estimator.stamp - estimator.period / 2)
        limit = rules.bias_limit(state.memory, parts, estimator.period)
        predicted = estimator.predict(parts)
        return estimator.observe(parts, predicted, axes, rules.bias_gain, limit)

    def _make_situation(
        self, estimator: Estimator, state: PlannerState, parts: Parts, active: bool
    ) -> Situation:
        """Collect the inputs of the task rules."""
        period, start, position = estimator.period, estimator.next_start, estimator.bias.position
        axes = self.rules.bias_axes(state.memory, parts, start - period / 2)
        return Situation(
            parts=parts,
            stamp=estimator.stamp,
            start=start,
            rests=estimator.next_rest,
            period=period,
            motion_known=estimator.log.known,
            latency_known=estimator.latency_known or not estimator.log.free_running,
            predicted=position + period * estimator.bias.along(axes),
            shortfall=np.hypot(*(estimator.by_request(parts) - position).T)
            / (start - estimator.stamp),
            active=active,
            seen=self._on_plate(estimator.seen),
            taken=estimator.taken,
            kept=state.kept,
            late=estimator.log.max_delay,
            resting_since=estimator.resting_since,
        )

    def _make_request(
        self,
        state: PlannerState,
        parts: Parts,
        content: DriftInterval | Targets,
    ) -> tuple[PlannerState, CycleRequest]:
        """Build the request to the solver. Store the requested drift in the estimator."""
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
        agreement = state.agreement
        if start is not None:
            position = start[:, :2]
            agreement = agreement.expecting(
                estimator.seen, parts.ids, position, estimator.next_start
            )
        estimator = estimator.with_request(parts.ids, drift, force)
        state = replace(state, estimator=estimator, agreement=agreement)
        in_time = not estimator.log.free_running or self.options.answer_s < IN_MOTION_S
        plate = estimator.next_plate if in_time and len(parts) <= CROWD else None
        return state, CycleRequest.make(
            parts, force, tolerance, None, period, start, targets, plate
        )

    def _make_progress(
        self, state: PlannerState, present: Parts, assessment: Assessment
    ) -> Progress:
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
