"""Simulated serial line in one direction.

Bytes arrive after the transmission time plus the delay in `LineFaults`. Random bytes are lost,
changed or repeated. The time is an argument of the methods, so that the simulation needs no clock.
"""

from __future__ import annotations

import numpy as np

from plate_core.serial_protocol import BITS_PER_BYTE

from .faults import LineFaults

SPLIT_S = 0.004
"""Maximum pause between the two parts of a split transmission [s]."""


class Line:
    """Serial line in one direction.

    Parameters
    ----------
    faults : LineFaults
    rng : Generator
        Random number generator for the faults.
    """

    def __init__(self, faults: LineFaults, rng: np.random.Generator) -> None:
        self.faults = faults
        self._rng = rng
        self._in_transit: list[tuple[float, bytes]] = []
        self._free_at = float("-inf")  # time at which the last byte arrives at the receiver [s]

    def sent(self, data: bytes, now: float) -> None:
        """Send bytes at the time `now` [s]."""
        if not data:
            return
        for late, part in self._split_randomly(data):
            start = max(now + self.faults.delay + late, self._free_at)
            baud = self.faults.baud
            self._free_at = start + (len(part) * BITS_PER_BYTE / baud if baud else 0.0)
            self._in_transit.append((self._free_at, self._damage(part)))

    def idle(self, now: float) -> bool:
        """Return whether the sender has transmitted all bytes by the time `now` [s]."""
        return self._free_at - self.faults.delay <= now

    def arrived(self, now: float) -> bytes:
        """Remove the bytes that have arrived by the time `now` [s], and return them."""
        arrived_bytes = b"".join(data for arrival, data in self._in_transit if arrival <= now)
        if arrived_bytes or (self._in_transit and self._in_transit[0][0] <= now):
            self._in_transit = [item for item in self._in_transit if item[0] > now]
        return arrived_bytes

    def cut(self) -> None:
        """Discard all bytes on the line."""
        self._in_transit, self._free_at = [], float("-inf")

    def _split_randomly(self, data: bytes) -> list[tuple[float, bytes]]:
        if len(data) < 2 or self._rng.random() >= self.faults.split:
            return [(0.0, data)]
        cut = int(self._rng.integers(1, len(data)))
        return [(0.0, data[:cut]), (float(self._rng.uniform(0, SPLIT_S)), data[cut:])]

    def _damage(self, data: bytes) -> bytes:
        faults = self.faults
        if not (faults.dropped or faults.corrupted or faults.repeated):
            return data
        values = np.frombuffer(data, np.uint8)
        drawn = self._rng.random((3, len(values)))
        other = self._rng.integers(1, 256, len(values), dtype=np.uint8)
        values = np.where(drawn[0] < faults.corrupted, values ^ other, values)
        count = np.where(drawn[1] < faults.dropped, 0, 1 + (drawn[2] < faults.repeated))
        return np.repeat(values, count).tobytes()
