"""The planner's state as ROS messages."""

from .messages import STATES, feed_to_msg, progress_to_msg

__all__ = ["STATES", "feed_to_msg", "progress_to_msg"]
