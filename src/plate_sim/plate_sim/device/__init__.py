"""The firmware's twin in Python, a motor controller that speaks docs/protocol.md; line and plate.

Use `Emulator` with a `FaultSchedule`, or `Device`, the controller alone. Files mirror firmware/.
"""

from .controller import Device, setpoint_allowed
from .emulator import TICK_US, Emulator
from .faults import FaultSchedule, LineFaults
from .limits import DeviceLimits, c_header
from .piece import check_pieces, states_of
from .plate import Segment, SuspendedPlate
from .pty import PseudoTerminal
from .serial_line import Line

__all__ = [
    "TICK_US",
    "Device",
    "DeviceLimits",
    "Emulator",
    "FaultSchedule",
    "Line",
    "LineFaults",
    "PseudoTerminal",
    "Segment",
    "SuspendedPlate",
    "c_header",
    "check_pieces",
    "setpoint_allowed",
    "states_of",
]
