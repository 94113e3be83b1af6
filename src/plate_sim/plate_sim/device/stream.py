"""A table to which knots are added while it plays (firmware/table.c, stream_add)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plate_core.serial_protocol import Knot, Status
from plate_core.serial_protocol.messages import MOTORS, TICK_S

from .limits import DeviceLimits
from .table import STATES, Table

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

    def added(
        self, first: int, knots: tuple[Knot, ...], time: float, limits: DeviceLimits
    ) -> tuple[Stream, float, Status]:
        """Return the stream with knots from number `first` on, and its time.

        Parameters
        ----------
        time : float
            Into the stream [s]; what was played before may make room.
        """
        known = (self.following - first) % 2**16
        if known >= 2**15:
            return self, time, Status.INCOMPLETE
        stream, status = self, Status.DONE
        for knot in knots[known:]:
            stream, time, status = stream._one_more(knot, time, limits)
            if status is not Status.DONE:
                break
        return stream, time, status

    def _one_more(
        self, knot: Knot, time: float, limits: DeviceLimits
    ) -> tuple[Stream, float, Status]:
        ticks = 0
        state = [np.array([getattr(knot, name)], np.float32) for name in STATES]
        if len(self.ticks):
            step = (knot.ticks - self.told) % 2**32
            if not 0 < step <= LONGEST_PIECE:
                return self, time, Status.WRONG_TIMES
            ticks = int(self.ticks[-1]) + step
            piece = Table(self.table, np.array([self.ticks[-1], ticks]), *self._with(state, -1))
            if not piece.keeps(limits):
                return self, time, Status.LIMIT
        gone, begin = 0, 0
        if len(self.ticks) == MAX_KNOTS:
            gone = self.piece_at(time)
            if gone == 0:
                return self, time, Status.TOO_LONG
            begin = int(self.ticks[gone])
            time -= begin * TICK_S
        stream = Stream(
            self.table,
            np.append(self.ticks[gone:], ticks) - begin,
            *self._with(state, gone),
            following=(self.following + 1) % 2**16,
            told=knot.ticks,
        )
        return stream, time, Status.DONE

    def _with(
        self, state: list[np.ndarray], begin: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States of the knots from `begin` on, and one more."""
        q, v, a = (
            np.concatenate([getattr(self, n)[begin:], s])
            for n, s in zip(STATES, state, strict=True)
        )
        return q, v, a
