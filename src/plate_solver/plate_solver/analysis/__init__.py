"""What a plate can do with parts where they are, and what it certainly cannot.

Public: `manipulability` and its relatives, and `is_out_of_reach`, a proof.
"""

from .manipulability import (
    Manipulability,
    condition_number,
    library_force,
    manipulability,
    manipulability_map,
)
from .unreachable import is_out_of_reach

__all__ = [
    "Manipulability",
    "condition_number",
    "is_out_of_reach",
    "library_force",
    "manipulability",
    "manipulability_map",
]
