"""The plate: its motion and the drive that gives it, which tables it plays, and its surface.
Public: the names below; for kernels `pieces.hpp` and `course.hpp` evaluate the motion."""

from .check_table import check_table
from .drive import PlateState
from .ground import LEVEL, Ground
from .motion import PlateMotion
from .response import motor_record, realise

__all__ = [
    "LEVEL",
    "Ground",
    "PlateMotion",
    "PlateState",
    "check_table",
    "motor_record",
    "realise",
]
