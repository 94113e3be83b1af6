"""Conversion of plate cycles to motor setpoints. Cycles are faded in and out if needed, and kept
within the rig's limits, including the motors' temperature.

`prepare` converts one cycle to a `MotorTable`. In the running driver, the class `Guard` calls
`prepare` and collects statistics.
"""

from .guard import Guard, Statistics
from .limits import ScaledCycle, scale_to_limits
from .motor_table import MAX_KNOTS, MotorTable, plays, prepare, unspliced
from .setpoint_stream import MAX_S, SetpointStream, densest, knots, refined

__all__ = [
    "MAX_KNOTS",
    "MAX_S",
    "Guard",
    "MotorTable",
    "ScaledCycle",
    "SetpointStream",
    "Statistics",
    "densest",
    "knots",
    "plays",
    "prepare",
    "refined",
    "scale_to_limits",
    "unspliced",
]
