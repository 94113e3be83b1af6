"""Status of the motors, as the driver reports it: a state, a reason, and a text for the user.

The values of state and reason are those of plate_interfaces/DriverStatus. `ros.convert` converts
between `DriverStatus` and the message.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

__all__ = ["DriverReason", "DriverState", "DriverStatus"]


class DriverState(IntEnum):
    """State of the motors. plate_interfaces/DriverStatus defines each value."""

    UNCONFIGURED = 0
    INACTIVE = 1
    DISABLED = 2
    ENABLING = 3
    READY = 4
    CALIBRATING = 5
    BRAKING = 6
    STOPPED = 7
    ERROR = 8


class DriverReason(IntEnum):
    """Reason why the motors are not ready. plate_interfaces/DriverStatus defines each value."""

    NONE = 0
    SWITCHED_OFF = 1
    EMERGENCY_STOP = 2
    POWER_CUT = 3
    EARLIER_STOP = 4
    HOST_SILENT = 5
    LIMIT = 6
    SUPPLY = 7
    HARDWARE = 8
    HEAT = 9
    FOLLOWING = 10
    DEVICE_RESET = 11
    NO_ANSWER = 12
    NO_TELEMETRY = 13
    PORT = 14
    WRONG_DEVICE = 15
    DEFECT = 16
    STOP_UNANSWERED = 17
    OTHER = 18
    DEVICE_CLOCK = 19

    @property
    def text(self) -> str:
        """Name of the reason in lower case, for use in a sentence."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class DriverStatus:
    """State of the motors, and the reason why they are not ready.

    Attributes
    ----------
    state : DriverState
    reason : DriverReason
    text : str
        Text that describes state and reason, and the required action of the user.
    enabled_ns : int
        Wall clock time of the last enable [ns]. 0 if the motors were never enabled.
    """

    state: DriverState
    reason: DriverReason = DriverReason.NONE
    text: str = ""
    enabled_ns: int = 0
