"""Model of a serial line: baud rate, round-trip time and fraction of lost bytes. The inputs are the
heartbeats of the host and the device's replies to them (pulses). The round-trip time is smoothed as
in RFC 6298. The outputs are timeouts, the heartbeat interval, the number of copies of each message,
and the length of messages."""

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
"""Overhead of a frame [bytes]: CRC, one byte of COBS, and the end byte."""

ANSWER_S = 0.03
"""Maximum response time of the device, in addition to the round trip [s]. The device needs this
time to check a whole table."""

UNKNOWN_S = 0.25
"""Round-trip time that is assumed until it is measured for the first time [s]."""

MAX_ROUND_S = 0.5
"""Upper limit of the estimated round-trip time [s]. A stall of the host can increase measured
values beyond this limit."""

HEARTBEAT_S, QUICK_HEARTBEAT_S = 0.025, 0.01
"""Heartbeat interval on a good line and on a lossy line [s]. The device's watchdog (0.25 s)
requires that at least one of 10 heartbeats arrives on a good line, or one of 25 on a lossy line. If
5 % of the bytes are lost, 40 % of the heartbeats arrive complete. In this case, a loss of 10
successive heartbeats occurs every 13 s, but a loss of 25 successive heartbeats only once in
hours."""

HEARTBEAT_FRACTION = 0.2
"""Maximum fraction of the line's capacity that heartbeats on a lossy line may use."""

LOSSY = 0.9
"""Minimum fraction of answered heartbeats on a line that does not count as lossy."""

MEMORY = 1 / 32
"""Weight of the newest heartbeat in the exponential average of the fraction of answered
heartbeats."""

ROUNDING_S = 1e-6
"""A negative round-trip time is treated as 0 if its magnitude is at most this value [s]."""

MAX_FRAME_S = 0.02
"""Maximum transmission time of a message that contains knots of a table [s]. Stops and heartbeats
must wait for the end of such a message."""

UNANSWERED = 0.05
"""Maximum probability that all copies of a command are lost. The loss of all copies causes a delay
of one round trip."""

TELEMETRY_S = 0.01
"""Interval between two telemetry messages [s]."""

MISS_PROBABILITY = 1e-9
"""If the probability that losses on the line explain missing telemetry is below this value, the
missing telemetry is an error. The value is small, because the loss rate is known only
approximately."""

MAX_PATIENCE_S = 3.0
"""Maximum time without telemetry, independent of the loss rate [s]."""

MAX_COPIES = 8
"""Maximum number of copies of a message that are sent together on a very lossy line."""


def frame_bytes(message: Message) -> int:
    """Return the length of a message's frame [bytes]."""
    knots = len(message.knots) * LAYOUTS[Knot].size if isinstance(message, Knots) else 0
    return HEADER.size + LAYOUTS[type(message)].size + knots + FRAME_BYTES


def _full_message(count: int) -> Knots:
    rest = (0.0,) * 4
    return Knots(1, 0, (Knot(0, rest, rest, rest),) * count)


ROUND_BYTES = frame_bytes(Heartbeat(0)) + frame_bytes(Pulse(0, 0))
"""Length of a heartbeat's frame plus the length of a pulse's frame [bytes]."""

ANSWER_BYTES = frame_bytes(Acknowledgement(0, Status.DONE))

TELEMETRY_BYTES = HEADER.size + LAYOUTS[Telemetry].size + FRAME_BYTES

FULL_BYTES = frame_bytes(_full_message(KNOTS_PER_MESSAGE))
"""Length of the longest message that contains knots of a table [bytes]. The device states its
receive window as a number of such messages."""


def upload_s(pieces: int, baud: float) -> float:
    """Return the upload time of a table with `pieces` pieces [s], on a line that also carries
    heartbeats."""
    count = LineModel(baud).knots_per_message
    messages, knots = divmod(pieces + 1, count)
    size = messages * frame_bytes(_full_message(count)) + (
        frame_bytes(_full_message(knots)) if knots else 0
    )
    size += frame_bytes(Begin(1, 0, 0)) + frame_bytes(Commit(1, 1))
    free = baud / BITS_PER_BYTE - frame_bytes(Heartbeat(0)) / HEARTBEAT_S
    return size / free if free > 0 else float("inf")


@dataclass(frozen=True)
class LineModel:
    """State of a serial line, estimated from heartbeats and pulses.

    Attributes
    ----------
    baud : float
        Speed of the line [bit/s]. Infinity: transmission takes no time.
    trip_s, deviation_s : float or None
        Smoothed round trip, and its mean deviation (RFC 6298) [s]. `trip_s` is None until a round
        trip is measured.
    answered : float
        Recent fraction of answered heartbeats (exponential average).
    beats : tuple of (int, float)
        Unanswered heartbeats. For each heartbeat, its host time [ns], and the time after which it
        counts as lost [s].
    free_at : float
        Time at which all sent bytes will have left the host [s].
    """

    baud: float = 921_600.0
    trip_s: float | None = None
    deviation_s: float = 0.0
    answered: float = 1.0
    beats: tuple[tuple[int, float], ...] = ()
    free_at: float = float("-inf")

    @property
    def byte_s(self) -> float:
        """Transmission time of a byte [s]."""
        return BITS_PER_BYTE / self.baud

    @property
    def round_s(self) -> float:
        """Upper estimate of the round trip: mean plus four deviations, at most `MAX_ROUND_S`
        [s]."""
        if self.trip_s is None:
            return UNKNOWN_S
        return min(self.trip_s + 4 * self.deviation_s, MAX_ROUND_S)

    @property
    def retry_s(self) -> float:
        """Time after which an unanswered command is sent again [s]."""
        return self.round_s + (0.0 if self.trip_s is None else ANSWER_S)

    @property
    def lossy(self) -> bool:
        """Whether messages are sent in several copies, because the line loses many bytes."""
        return self.answered < LOSSY

    @property
    def heartbeat_s(self) -> float:
        """Heartbeat interval [s]."""
        if not self.lossy:
            return HEARTBEAT_S
        min_s = frame_bytes(Heartbeat(0)) * self.byte_s / HEARTBEAT_FRACTION
        return min(HEARTBEAT_S, max(QUICK_HEARTBEAT_S, min_s))

    def arriving(self, size: int) -> float:
        """Return the probability that a frame of `size` bytes arrives whole."""
        return float(max(self.answered, 1e-6) ** (size / ROUND_BYTES))

    def copies(self, size: int) -> int:
        """Return the number of copies that must be sent so that one copy of a frame arrives on
        average."""
        if not self.lossy:
            return 1
        return min(MAX_COPIES, max(1, ceil(1 / self.arriving(size) - 0.25)))

    def command_copies(self, size: int) -> int:
        """Return the number of copies of a command that is needed for an answer with a probability
        of at least 1 - `UNANSWERED`."""
        if not self.lossy:
            return 1
        log_loss = log1p(-self.arriving(size + ANSWER_BYTES))
        return min(MAX_COPIES, ceil(log(UNANSWERED) / log_loss))

    @property
    def telemetry_timeout_s(self) -> float:
        """Time without telemetry that losses on the line cannot explain [s]."""
        lost = log1p(-self.arriving(TELEMETRY_BYTES)) if self.lossy else float("-inf")
        return min(MAX_PATIENCE_S, TELEMETRY_S * log(MISS_PROBABILITY) / lost)

    @property
    def knots_per_message(self) -> int:
        """Number of knots per message that maximises the number of arriving knots per second."""

        def knot_yield(count: int) -> float:
            size = frame_bytes(_full_message(count))
            return count * self.arriving(size) / size

        counts = [
            count
            for count in range(2, KNOTS_PER_MESSAGE + 1)
            if frame_bytes(_full_message(count)) * self.byte_s <= MAX_FRAME_S
        ]
        return max([1, *counts], key=knot_yield)

    def sent(self, size: int, now: float) -> LineModel:
        """Return the line after `size` more bytes were sent at `now` [s]."""
        return replace(self, free_at=max(now, self.free_at) + size * self.byte_s)

    def heartbeat_sent(self, host_ns: int, now: float) -> LineModel:
        """Return the line model after a heartbeat was sent at `now` [s]. Heartbeats without a pulse
        before their deadline count as lost."""
        late = sum(1 for _, until in self.beats if until <= now)
        kept = tuple(beat for beat in self.beats if beat[1] > now)
        until = max(now, self.free_at) + self.retry_s
        lost = self.answered * (1 - MEMORY) ** late
        return replace(self, answered=lost, beats=(*kept, (host_ns, until)))

    def received(self, pulse: Pulse, now: float) -> LineModel:
        """Return the line model after a pulse arrived at `now` [s] in reply to a heartbeat."""
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
