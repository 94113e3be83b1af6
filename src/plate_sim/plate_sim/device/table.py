"""Motor tables and streams on the device, and the checks before they play (firmware/table.c).

All in the order and the single precision of the firmware, so that both play the same bits.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from plate_core.serial_protocol import MOTORS, TICK_S, Knot, Status, table_crc

from . import piece
from .limits import DeviceLimits
from .piece import PIECE_WORK, PieceCheck, check_pieces, coefficients, lengths, states_of

REST_M, REST_SPEED = np.float32(2e-6), np.float32(2e-3)
"""How far from rest at home a table may begin and end [m], [m/s]: rounding, and no jolt. (One that
follows upon a splice begins in motion.)"""

SHORTEST_TICKS = 1_000_000
"""Shortest table, or part of one before or after its splice [TICK_S]: 10 ms, several ticks."""

MAX_KNOTS = 512
"""What a table or a stream can hold."""

LONGEST_PIECE = 5_000_000
"""Of a stream [TICK_S]: 50 ms, so that times never wrap."""

T = TypeVar("T")


def changed(before: T, /, **values: Any) -> T:
    """Return a copy of a frozen state with other values: `dataclasses.replace`, 7 times as fast.

    The device makes some six of them each millisecond. For states that check and derive nothing.
    """
    new = object.__new__(type(before))
    new.__dict__.update(before.__dict__)
    new.__dict__.update(values)
    return new


@dataclass(frozen=True)
class Table:
    """A whole table.

    Attributes
    ----------
    table : int
        Its number.
    ticks : (k + 1,)
        Times of the knots, from 0 [TICK_S].
    states : (3, k + 1, 4)
        Position, speed and acceleration of the motors [m], [m/s], [m/s2], float32.
    splice : int
        When the next table may take over, and else its tail begins [TICK_S]; 0: it has none.
    """

    table: int
    ticks: np.ndarray
    states: np.ndarray
    splice: int = 0

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the knots (k + 1,) [s]."""
        return self.ticks * TICK_S

    @cached_property
    def knot_ticks(self) -> list[int]:
        """Times of the knots [TICK_S]."""
        return [int(ticks) for ticks in self.ticks]

    @property
    def period_ticks(self) -> int:
        """Its length [TICK_S]."""
        return self.knot_ticks[-1]

    @property
    def period(self) -> float:
        """Its length [s]."""
        return float(self.times[-1])

    @property
    def begins_home(self) -> bool:
        """Whether the first knot is at rest at home."""
        return is_home(self.states[:2, 0])

    def follows(self, before: Table) -> bool:
        """Tell whether it begins in the very state, bit by bit, in which another is spliced."""
        if not before.splice:
            return False
        splice = before.states[:, before.knot_ticks.index(before.splice)]
        return self.states[:, 0].tobytes() == splice.tobytes()

    def part(self, into: int) -> tuple[int, int]:
        """Return the time into the part that is played at a time, its cycle or its tail, and that
        part's length [TICK_S]."""
        if into < self.splice:
            return into, self.splice
        return into - self.splice, self.period_ticks - self.splice

    @cached_property
    def coefficients(self) -> np.ndarray:
        """See `piece.coefficients`."""
        return coefficients(self.ticks, self.states)

    @cached_property
    def scales(self) -> np.ndarray:
        """Powers (k, 3, 1) of the pieces' lengths: 1, h, h^2."""
        h = lengths(self.ticks)
        return np.stack([np.ones_like(h), h, h * h], axis=1)[:, :, None]

    def piece_at(self, into: int) -> int:
        """Return the number of the piece that is played at a time [TICK_S]."""
        return min(max(bisect_right(self.knot_ticks, into) - 1, 0), len(self.knot_ticks) - 2)

    def at(self, into: int) -> np.ndarray:
        """Return position, speed and acceleration (3, 4) at a time [TICK_S]; at the end, rest."""
        if into == self.period_ticks:
            return np.stack(
                [self.states[0, -1] + np.float32(0), *np.zeros((2, MOTORS), np.float32)]
            )
        k, ticks = self.piece_at(into), self.knot_ticks
        s = np.float32(into - ticks[k]) / np.float32(ticks[k + 1] - ticks[k])
        powers = self.coefficients[:, k]
        value = powers[0]
        for power in powers[1:]:
            value = power + s * value
        return np.asarray(value / self.scales[k] + np.float32(0))  # no negative zero


@dataclass(frozen=True)
class Stream(Table):
    """Setpoints that are streamed.

    Attributes
    ----------
    following : int
        Number of the knot to come, modulo 65536.
    last_ticks : int
        Time of the last one, as the host counts it, modulo 2^32 [TICK_S].
    """

    following: int = 0
    last_ticks: int = 0

    @classmethod
    def opened(cls, table: int) -> Stream:
        """Return a stream without knots."""
        return cls(table, np.zeros(0, int), np.zeros((3, 0, MOTORS), np.float32))

    @property
    def rests(self) -> bool:
        """Whether the last knot is at rest."""
        return not np.any(self.states[1:, -1])

    def known(self, first: int) -> int | None:
        """Return how many of a message's knots, from number `first` on, are there already; None if
        there is a gap before them."""
        known = (self.following - first) % 2**16
        return known if known < 2**15 else None

    def room(self, time: int) -> int:
        """Return how many knots have been played at a time [TICK_S], if the buffer is full."""
        return self.piece_at(time) if len(self.ticks) == MAX_KNOTS else 0

    def refusal(self, knot: Knot, time: int) -> Status:
        """Return why a knot cannot be added, its piece not checked, or DONE."""
        if not len(self.ticks):
            return Status.DONE
        if not 0 < (knot.ticks - self.last_ticks) % 2**32 <= LONGEST_PIECE:
            return Status.WRONG_TIMES
        full = len(self.ticks) - self.room(time) == MAX_KNOTS
        return Status.TOO_LONG if full else Status.DONE

    def check(self, knot: Knot, limits: DeviceLimits) -> PieceCheck:
        """Check the piece up to a knot that may follow."""
        ticks = np.array([0, (knot.ticks - self.last_ticks) % 2**32])
        states = np.concatenate([self.states[:, -1:], states_of([knot])], axis=1)
        return check_pieces(ticks, states, limits)[0]

    def added(self, knot: Knot, time: int) -> tuple[Stream, int]:
        """Return the stream with one more knot, and its time [TICK_S]: what was played makes room
        where it must, and counts no longer."""
        ticks = 0
        if len(self.ticks):
            ticks = int(self.ticks[-1]) + (knot.ticks - self.last_ticks) % 2**32
        gone = self.room(time)
        begin = int(self.ticks[gone]) if gone else 0
        states = np.concatenate([self.states[:, gone:], states_of([knot])], axis=1)
        stream = Stream(
            self.table, np.append(self.ticks[gone:], ticks) - begin, states,
            following=(self.following + 1) % 2**16, last_ticks=knot.ticks,
        )  # fmt: skip
        return stream, time - begin


@dataclass(frozen=True)
class PendingTable:
    """A table that is being filled, and checked piece by piece.

    Attributes
    ----------
    table, count, crc, splice : int
        As in Begin.
    knots : mapping of int to Knot
        Those that have come.
    number : int
        Knots that have been checked, each with the piece before it.
    status : Status
        DONE so far, or why the table must not play.
    ahead : tuple of PieceCheck
        Of the pieces before the knots from `number` on, as far as they were computed.
    left : int or None
        Halvings left of the first of them, if it was begun.
    heat : (4,)
        Integral of force squared so far [N2 s], float32.
    made : Table or None
        All of it, once it may play.
    """

    table: int
    count: int
    crc: int
    splice: int
    knots: Mapping[int, Knot] = field(default_factory=dict)
    number: int = 0
    status: Status = Status.DONE
    ahead: tuple[PieceCheck, ...] = ()
    left: int | None = None
    heat: np.ndarray = field(default_factory=lambda: np.zeros(MOTORS, np.float32))
    made: Table | None = None

    @property
    def period_ticks(self) -> int:
        """Time of the last knot, which must be there [TICK_S]."""
        return self.knots[self.count - 1].ticks

    @property
    def closes(self) -> bool:
        """Whether it begins at rest at home, which must be known, and has no tail."""
        return not self.splice and is_home(states_of([self.knots[0]])[:2, 0])

    @property
    def decided(self) -> bool:
        """Whether all has been checked, or enough to refuse it: then `status` is the answer."""
        return self.status is not Status.DONE or self.number == self.count

    def filled(self, first: int, knots: tuple[Knot, ...]) -> PendingTable:
        """Return the table with more knots; one that is there stays as it came first."""
        more = {first + i: knot for i, knot in enumerate(knots)}
        return changed(self, knots={**more, **self.knots})

    def checked(self, limits: DeviceLimits, work: int) -> PendingTable:
        """Return the table after as many checks as there is work for."""
        table = self
        while work > 0 and table.number in table.knots and not table.decided:
            if table.left is None:
                status = table._order()
                if status is not Status.DONE:
                    return changed(table, status=status)
                if table.number > 0 and not table.ahead:
                    table = changed(table, ahead=tuple(table._checks(limits)))
                work -= PIECE_WORK
            if table.number == 0:
                table = changed(table, number=1)
                continue
            check = table.ahead[0]
            left = check.halvings if table.left is None else table.left
            done = min(left, max(work, 0))
            work -= done
            if left > done:
                return changed(table, left=left - done)
            heat, ticks = table.heat + check.heat, table.knots[table.number].ticks
            keeps = check.keeps and (ticks != table.splice or bears(limits, heat, ticks))
            table = changed(
                table, left=None, ahead=table.ahead[1:], number=table.number + 1,
                heat=heat, status=Status.DONE if keeps else Status.LIMIT,
            )  # fmt: skip
            if keeps and table.number == table.count:
                table = table._whole(limits)
        return table

    def _order(self) -> Status:
        """Whether the next knot follows upon the one before; the last one, after a splice that
        there is, to rest."""
        knot, splice = self.knots[self.number], self.splice
        if knot.ticks <= self.knots[self.number - 1].ticks if self.number else knot.ticks != 0:
            return Status.WRONG_TIMES
        if self.number < self.count - 1:
            return Status.DONE
        found = any(self.knots[k].ticks == splice for k in range(self.number))
        if not found or 0 < splice < SHORTEST_TICKS or knot.ticks - splice < SHORTEST_TICKS:
            return Status.WRONG_TIMES
        return Status.DONE if is_home(states_of([knot])[:2, 0]) else Status.JUMP

    def _checks(self, limits: DeviceLimits) -> list[PieceCheck]:
        """Check all pieces from the next one on of which both ends are there, in order."""
        knots = [self.knots[self.number - 1], self.knots[self.number]]
        while (after := self.knots.get(self.number + len(knots) - 1)) is not None:
            if after.ticks <= knots[-1].ticks:
                break
            knots.append(after)
        return check_pieces(np.array([knot.ticks for knot in knots]), states_of(knots), limits)

    def _whole(self, limits: DeviceLimits) -> PendingTable:
        """What only the whole table tells."""
        knots = [self.knots[k] for k in range(self.count)]
        if table_crc(knots) != self.crc:
            return changed(self, status=Status.INCOMPLETE)
        if not bears(limits, self.heat, self.period_ticks):
            return changed(self, status=Status.LIMIT)
        ticks = np.array([knot.ticks for knot in knots])
        whole = Table(self.table, ticks, states_of(knots), self.splice)
        return changed(self, made=whole)


def bears(limits: DeviceLimits, heat: np.ndarray, ticks: int) -> bool:
    """Tell whether motors bear an integral of force squared (4,) [N2 s] in a time [TICK_S]."""
    most = limits.continuous_square * (np.float32(ticks) * piece.TICK_S)
    return bool((heat <= most).all())


def is_home(state: np.ndarray) -> bool:
    """Tell whether position and speed (2, 4) are those of rest at home."""
    return bool((np.abs(state) <= [[REST_M], [REST_SPEED]]).all())
