"""The planner: one image's parts in, what is asked of them out. Pure; time is an argument."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PartSet, Rig
from plate_core.parts import part_class
from plate_core.scenario import FollowTask, Scenario, SortTask, check_scenario

from .clock import CycleClock
from .following import Follower, FollowState
from .pd import FollowOptions
from .progress import Progress
from .requests import Asked, DriftRequest
from .sorting import SortOptions, is_sorted, part_sides, sort_request
from .task import Phase, TaskLimits, TaskState, begin, judge, started

NOTHING = PartSet.make((), np.zeros((0, 2)))
"""Nothing is asked of any part: the plate rests."""


@dataclass(frozen=True)
class PlannerOptions:
    """All that can be tuned.

    Attributes
    ----------
    sort : SortOptions
    follow : FollowOptions
    default_period : float
        Length of a cycle until two images have told it [s].
    wait_s : float
        Longest time from start until all parts are seen [s].
    patience_s : float
        A part unseen for longer than this is lost [s].
    """

    sort: SortOptions = field(default_factory=SortOptions)
    follow: FollowOptions = field(default_factory=FollowOptions)
    default_period: float = 0.1
    wait_s: float = 10.0
    patience_s: float = 1.0


@dataclass(frozen=True)
class PlannerState:
    """What the planner remembers from image to image.

    Attributes
    ----------
    task : TaskState
    clock : CycleClock
    follow : FollowState
    asked : Asked
        The last request.
    known : tuple of str
        Ids in the last image with all parts: tells which one is missing.
    answer : (PartSet, Progress) or None
        Answer to the last image, given again when the same image comes again.
    """

    task: TaskState
    clock: CycleClock
    follow: FollowState = field(default_factory=FollowState)
    asked: Asked = field(default_factory=Asked)
    known: tuple[str, ...] = ()
    answer: tuple[PartSet, Progress] | None = None


@dataclass(frozen=True)
class Planner:
    """Plans one scenario on one rig.

    Use: `state = planner.start(planner.initial())`, then for every image
    `state, asked, progress = planner.plan(state, parts, t)`.
    """

    rig: Rig
    scenario: Scenario
    options: PlannerOptions = field(default_factory=PlannerOptions)

    def __post_init__(self) -> None:
        check_scenario(self.scenario, self.rig)

    @property
    def limits(self) -> TaskLimits:
        """When to give up, and when to call it done."""
        task = self.scenario.task
        return TaskLimits(
            time_limit_s=self.scenario.time_limit_s,
            hold_s=task.hold_s if isinstance(task, SortTask) else 0.0,
            wait_s=self.options.wait_s,
            patience_s=self.options.patience_s,
        )

    def initial(self) -> PlannerState:
        """Return the state of a planner that has seen nothing and does nothing."""
        clock = CycleClock.starting(self.options.default_period)
        return PlannerState(TaskState(), clock)

    def start(self, state: PlannerState) -> PlannerState:
        """Start the task, or start it again; its time begins when all parts are seen."""
        return replace(state, task=started(), follow=FollowState(), asked=Asked(), known=())

    def stop(self, state: PlannerState) -> PlannerState:
        """Stop: nothing is asked from the next image on."""
        return replace(state, task=TaskState())

    def plan(
        self, state: PlannerState, parts: PartSet, t: float
    ) -> tuple[PlannerState, PartSet, Progress]:
        """Answer one image.

        Parameters
        ----------
        state : PlannerState
        parts : PartSet
            Parts as vision saw them.
        t : float
            Stamp of the image [s]. The same stamp again gives the same answer again; an earlier
            one means that the source was started again, and a running task begins again too.

        Returns
        -------
        state : PlannerState
        asked : PartSet
            The same parts with force and tolerance [N]; no parts when nothing is asked.
        progress : Progress
        """
        if state.answer is not None and t == state.clock.stamp:
            return state, *state.answer
        if state.clock.went_back(t) and state.task.phase is Phase.RUNNING:
            state = self.start(state)
        state = replace(state, clock=state.clock.tick(t))
        on_plate = self._on_plate(parts)
        state, request, sorted_count = self._advance(state, on_plate, t)
        asked = NOTHING
        if request is not None:
            asked, state = self._ask(state, on_plate, request, t)
        progress = self._progress(state, len(on_plate), sorted_count, t)
        return replace(state, answer=(asked, progress)), asked, progress

    def _advance(
        self, state: PlannerState, parts: PartSet, t: float
    ) -> tuple[PlannerState, DriftRequest | None, int]:
        """Bring the task up to date, and say what drift it wants, and how many are sorted."""
        if isinstance(self.scenario.task, SortTask):
            return self._advance_sort(self.scenario.task, state, parts, t)
        return self._advance_follow(self.scenario.task, state, parts, t)

    def _advance_sort(
        self, goal: SortTask, state: PlannerState, parts: PartSet, t: float
    ) -> tuple[PlannerState, DriftRequest | None, int]:
        missing = self._missing(state, parts)
        there = is_sorted(parts, goal, self.rig)
        count = int(np.sum(there))
        goal_met = count == np.count_nonzero(part_sides(parts.ids, goal.sides))
        task = begin(state.task, t, missing, self.limits)
        task = judge(task, t, missing, goal_met, "", self.limits)
        state = replace(state, task=task, known=state.known if missing else parts.ids)
        if not task.active or not len(parts):
            return state, None, count
        request = sort_request(parts, goal, self.rig, state.clock.period, self.options.sort)
        return state, request, count

    def _advance_follow(
        self, goal: FollowTask, state: PlannerState, parts: PartSet, t: float
    ) -> tuple[PlannerState, DriftRequest | None, int]:
        follower = Follower(goal, self.rig)
        period, options = state.clock.period, self.options.follow
        missing = self._missing(state, parts)
        task = begin(state.task, t, missing, self.limits)
        follow = state.follow
        if task.active:
            if not state.task.active:
                follow = follower.begin(parts, t, period)
            follow = follower.measure(follow, parts, t)
            missing = follower.missing(follow, parts)
            problem = follower.problem(follow, parts, t, options)
            task = judge(task, t, missing, follower.finished(follow, t), problem, self.limits)
        known = state.known if missing else parts.ids
        state = replace(state, task=task, follow=follow, known=known)
        if not task.active or not len(parts):
            return state, None, 0
        asked = state.asked.of(parts.ids, t, period)
        return state, follower.request(follow, parts, asked, t, period, options), 0

    def _ask(
        self, state: PlannerState, parts: PartSet, request: DriftRequest, t: float
    ) -> tuple[PartSet, PlannerState]:
        """Put a request into forces, and remember the drift that they lead to."""
        task, period = self.scenario.task, state.clock.period
        options = self.options.sort if isinstance(task, SortTask) else self.options.follow
        force, tolerance = request.force(parts.velocity, self.rig, period, options.force_share_max)
        drift = parts.velocity + force * period / self.rig.parts.mass_kg
        state = replace(state, asked=Asked(parts.ids, drift, t))
        return replace(parts, force=force, tolerance=tolerance), state

    def _on_plate(self, parts: PartSet) -> PartSet:
        """Leave out parts whose centre is beyond the plate's edge: they have fallen off."""
        keep = np.all(np.abs(parts.position) <= self.rig.plate.half, axis=1)
        if np.all(keep):
            return parts
        return PartSet.make(
            tuple(i for i, k in zip(parts.ids, keep, strict=True) if k),
            position=parts.position[keep],
            velocity=parts.velocity[keep],
            angle=parts.angle[keep],
        )

    def _missing(self, state: PlannerState, parts: PartSet) -> tuple[str, ...]:
        """Name the parts of the scenario that are not seen, by id where it is known."""
        seen = Counter(part_class(i) for i in parts.ids)
        names: list[str] = []
        for label, wanted in Counter(self.scenario.labels).items():
            short = wanted - seen[label]
            if short <= 0:
                continue
            gone = [i for i in state.known if part_class(i) == label and i not in parts.ids]
            names += gone[:short] if len(gone) >= short else [f"{short} of {wanted} {label} parts"]
        return tuple(names)

    def _progress(self, state: PlannerState, seen: int, sorted_count: int, t: float) -> Progress:
        return Progress(
            phase=state.task.phase.value,
            text=state.task.text,
            time_s=state.task.elapsed(t),
            parts_total=self.scenario.count,
            parts_seen=seen,
            parts_sorted=sorted_count,
            rms_error_m=state.follow.rms_error_m,
            max_error_m=state.follow.max_error_m,
            period_s=state.clock.period,
        )
