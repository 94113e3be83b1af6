"""The page's part in the graph: what it hears, and what it asks for."""

from .listener import TOPICS, Listener
from .operator import Asked, Operator
from .replay import Replay
from .stops import Stops

__all__ = ["TOPICS", "Asked", "Listener", "Operator", "Replay", "Stops"]
