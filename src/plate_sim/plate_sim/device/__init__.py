"""The firmware's twin in Python, a motor controller that speaks docs/protocol.md; line and plate.

Use `Emulator` with a `FaultSchedule`, or `Device`, the controller alone. Files mirror firmware/.
"""

from .controller import Device, setpoint_allowed
from .drives import BusJudge, SimulatedDrives, SimulatedODrives
from .emulator import TICK_US, Emulator
from .faults import FaultSchedule, LineFaults
from .firmware import FirmwareOnDesk
from .limits import DeviceLimits, c_header, rig_header
from .piece import check_pieces, states_of
from .plate import Segment, SuspendedPlate
from .pty import PseudoTerminal
from .serial_line import Line

__all__ = [
    "TICK_US",
    "BusJudge",
    "Device",
    "DeviceLimits",
    "Emulator",
    "FaultSchedule",
    "FirmwareOnDesk",
    "Line",
    "LineFaults",
    "PseudoTerminal",
    "Segment",
    "SimulatedDrives",
    "SimulatedODrives",
    "SuspendedPlate",
    "c_header",
    "check_pieces",
    "rig_header",
    "setpoint_allowed",
    "states_of",
]
