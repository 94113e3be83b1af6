"""What each task asks of the parts; `rules_for` picks the rules of a task, `TaskRules` says what
the planner wants of them.

A new task is one file here with a class of `TaskRules`, and its case in `rules_for` below (and a
field of `TaskOptions`, if it has any). How a scenario file says it stands in `plate_core.tasks`.
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
from .task import SIGHT_M, SIGHT_RAD, Assessment, Situation, TaskRules

__all__ = [
    "CROWD",
    "SIGHT_M",
    "SIGHT_RAD",
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
    """What can be tuned of each task."""

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
