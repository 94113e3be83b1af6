"""The page's ROS interface: its subscriptions, and the calls that it makes."""

from .listener import TOPICS, Listener
from .operator import Asked, Operator
from .replay import Replay
from .stops import Stops

__all__ = ["TOPICS", "Asked", "Listener", "Operator", "Replay", "Stops"]
