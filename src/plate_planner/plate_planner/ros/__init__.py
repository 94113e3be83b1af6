"""Action servers of the planner, publishers of its reports, and conversions of its state to ROS
messages."""

from .goals import GoalServers
from .messages import STATES, run_to_msg
from .reports import TaskReports

__all__ = [
    "STATES",
    "GoalServers",
    "TaskReports",
    "run_to_msg",
]
