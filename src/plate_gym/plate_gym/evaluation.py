"""Evaluation of tasks with the true positions of the parts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from plate_bringup.production import REQUESTS, FeederCell, Production
from plate_core import Parts, PlateCycle, PlateError, Rig, part_class
from plate_core.tasks import AssembleTask, FeedTask, FollowTask, PoseTask, SortTask, Task
from plate_planner.tasks import (
    ANGLE_ERROR_RAD,
    POSITION_ERROR_M,
    Assembler,
    Feeder,
    FeedMemory,
    Follower,
    FollowMemory,
    PoseMemory,
    Poser,
    Situation,
    Sorter,
)
from plate_sim.world import Simulation, WorldState

from .tasks import FEED_S

__all__ = ["Memory", "TaskEvaluator"]

START_S = 0.2
"""Time at which the reference positions begin to move along their paths [s]. The first cycle that
depends on the second image begins at this time."""

AHEAD_S = 0.1
"""Interval between the two reference positions that an agent receives for each part [s]. The first
one is for the start of the next cycle."""

ROUNDING_S = 1e-6
"""Tolerance for rounding errors of sums of periods [s]."""

ROBOT_S = 2.0
"""Time between two picks of the robot that takes the parts [s]."""

MAX_PICKS = 1 + int(FEED_S / ROBOT_S - (1 - REQUESTS))
"""Maximum number of parts that the robot can take during a feed task. The robot requests the first
part at the beginning of the task."""

ENOUGH = 0.9
"""Minimum fraction of `MAX_PICKS` that the robot must pick for success."""


@dataclass(frozen=True)
class Followed:
    """State of a task in which parts follow paths.

    Attributes
    ----------
    memory : FollowMemory
        Reference positions on the paths. If parts are too far from their references, the references
        advance more slowly, as in the planner of this project.
    time : float
        Time of the last evaluation [s].
    square_m2 : (M,)
        Squared distance of each part from its reference, summed over all evaluations [m2].
    """

    memory: FollowMemory
    time: float
    square_m2: np.ndarray


class Feeding:
    """State of a feed task, which includes the hopper, the robot, and the rules of the feeder. The
    object is mutable: `advance` changes it.

    Attributes
    ----------
    ids : (M,) of str
        Id of the part in each row of observations and actions. The id is empty if the row has no
        part. A new part gets the first row that was empty in the last cycle. If there is no such
        row, it gets a row that has just become empty.
    rests : bool
        Whether the plate rests in the next cycle. The plate rests while the robot picks, or if
        enough parts are ready.
    made : Production
        Counts of the parts that were fed since the start of the task.
    time : float
        Present time [s].
    """

    def __init__(self, task: FeedTask, rig: Rig) -> None:
        self._cell = FeederCell(task, rig, ROBOT_S)
        self._rules, self._memory = Feeder(task, rig), FeedMemory()
        self.ids = np.full(rows_of(task), "", object)

    def advance(self, world: Simulation, time: float, running: PlateCycle) -> None:
        """Advance the state to the time `time` [s], at which the cycle `running` begins. Record the
        positions of the parts. The robot acts as in `plate_bringup.loop`, but it knows the true
        positions."""
        self.time = time
        self._cell.act(world, time)
        if time > 0:
            order = self._cell.order(self._memory.report, time)
            self._rules = replace(self._rules, task=replace(self._rules.task, order=order))
        parts = _parts(world.state.take(world.state.on_plate))
        tail = 0.0 if running.tail is None else running.tail.period
        now = _situation(parts, time, running.period, tail)
        self._memory, found = self._rules.assess(self._memory, now)
        self.rests = found.request is None
        self.made = Production.of(self._cell.tally, self._cell.robot, world, self._rules.task)
        new_ids = [name for name in parts.ids if name not in self.ids]
        stays = np.isin(self.ids, parts.ids)
        first = np.argsort(np.where(stays, 2, self.ids != ""), kind="stable")
        self.ids = np.where(stays, self.ids, "")
        self.ids[first[: len(new_ids)]] = new_ids

    def agent_info(self) -> dict[str, Any]:
        """Return the entries `ids`, `rests`, `order` and `waiting` of the dictionary `info` for an
        agent."""
        order, waiting = self._rules.task.order, self.made.waiting
        return {"ids": self.ids, "rests": self.rests, "order": order, "waiting": waiting}

    @property
    def pick_column(self) -> np.ndarray:
        """Column (M, 1) of observations. The value is 1 for a part that must be picked, -1 for a
        part that must be discharged, and 0 for an empty row."""
        labels = [pick.label for pick in self._rules.task.picks]
        kinds = [(part_class(name) in labels) - 0.5 if name else 0.0 for name in self.ids]
        return np.sign(kinds)[:, None]


def rows_of(task: FeedTask) -> int:
    """Return the maximum number of parts on the plate in a feed task."""
    if task.hopper is None:
        raise PlateError("a task of kind feed requires a hopper")
    return task.hopper.fill


Memory = PoseMemory | Followed | Feeding | None
"""State of the evaluation of a task. For a task with poses, the state is the assignment of parts to
poses. Tasks with paths and feed tasks have separate classes. For other tasks, the state is None."""


class Score(NamedTuple):
    """Evaluation of a task on each of N plates with M parts.

    Attributes
    ----------
    error_m : (N, M)
        Distance of each part from its target [m]. In a task with paths, the root mean square of the
        part's distance from its reference since the start.
    turn_error : (N, M)
        Error of the angle of each part [rad]. 0 for a part without a target angle.
    there : (N, M)
        Whether each part is where the task requires it. In a feed task, the number of picked parts
        (N, 1).
    to_go : (N,)
        Remaining distance, summed over the parts [m]. A rotation counts as the distance by which
        the farthest point of the part's contour must move. In a task with paths, the longest
        remaining length of a path [m]. In a feed task, the maximum number of parts that the robot
        can take minus the number of picked parts.
    met : (N,) bool
        Whether the requirements of the task are fulfilled now.
    failed : (N,) bool
        Whether a part is farther from its reference position than the task allows.
    """

    error_m: np.ndarray
    turn_error: np.ndarray
    there: np.ndarray
    to_go: np.ndarray
    met: np.ndarray
    failed: np.ndarray


class TaskEvaluator:
    """Evaluates a task by the rules of the planner, but with the true positions of the parts.

    The tolerances of the task are increased by the errors of the camera (`POSITION_ERROR_M`,
    `ANGLE_ERROR_RAD`).

    Attributes
    ----------
    hold_s : float
        Duration for which the requirements of a task must be fulfilled until the task is done [s].
    follows, feeds : bool
        Whether the task is a task with paths, and whether it is a feed task.

    Raises
    ------
    PlateError
        If the task is not of one of the kinds sort, assemble, pose, follow and feed.
    """

    def __init__(self, task: Task, rig: Rig) -> None:
        self._rig = rig
        self._rules: Sorter | Assembler | Poser | Follower | Feeder
        if isinstance(task, SortTask):
            self._rules = Sorter(task, rig)
        elif isinstance(task, AssembleTask):
            self._rules = Assembler(task, rig)
        elif isinstance(task, PoseTask):
            self._rules = Poser(task, rig)
        elif isinstance(task, FollowTask):
            self._rules = Follower(task, rig)
        elif isinstance(task, FeedTask):
            self._rules = Feeder(task, rig)
        else:
            kind = type(task).__name__
            raise PlateError(
                f"task is a {kind}, allowed: SortTask, AssembleTask, PoseTask, FollowTask, FeedTask"
            )
        self.follows, self.feeds = isinstance(task, FollowTask), isinstance(task, FeedTask)
        self.hold_s = 0.0 if self.feeds else self._rules.hold_s

    def begin(self, world: Simulation, running: PlateCycle) -> Memory:
        """Return the initial state of a task that begins at the start of the cycle `running`."""
        parts = _parts(world.state)
        if isinstance(self._rules, Poser):
            return self._rules.begin(parts)
        if isinstance(self._rules, Follower):
            zero = np.zeros(len(parts))
            memory = Followed(self._rules.begin(parts, START_S), 0.0, zero)
            return self.update(memory, world, 0.0, running)
        if isinstance(self._rules, Feeder):
            return self.update(Feeding(self._rules.task, self._rig), world, 0.0, running)
        return None

    def update(self, memory: Memory, world: Simulation, time: float, running: PlateCycle) -> Memory:
        """Update the state of a task at the time `time` [s], at which the cycle `running` begins.
        If parts are too far from their reference positions on the paths, the references advance
        more slowly."""
        if isinstance(memory, Feeding):
            memory.advance(world, time, running)
        if not isinstance(memory, Followed) or not isinstance(self._rules, Follower):
            return memory
        parts = _parts(world.state)
        follow = self._rules.measure(memory.memory, _situation(parts, time, running.period))
        error = self._rules.errors(follow, parts, time)
        return Followed(follow, time, memory.square_m2 + error**2)

    def agent_info(self, memory: Memory) -> dict[str, Any]:
        """Return the entries of the dictionary `info` that depend on the kind of task. For tasks
        with paths, these are `path_s` and `pace`. For feed tasks, these are the entries of
        `Feeding.agent_info`. For other tasks, there are none."""
        if isinstance(memory, Feeding):
            return memory.agent_info()
        if not isinstance(memory, Followed):
            return {}
        follow = memory.memory
        return {"path_s": np.array(follow.progress), "pace": np.array(follow.scaling)}

    def references(self, memory: Memory, ids: tuple[str, ...]) -> np.ndarray:
        """Return the additional columns of observations. In a task with paths, the columns (M, 4)
        are the reference x, y at the start of the next cycle, and the reference `AHEAD_S` later [m,
        plate_home]. In a feed task, the column (M, 1) is `Feeding.pick_column`. For other tasks,
        the result has the shape (M, 0)."""
        if isinstance(memory, Feeding):
            return memory.pick_column
        if not isinstance(memory, Followed) or not isinstance(self._rules, Follower):
            return np.zeros((len(ids), 0))
        follow = memory.memory
        times = follow.anchor, follow.anchor + AHEAD_S
        places = np.hstack([self._rules.reference(follow, t) for t in times])
        return places[[follow.match.index(name) for name in ids]]

    def score(self, memories: list[Memory], states: list[WorldState]) -> Score:
        """Evaluate the task on N plates. `memories` contains the result of `begin` or `update` for
        each plate."""
        rules, names = self._rules, states[0].ids
        if isinstance(rules, Follower):
            return _evaluate_paths(rules, memories, states)
        if isinstance(rules, Feeder):
            return _evaluate_feeding(rules, memories)
        shape = len(states), len(names)
        error, angle = np.zeros(shape), np.zeros(shape)
        near_m, near_rad = POSITION_ERROR_M, np.inf
        if isinstance(rules, Sorter):  # the rules of a sort task evaluate all plates in one call
            to_go = rules.distances(names, np.array([state.position for state in states]))
            error = np.where(np.isnan(to_go), 0.0, to_go)
        else:
            near_m += rules.task.tolerance_m
            for row, (memory, state) in enumerate(zip(memories, states, strict=True)):
                if isinstance(rules, Assembler):
                    error[row] = np.nan_to_num(rules.distance(_parts(state)))
                elif isinstance(memory, PoseMemory):
                    error[row], angle[row] = rules.errors(memory, _parts(state))
            if isinstance(rules, Poser):
                near_rad = ANGLE_ERROR_RAD + rules.task.tolerance_rad
        angle = np.abs(angle)
        labels = [part_class(name) for name in names]
        reaches = {label: self._rig.part_type(label).reach_m for label in set(labels)}
        reach = np.array([reaches[label] for label in labels])
        reached = (error <= near_m) & (angle <= near_rad)
        to_go, never = np.sum(error + reach * angle, axis=1), np.zeros(len(states), bool)
        return Score(error, angle, reached, to_go, np.all(reached, axis=1), never)


def _evaluate_paths(rules: Follower, memories: list[Memory], states: list[WorldState]) -> Score:
    """Evaluate a task in which parts follow paths on N plates."""
    shape = len(states), len(states[0].ids)
    rms, now = np.zeros(shape), np.zeros(shape)
    to_go, at_end = np.zeros(len(states)), np.zeros(len(states), bool)
    for row, (memory, state) in enumerate(zip(memories, states, strict=True)):
        assert isinstance(memory, Followed)
        follow, time = memory.memory, memory.time
        rms[row] = np.sqrt(memory.square_m2 * len(follow.match) / follow.samples)
        now[row] = rules.errors(follow, _parts(state), time)
        to_go[row], at_end[row] = rules.to_go(follow, time), rules.finished(follow, time)
    reached = now <= rules.task.max_error_m + POSITION_ERROR_M
    kept = np.all(reached, axis=1)
    return Score(rms, np.zeros(shape), reached, to_go, at_end & kept, ~kept)


def _evaluate_feeding(rules: Feeder, memories: list[Memory]) -> Score:
    """Evaluate a feed task on N plates."""
    zero = np.zeros((len(memories), rows_of(rules.task)))
    never = np.zeros(len(memories), bool)
    fed = [memory for memory in memories if isinstance(memory, Feeding)]
    picks = np.array([progress.made.picks for progress in fed])
    over = np.array([progress.time >= FEED_S - ROUNDING_S for progress in fed])
    enough = picks >= ENOUGH * MAX_PICKS
    return Score(zero, zero, picks[:, None], MAX_PICKS - picks, over & enough, never)


def _situation(parts: Parts, time: float, period: float, tail: float = 0.0) -> Situation:
    """Return the input of the planner's rules at the time `time` [s]. A cycle of the length
    `period` [s] begins at this time. If the plate is stopped after this cycle, it needs the
    additional time `tail` [s] to come to rest."""
    return Situation(
        parts=parts, stamp=time, start=time + period, rests=time + period + tail, period=period,
        motion_known=True, latency_known=True, predicted=parts.position,
        shortfall=np.zeros(len(parts)), active=True, seen=parts, taken=time,
    )  # fmt: skip


def _parts(state: WorldState) -> Parts:
    return Parts.make(state.ids, state.position, angle=state.angle)
