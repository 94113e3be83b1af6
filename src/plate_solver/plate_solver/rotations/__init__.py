"""Method A (section 3.1): which rotations, for how long, in which order, and the motion they make.

Public: the library, the linear programme, the plan and its motions; `plate_solver.RotationSolver`
is the door.
"""

from .family import RotationFamily
from .library import REACH, Library, grid, ring, rotation_matrix, solve_weights
from .plan import RotationPlan, plan_rotations, with_return_strokes
from .simplex import TimeFractions, least_time

__all__ = [
    "REACH",
    "Library",
    "RotationFamily",
    "RotationPlan",
    "TimeFractions",
    "grid",
    "least_time",
    "plan_rotations",
    "ring",
    "rotation_matrix",
    "solve_weights",
    "with_return_strokes",
]
