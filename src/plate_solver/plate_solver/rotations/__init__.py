"""Method A (section 3.1): sequences of plate rotations, their durations, order and motion.

This package exports the plan and the family of motions. `RotationCycles`, the solver that the
controller uses, is in `solver.py`.
"""

from .family import RotationFamily
from .plan import RotationPlan, plan_rotations

__all__ = [
    "RotationFamily",
    "RotationPlan",
    "plan_rotations",
]
