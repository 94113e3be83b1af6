"""Plate motions that put wanted forces, or displacements, under many parts at once."""

from .controller import Answer, Controller
from .force_map import average_force
from .manipulability import (
    Manipulability,
    guaranteed_force,
    manipulability,
    manipulability_map,
)
from .rotations import RotationSolver
from .sinusoids import SinusoidSolver
from .solution import Solution
from .steering import Goal

__all__ = [
    "Answer",
    "Controller",
    "Goal",
    "Manipulability",
    "RotationSolver",
    "SinusoidSolver",
    "Solution",
    "average_force",
    "guaranteed_force",
    "manipulability",
    "manipulability_map",
]
