"""A table to which knots are added while it plays (firmware/table.c, stream_add)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core.serial_protocol import MOTORS, Knot, Status

from .limits import DeviceLimits
from .piece import Look, looks, rows
from .table import REST_M, REST_SPEED, Table

MAX_KNOTS = 512
"""What a table or a stream can hold."""

LONGEST_PIECE = 5_000_000
"""Of a stream [TICK_S]: 50 ms, so that times never wrap."""


@dataclass(frozen=True)
class Stream(Table):
    """Setpoints that are streamed.

    Attributes
    ----------
    following : int
        Number of the knot to come, modulo 65536.
    told : int
        Time of the last one, as the host counts it, modulo 2^32 [TICK_S].
    """

    following: int = 0
    told: int = 0

    @classmethod
    def opened(cls, table: int) -> Stream:
        """Return a stream without knots."""
        nothing = np.zeros((0, MOTORS), np.float32)
        return cls(table, np.zeros(0, int), nothing, nothing, nothing)

    @property
    def rests(self) -> bool:
        """Whether the last knot is at rest."""
        return not (np.any(self.velocity[-1]) or np.any(self.acceleration[-1]))

    @property
    def begins_home(self) -> bool:
        """Whether the first knot is at rest at home."""
        q, v = np.abs(self.position[0]), np.abs(self.velocity[0])
        return bool((q <= REST_M).all() and (v <= REST_SPEED).all())

    def known(self, first: int) -> int | None:
        """Return how many of a message's knots, from number `first` on, are there already; None if
        there is a gap before them."""
        known = (self.following - first) % 2**16
        return known if known < 2**15 else None

    def room(self, time: int) -> int:
        """Return how many knots have been played at a time [TICK_S], if the buffer is full."""
        return self.piece_at(time) if len(self.ticks) == MAX_KNOTS else 0

    def refusal(self, knot: Knot, time: int) -> Status:
        """Return why a knot cannot be added, its piece not looked at, or DONE."""
        if not len(self.ticks):
            return Status.DONE
        if not 0 < (knot.ticks - self.told) % 2**32 <= LONGEST_PIECE:
            return Status.WRONG_TIMES
        full = len(self.ticks) - self.room(time) == MAX_KNOTS
        return Status.TOO_LONG if full else Status.DONE

    def look(self, knot: Knot, limits: DeviceLimits) -> Look:
        """Look at the piece up to a knot that may follow."""
        ticks = np.array([0, (knot.ticks - self.told) % 2**32])
        last = (self.position[-1], self.velocity[-1], self.acceleration[-1])
        states = [np.stack([x, y[0]]) for x, y in zip(last, rows([knot]), strict=True)]
        return looks(ticks, (states[0], states[1], states[2]), limits)[0]

    def added(self, knot: Knot, time: int) -> tuple[Stream, int]:
        """Return the stream with one more knot, and its time [TICK_S]: what was played makes room
        where it must, and counts no longer."""
        ticks = 0
        if len(self.ticks):
            ticks = int(self.ticks[-1]) + (knot.ticks - self.told) % 2**32
        gone = self.room(time)
        begin = int(self.ticks[gone]) if gone else 0
        q, v, a = (
            np.concatenate([old[gone:], new])
            for old, new in zip(
                (self.position, self.velocity, self.acceleration), rows([knot]), strict=True
            )
        )
        stream = Stream(
            self.table, np.append(self.ticks[gone:], ticks) - begin, q, v, a,
            following=(self.following + 1) % 2**16, told=knot.ticks,
        )  # fmt: skip
        return stream, time - begin
