"""A motor table on the device: its quintics, and the checks before it may play.

All in the order and the single precision of firmware/table.c, so that both play the same bits.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from plate_core.serial_protocol import MOTORS, TICK_S, Knot, Status, table_crc

from . import piece
from .changed import changed
from .limits import DeviceLimits
from .piece import PIECE_WORK, Look, lengths, looks, rows

REST_M, REST_SPEED = np.float32(2e-6), np.float32(2e-3)
"""How far from rest at home a table may begin and end [m], [m/s]: rounding, and no jolt."""

SHORTEST_TICKS = 1_000_000
"""Shortest table [TICK_S]: 10 ms, several ticks."""


@dataclass(frozen=True)
class Draft:
    """The second buffer: a table that is being filled, and looked at piece by piece.

    Attributes
    ----------
    table, count, crc : int
        As in Begin.
    knots : mapping of int to Knot
        Those that have come.
    number : int
        Knots that have been looked at, each with the piece before it.
    status : Status
        DONE so far, or why the table must not play.
    ahead : tuple of Look
        Pieces before the knots from `number` on, as far as they were computed.
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
    knots: Mapping[int, Knot] = field(default_factory=dict)
    number: int = 0
    status: Status = Status.DONE
    ahead: tuple[Look, ...] = ()
    left: int | None = None
    heat: np.ndarray = field(default_factory=lambda: np.zeros(MOTORS, np.float32))
    made: Table | None = None

    @property
    def period_ticks(self) -> int:
        """Time of the last knot, which must be there [TICK_S]."""
        return self.knots[self.count - 1].ticks

    @property
    def looked_at(self) -> bool:
        """Whether all has been looked at, or enough to refuse it: then `status` is the answer."""
        return self.status is not Status.DONE or self.number == self.count

    def filled(self, first: int, knots: tuple[Knot, ...]) -> Draft:
        """Return the draft with more knots; one that is there stays as it came first."""
        more = {first + i: knot for i, knot in enumerate(knots)}
        return changed(self, knots={**more, **self.knots})

    def looked(self, limits: DeviceLimits, work: int) -> Draft:
        """Return the draft after as much looking as there is work for."""
        draft = self
        while work > 0 and draft.number in draft.knots and not draft.looked_at:
            if draft.left is None:
                status = draft._order()
                if status is not Status.DONE:
                    return changed(draft, status=status)
                if draft.number > 0 and not draft.ahead:
                    draft = changed(draft, ahead=tuple(draft._looks(limits)))
                work -= PIECE_WORK
            if draft.number == 0:
                draft = changed(draft, number=1)
                continue
            look = draft.ahead[0]
            left = look.halvings if draft.left is None else draft.left
            done = min(left, max(work, 0))
            work -= done
            if left > done:
                return changed(draft, left=left - done)
            draft = changed(
                draft, left=None, ahead=draft.ahead[1:], number=draft.number + 1,
                heat=draft.heat + look.heat, status=Status.DONE if look.keeps else Status.LIMIT,
            )  # fmt: skip
            if look.keeps and draft.number == draft.count:
                draft = draft._whole(limits)
        return draft

    def _order(self) -> Status:
        """Whether the next knot follows upon the one before, and is home where it has to be."""
        knot, last = self.knots[self.number], self.number == self.count - 1
        if knot.ticks <= self.knots[self.number - 1].ticks if self.number else knot.ticks != 0:
            return Status.WRONG_TIMES
        if last and knot.ticks < SHORTEST_TICKS:
            return Status.WRONG_TIMES
        return Status.JUMP if (last or not self.number) and not is_home(knot) else Status.DONE

    def _looks(self, limits: DeviceLimits) -> list[Look]:
        """Look at all pieces from the next one on of which both ends are there, in order."""
        knots = [self.knots[self.number - 1], self.knots[self.number]]
        while (after := self.knots.get(self.number + len(knots) - 1)) is not None:
            if after.ticks <= knots[-1].ticks:
                break
            knots.append(after)
        return looks(np.array([knot.ticks for knot in knots]), rows(knots), limits)

    def _whole(self, limits: DeviceLimits) -> Draft:
        """What only the whole table tells."""
        knots = [self.knots[k] for k in range(self.count)]
        if table_crc(knots) != self.crc:
            return changed(self, status=Status.INCOMPLETE)
        bearable = limits.bearable * (np.float32(self.period_ticks) * piece.TICK_S)
        if not (self.heat <= bearable).all():
            return changed(self, status=Status.LIMIT)
        table = Table(self.table, np.array([knot.ticks for knot in knots]), *rows(knots))
        return changed(self, made=table)


def is_home(knot: Knot) -> bool:
    """Tell whether a knot is at rest at home."""
    q, v = np.abs(np.array([knot.position, knot.velocity], np.float32))
    return bool((q <= REST_M).all() and (v <= REST_SPEED).all())


@dataclass(frozen=True)
class Table:
    """A whole table.

    Attributes
    ----------
    table : int
        Its number.
    ticks : (k + 1,)
        Times of the knots, from 0 [TICK_S].
    position, velocity, acceleration : (k + 1, 4)
        Of the motors [m], [m/s], [m/s2], float32.
    """

    table: int
    ticks: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

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

    @cached_property
    def pieces(self) -> np.ndarray:
        """Coefficients (6, k, 3, 4) of the pieces' quintics and their first two derivatives by
        s = t/h [m], highest power first."""
        h = lengths(self.ticks)[:, None]
        a, b = slice(None, -1), slice(1, None)
        half = np.float32(0.5)
        c0, c1 = self.position[a], h * self.velocity[a]
        c2 = half * h * h * self.acceleration[a]
        # What the left end's Taylor polynomial misses at the right end
        dp = self.position[b] - c0 - c1 - c2
        dv = h * self.velocity[b] - c1 - 2 * c2
        da = h * h * self.acceleration[b] - 2 * c2
        c3 = 10 * dp - 4 * dv + half * da
        c4 = -15 * dp + 7 * dv - da
        c5 = 6 * dp - 3 * dv + half * da
        no = np.zeros_like(c0)
        rows = [
            [c5, c4, c3, c2, c1, c0],
            [no, 5 * c5, 4 * c4, 3 * c3, 2 * c2, c1],
            [no, no, 20 * c5, 12 * c4, 6 * c3, 2 * c2],
        ]
        return np.array(rows).transpose(1, 2, 0, 3)

    @cached_property
    def scales(self) -> np.ndarray:
        """Powers (k, 3, 1) of the pieces' lengths: 1, h, h^2."""
        h = lengths(self.ticks)
        return np.stack([np.ones_like(h), h, h * h], axis=1)[:, :, None]

    def piece_at(self, into: int) -> int:
        """Return the number of the piece that is played at a time [TICK_S]."""
        return min(max(bisect_right(self.knot_ticks, into) - 1, 0), len(self.knot_ticks) - 2)

    def at(self, into: int) -> np.ndarray:
        """Return position, speed and acceleration (3, 4) at a time [TICK_S] within the period."""
        k, ticks = self.piece_at(into), self.knot_ticks
        s = np.float32(into - ticks[k]) / np.float32(ticks[k + 1] - ticks[k])
        all_pieces = self.pieces
        value = all_pieces[0, k]
        for power in range(1, 6):
            value = all_pieces[power, k] + s * value
        return np.asarray(value / self.scales[k] + np.float32(0))  # no negative zero
