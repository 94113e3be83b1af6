"""Method A (section 3.1): which rotations, for how long, in which order, and the motion they make.

Public: the plan and its motions; `plate_solver.RotationSolver`
is the door.
"""

from .family import RotationFamily
from .plan import RotationPlan, plan_rotations, with_return_strokes

__all__ = [
    "RotationFamily",
    "RotationPlan",
    "plan_rotations",
    "with_return_strokes",
]
