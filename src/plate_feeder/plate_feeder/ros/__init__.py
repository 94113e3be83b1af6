"""The feeder's client of the planner's task."""

from .feed_goal import FeedGoal

__all__ = ["FeedGoal"]
