"""Averaged forces as in the paper. An averaged force is the mean friction on a part over a cycle.

This package computes the averaged forces of a motion, finds motions of Methods A and B for
requested forces, and proves that a request is infeasible. The controller does not use this package.
"""

from .manipulability import Manipulability, library_force, manipulability
from .mean_force import average_force, step_force_gradient, step_forces
from .rotation_solver import RotationSolver
from .sinusoid_force import force_rules, sinusoid_forces
from .sinusoid_solver import SinusoidSolver
from .unreachable import is_out_of_reach
from .weights import solve_weights

__all__ = [
    "Manipulability",
    "RotationSolver",
    "SinusoidSolver",
    "average_force",
    "force_rules",
    "is_out_of_reach",
    "library_force",
    "manipulability",
    "sinusoid_forces",
    "solve_weights",
    "step_force_gradient",
    "step_forces",
]
