"""What a plate can do with parts where they are, and what it certainly cannot.

Public: `manipulability` and its relatives; `is_out_of_reach` and `speed_bounds`, which are proven.
"""

from .bounds import SpeedBounds, rest_to_rest_s, shift_accel, speed_bounds
from .manipulability import Manipulability, condition_number, library_force, manipulability
from .unreachable import is_out_of_reach

__all__ = [
    "Manipulability",
    "SpeedBounds",
    "condition_number",
    "is_out_of_reach",
    "library_force",
    "manipulability",
    "rest_to_rest_s",
    "shift_accel",
    "speed_bounds",
]
