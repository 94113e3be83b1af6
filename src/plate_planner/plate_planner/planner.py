"""The planner: one image's parts in, what is asked of them out. Pure; time is an argument."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from plate_core import Parts, PlateCycle, Rig, Wanted
from plate_core.tasks import AssembleTask, FollowTask, PoseTask, Scenario, SortTask
from plate_core.tasks import check_scenario as check

from .ages import Ages
from .assembling import AssembleOptions, Assembly
from .bins import check_bins
from .clock import CycleClock
from .following import Follower, FollowState
from .pd import FollowOptions
from .plight import plight_of
from .posing import PoseOptions, Poser, PoseState
from .progress import Progress
from .requests import Asked, DriftRequest
from .sorting import Sorter, SortOptions
from .task import NEARER_M, Findings, Phase, TaskLimits, TaskState, begin, judge, started, stopped
from .watch import Watch, missing_parts, on_plate

NOTHING = Wanted.make(Parts.make((), np.zeros((0, 2))))
"""Nothing is asked of any part: the plate rests."""


@dataclass(frozen=True)
class PlannerOptions:
    """All that can be tuned.

    Attributes
    ----------
    sort : SortOptions
    follow : FollowOptions
    assemble : AssembleOptions
    pose : PoseOptions
    default_period : float
        Length of a cycle until two images have told it [s].
    wait_s : float
        Longest time from start until all parts are seen [s].
    patience_s : float
        A part unseen for longer than this is lost [s].
    stuck_s : float
        A task that comes no nearer to its goal for longer than this is stuck [s].
    image_age_s : float or None
        How old an image is at its stamp [s]; None: found out from the motion.
    """

    sort: SortOptions = field(default_factory=SortOptions)
    follow: FollowOptions = field(default_factory=FollowOptions)
    assemble: AssembleOptions = field(default_factory=AssembleOptions)
    pose: PoseOptions = field(default_factory=PoseOptions)
    default_period: float = 0.1
    wait_s: float = 10.0
    patience_s: float = 1.0
    stuck_s: float = 30.0
    image_age_s: float | None = None


@dataclass(frozen=True)
class PlannerState:
    """What the planner remembers from image to image.

    Attributes
    ----------
    task : TaskState
    clock : CycleClock
    watch : Watch
        Estimate of the parts.
    follow : FollowState
    pose : PoseState
    asked : Asked
        The last request.
    known : tuple of str
        Ids in the last image with all parts.
    answer : (Wanted, Progress) or None
        Answer to the last image, given again when the same image comes again.
    """

    task: TaskState
    clock: CycleClock
    watch: Watch
    follow: FollowState = field(default_factory=FollowState)
    pose: PoseState = field(default_factory=PoseState)
    asked: Asked = field(default_factory=Asked)
    known: tuple[str, ...] = ()
    answer: tuple[Wanted, Progress] | None = None

    @property
    def period(self) -> float:
        """Length of a cycle [s]: of the one that runs, or what the images' stamps tell."""
        return self.watch.log.period if self.watch.log.known else self.clock.period

    @property
    def next_start(self) -> float:
        """Stamp at which the answer to the last image begins to act [s]."""
        return self.watch.log.end if self.watch.log.known else self.watch.stamp + self.clock.period


@dataclass(frozen=True)
class View:
    """What one image means for the task.

    Attributes
    ----------
    findings : Findings
    request : DriftRequest or None
        What is wanted of the parts, if the task goes on.
    count : int
        Parts that are where they belong.
    error : (K,)
        Distances of parts from where they should be now [m].
    """

    findings: Findings
    request: DriftRequest | None
    count: int = 0
    error: np.ndarray = field(default_factory=lambda: np.zeros(0))


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
        check(self.scenario, self.rig)
        check_bins(self.scenario, self.rig)

    @property
    def limits(self) -> TaskLimits:
        """When to give up, and when to call it done."""
        task = self.scenario.task
        return TaskLimits(
            time_limit_s=self.scenario.time_limit_s,
            hold_s=0.0 if isinstance(task, FollowTask) else task.hold_s,
            wait_s=self.options.wait_s,
            patience_s=self.options.patience_s,
            stuck_s=self.options.stuck_s,
            # References are known without noise: however slow, they come nearer or stand still.
            nearer_m=0.0 if isinstance(task, FollowTask) else NEARER_M,
        )

    def initial(self) -> PlannerState:
        """Return the state of a planner that has seen nothing and does nothing."""
        clock = CycleClock.starting(self.options.default_period)
        facts = self.rig.friction.accel, self.rig.parts.mass_kg
        watch = Watch(*facts, ages=Ages.known(self.options.image_age_s))
        return PlannerState(TaskState(), clock, watch)

    def start(self, state: PlannerState) -> PlannerState:
        """Start the task, or start it again; its time begins when all parts are seen twice."""
        return replace(state, task=started(), follow=FollowState(), pose=PoseState(), asked=Asked())

    def stop(self, state: PlannerState, why: str = "stopped") -> PlannerState:
        """Stop: nothing is asked from the next image on; a running task is aborted, `why`."""
        return replace(state, task=stopped(state.task, state.clock.stamp, why))

    def hear(self, state: PlannerState, cycle: PlateCycle, arrival: float) -> PlannerState:
        """Take in a cycle that the solver sent, and when [s, the time of the stamps].

        Without it the planner takes parts to do as was asked of them.
        """
        return replace(state, watch=state.watch.hear(cycle, arrival))

    def plan(
        self, state: PlannerState, parts: Parts, t: float
    ) -> tuple[PlannerState, Wanted, Progress]:
        """Answer one image.

        Parameters
        ----------
        state : PlannerState
        parts : Parts
            Parts as vision saw them.
        t : float
            Stamp of the image [s]. The same stamp again gives the same answer again; an earlier
            one means that the source was started again, and a running task begins again too.

        Returns
        -------
        state : PlannerState
        wanted : Wanted
            Of the same parts; of none when nothing is asked.
        progress : Progress
        """
        if state.answer is not None and t == state.clock.stamp:
            return state, *state.answer
        if state.clock.went_back(t) and state.task.phase is Phase.RUNNING:
            state = self.start(state)
        state = replace(state, clock=state.clock.tick(t), watch=state.watch.look(parts, t))
        turns = isinstance(self.scenario.task, PoseTask)  # the watch takes parts for points
        inside = on_plate(parts if turns else state.watch.parts, self.rig)
        state, view = self._advance(state, inside, t)
        wanted = NOTHING
        if state.task.active and view.request is not None and len(inside):
            wanted, state = self._ask(state, inside, view.request, t)
        progress = self._progress(state, len(inside), view, t)
        return replace(state, answer=(wanted, progress)), wanted, progress

    def _advance(self, state: PlannerState, parts: Parts, t: float) -> tuple[PlannerState, View]:
        """Bring the task up to date."""
        missing = missing_parts(self.scenario, state.known, parts)
        again = set(state.known) == set(parts.ids) <= set(state.watch.seen.ids)
        task = begin(state.task, t, missing, again, self.limits)
        begins = task.active and not state.task.active
        state = replace(state, task=task, known=state.known if missing else parts.ids)
        if isinstance(self._rules, Sorter):
            view = self._sort(self._rules, state, parts, missing)
        elif isinstance(self._rules, Poser):
            state, view = self._pose(self._rules, state, parts, missing, t, begins)
        elif isinstance(self._rules, Assembly):
            view = self._assemble(self._rules, state, parts, missing)
        else:
            state, view = self._follow(self._rules, state, parts, t, begins)
        return replace(state, task=judge(task, t, view.findings, self.limits)), view

    @cached_property
    def _rules(self) -> Sorter | Assembly | Poser | Follower:
        """The rules of the task: kept, since they hold tables of paths and bins."""
        task = self.scenario.task
        if isinstance(task, SortTask):
            return Sorter(task, self.rig)
        if isinstance(task, AssembleTask):
            return Assembly(task, self.rig)
        if isinstance(task, PoseTask):
            return Poser(task, self.rig)
        return Follower(task, self.rig)

    def _sort(
        self, sorter: Sorter, state: PlannerState, parts: Parts, missing: tuple[str, ...]
    ) -> View:
        to_go = sorter.to_go(parts)
        count = int(np.sum(to_go == 0))
        met = count == np.count_nonzero(~np.isnan(to_go))
        to_go = np.nan_to_num(to_go)
        plight = plight_of(state.asked, self.rig, parts, to_go)
        found = Findings(missing, met, float(np.sum(to_go)), plight=plight)
        return View(found, sorter.request(parts, state.period, self.options.sort), count)

    def _assemble(
        self, assembly: Assembly, state: PlannerState, parts: Parts, missing: tuple[str, ...]
    ) -> View:
        distance = assembly.distance(parts)  # NaN for a part that has no place
        error = distance[~np.isnan(distance)]
        count = int(np.sum(error <= assembly.task.tolerance_m))
        plight = plight_of(state.asked, self.rig, parts, np.nan_to_num(distance))
        met = count == len(assembly.task.place)
        found = Findings(missing, met, float(np.sum(error)), plight=plight)
        request = assembly.request(parts, state.period, self.options.assemble)
        return View(found, request, count, error)

    def _pose(
        self,
        poser: Poser,
        state: PlannerState,
        parts: Parts,
        missing: tuple[str, ...],
        t: float,
        begins: bool,
    ) -> tuple[PlannerState, View]:
        if not state.task.active:
            return state, View(Findings(missing, False, 0.0), None)
        pose = poser.begin(parts) if begins else state.pose
        distance, angle = poser.errors(pose, parts)
        short = distance + self.rig.parts.radius_m * np.abs(angle)  # the way of the rim
        count, plight = poser.count(pose, parts), plight_of(state.asked, self.rig, parts, short)
        met, problem = count == len(poser.task.poses), poser.problem(pose, parts)
        found = Findings(missing, met, float(np.sum(short)), problem, plight)
        ahead = state.asked.places(parts, t, state.period)
        pose, request = poser.request(pose, parts, ahead, state.period, self.options.pose)
        return replace(state, pose=pose), View(found, request, count, distance)

    def _follow(
        self, follower: Follower, state: PlannerState, parts: Parts, t: float, begins: bool
    ) -> tuple[PlannerState, View]:
        period, options, follow = state.period, self.options.follow, state.follow
        start = state.next_start
        if not state.task.active:
            return state, View(Findings((), False, 0.0), None)
        known = state.watch.log.known
        if begins or (known and t < follow.began - period / 2):
            # How long the solver's cycles are is known from the first that runs: so wait for it.
            follow = follower.begin(parts, start if known else start + period)
        hoped = state.asked.places(parts, t, period)
        ahead = state.watch.ahead(parts.ids)
        if ahead is None:
            ahead = hoped
        short = np.hypot(*(hoped - ahead).T) / period
        age = state.watch.ages.age if state.watch.ages.found or not known else None
        follow = follower.observe(follow, parts, t, ahead, start, age, options)
        follow = follower.measure(follow, parts, t, start, short, options)
        error = follower.errors(follow, parts, t)
        found = Findings(
            follower.missing(follow, parts),
            follower.finished(follow, t),
            follower.to_go(follow, t),
            follower.problem(follow, parts, t, options),
            plight_of(state.asked, self.rig, parts, error),
        )
        request = follower.request(follow, parts, ahead, start, period, options)
        return replace(state, follow=follow), View(found, request, 0, error)

    def _ask(
        self, state: PlannerState, parts: Parts, request: DriftRequest, t: float
    ) -> tuple[Wanted, PlannerState]:
        """Put a request into forces, and remember the drift that they lead to."""
        task, period = self.scenario.task, state.period
        kinds = {SortTask: "sort", AssembleTask: "assemble", PoseTask: "pose", FollowTask: "follow"}
        share = getattr(self.options, kinds[type(task)]).force_share_max
        free = isinstance(task, SortTask | AssembleTask)  # following has an observer of its own
        velocity = parts.velocity + (state.watch.surprise(parts.ids) if free else 0.0)
        force, tolerance = request.force(velocity, self.rig, period, share)
        drift = velocity + force * period / self.rig.parts.mass_kg
        state = replace(state, asked=Asked(parts.ids, drift, t, force))
        poser, torque = self._rules, np.zeros(len(parts))
        if isinstance(poser, Poser):
            torque = poser.torque(state.pose, parts, period)
        return Wanted(parts, force, tolerance, torque), state

    def _progress(self, state: PlannerState, seen: int, view: View, t: float) -> Progress:
        rms, most = state.follow.rms_error_m, state.follow.max_error_m
        if isinstance(self.scenario.task, AssembleTask | PoseTask) and len(view.error):
            rms, most = float(np.sqrt(np.mean(view.error**2))), float(np.max(view.error))
        return Progress(
            phase=state.task.phase.value,
            text=state.task.text,
            time_s=state.task.elapsed(t),
            parts_total=self.scenario.count,
            parts_seen=seen,
            parts_sorted=view.count,
            to_go_m=view.findings.to_go_m,
            rms_error_m=rms,
            max_error_m=most,
            pace=state.follow.paces[1],
            period_s=state.period,
            image_age_s=state.watch.ages.age,
        )
