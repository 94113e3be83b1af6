"""What a task counts, by where the parts truly are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plate_core import Parts, PlateError, Rig, part_class
from plate_core.tasks import AssembleTask, FollowTask, PoseTask, SortTask, Task
from plate_planner.tasks import (
    SIGHT_M,
    SIGHT_RAD,
    Assembler,
    Follower,
    FollowMemory,
    PoseMemory,
    Poser,
    Situation,
    Sorter,
)
from plate_sim.world import WorldState

__all__ = ["Judge", "Memory"]

START_S = 0.2
"""When references leave the starts of their paths [s]: with the answer to the second image."""

AHEAD_S = 0.1
"""How far ahead agents are told where a reference will be [s]."""


@dataclass(frozen=True)
class Followed:
    """How paths have been followed so far.

    Attributes
    ----------
    memory : FollowMemory
        Where the references are: they wait for parts that are behind, as in our own loop.
    time : float
        Of what was judged last [s].
    square_m2 : (M,)
        Sum of the squared distances of each part from its reference [m2].
    """

    memory: FollowMemory
    time: float
    square_m2: np.ndarray


Memory = PoseMemory | Followed | None
"""What is remembered of a task: which part has which pose, or follows which path."""


class Score(NamedTuple):
    """How far a task is on each of N plates with M parts.

    Attributes
    ----------
    error_m : (N, M)
        Distance of each part from where it is to be [m]; from the reference that it follows: root
        mean square so far.
    turn_error : (N, M)
        What is missing to its angle [rad]; 0 where none is asked.
    there : (N, M)
        Which parts are as the task asks.
    to_go_m : (N,)
        The way still to go, summed over parts [m]; turns count as ways of the rim. On paths: of the
        reference that has the longest.
    met : (N,) bool
        Whether all is as the task asks.
    failed : (N,) bool
        Whether a part is further off its path than it may ever be.
    """

    error_m: np.ndarray
    turn_error: np.ndarray
    there: np.ndarray
    to_go_m: np.ndarray
    met: np.ndarray
    failed: np.ndarray


class Judge:
    """Judges one task as the planner's supervision does, but by the truth.

    The camera may err by `SIGHT_M` and `SIGHT_RAD`: what looks right to it is right.

    Attributes
    ----------
    hold_s : float
        The task is done when all parts have been there for this time [s].
    follows : bool
        Whether parts are to follow paths.

    Raises
    ------
    PlateError
        If the task is of another kind than sort, assemble, pose or follow.
    """

    def __init__(self, task: Task, rig: Rig) -> None:
        self._rig = rig
        self._rules: Sorter | Assembler | Poser | Follower
        if isinstance(task, SortTask):
            self._rules = Sorter(task, rig)
        elif isinstance(task, AssembleTask):
            self._rules = Assembler(task, rig)
        elif isinstance(task, PoseTask):
            self._rules = Poser(task, rig)
        elif isinstance(task, FollowTask):
            self._rules = Follower(task, rig)
        else:
            kind = type(task).__name__
            raise PlateError(
                f"task is a {kind}, allowed: SortTask, AssembleTask, PoseTask, FollowTask"
            )
        self.hold_s = self._rules.hold_s
        self.follows = isinstance(task, FollowTask)

    def begin(self, state: WorldState, period: float) -> Memory:
        """Return what is to be remembered of a task that begins, while a cycle of a period [s]
        runs."""
        parts = _parts(state)
        if isinstance(self._rules, Poser):
            return self._rules.begin(parts)
        if isinstance(self._rules, Follower):
            none = np.zeros(len(parts))
            memory = Followed(self._rules.begin(parts, START_S), 0.0, none)
            return self.look(memory, state, 0.0, period)
        return None

    def look(self, memory: Memory, state: WorldState, time: float, period: float) -> Memory:
        """Take in where parts are at a time [s], while a cycle of a period [s] begins: references
        go on, as slowly as parts that are behind ask for."""
        if not isinstance(self._rules, Follower) or not isinstance(memory, Followed):
            return memory
        parts = _parts(state)
        now = Situation(
            parts=parts, stamp=time, start=time + period, rests=time + period, period=period,
            motion_known=True, latency_known=True, predicted=parts.position,
            shortfall=np.zeros(len(parts)), active=True, seen=parts, taken=time,
        )  # fmt: skip
        follow = self._rules.measure(memory.memory, now)
        error = self._rules.errors(follow, parts, time)
        return Followed(follow, time, memory.square_m2 + error**2)

    def told(self, memory: Memory) -> dict[str, np.ndarray]:
        """Return what an agent learns of the references on paths: `path_s`, `pace`."""
        if not isinstance(memory, Followed):
            return {}
        follow = memory.memory
        return {"path_s": np.array(follow.progress), "pace": np.array(follow.scaling)}

    def references(self, memory: Memory, ids: tuple[str, ...]) -> np.ndarray:
        """Return where each part (M, 4) is to be, x and y, when the next cycle begins, and
        `AHEAD_S` later [m, plate_home]; (M, 0) where no path is to be followed."""
        if not isinstance(self._rules, Follower) or not isinstance(memory, Followed):
            return np.zeros((len(ids), 0))
        follow = memory.memory
        times = follow.anchor, follow.anchor + AHEAD_S
        places = np.hstack([self._rules.reference(follow, t) for t in times])
        return places[[follow.match.index(name) for name in ids]]

    def score(self, memories: list[Memory], states: list[WorldState]) -> Score:
        """Judge the parts of N plates: `memories` are those of `begin` and `look`."""
        rules, names = self._rules, states[0].ids
        if isinstance(rules, Follower):
            return _followed(rules, memories, states)
        shape = len(states), len(names)
        error, turn = np.zeros(shape), np.zeros(shape)
        near_m, near_rad = SIGHT_M, np.inf
        if isinstance(rules, Sorter):  # all plates at once
            place = np.concatenate([state.position for state in states])
            to_go = rules.to_go(Parts.make(names * len(states), place))
            error = np.where(np.isnan(to_go), 0.0, to_go).reshape(shape)
        else:
            near_m += rules.task.tolerance_m
            for row, (memory, state) in enumerate(zip(memories, states, strict=True)):
                if isinstance(rules, Assembler):
                    error[row] = np.nan_to_num(rules.distance(_parts(state)))
                elif isinstance(memory, PoseMemory):
                    error[row], turn[row] = rules.errors(memory, _parts(state))
            if isinstance(rules, Poser):
                near_rad = SIGHT_RAD + rules.task.tolerance_rad
        turn = np.abs(turn)
        labels = [part_class(name) for name in names]
        reaches = {label: self._rig.part_type(label).reach_m for label in set(labels)}
        reach = np.array([reaches[label] for label in labels])
        there = (error <= near_m) & (turn <= near_rad)
        to_go, never = np.sum(error + reach * turn, axis=1), np.zeros(len(states), bool)
        return Score(error, turn, there, to_go, np.all(there, axis=1), never)


def _followed(rules: Follower, memories: list[Memory], states: list[WorldState]) -> Score:
    """Judge how paths were followed on N plates."""
    shape = len(states), len(states[0].ids)
    rms, now = np.zeros(shape), np.zeros(shape)
    to_go, at_end = np.zeros(len(states)), np.zeros(len(states), bool)
    for row, (memory, state) in enumerate(zip(memories, states, strict=True)):
        assert isinstance(memory, Followed)
        follow, time = memory.memory, memory.time
        rms[row] = np.sqrt(memory.square_m2 * len(follow.match) / follow.samples)
        now[row] = rules.errors(follow, _parts(state), time)
        to_go[row], at_end[row] = rules.to_go(follow, time), rules.finished(follow, time)
    there = now <= rules.task.max_error_m + SIGHT_M
    kept = np.all(there, axis=1)
    return Score(rms, np.zeros(shape), there, to_go, at_end & kept, ~kept)


def _parts(state: WorldState) -> Parts:
    return Parts.make(state.ids, state.position, angle=state.angle)
