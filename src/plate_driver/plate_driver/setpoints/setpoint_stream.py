"""Cycle after cycle as one endless stream of setpoints, for a device to which they are streamed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly

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
class SetpointStream:
    """Setpoints that go on with the newest cycle wherever one ends.

    Attributes
    ----------
    cycle, newest : tuple of Knot
        The cycle that is sent now, and the one to follow: from 0 to its period, both ends given.
    left : int
        Times that the newest is yet to be sent: then the stream ends at rest.
    sent : int
        Setpoints so far.
    at : int
        Next knot of the cycle.
    begin : int
        When the cycle began, since the stream's start [TICK_S].
    ended : bool
        Whether rest at the end was sent.
    """

    cycle: tuple[Knot, ...]
    newest: tuple[Knot, ...]
    left: int
    sent: int = 0
    at: int = 0
    begin: int = 0
    ended: bool = False

    @classmethod
    def of(cls, cycle: tuple[Knot, ...], repeats: int) -> SetpointStream:
        """Return the stream that plays a cycle so many times."""
        return cls(cycle, cycle, repeats - 1)

    @property
    def time(self) -> float:
        """Time of the last setpoint sent [s]."""
        rest = REST_TICKS if self.ended else 0
        return (self.begin + self.cycle[max(0, self.at - 1)].ticks + rest) * TICK_S

    def followed_by(self, cycle: tuple[Knot, ...], repeats: int) -> SetpointStream:
        """Return the stream that goes on with another cycle; one that has ended does not."""
        return replace(self, newest=cycle, left=repeats)

    def until(self, time: float) -> tuple[SetpointStream, tuple[Knot, ...]]:
        """Return the stream sent up to a time [s] or a little more, and what is new of it."""
        stream, knots = self, []
        while stream.time < time and not stream.ended:
            if stream.at == len(stream.cycle):  # its end was sent: the next one's start is the same
                begin = stream.begin + stream.cycle[-1].ticks
                if not stream.left:
                    ticks = (begin + REST_TICKS) % TICKS
                    knots.append(Knot(ticks, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4))
                    stream = replace(stream, sent=stream.sent + 1, ended=True)
                    continue
                stream = replace(
                    stream, cycle=stream.newest, at=1, begin=begin, left=stream.left - 1
                )
            knot = stream.cycle[stream.at]
            knots.append(replace(knot, ticks=(stream.begin + knot.ticks) % TICKS))
            stream = replace(stream, at=stream.at + 1, sent=stream.sent + 1)
        return stream, tuple(knots)


def knots(table: MotorTable) -> tuple[Knot, ...]:
    """Return the knots of a motor table, and of its tail, in the wire's precision."""
    return _rounded(table.cycle.knots[0], table.q, table.qd, table.qdd)


def refined(table: MotorTable) -> tuple[Knot, ...]:
    """Return the same motion with no piece longer than a stream's may be."""
    times = table.cycle.times
    steps = np.diff(times)
    counts = np.ceil(steps / LONGEST_S).astype(int)
    part = np.concatenate([np.arange(n) / n for n in counts]) * np.repeat(steps, counts)
    t = np.append(np.repeat(times[:-1], counts) + part, times[-1])
    pieces = quintic_pieces(times, table.q, table.qd, table.qdd)
    spline = PPoly(pieces.transpose(1, 0, 2)[::-1], times)
    states = [spline(t, order) for order in range(3)]
    for state, exact in zip(states, (table.q, table.qd, table.qdd), strict=True):
        state[-1] = exact[-1]
    return _rounded(t, *states)


def _rounded(times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> tuple[Knot, ...]:
    """Knots in the wire's precision."""
    states = (np.asarray(x, np.float32).tolist() for x in (q, qd, qdd))
    ticks = np.round(times / TICK_S).astype(int).tolist()
    rows = zip(ticks, *states, strict=True)
    return tuple(Knot(t, tuple(x), tuple(v), tuple(a)) for t, x, v, a in rows)
