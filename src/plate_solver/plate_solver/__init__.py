"""Plate motions that put wanted forces, or displacements, under many parts at once.

Public: the names below and those of the chapters: `maps`, `fit`, `sinusoids`, `rotations`,
`requests`, `analysis`.
"""

from .analysis import Manipulability, library_force, manipulability
from .controller import DRIFT_TOLERANCE, EFFORT, EXACT_MISS, METHODS, Answer, Controller
from .limits import EQUAL_WEIGHT, Limits, limit_use
from .maps import average_force
from .rehearsal import Rehearsal, Verdict, judge_task, rehearse
from .requests import Goal, Solution, Status
from .rotations.solver import RotationSolver
from .sinusoids.solver import SinusoidSolver

__all__ = [
    "DRIFT_TOLERANCE",
    "EFFORT",
    "EQUAL_WEIGHT",
    "EXACT_MISS",
    "METHODS",
    "Answer",
    "Controller",
    "Goal",
    "Limits",
    "Manipulability",
    "Rehearsal",
    "RotationSolver",
    "SinusoidSolver",
    "Solution",
    "Status",
    "Verdict",
    "average_force",
    "judge_task",
    "library_force",
    "limit_use",
    "manipulability",
    "rehearse",
]
