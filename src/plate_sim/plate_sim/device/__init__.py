"""Simulated motor controller with the protocol of docs/protocol.md. The simulated controller runs
the real firmware, and simulates the serial line and the plate.

`Emulator` simulates controller, line and plate with the faults of a `FaultSchedule`. `Device` is
only the controller.
"""

from .._kernels import Device
from .drives import SetpointCheck, SimulatedDrives, SimulatedODrives
from .emulator import TICK_US, Emulator
from .faults import FaultSchedule, LineFaults
from .firmware import FirmwareOnDesk
from .limits import DeviceLimits, c_header, rig_header
from .plate import Segment, SuspendedPlate
from .pty import PseudoTerminal
from .serial_line import Line

__all__ = [
    "TICK_US",
    "Device",
    "DeviceLimits",
    "Emulator",
    "FaultSchedule",
    "FirmwareOnDesk",
    "Line",
    "LineFaults",
    "PseudoTerminal",
    "Segment",
    "SetpointCheck",
    "SimulatedDrives",
    "SimulatedODrives",
    "SuspendedPlate",
    "c_header",
    "rig_header",
]
