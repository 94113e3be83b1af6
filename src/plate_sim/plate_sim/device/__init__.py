"""A motor controller that speaks docs/protocol.md: the firmware's twin, its line and its plate."""

from .controller import Device
from .emulator import Accidents, Emulator
from .hung import HungPlate
from .limits import DeviceLimits
from .line import Line, Trouble
from .played import Recorder, Stretch

__all__ = [
    "Accidents",
    "Device",
    "DeviceLimits",
    "Emulator",
    "HungPlate",
    "Line",
    "Recorder",
    "Stretch",
    "Trouble",
]
