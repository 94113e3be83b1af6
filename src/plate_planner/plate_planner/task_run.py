"""Runs the task of the planner. The state of the parts is also estimated while no task runs. This
module does not use ROS.

`TaskRunner` passes each event (image, cycle start, cycle, targets, order) to the pure functions of
`Planner` and stores the state that they return. If there is no task, it updates only the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from plate_core import CycleRequest, OverlookedThing, Parts, PlateCycle, PlateError, Rig
from plate_core.tasks import FeedOrder, MoveTask, PartTarget

from .estimation import Estimator
from .planner import Planner, PlannerOptions, PlannerState
from .supervision import Failure, Overlooked, Phase, Progress, Reason, TaskState

__all__ = ["Run", "TaskRunner"]

BY_PERSON = (Reason.STOPPED, Reason.CANCELED, Reason.PREEMPTED)
"""Reasons for the end of a task that a user has requested. An end with such a reason is not a
failure."""


@dataclass
class Run:
    """The running task, or the last task if none runs.

    Attributes
    ----------
    planner : Planner
    state : PlannerState
    began : float
        Arrival time of the goal [s, steady clock].
    goal
        Goal handle of the action server.
    finished : bool
        Whether the result was sent to the goal's client.
    progress : Progress or None
        Progress at the time of the last request. None before the first request.
    """

    planner: Planner
    state: PlannerState
    began: float
    goal: Any
    finished: bool = False
    progress: Progress | None = None

    @property
    def name(self) -> str:
        """Kind of the task."""
        return self.planner.scenario.name

    @property
    def task(self) -> TaskState:
        """State of the task."""
        return self.state.task

    @property
    def running(self) -> bool:
        """Whether the task runs."""
        return self.task.phase is Phase.RUNNING

    @property
    def failed(self) -> bool:
        """Whether the task ended without success, for a reason that is not in `BY_PERSON`."""
        return self.task.phase.is_failure and self.task.reason not in BY_PERSON


class TaskRunner:
    """Runs one task at a time. The state of the parts is also estimated while no task runs.

    Parameters
    ----------
    rig : Rig
    options : PlannerOptions

    Attributes
    ----------
    run : Run or None
        Running task, or the last task if no task runs. None if there was no task yet, or after a
        call of `forget`.
    overlooked : Overlooked
        Objects in the images that the detector does not publish as parts.
    """

    def __init__(self, rig: Rig, options: PlannerOptions) -> None:
        self.run: Run | None = None
        self._idle = Estimator.of(rig, options.default_period, options.image_age_s)
        self.overlooked = Overlooked(rig)
        self._others_reported = False

    @property
    def estimator(self) -> Estimator:
        """Estimated state of the parts."""
        return self._idle if self.run is None else self.run.state.estimator

    @property
    def running(self) -> Run | None:
        """The running task. None if no task runs."""
        return self.run if self.run is not None and self.run.running else None

    def seen_without_task(self, stamp: float) -> bool:
        """Whether the last image before the task has the stamp `stamp` [s]."""
        return stamp == self._idle.stamp

    def begin(self, planner: Planner, goal: Any, now: float) -> None:
        """Begin a task at the time `now` [s, steady clock]. `goal` is the task's goal handle."""
        state = planner.start(planner.initial(self.estimator))
        self.run, self._others_reported = Run(planner, state, now, goal), False

    def end(self, why: Failure) -> bool:
        """End the running task. Return whether a task was running."""
        run = self.running
        if run is not None:
            run.state = run.planner.stop(run.state, why)
        return run is not None

    def forget(self) -> None:
        """Delete the last task, but keep the estimated state of the parts."""
        self._idle, self.run = self.estimator, None

    def set_options(self, options: PlannerOptions) -> None:
        """Change the options of the running or last task."""
        if self.run is not None:
            self.run.planner = replace(self.run.planner, options=options)

    # Events

    def record_image(self, things: tuple[OverlookedThing, ...], parts: Parts) -> str:
        """Record the objects of an image that the detector does not publish as parts. If there are
        objects that do not belong to the task, return a warning, at most once per task. Otherwise
        return ""."""
        self.overlooked.add(things, parts)
        text = "" if self._others_reported else self.others()
        self._others_reported = self._others_reported or bool(text)
        return text

    def see(self, parts: Parts, stamp: float) -> None:
        """Record the parts of an image with the stamp `stamp` [s]. Do not compute a request."""
        if self.run is None:
            self._idle = self._idle.update(parts, stamp)
        else:
            self.run.state = self.run.planner.see(self.run.state, parts, stamp)

    def record_start(self, cycle: PlateCycle, begin: float, triggered: bool) -> None:
        """Record that the plate began a cycle at the time `begin` [s, in the time of the image
        stamps]. `triggered` states whether images are taken at cycle starts."""
        if self.run is None:
            self._idle = self._idle.started(cycle, begin, triggered)
        else:
            self.run.state = self.run.planner.started(self.run.state, cycle, begin, triggered)

    def record_cycle(self, cycle: PlateCycle, arrival: float, requested: float) -> None:
        """Record a cycle from the solver that arrived at the time `arrival` [s, in the time of the
        image stamps]. `requested` [s] is the stamp of the request from which this cycle results."""
        if self.run is None:
            self._idle = self._idle.record_cycle(cycle, arrival, requested)
        else:
            self.run.state = self.run.planner.record_cycle(
                self.run.state, cycle, arrival, requested
            )

    # Results

    def plan(self, run: Run, parts: Parts, stamp: float) -> CycleRequest:
        """Record an image that was taken at the start of a cycle, and return the request for the
        next cycle."""
        run.state, request, run.progress = run.planner.plan(run.state, parts, stamp)
        return request

    def next_request(self, run: Run) -> CycleRequest:
        """Return the request for the next cycle, computed from the images recorded so far."""
        run.state, request, run.progress = run.planner.next_request(run.state)
        return request

    def retarget(self, targets: tuple[PartTarget, ...]) -> tuple[str, ...]:
        """Change targets of parts in the running `move` task. Return the reasons why targets were
        refused.

        Raises
        ------
        PlateError
            If no `move` task runs.
        """
        run = self.run
        if run is None:
            raise PlateError("targets: no task of kind move runs")
        run.planner, run.state, refused = run.planner.retarget(run.state, targets)
        return refused

    def order(self, order: FeedOrder) -> None:
        """Change the order of a running `feed` task.

        Raises
        ------
        PlateError
            If no `feed` task runs, or the order is infeasible.
        """
        run = self.run
        if run is None:
            raise PlateError("feed_orders: no task of kind feed runs")
        run.planner = run.planner.order(run.state, order)

    @property
    def targets(self) -> tuple[PartTarget, ...]:
        """Targets of the parts in the running `move` task. Empty if no `move` task runs."""
        task = None if self.running is None else self.running.planner.scenario.task
        return task.targets if isinstance(task, MoveTask) else ()

    def others(self) -> str:
        """Return a text about objects on the plate that do not belong to the task. Return "" if
        there are no such objects, or if no task moves parts."""
        run = self.run
        if run is None or not run.task.active:
            return ""
        count = run.planner.scenario.count
        texts = [run.planner.others(run.state.estimator.seen), self.overlooked.text]
        text = "; ".join(filter(None, texts))
        moves = f"{run.name} moves {count} parts" if count else run.name
        return f"{moves}: {text}" if text else ""
