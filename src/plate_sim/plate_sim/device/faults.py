"""What goes wrong with the device: faults of its line, and a schedule of greater ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from plate_core import PlateError


@dataclass(frozen=True)
class LineFaults:
    """What a serial line does to bytes.

    Attributes
    ----------
    dropped, corrupted, repeated : float
        Fraction of bytes that vanish, change, or come twice.
    split : float
        Fraction of transmissions whose second part comes later, by up to 4 ms.
    delay : float
        Of all bytes [s].
    baud : float
        Bits a second; 0: as fast as it goes.
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
    """What goes wrong again and again.

    Attributes
    ----------
    line : LineFaults
        In both directions.
    disconnect_every, reset_every, brown_out_every : float
        Time from one to the next [s]; 0: never.
    disconnect_s : float
        How long the line is disconnected [s].
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
