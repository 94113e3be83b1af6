"""The plate: its motion and the drive that gives it, tables from the solver, and its surface.
Public: the names below; for kernels `pieces.hpp` and `course.hpp` evaluate the motion."""

from .drive import PlateState
from .ground import LEVEL, Ground
from .motion import PlateMotion
from .response import motor_record, realise
from .table_queue import Playback, check_table, next_playback

__all__ = [
    "LEVEL",
    "Ground",
    "PlateMotion",
    "PlateState",
    "Playback",
    "check_table",
    "motor_record",
    "next_playback",
    "realise",
]
