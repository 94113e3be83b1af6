"""The goal of one cycle, judged on the cycle map: where parts are to end, and what a miss costs.

`Solution` says how much of a goal, or of a request for forces, the motion found meets.
"""

from .ends import Ends, end_errors
from .goal import Family, Goal, Turns, fit_goal, goal_solution
from .solution import Solution, Status

__all__ = [
    "Ends",
    "Family",
    "Goal",
    "Solution",
    "Status",
    "Turns",
    "end_errors",
    "fit_goal",
    "goal_solution",
]
