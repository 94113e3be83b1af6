"""Simulation of the plate. The package contains the plate's motion, its drive, the check of motor
tables, and its surface. All names that the package exports are public. In compiled code,
`pieces.hpp` and `course.hpp` evaluate the motion."""

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
