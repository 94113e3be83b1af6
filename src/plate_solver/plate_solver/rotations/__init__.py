"""Method A (section 3.1): which rotations, for how long, in which order, and the motion they make.

Public: the plan and its motions; `RotationCycles`, for the controller, is in `solver.py`.
"""

from .family import RotationFamily
from .plan import RotationPlan, plan_rotations, with_return_strokes

__all__ = [
    "RotationFamily",
    "RotationPlan",
    "plan_rotations",
    "with_return_strokes",
]
