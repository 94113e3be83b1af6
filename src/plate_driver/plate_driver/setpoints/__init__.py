"""From a plate cycle to what the motors get: faded in and out, within the limits, never too warm.

`prepare` makes a `MotorTable` of a cycle, `Guard` does that for a running driver and counts.
"""

from .guard import Guard, Statistics
from .limits import Fit, fit
from .motor_table import MAX_KNOTS, MotorTable, plays, prepare, unspliced
from .setpoint_stream import SetpointStream, knots, refined

__all__ = [
    "MAX_KNOTS",
    "Fit",
    "Guard",
    "MotorTable",
    "SetpointStream",
    "Statistics",
    "fit",
    "knots",
    "plays",
    "prepare",
    "refined",
    "unspliced",
]
