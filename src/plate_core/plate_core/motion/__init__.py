"""The plate's motion: closed cycles, the motors that give them, and the limits they must keep.

A `PlateCycle` is knots and quintic splines; `usage` holds one against a rig's limits.
"""

from .cycle import PIECES, PlateCycle, control_points, is_rest, quintic_pieces
from .kinematics import motor_state, plate_state
from .limits import CycleUsage, corner_accel, derivative, polynomial_peaks, usage

__all__ = [
    "PIECES",
    "CycleUsage",
    "PlateCycle",
    "control_points",
    "corner_accel",
    "derivative",
    "is_rest",
    "motor_state",
    "plate_state",
    "polynomial_peaks",
    "quintic_pieces",
    "usage",
]
