"""A serial line, one way, with all that may go wrong on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core import PlateError

BITS_PER_BYTE = 10
"""On a UART: with start and stop bit."""

SPLIT_S = 0.004
"""Longest pause between the two parts of a transmission that is split [s]."""


@dataclass(frozen=True)
class Trouble:
    """What a line does to bytes.

    Attributes
    ----------
    dropped, corrupted, repeated : float
        Share of bytes that vanish, change, or come twice.
    split : float
        Share of transmissions of which the rest comes later, by up to `SPLIT_S`.
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
        if not 0 <= self.baud < np.inf:
            raise PlateError(f"baud is {self.baud!r}, allowed: 0 or more")


class Line:
    """Bytes on their way.

    Parameters
    ----------
    trouble : Trouble
    rng : Generator
        Of all chance.
    """

    def __init__(self, trouble: Trouble, rng: np.random.Generator) -> None:
        self.trouble = trouble
        self._rng = rng
        self._way: list[tuple[float, bytes]] = []
        self._free_at = float("-inf")  # when the last byte has come

    def sent(self, data: bytes, now: float) -> None:
        """Put bytes on the line at a time [s]."""
        if not data:
            return
        for late, part in self._split(data):
            start = max(now + self.trouble.delay + late, self._free_at)
            baud = self.trouble.baud
            self._free_at = start + (len(part) * BITS_PER_BYTE / baud if baud else 0.0)
            self._way.append((self._free_at, self._spoilt(part)))

    def idle(self, now: float) -> bool:
        """Tell whether all that was sent is on its way, but for the delay."""
        return self._free_at - self.trouble.delay <= now

    def arrived(self, now: float) -> bytes:
        """Take what has come by a time [s]."""
        came = b"".join(data for at, data in self._way if at <= now)
        if came or (self._way and self._way[0][0] <= now):
            self._way = [item for item in self._way if item[0] > now]
        return came

    def cut(self) -> None:
        """Lose what is on the line."""
        self._way, self._free_at = [], float("-inf")

    def _split(self, data: bytes) -> list[tuple[float, bytes]]:
        if len(data) < 2 or self._rng.random() >= self.trouble.split:
            return [(0.0, data)]
        cut = int(self._rng.integers(1, len(data)))
        return [(0.0, data[:cut]), (float(self._rng.uniform(0, SPLIT_S)), data[cut:])]

    def _spoilt(self, data: bytes) -> bytes:
        trouble = self.trouble
        if not (trouble.dropped or trouble.corrupted or trouble.repeated):
            return data
        values = np.frombuffer(data, np.uint8)
        chance = self._rng.random((3, len(values)))
        other = self._rng.integers(1, 256, len(values), dtype=np.uint8)
        values = np.where(chance[0] < trouble.corrupted, values ^ other, values)
        count = np.where(chance[1] < trouble.dropped, 0, 1 + (chance[2] < trouble.repeated))
        return np.repeat(values, count).tobytes()
