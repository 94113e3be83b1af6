"""Conversion of successive motor tables to one continuous stream of setpoints, for devices that
receive setpoints instead of whole tables. Inputs are motor tables. The outputs are knots in the
format of the serial protocol. The times of two successive knots differ by at most `MAX_S`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from plate_core import CycleError
from plate_core.motion import evaluate_pieces, quintic_pieces
from plate_core.serial_protocol import TICK_S, Knot

from .motor_table import MotorTable

MAX_S = 0.04
"""Maximum time between setpoints of a stream [s]. Devices accept up to 50 ms."""

TICKS = 2**32
"""Number at which the times in the serial protocol wrap around to 0 [TICK_S]."""

REST_TICKS = 1_000_000
"""At the end of a cycle, the motors are at home with zero speed, but their acceleration may not be
zero. In this time, the acceleration decreases to zero [TICK_S]. It is 10 ms. The quintic for this
motion does not exceed the acceleration at the end of the cycle."""

MIN_TICKS = 20_000_000
"""Minimum duration of a stream [TICK_S]. It is 0.2 s. Devices refuse a shorter stream, because they
could not brake in this time. Therefore setpoints at rest extend a shorter stream."""


@dataclass(frozen=True)
class SetpointStream:
    """Stream of setpoints of successive cycles.

    At the end of a cycle, the stream continues with the newest cycle, if this cycle begins in the
    final state of the current cycle. Otherwise the stream continues with the tail. This choice is
    made when the first setpoint after the end is sent.

    Attributes
    ----------
    playing : MotorTable
        Cycle or tail that is currently sent.
    knots : tuple of Knot
        Setpoints of `playing` from 0 to its period, both ends included.
    newest : MotorTable
        Table to play next.
    left : int
        Remaining number of plays of `newest`. After these plays, the stream ends at rest.
    sent : int
        Number of setpoints sent so far.
    at : int
        Index of the next knot to send.
    begin : int
        Start of `playing` relative to the start of the stream [TICK_S].
    rest : int
        Duration of the rest at the end [TICK_S]. 0 until the stream has ended.
    """

    playing: MotorTable
    knots: tuple[Knot, ...]
    newest: MotorTable
    left: int
    sent: int = 0
    at: int = 0
    begin: int = 0
    rest: int = 0

    @classmethod
    def of(cls, table: MotorTable, repeats: int) -> SetpointStream:
        """Return the stream that plays a table `repeats` times, from rest.

        Raises
        ------
        CycleError
            If the table begins in motion.
        """
        if not table.cycle.starts_at_rest:
            raise CycleError("plate_cycle: begins in motion, but the plate is at rest")
        return cls(table, refined(table), table, repeats - 1)

    @property
    def time(self) -> float:
        """Time of the last sent setpoint [s]."""
        return (self.begin + self.knots[max(0, self.at - 1)].ticks + self.rest) * TICK_S

    @property
    def ended(self) -> bool:
        """Whether the final setpoints at rest were sent."""
        return self.rest > 0

    def followed_by(self, table: MotorTable, repeats: int) -> SetpointStream:
        """Return the stream that continues with another table. If this stream has ended, the new
        table has no effect.

        Raises
        ------
        CycleError
            If the table begins in motion, but not in the final state of the current cycle.
        """
        if not (table.cycle.starts_at_rest or table.cycle.follows(self.playing.cycle)):
            raise CycleError(
                "plate_cycle: begins in motion, but not in the final state of the current cycle"
            )
        return replace(self, newest=table, left=repeats)

    def until(self, time: float) -> tuple[SetpointStream, tuple[Knot, ...]]:
        """Return the stream after all setpoints up to `time` [s] or slightly later were sent, and
        these setpoints."""
        stream, knots = self, []
        while stream.time < time and not stream.ended:
            # The end of this cycle is the start of the next cycle.
            if stream.at == len(stream.knots):
                after = stream._next_stream()
                if after is None:
                    end = stream.begin + stream.knots[-1].ticks
                    rests = _rest_ticks(end)
                    zero = (0.0,) * 4
                    knots += [Knot((end + rest) % TICKS, zero, zero, zero) for rest in rests]
                    stream = replace(stream, sent=stream.sent + len(rests), rest=rests[-1])
                    continue
                stream = after
            knot = stream.knots[stream.at]
            knots.append(replace(knot, ticks=(stream.begin + knot.ticks) % TICKS))
            stream = replace(stream, at=stream.at + 1, sent=stream.sent + 1)
        return stream, tuple(knots)

    def _next_stream(self) -> SetpointStream | None:
        """Return the stream at the start of the next cycle or tail. None if the stream ends at
        rest."""
        tail = self.playing.tail
        begin = self.begin + self.knots[-1].ticks
        newest = self.newest.cycle
        fits = newest.starts_at_rest if tail is None else newest.follows(self.playing.cycle)
        if self.left and fits:
            table, left = self.newest, self.left - 1
        elif tail is not None:
            table, left = tail, self.left
        else:
            return None
        return replace(self, playing=table, knots=refined(table), at=1, begin=begin, left=left)


def knots(table: MotorTable) -> tuple[Knot, ...]:
    """Return the knots of a motor table and of its tail, rounded to the precision of the
    protocol."""
    return _round_knots(table.cycle.knots[0], table.q, table.qd, table.qdd)


def densest(table: MotorTable, repeats: int, window_s: float) -> int:
    """Return the maximum number of setpoints within `window_s` [s] of a stream. The stream plays a
    table `repeats` times, followed by its tail or by setpoints at rest."""
    window = round(window_s / TICK_S)
    parts = [np.array([knot.ticks for knot in refined(part)]) for part in _table_and_tail(table)]
    if table.tail is None:
        # more repetitions give the same maximum counts
        parts *= min(repeats, window // int(parts[0][-1]) + 2)
    times = np.array([0])
    for part in parts:
        times = np.append(times, times[-1] + part[1:])
    times = np.append(times, times[-1] + np.array(_rest_ticks(int(times[-1]))))
    counts = np.searchsorted(times, times + window, side="right") - np.arange(len(times))
    return int(np.max(counts))


def _table_and_tail(table: MotorTable) -> tuple[MotorTable, ...]:
    """Return the table, followed by its tail if the table has a tail."""
    return (table,) if table.tail is None else (table, table.tail)


def _rest_ticks(end: int) -> list[int]:
    """Return the times of the setpoints at rest [TICK_S], relative to the end of the motion. `end`
    is the end of the motion relative to the start of the stream [TICK_S]."""
    last = max(REST_TICKS, MIN_TICKS - end)
    steps = math.ceil((last - REST_TICKS) * TICK_S / MAX_S)
    return [round(t) for t in np.linspace(REST_TICKS, last, steps + 1)]


def refined(table: MotorTable) -> tuple[Knot, ...]:
    """Return a table's motion without its tail, with pieces of at most `MAX_S`."""
    times = table.cycle.times
    states_at_knots = [values[: len(times)] for values in (table.q, table.qd, table.qdd)]
    steps = np.diff(times)
    counts = np.ceil(steps / MAX_S).astype(int)
    part = np.concatenate([np.arange(n) / n for n in counts]) * np.repeat(steps, counts)
    t = np.append(np.repeat(times[:-1], counts) + part, times[-1])
    pieces = quintic_pieces(times, *states_at_knots)
    states = [evaluate_pieces(times, pieces, t, order) for order in range(3)]
    for state, exact in zip(states, states_at_knots, strict=True):
        state[-1] = exact[-1]
    return _round_knots(t, *states)


def _round_knots(
    times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[Knot, ...]:
    """Return knots, rounded to the precision of the protocol."""
    states = (np.asarray(x, np.float32).tolist() for x in (q, qd, qdd))
    ticks = np.round(times / TICK_S).astype(int).tolist()
    rows = zip(ticks, *states, strict=True)
    return tuple(Knot(t, tuple(x), tuple(v), tuple(a)) for t, x, v, a in rows)
