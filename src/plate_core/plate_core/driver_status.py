"""What the driver says of the motors: a state, a reason, and both in words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

__all__ = ["DriverReason", "DriverState", "DriverStatus"]


class DriverState(IntEnum):
    """What the motors do, as in plate_interfaces/DriverStatus, which says what each one means."""

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
    """Why they are not ready, as in plate_interfaces/DriverStatus."""

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
    def words(self) -> str:
        """Its name, as it stands in a sentence."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class DriverStatus:
    """What the motors do, and why they are not ready.

    Attributes
    ----------
    state : DriverState
    reason : DriverReason
    text : str
        Both in words, with what to do.
    enabled_ns : int
        Wall clock at the last enable [ns]; 0: there was none.
    """

    state: DriverState
    reason: DriverReason = DriverReason.NONE
    text: str = ""
    enabled_ns: int = 0
