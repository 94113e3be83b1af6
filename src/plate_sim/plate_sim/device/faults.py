"""Faults of the simulated device. The faults are errors on the serial line, and periodic
disconnections, resets and brown-outs. The modules `serial_line` and `emulator` simulate these
faults."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from plate_core import PlateError


@dataclass(frozen=True)
class LineFaults:
    """Faults of a serial line.

    Attributes
    ----------
    dropped, corrupted, repeated : float
        Fractions of the bytes that are lost, changed and repeated.
    split : float
        Fraction of transmissions whose second part is delayed by up to 4 ms.
    delay : float
        Delay of all bytes [s].
    baud : float
        Speed of the line [bit/s]. 0 means that a transmission takes no time.
    """

    dropped: float = 0.0
    corrupted: float = 0.0
    repeated: float = 0.0
    split: float = 0.0
    delay: float = 0.0
    baud: float = 0.0

    def __post_init__(self) -> None:
        for name in ("dropped", "corrupted", "repeated", "split", "delay"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise PlateError(f"{name} is {value!r}, allowed: 0 to 1")
        if not 0 <= self.baud < inf:
            raise PlateError(f"baud is {self.baud!r}, allowed: 0 or more")


@dataclass(frozen=True)
class FaultSchedule:
    """Schedule of periodic faults.

    Attributes
    ----------
    line : LineFaults
        Faults of the line in both directions.
    disconnect_every, reset_every, brown_out_every : float
        Periods of disconnections, resets and brown-outs [s]. 0 disables this kind of fault.
    disconnect_s : float
        Duration of a disconnection [s].
    """

    line: LineFaults = field(default_factory=LineFaults)
    disconnect_every: float = 0.0
    reset_every: float = 0.0
    brown_out_every: float = 0.0
    disconnect_s: float = 2.0

    def __post_init__(self) -> None:
        for name in ("disconnect_every", "reset_every", "brown_out_every", "disconnect_s"):
            value = getattr(self, name)
            if not 0 <= value < 1e6:
                raise PlateError(f"{name} is {value!r}, allowed: 0 to 1e6 s")
