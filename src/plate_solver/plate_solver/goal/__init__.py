"""The goal of one cycle. A goal contains the required end positions and angles of the parts, and
the weights of their errors.

The cycle map evaluates motions. `Solution` contains a motion and the fraction of the request that
it meets.
"""

from .ends import Ends
from .goal import Goal, PartRotations, goal_solution
from .solution import Solution, Status

__all__ = [
    "Ends",
    "Goal",
    "PartRotations",
    "Solution",
    "Status",
    "goal_solution",
]
