"""Turns a task and the parts' positions into the force wanted on each part."""

from .assembling import AssembleOptions
from .pd import FollowOptions
from .planner import Planner, PlannerOptions, PlannerState
from .posing import PoseOptions
from .progress import Progress
from .sorting import SortOptions
from .task import Phase, TaskState

__all__ = [
    "AssembleOptions",
    "FollowOptions",
    "Phase",
    "Planner",
    "PlannerOptions",
    "PlannerState",
    "PoseOptions",
    "Progress",
    "SortOptions",
    "TaskState",
]
