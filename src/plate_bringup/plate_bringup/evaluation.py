"""Evaluation of a run by the true state of the parts, which only a simulator knows.

`true_errors` evaluates one cycle. `is_fulfilled` evaluates the end of a task.
"""

from __future__ import annotations

import numpy as np

from plate_core import Parts, Rig
from plate_core.tasks import (
    AssembleTask,
    FeedTask,
    FollowTask,
    MoveTask,
    PoseTask,
    Scenario,
    SortTask,
    Task,
)
from plate_planner import PlannerState
from plate_planner.tasks import (
    ANGLE_ERROR_RAD,
    POSITION_ERROR_M,
    Assembler,
    Follower,
    Poser,
    Sorter,
)
from plate_sim.world import WorldState

__all__ = ["is_fulfilled", "true_errors"]


def true_errors(
    scenario: Scenario,
    rig: Rig,
    state: PlannerState,
    parts: Parts,
    world: WorldState,
    t: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the true distances of the parts from their references or targets (P,) [m], and in a
    pose task their angle errors (P,) [rad]. An array is empty if its errors are not defined."""
    task, true, empty = scenario.task, world.position, np.zeros(0)
    if not len(true):
        return empty, empty
    if isinstance(task, AssembleTask):
        distance = Assembler(task, rig).distance(Parts.make(world.ids, true))
        return distance[~np.isnan(distance)], empty
    if state.memory is None:
        return empty, empty
    if isinstance(task, PoseTask):
        missing = Poser(task, rig).errors(
            state.memory, _nearest_true_parts(parts, state.memory.match, world)
        )
        return missing[0], np.abs(missing[1])
    if isinstance(task, MoveTask):
        true_parts = _nearest_true_parts(parts, tuple(target.id for target in task.targets), world)
        position = {target.id: target.place for target in task.targets}
        goal = np.array([position[name] for name in true_parts.ids]).reshape(-1, 2)
        return np.hypot(*(true_parts.position - goal).T), empty
    # Before the reference paths of a follow task start, there are no errors.
    if not isinstance(task, FollowTask) or state.memory.leading:
        return empty, empty
    reference = Follower(task, rig).reference(state.memory, t)
    seen = dict(zip(parts.ids, parts.position, strict=True))
    errors = []
    for k, name in enumerate(state.memory.match):
        if name in seen:
            nearest = np.argmin(np.sum((true - seen[name]) ** 2, axis=1))
            errors.append(np.linalg.norm(true[nearest] - reference[k]))
    return np.array(errors), empty


def _nearest_true_parts(parts: Parts, names: tuple[str, ...], world: WorldState) -> Parts:
    """For each detected part whose id is in `names`, return the nearest true part. The returned
    parts have the ids of the detected parts."""
    ids = [name for name in names if name in parts.ids]
    seen = parts.position[[parts.ids.index(name) for name in ids]]
    rows = [int(np.argmin(np.sum((world.position - position) ** 2, axis=1))) for position in seen]
    return Parts.make(tuple(ids), world.position[rows], angle=world.angle[rows])


def is_fulfilled(
    task: Task, rig: Rig, world: WorldState, error: np.ndarray, turn_error: np.ndarray
) -> bool:
    """Return whether the task is fulfilled by the final true state `world` of the parts. All parts
    must be on the plate.

    `error` (n,) contains distances of the parts from their references [m]: those of all cycles in a
    follow task, and of the last cycle in other tasks. `turn_error` (P,) contains the angle errors
    in the last cycle [rad].
    """
    if world.dropped:
        return False
    if isinstance(task, FeedTask):
        return True
    if isinstance(task, SortTask):
        true = Parts.make(world.ids, world.position)
        return float(np.max(np.nan_to_num(Sorter(task, rig).to_go(true)))) <= POSITION_ERROR_M
    max_error = float(np.max(error, initial=0.0))
    if isinstance(task, FollowTask):
        return max_error <= task.max_error_m + POSITION_ERROR_M
    at_targets = max_error <= task.tolerance_m + POSITION_ERROR_M
    if isinstance(task, PoseTask):
        turned = float(np.max(turn_error, initial=0.0))
        at_targets = at_targets and turned <= task.tolerance_rad + ANGLE_ERROR_RAD
    return at_targets
