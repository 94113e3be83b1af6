"""What the feeder asks of the graph: the planner's task."""

from .feed_goal import FeedGoal

__all__ = ["FeedGoal"]
