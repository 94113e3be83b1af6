"""What a task counts, by where the parts truly are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plate_core import Parts, PlateError, Rig, part_class
from plate_core.tasks import AssembleTask, PoseTask, SortTask, Task
from plate_planner.tasks import SIGHT_M, SIGHT_RAD, Assembler, PoseMemory, Poser, Sorter
from plate_sim.world import WorldState


class Score(NamedTuple):
    """How far a task is on each of N plates with M parts.

    Attributes
    ----------
    error_m : (N, M)
        Distance of each part from where it is to be [m].
    turn_error : (N, M)
        What is missing to its angle [rad]; 0 where none is asked.
    there : (N, M)
        Which parts are as the task asks.
    to_go_m : (N,)
        The way still to go, summed over parts [m]; turns count as ways of the rim.
    """

    error_m: np.ndarray
    turn_error: np.ndarray
    there: np.ndarray
    to_go_m: np.ndarray


class Judge:
    """Judges one task as the planner's supervision does, but by the truth.

    The camera may err by `SIGHT_M` and `SIGHT_RAD`: what looks right to it is right.

    Attributes
    ----------
    hold_s : float
        The task is done when all parts have been there for this time [s].

    Raises
    ------
    PlateError
        If the task is of another kind than sort, assemble or pose.
    """

    def __init__(self, task: Task, rig: Rig) -> None:
        self._rig = rig
        self._rules: Sorter | Assembler | Poser
        if isinstance(task, SortTask):
            self._rules = Sorter(task, rig)
        elif isinstance(task, AssembleTask):
            self._rules = Assembler(task, rig)
        elif isinstance(task, PoseTask):
            self._rules = Poser(task, rig)
        else:
            kind = type(task).__name__
            raise PlateError(f"task is a {kind}, allowed: SortTask, AssembleTask, PoseTask")
        self.hold_s = task.hold_s

    def begin(self, state: WorldState) -> PoseMemory | None:
        """Return what is to be remembered of a task that begins: which part has which pose."""
        return self._rules.begin(_parts(state)) if isinstance(self._rules, Poser) else None

    def score(self, memories: list[PoseMemory | None], states: list[WorldState]) -> Score:
        """Judge the parts of N plates: `memories` are those of `begin`."""
        rules, names = self._rules, states[0].ids
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
                elif memory is not None:
                    error[row], turn[row] = rules.errors(memory, _parts(state))
            if isinstance(rules, Poser):
                near_rad = SIGHT_RAD + rules.task.tolerance_rad
        turn = np.abs(turn)
        labels = [part_class(name) for name in names]
        reaches = {label: self._rig.part_type(label).reach_m for label in set(labels)}
        reach = np.array([reaches[label] for label in labels])
        there = (error <= near_m) & (turn <= near_rad)
        return Score(error, turn, there, np.sum(error + reach * turn, axis=1))


def _parts(state: WorldState) -> Parts:
    return Parts.make(state.ids, state.position, angle=state.angle)
