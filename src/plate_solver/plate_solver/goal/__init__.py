"""The goal of one cycle. A goal contains the required end positions and angles of the parts, and
the weights of their errors.

The cycle map evaluates motions. `Solution` contains a motion and the fraction of the request that
it meets.
"""

from .ends import Ends, end_errors
from .goal import Family, Goal, PartRotations, fit_goal, goal_solution
from .solution import Solution, Status

__all__ = [
    "Ends",
    "Family",
    "Goal",
    "PartRotations",
    "Solution",
    "Status",
    "end_errors",
    "fit_goal",
    "goal_solution",
]
