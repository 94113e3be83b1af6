"""The plate's motion: closed cycles, the motors that give them, and the limits they must keep.

A `PlateCycle` is knots and quintic splines; `usage` holds one against a rig's limits.
"""

from .cycle import PlateCycle, quintic_pieces
from .kinematics import motor_state, plate_state
from .limits import PIECES, CycleUsage, corner_accel, usage

__all__ = [
    "PIECES",
    "CycleUsage",
    "PlateCycle",
    "corner_accel",
    "motor_state",
    "plate_state",
    "quintic_pieces",
    "usage",
]
