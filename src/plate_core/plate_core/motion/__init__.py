"""The plate's motion: cycles, the corresponding motor motion, and the rig's limits.

A `PlateCycle` consists of knots and quintic splines. `usage` compares a cycle with a rig's limits.
`motor_state` and `plate_state` convert between plate and motors. A `Timeline` determines which
cycle runs and which cycle follows.
"""

from .cycle import (
    PIECES,
    REST_TOLERANCE,
    PlateCycle,
    control_points,
    evaluate_pieces,
    is_rest,
    quintic_pieces,
)
from .kinematics import motor_state, plate_state
from .limits import CycleUsage, corner_accel, derivative, polynomial_peaks, usage
from .timeline import HANDOVER_S, HOLD_CYCLES, IDLE_S, Timeline, in_time, next_cycle

__all__ = [
    "HANDOVER_S",
    "HOLD_CYCLES",
    "IDLE_S",
    "PIECES",
    "REST_TOLERANCE",
    "CycleUsage",
    "PlateCycle",
    "Timeline",
    "control_points",
    "corner_accel",
    "derivative",
    "evaluate_pieces",
    "in_time",
    "is_rest",
    "motor_state",
    "next_cycle",
    "plate_state",
    "polynomial_peaks",
    "quintic_pieces",
    "usage",
]
