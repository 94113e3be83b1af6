"""The host's side of the serial protocol as a state machine: no port, no clock of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from plate_core.serial_protocol import (
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    State,
    Status,
    Stop,
    Telemetry,
    table_crc,
)
from plate_core.serial_protocol.messages import KNOTS_PER_MESSAGE, MOTORS, VERSION

RETRY_S = (0.03,) * 12 + (0.06,) * 6 + (0.12,) * 6
"""How long to wait for an answer beyond the round trip, try by try [s]. With one byte in a hundred
damaged 46 % of the messages with one knot are answered: one in 2.6 million then fails all tries."""

HEARTBEAT_S = 0.05
"""Time between heartbeats [s]: four may be lost before the device's watchdog bites."""

SILENCE_S = 0.25
"""Telemetry comes every 10 ms: after so long without a message the device is gone [s]."""

ROUSE_S = 0.5
"""Least time between two requests to find home, or to enable the motors [s]."""

PULSE_AGE_S = 5.0
"""How long the pulse with the shortest round trip is kept [s]: 50 ppm of drift make 0.25 ms."""

HARMLESS = Fault.HOST_SILENT | Fault.STOPPED | Fault.NO_HOME
"""Faults after which the motors may be enabled again without a look at the rig: a device that was
reset finds home and goes on; one whose supply, drive, limit or heat failed waits for a person."""


LATER = (Status.INCOMPLETE, Status.TOO_LONG)
"""Answers to setpoints of a stream that come before others, or find no room."""


@dataclass(frozen=True)
class DeviceClock:
    """Where the device's clock stands on the host's.

    Attributes
    ----------
    offset_s : float
        Host time minus device time [s], right to half the round trip.
    trip_s : float
        Round trip of the pulse it comes from [s]; infinite if none has come.
    at : float
        When that pulse came [s].
    """

    offset_s: float = 0.0
    trip_s: float = float("inf")
    at: float = float("-inf")

    def heard(self, pulse: Pulse, now: float) -> DeviceClock:
        """Return the clock after a pulse that came at `now` [s]."""
        sent, device = pulse.host_ns * 1e-9, pulse.device_us * 1e-6
        trip = now - sent
        if trip < 0 or (trip > self.trip_s and now - self.at < PULSE_AGE_S):
            return self
        return DeviceClock((sent + now) / 2 - device, trip, now)

    def host_time(self, device_us: int) -> float:
        """Return the host's time [s] of a time of the device."""
        return device_us * 1e-6 + self.offset_s


@dataclass(frozen=True)
class Pending:
    """A command that is not answered yet: when it was sent last [s], and how often."""

    sequence: int
    message: Message
    sent_at: float = 0.0
    tries: int = 0


@dataclass(frozen=True)
class Link:
    """What the host knows of the device, and what it has yet to tell it.

    Attributes
    ----------
    session : int
        Number of this session; another one for each link.
    heard_at : float
        When the last message came, or the link was made [s].
    queue : tuple of Pending
        Commands in order.
    next_table : tuple of Message
        The newest table, while another one is still on its way.
    device : Capabilities or None
        None until it has answered.
    telemetry : Telemetry or None
        The last one; None until one has come, and again after each table.
    failed : str
        Why the link is of no use any more; empty while it is.
    refusal : str
        What the device refused since the last `forgiven`.
    retries : int
        Messages repeated so far.
    roused, roused_at
        The last request to find home or enable, and when it was made [s].
    inspected : bool
        Someone has looked at the rig: the next Enable may clear any fault.
    """

    session: int
    heard_at: float
    queue: tuple[Pending, ...] = ()
    next_table: tuple[Message, ...] = ()
    sequence: int = 0
    device: Capabilities | None = None
    telemetry: Telemetry | None = None
    clock: DeviceClock = field(default_factory=DeviceClock)
    heartbeat_at: float = float("-inf")
    roused: Message | None = None
    roused_at: float = float("-inf")
    inspected: bool = False
    failed: str = ""
    refusal: str = ""
    retries: int = 0

    @classmethod
    def begun(cls, session: int, now: float) -> Link:
        """Return a link that is about to say hello."""
        return cls(session, now)._asked(Hello(VERSION, session))

    @property
    def busy(self) -> bool:
        """Whether a command is still to be sent, or not answered yet."""
        return bool(self.queue or self.next_table)

    # What the host wants

    def uploading(self, table: int, knots: Sequence[Knot]) -> Link:
        """Return the link that sends a table, to be played until another one comes.

        An upload that is under way is finished first, or a quick planner would never see one
        through; of those that wait, the newest counts.
        """
        begin = Begin(table, len(knots), table_crc(knots))
        return replace(self, next_table=(begin, *_parts(table, 0, knots), Commit(table, 0)))

    def streaming(self, table: int, knots: Sequence[Knot]) -> Link:
        """Return the link that opens a stream with its first setpoints."""
        return replace(
            self, next_table=(Begin(table, 0, 0), *_parts(table, 0, knots), Commit(table, 0))
        )

    def adding(self, table: int, first: int, knots: Sequence[Knot]) -> Link:
        """Return the link that adds setpoints, from number `first` on, to the stream that plays."""
        return self._asked(*_parts(table, first, knots))

    def stopping(self, now: bool = False) -> Link:
        """Return the link that wants the plate to brake, or to lose its current `now`."""
        cleared = replace(self, queue=(), next_table=(), inspected=False)
        return cleared._asked(Stop(int(now)))

    def homing(self) -> Link:
        """Return the link that wants the device, which must be off, to find home again."""
        return self._asked(Home())

    def enabling(self) -> Link:
        """Return the link that may enable the motors once, whatever the device stopped for."""
        return replace(self, inspected=True)

    def forgiven(self) -> Link:
        """Return the link without its refusal, which was told."""
        return replace(self, refusal="")

    def _asked(self, *messages: Message) -> Link:
        numbers = [(self.sequence + i) % 2**16 for i in range(len(messages) + 1)]
        new = [Pending(n, m) for n, m in zip(numbers, messages, strict=False)]
        return replace(self, queue=(*self.queue, *new), sequence=numbers[-1])

    # What the device says

    def heard(self, packet: Packet, now: float) -> Link:
        """Return the link after a message that came at `now` [s]."""
        link, message = replace(self, heard_at=now), packet.message
        if isinstance(message, Telemetry):
            return replace(link, telemetry=message)
        if isinstance(message, Pulse):
            return replace(link, clock=link.clock.heard(message, now))
        if isinstance(message, Capabilities):
            return link._greeted(message)
        if isinstance(message, Acknowledgement):
            return link._answered(message)
        return link

    def _greeted(self, device: Capabilities) -> Link:
        if device.version != VERSION or device.motors != MOTORS:
            return replace(
                self,
                failed=f"device speaks version {device.version} for {device.motors} motors, "
                f"allowed: version {VERSION} for {MOTORS}",
            )
        if device.session != self.session:
            return self  # an answer to someone before us
        if self.device is not None and device.boot != self.device.boot:
            return replace(self, failed="device was reset")
        queue = tuple(p for p in self.queue if not isinstance(p.message, Hello))
        return replace(self, device=device, queue=queue)

    def _answered(self, answer: Acknowledgement) -> Link:
        if answer.status is Status.NO_SESSION and self.device is not None:
            return replace(self, failed="device was reset")
        about = [p for p in self.queue if p.sequence == answer.sequence and p.tries]
        if not about:
            return self
        if isinstance(about[0].message, Knots) and answer.status in LATER:
            return self._missed(about[0])
        queue = tuple(p for p in self.queue if p.sequence != answer.sequence)
        if answer.status is Status.DONE:
            # State and waiting table are known by the next telemetry: the last is from before.
            changed = isinstance(about[0].message, Commit | Home | Enable)
            telemetry = None if changed else self.telemetry
            return replace(self, queue=queue, telemetry=telemetry)
        name = type(about[0].message).__name__
        reason = f"device refuses {name}: {answer.status.name.lower().replace('_', ' ')}"
        queue = tuple(p for p in queue if not isinstance(p.message, Knots | Commit))
        return replace(self, queue=queue, refusal=reason)

    def _missed(self, early: Pending) -> Link:
        """Return the link that sends setpoints again, up to those that came before their turn.

        The line keeps the order: what was sent before them and is not answered was lost.
        """
        end = self.queue.index(early) + 1
        queue = tuple(
            replace(p, sent_at=float("-inf"))
            if isinstance(p.message, Knots) and p.tries and p.sent_at <= early.sent_at
            else p
            for p in self.queue[:end]
        )
        return replace(self, queue=queue + self.queue[end:])

    # What is to be sent

    def due(self, now: float) -> tuple[Link, list[Packet]]:
        """Return the link after sending, and the packets to send at `now` [s]."""
        if self.failed:
            return self, []
        if now - self.heard_at > SILENCE_S and self.device is not None:
            return replace(self, failed=f"device has been silent for {SILENCE_S:g} s"), []
        link = self._fed(now)._split(now)
        packets: list[Packet] = []
        for pending in link._sendable(now):
            if pending.tries == len(RETRY_S):
                name = type(pending.message).__name__
                return replace(link, failed=f"device does not answer {name}"), []
            packets.append(Packet(pending.sequence, pending.message))
            sent = replace(pending, sent_at=now, tries=pending.tries + 1)
            queue = tuple(sent if p is pending else p for p in link.queue)
            link = replace(link, queue=queue, retries=link.retries + (pending.tries > 0))
        if link.device is not None and now - link.heartbeat_at >= HEARTBEAT_S:
            packets.append(Packet(link.sequence, Heartbeat(round(now * 1e9))))
            link = replace(link, heartbeat_at=now)
        return link, packets

    def _fed(self, now: float) -> Link:
        """Return the link with the next table, or what must come before it, in an empty queue."""
        if self.queue or not self.next_table or self.device is None or self.telemetry is None:
            return self
        if self.telemetry.waiting:
            return self  # Begin would throw it away
        if self.telemetry.state in (State.READY, State.PLAYING):
            return replace(self, next_table=())._asked(*self.next_table)
        return self._roused(self.telemetry, now)

    def _roused(self, telemetry: Telemetry, now: float) -> Link:
        """Return the link that has a device that is off find home, or enable its motors."""
        if telemetry.state is not State.OFF:
            return self
        if telemetry.faults & ~HARMLESS and not self.inspected:
            return self
        wanted = Home() if telemetry.faults & Fault.NO_HOME else Enable()
        if wanted == self.roused and now - self.roused_at < ROUSE_S:
            return self
        inspected = self.inspected and not isinstance(wanted, Enable)
        link = replace(self, roused=wanted, roused_at=now, inspected=inspected)
        return link._asked(wanted)

    def _in_flight(self, pending: Pending, now: float) -> bool:
        """Tell whether the answer to a command may still come."""
        trip = self.clock.trip_s if self.clock.trip_s < SILENCE_S else 0.0
        return pending.tries > 0 and now - pending.sent_at < RETRY_S[pending.tries - 1] + trip

    def _split(self, now: float) -> Link:
        """Return the link with knots that are not answered in messages of one knot each.

        On a line that spoils bytes long messages hardly ever arrive whole.
        """
        queue: list[Pending] = []
        sequence = self.sequence
        for p in self.queue:
            message = p.message
            if (
                not isinstance(message, Knots)
                or len(message.knots) == 1
                or not p.tries
                or self._in_flight(p, now)
            ):
                queue.append(p)
                continue
            for i, knot in enumerate(message.knots):
                part = replace(message, first=(message.first + i) % 2**16, knots=(knot,))
                queue.append(replace(p, sequence=sequence, message=part))
                sequence = (sequence + 1) % 2**16
        return replace(self, queue=tuple(queue), sequence=sequence)

    def _sendable(self, now: float) -> list[Pending]:
        """Commands to send now: one, or as many knots as the device can hold."""
        if self.device is None or not self.queue or not isinstance(self.queue[0].message, Knots):
            return [p for p in self.queue[:1] if not self._in_flight(p, now)]
        knots = [p for p in self.queue if isinstance(p.message, Knots)]
        due = [p for p in knots if not self._in_flight(p, now)]
        room = self.device.window - (len(knots) - len(due))
        return due[: max(0, room)]


def _parts(table: int, first: int, knots: Sequence[Knot]) -> list[Message]:
    """Knots from number `first` on, in messages."""
    starts = range(0, len(knots), KNOTS_PER_MESSAGE)
    return [
        Knots(table, (first + k) % 2**16, tuple(knots[k : k + KNOTS_PER_MESSAGE])) for k in starts
    ]
