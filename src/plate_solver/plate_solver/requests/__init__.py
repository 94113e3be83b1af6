"""What is asked of a solver and what it answers: requests, goals, solutions, and parts of requests.

Public: `Goal` and `Solution` with `Status`; the rest serves the two methods.
"""

from .ends import Ends, end_errors
from .goal import Family, Goal, Turns, fit_goal, goal_solution
from .partial import easiest_force, largest_fraction
from .refinement import (
    MOST_ON_CYCLE,
    REFINED_TOLERANCE,
    REFINEMENTS,
    judged,
    on_cycle,
    on_mean_velocity,
)
from .request import CURL_LENGTH_M, Request
from .solution import Solution, Status, force_solution

__all__ = [
    "CURL_LENGTH_M",
    "MOST_ON_CYCLE",
    "REFINED_TOLERANCE",
    "REFINEMENTS",
    "Ends",
    "Family",
    "Goal",
    "Request",
    "Solution",
    "Status",
    "Turns",
    "easiest_force",
    "end_errors",
    "fit_goal",
    "force_solution",
    "goal_solution",
    "judged",
    "largest_fraction",
    "on_cycle",
    "on_mean_velocity",
]
