"""The page's ROS interface: its subscriptions and its calls."""

from .listener import TOPICS, Listener
from .operator import Operator, PendingCommand
from .replay import Replay
from .stops import Stops

__all__ = ["TOPICS", "Listener", "Operator", "PendingCommand", "Replay", "Stops"]
