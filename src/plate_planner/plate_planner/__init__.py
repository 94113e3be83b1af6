"""Computes which force the plate should exert on each part. The inputs are a task and the positions
of the parts.

The subpackage `estimation` estimates the state of the parts, `tasks` computes the motions that a
task requests, and `supervision` decides whether a task can continue.
"""

from .planner import NOTHING, Planner, PlannerOptions, PlannerState
from .supervision import Phase, Progress, TaskState
from .tasks import FollowOptions

__all__ = [
    "NOTHING",
    "FollowOptions",
    "Phase",
    "Planner",
    "PlannerOptions",
    "PlannerState",
    "Progress",
    "TaskState",
]
