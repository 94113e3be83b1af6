"""The planner's action servers, its reports, and its state as ROS messages."""

from .goals import GoalServers
from .messages import STATES, run_to_msg
from .reports import TaskReports

__all__ = [
    "STATES",
    "GoalServers",
    "TaskReports",
    "run_to_msg",
]
