"""Rules of the tasks. The rules compute drifts or targets for the parts. `TaskRules` is the
interface, and `rules_for` returns the rules of a task.

A new task needs three things: one file here with a subclass of `TaskRules`, a case in `rules_for`,
and a field of `TaskOptions` if it has options. The keys of a task in a scenario file are defined in
`plate_core.tasks`.
"""

from dataclasses import dataclass, field
from typing import assert_never

from plate_core import Rig
from plate_core.tasks import AssembleTask, FeedTask, FollowTask, MoveTask, PoseTask, SortTask, Task

from .assemble import Assembler
from .drift import DriftInterval
from .feed import Feeder, FeedMemory, FeedReport
from .follow import SLOWED, Follower, FollowMemory, FollowOptions, pd_drift
from .move import MoveMemory, Mover
from .pose import PoseMemory, Poser
from .sort import Sorter
from .targets import CROWD, assign
from .task import ANGLE_ERROR_RAD, POSITION_ERROR_M, Assessment, Situation, TaskRules

__all__ = [
    "ANGLE_ERROR_RAD",
    "CROWD",
    "POSITION_ERROR_M",
    "SLOWED",
    "Assembler",
    "Assessment",
    "DriftInterval",
    "FeedMemory",
    "FeedReport",
    "Feeder",
    "FollowMemory",
    "FollowOptions",
    "Follower",
    "MoveMemory",
    "Mover",
    "PoseMemory",
    "Poser",
    "Situation",
    "Sorter",
    "TaskOptions",
    "TaskRules",
    "assign",
    "pd_drift",
    "rules_for",
]


@dataclass(frozen=True)
class TaskOptions:
    """Options of the tasks."""

    follow: FollowOptions = field(default_factory=FollowOptions)


def rules_for(task: Task, rig: Rig, options: TaskOptions) -> TaskRules:
    """Return the rules of a task."""
    match task:
        case SortTask():
            return Sorter(task, rig)
        case FollowTask():
            return Follower(task, rig, options.follow)
        case AssembleTask():
            return Assembler(task, rig)
        case PoseTask():
            return Poser(task, rig)
        case MoveTask():
            return Mover(task, rig)
        case FeedTask():
            return Feeder(task, rig)
    assert_never(task)
