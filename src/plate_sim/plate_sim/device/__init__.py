"""A motor controller that speaks docs/protocol.md: the firmware's twin, in Python."""

from .controller import Device
from .limits import DeviceLimits

__all__ = ["Device", "DeviceLimits"]
