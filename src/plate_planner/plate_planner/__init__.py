"""Turns a task and the parts' positions into the force wanted on each part.

Chapters: `estimation` (where the parts are), `tasks` (what is asked of them) and `supervision`
(whether a task goes on).
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
