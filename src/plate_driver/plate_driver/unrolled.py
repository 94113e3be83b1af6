"""Cycle after cycle as one endless row of setpoints, for a device to which they are streamed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plate_core.motion import quintic_pieces
from plate_core.serial_protocol import TICK_S, Knot

from .motor_table import MotorTable

LONGEST_S = 0.04
"""Longest piece of a stream [s]; devices take 50 ms."""

TICKS = 2**32
"""Times on the wire count modulo this many ticks."""

REST_TICKS = 1_000_000
"""From a cycle's end, at home without speed, to rest without acceleration [TICK_S]: 10 ms. The
quintic between them needs no more acceleration than there was."""


@dataclass(frozen=True)
class Unrolled:
    """A row of setpoints that goes on with the newest cycle wherever one ends.

    Attributes
    ----------
    cycle, newest : tuple of Knot
        The cycle that is told now, and the one to follow: from 0 to its period, both ends given.
    left : int
        Times that the newest is yet to be told: then the row ends at rest.
    told : int
        Setpoints so far.
    at : int
        Next knot of the cycle.
    begin : int
        When the cycle began, since the row's start [TICK_S].
    ended : bool
        Whether rest at the end was told.
    """

    cycle: tuple[Knot, ...]
    newest: tuple[Knot, ...]
    left: int
    told: int = 0
    at: int = 0
    begin: int = 0
    ended: bool = False

    @classmethod
    def of(cls, cycle: tuple[Knot, ...], repeats: int) -> Unrolled:
        """Return the row that tells a cycle so many times."""
        return cls(cycle, cycle, repeats - 1)

    @property
    def time(self) -> float:
        """Time of the last setpoint told [s]."""
        rest = REST_TICKS if self.ended else 0
        return (self.begin + self.cycle[max(0, self.at - 1)].ticks + rest) * TICK_S

    def followed_by(self, cycle: tuple[Knot, ...], repeats: int) -> Unrolled:
        """Return the row that goes on with another cycle; one that has ended does not."""
        return replace(self, newest=cycle, left=repeats)

    def until(self, time: float) -> tuple[Unrolled, tuple[Knot, ...]]:
        """Return the row told up to a time [s] or a little more, and what is new of it."""
        row, knots = self, []
        while row.time < time and not row.ended:
            if row.at == len(row.cycle):  # its end was told: the next one's start is the same
                begin = row.begin + row.cycle[-1].ticks
                if not row.left:
                    ticks = (begin + REST_TICKS) % TICKS
                    knots.append(Knot(ticks, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4))
                    row = replace(row, told=row.told + 1, ended=True)
                    continue
                row = replace(row, cycle=row.newest, at=1, begin=begin, left=row.left - 1)
            knot = row.cycle[row.at]
            knots.append(replace(knot, ticks=(row.begin + knot.ticks) % TICKS))
            row = replace(row, at=row.at + 1, told=row.told + 1)
        return row, tuple(knots)


def knots(table: MotorTable) -> tuple[Knot, ...]:
    """Return the knots of a motor table, as the device gets them."""
    return _rounded(table.cycle.times, table.q, table.qd, table.qdd)


def finer(table: MotorTable) -> tuple[Knot, ...]:
    """Return the same motion with no piece longer than a stream's may be."""
    times = table.cycle.times
    steps = np.diff(times)
    counts = np.ceil(steps / LONGEST_S).astype(int)
    piece = np.repeat(np.arange(len(steps)), counts)
    part = np.concatenate([np.arange(n) / n for n in counts]) * steps[piece]
    powers = quintic_pieces(times, table.q, table.qd, table.qdd)[piece]
    states = [table.q, table.qd, table.qdd]
    for order, ends in enumerate(states):
        value = np.zeros((len(piece), ends.shape[1]))
        for k in range(5 - order, -1, -1):
            value = value * part[:, None] + powers[:, k]
        states[order] = np.concatenate([value, ends[-1:]])
        powers = powers[:, 1:] * np.arange(1, 6 - order)[:, None]
    return _rounded(np.append(times[piece] + part, times[-1]), *states)


def _rounded(times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[Knot, ...]:
    """Knots in the wire's precision."""
    states = (np.asarray(x, np.float32).tolist() for x in (q, qd, qdd))
    ticks = np.round(times / TICK_S).astype(int).tolist()
    rows = zip(ticks, *states, strict=True)
    return tuple(Knot(t, tuple(x), tuple(v), tuple(a)) for t, x, v, a in rows)
