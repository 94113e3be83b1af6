"""The planner's action servers, its reports, and its state as ROS messages."""

from .goals import GoalServers
from .messages import STATES, feed_to_msg, progress_to_msg, run_to_msg
from .reports import TaskReports

__all__ = [
    "STATES",
    "GoalServers",
    "TaskReports",
    "feed_to_msg",
    "progress_to_msg",
    "run_to_msg",
]
