"""What a serial line is like, as the host sees it: how fast, how far, how much of it is lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, log, log1p

from plate_core.serial_protocol import (
    BITS_PER_BYTE,
    HEADER,
    KNOTS_PER_MESSAGE,
    LAYOUTS,
    Acknowledgement,
    Begin,
    Commit,
    Heartbeat,
    Knot,
    Knots,
    Message,
    Pulse,
    Status,
    Telemetry,
)

FRAME_BYTES = 6
"""Of a frame beside its packet: CRC, one byte of COBS, the end."""

ANSWER_S = 0.03
"""What a device may take for an answer beside the round trip [s]: a whole table is checked."""

UNKNOWN_S = 0.25
"""Wait for an answer while the round trip is not known [s]."""

MOST_ROUND_S = 0.5
"""Longest that a round trip is taken for [s], whatever was measured while this host stood still."""

HEARTBEAT_S, QUICK_HEARTBEAT_S = 0.025, 0.01
"""Time between heartbeats, and where they are lost [s]: of ten or 25 one must reach the device, or
its watchdog (0.25 s) bites. Where 5 % of the bytes are lost four heartbeats in ten come whole: ten
are all lost once in 13 s, 25 once in hours."""

HEARTBEAT_SHARE = 0.2
"""Of the line that quick heartbeats may take, at most."""

LOSSY = 0.9
"""Fraction of heartbeats that are answered below which the line counts as one that loses."""

MEMORY = 1 / 32
"""Weight of the newest heartbeat in that fraction."""

ROUNDING_S = 1e-6
"""A pulse that comes earlier than its heartbeat by less than this comes at once [s]."""

MOST_FRAME_S = 0.02
"""Longest that knots may keep the line [s]: a stop and heartbeats wait behind them."""

UNANSWERED = 0.05
"""Share of commands that may come to nothing: a round trip more each."""

TELEMETRY_S = 0.01
"""Time between two telemetries [s]."""

CHANCE = 1e-9
"""Probability that the line loses all telemetries of a time, below which their absence is an error.
Its losses are known roughly."""

MOST_PATIENCE_S = 3.0
"""Maximum time without any telemetry, whatever the line loses [s]."""

MOST_COPIES = 8
"""Times that a message is sent at once, at most, on a line that loses nearly all."""


def frame_bytes(message: Message) -> int:
    """Return the length of a message's frame."""
    knots = len(message.knots) * LAYOUTS[Knot].size if isinstance(message, Knots) else 0
    return HEADER.size + LAYOUTS[type(message)].size + knots + FRAME_BYTES


def _full(count: int) -> Knots:
    rest = (0.0,) * 4
    return Knots(1, 0, (Knot(0, rest, rest, rest),) * count)


ROUND_BYTES = frame_bytes(Heartbeat(0)) + frame_bytes(Pulse(0, 0))
"""Of a heartbeat and its pulse."""

ANSWER_BYTES = frame_bytes(Acknowledgement(0, Status.DONE))

TELEMETRY_BYTES = HEADER.size + LAYOUTS[Telemetry].size + FRAME_BYTES

FULL_BYTES = frame_bytes(_full(KNOTS_PER_MESSAGE))
"""Of the longest message of knots: a device's window is so many of them."""


def upload_s(pieces: int, baud: float) -> float:
    """Return how long a table takes on a line [s], beside the heartbeats."""
    count = LineModel(baud).knots_per_message
    messages, knots = divmod(pieces + 1, count)
    size = messages * frame_bytes(_full(count)) + (frame_bytes(_full(knots)) if knots else 0)
    size += frame_bytes(Begin(1, 0, 0)) + frame_bytes(Commit(1, 1))
    free = baud / BITS_PER_BYTE - frame_bytes(Heartbeat(0)) / HEARTBEAT_S
    return size / free if free > 0 else float("inf")


@dataclass(frozen=True)
class LineModel:
    """What heartbeats and pulses show of a line.

    Attributes
    ----------
    baud : float
        Bits a second; infinite: as fast as it goes.
    trip_s, deviation_s : float or None
        Smoothed round trip, and its mean deviation (RFC 6298) [s]; None: nothing known.
    answered : float
        Fraction of heartbeats that are answered, of late.
    beats : tuple of (int, float)
        Heartbeats that are not answered yet: their time [ns], and when they count for lost [s].
    free_at : float
        When all that was sent has left [s].
    """

    baud: float = 921_600.0
    trip_s: float | None = None
    deviation_s: float = 0.0
    answered: float = 1.0
    beats: tuple[tuple[int, float], ...] = ()
    free_at: float = float("-inf")

    @property
    def byte_s(self) -> float:
        """Time that a byte takes [s]."""
        return BITS_PER_BYTE / self.baud

    @property
    def round_s(self) -> float:
        """A round trip, long enough for nearly all [s]."""
        if self.trip_s is None:
            return UNKNOWN_S
        return min(self.trip_s + 4 * self.deviation_s, MOST_ROUND_S)

    @property
    def retry_s(self) -> float:
        """Time after which a command that is not answered is sent again [s]."""
        return self.round_s + (0.0 if self.trip_s is None else ANSWER_S)

    @property
    def lossy(self) -> bool:
        """Whether the line loses so much that it takes measures."""
        return self.answered < LOSSY

    @property
    def heartbeat_s(self) -> float:
        """Time from one heartbeat to the next [s]."""
        if not self.lossy:
            return HEARTBEAT_S
        least = frame_bytes(Heartbeat(0)) * self.byte_s / HEARTBEAT_SHARE
        return min(HEARTBEAT_S, max(QUICK_HEARTBEAT_S, least))

    def arriving(self, size: int) -> float:
        """Return the probability that a frame of `size` bytes arrives whole."""
        return float(max(self.answered, 1e-6) ** (size / ROUND_BYTES))

    def copies(self, size: int) -> int:
        """Return how often a frame is to be sent at once, so that one is likely to arrive."""
        if not self.lossy:
            return 1
        return min(MOST_COPIES, max(1, ceil(1 / self.arriving(size) - 0.25)))

    def command_copies(self, size: int) -> int:
        """Return how often a command is to be sent at once, so that it is most likely answered."""
        if not self.lossy:
            return 1
        none = log1p(-self.arriving(size + ANSWER_BYTES))
        return min(MOST_COPIES, ceil(log(UNANSWERED) / none))

    @property
    def telemetry_timeout_s(self) -> float:
        """Time after which it is not the line that has kept all telemetry back [s]."""
        lost = log1p(-self.arriving(TELEMETRY_BYTES)) if self.lossy else float("-inf")
        return min(MOST_PATIENCE_S, TELEMETRY_S * log(CHANCE) / lost)

    @property
    def knots_per_message(self) -> int:
        """As many as bring most knots whole over the line in a time."""

        def yielded(count: int) -> float:
            size = frame_bytes(_full(count))
            return count * self.arriving(size) / size

        counts = [
            count
            for count in range(2, KNOTS_PER_MESSAGE + 1)
            if frame_bytes(_full(count)) * self.byte_s <= MOST_FRAME_S
        ]
        return max([1, *counts], key=yielded)

    def sent(self, size: int, now: float) -> LineModel:
        """Return the line with so many bytes more on it."""
        return replace(self, free_at=max(now, self.free_at) + size * self.byte_s)

    def beaten(self, host_ns: int, now: float) -> LineModel:
        """Return the line after a heartbeat; those that were not answered in time count."""
        late = sum(1 for _, until in self.beats if until <= now)
        kept = tuple(beat for beat in self.beats if beat[1] > now)
        until = max(now, self.free_at) + self.retry_s
        lost = self.answered * (1 - MEMORY) ** late
        return replace(self, answered=lost, beats=(*kept, (host_ns, until)))

    def heard(self, pulse: Pulse, now: float) -> LineModel:
        """Return the line after a pulse."""
        trip = now - pulse.host_ns * 1e-9
        if trip < -ROUNDING_S:
            return self
        trip = max(trip, 0.0)
        kept = tuple(beat for beat in self.beats if beat[0] != pulse.host_ns)
        answered = self.answered
        if len(kept) < len(self.beats):
            answered += MEMORY * (1 - answered)
        if self.trip_s is None:
            return replace(self, beats=kept, answered=answered, trip_s=trip, deviation_s=trip / 2)
        deviation = self.deviation_s + (abs(trip - self.trip_s) - self.deviation_s) / 4
        smoothed = self.trip_s + (trip - self.trip_s) / 8
        return replace(self, beats=kept, answered=answered, trip_s=smoothed, deviation_s=deviation)
