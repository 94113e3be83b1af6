"""Turns a task and the parts' positions into the force wanted on each part."""

from .pd import FollowOptions
from .planner import Planner, PlannerOptions, PlannerState
from .progress import Progress
from .sorting import SortOptions
from .task import Phase, TaskState

__all__ = [
    "FollowOptions",
    "Phase",
    "Planner",
    "PlannerOptions",
    "PlannerState",
    "Progress",
    "SortOptions",
    "TaskState",
]
