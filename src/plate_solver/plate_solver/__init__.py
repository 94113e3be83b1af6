"""Plate motions that put wanted forces, or displacements, under many parts at once.

Public: the names below and those of the chapters: `averages`, `cycle_map`, `fit`, `goal`,
`library`, `rotations`, `sinusoids`.
"""

from .averages import Manipulability, average_force, library_force, manipulability
from .controller import DRIFT_TOLERANCE, EFFORT, EXACT_MISS, METHODS, Answer, Controller
from .goal import Goal, Solution, Status
from .limits import EQUAL_WEIGHT, Limits, limit_use
from .rehearsal import Rehearsal, Verdict, judge_task, rehearse
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
