"""Action client of the feeder for the planner's action feed_parts."""

from .feed_goal import FeedGoal

__all__ = ["FeedGoal"]
