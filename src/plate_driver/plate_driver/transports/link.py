"""The host's side of the serial protocol as a state machine: no port, no clock of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil

from plate_core.driver_status import DriverReason
from plate_core.serial_protocol import (
    MOTORS,
    VERSION,
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    DriveTrouble,
    Enable,
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
    Trigger,
    table_crc,
)

from .device_clock import DeviceClock
from .line import ANSWER_S, FULL_BYTES, LineModel, frame_bytes
from .transport import Condition, Report

SILENCE_S = 1.0
"""So long, and a round trip, without a message, and the device is gone [s]: the link is begun anew.
The device itself brakes after a quarter of that. A link that is begun anew costs a stop, so a line
that loses nearly everything must not seem silent: where 5 % of the bytes are lost one message in
seven comes whole, of some two hundred in this time."""

GREETING_S = 5.0
"""Time after which a Hello that is not answered is given up [s]."""

GREETING_TRIES = 30
"""Number of the first Hellos, one each `ANSWER_S`."""

LATER_GREETING_S = 0.1
"""Time between Hellos after these [s]."""

GIVE_UP_S = 5.0
"""Time, and twenty round trips, after which a command that is not answered is given up [s]. Knots
are not, as long as the device is heard: they only come late."""

QUEUE_S = 0.008
"""What may wait on the line when more is sent [s]: the next look is 5 ms later, and a stop must not
wait for long behind what was sent before."""

KNOTS_ANSWER_S = 0.01
"""What a device may take to answer knots, beside the round trip [s]."""

MOST_TRIP_S = 1.0
"""A pulse that took longer says nothing of the line [s]."""

SCATTER = 40_503
"""Sessions that follow each other begin so far apart (Knuth's multiplicative hashing)."""

MOVABLE = (State.READY, State.PLAYING)
"""States in which the device takes a table."""

LATER = (Status.INCOMPLETE, Status.TOO_LONG)
"""Answers to setpoints of a stream that come before others, or find no room."""


LATE_IN_MOTION = "a cycle in motion came too late: the plate comes to rest"
"""Of a table that the device refuses as it begins elsewhere."""


@dataclass(frozen=True)
class Pending:
    """A command that is not answered yet: when it was sent first and last, and when what was sent
    last has left the line [s]; and how often."""

    sequence: int
    message: Message
    first_at: float = 0.0
    sent_at: float = float("-inf")
    tries: int = 0


@dataclass(frozen=True)
class Answer:
    """What became of the last Stop, Enable or Home: None as long as it is not answered."""

    sequence: int
    message: Message
    status: Status | None = None


@dataclass(frozen=True)
class Link:
    """What the host knows of the device, and what it has yet to send.

    Attributes
    ----------
    session : int
        Number of this session; another one for each link.
    heard_at : float
        When the last message came, or the link was made [s].
    line : LineModel
        How fast it is, and how good.
    queue : tuple of Pending
        Commands in order.
    next_table : tuple of Message
        The newest table, while another one is still on its way.
    follows : int
        The table that it goes on from in motion; 0: it begins at rest.
    device : Capabilities or None
        None until it has answered.
    telemetry : Telemetry or None
        The last one.
    telemetry_at : float
        When it came [s].
    fresh_telemetry : Telemetry or None
        The same, but None after each command that changes what it says, until the next one.
    trouble : DriveTrouble or None
        What the device has said of a drive since the motors were enabled.
    answer : Answer or None
        What became of the last Stop, Enable or Home.
    flight : tuple of (float, int)
        Knots on their way to the device: when they have come [s], and their bytes.
    failed : Report or None
        Why the link is of no use any more; None while it is.
    refusal : str
        What the device refused since the last `without_refusal`.
    retries : int
        Messages repeated so far.
    in_turn : bool
        Whether knots count only in their order: of a stream, not of a table.
    """

    session: int
    heard_at: float
    line: LineModel = field(default_factory=LineModel)
    queue: tuple[Pending, ...] = ()
    next_table: tuple[Message, ...] = ()
    follows: int = 0
    sequence: int = 0
    device: Capabilities | None = None
    telemetry: Telemetry | None = None
    telemetry_at: float = float("-inf")
    fresh_telemetry: Telemetry | None = None
    trouble: DriveTrouble | None = None
    clock: DeviceClock = field(default_factory=DeviceClock)
    heartbeat_at: float = float("-inf")
    answer: Answer | None = None
    flight: tuple[tuple[float, int], ...] = ()
    failed: Report | None = None
    refusal: str = ""
    retries: int = 0
    in_turn: bool = False

    @classmethod
    def begun(
        cls, session: int, now: float, baud: float = float("inf"), trigger: Trigger | None = None
    ) -> Link:
        """Return a link that is about to say hello, over a line of so many bits a second, and then
        when the camera is to be triggered."""
        # Numbers begin elsewhere in each session, so that no answer to an older one fits.
        number = session * SCATTER % 2**16
        link = cls(session, now, LineModel(baud), sequence=number)
        link = link._asked(Hello(VERSION, session))
        return link if trigger is None else link._asked(trigger)

    @property
    def busy(self) -> bool:
        """Whether a command is still to be sent, or not answered yet."""
        return bool(self.queue or self.next_table)

    @property
    def movable(self) -> bool:
        """Whether the device takes tables."""
        return self.telemetry is not None and self.telemetry.state in MOVABLE

    # What the host wants

    def uploading(
        self,
        table: int,
        knots: Sequence[Knot],
        repeats: int,
        splice_ticks: int = 0,
        follows: int = 0,
    ) -> Link:
        """Return the link that sends a table, to be played so often unless another one comes.

        It has a tail from `splice_ticks` on, unless that is 0. Where it goes on in motion from a
        table with the number `follows`, it is held back until that one plays.

        An upload that is under way is finished first, or a quick planner would never see one
        through; of those that wait, the newest counts.
        """
        begin = Begin(table, len(knots), table_crc(knots), splice_ticks)
        parts = _parts(table, 0, knots, self.line.knots_per_message)
        upload = (begin, *parts, Commit(table, repeats))
        return replace(self, next_table=upload, follows=follows, in_turn=False)

    def streaming(self, table: int, knots: Sequence[Knot]) -> Link:
        """Return the link that opens a stream with its first setpoints."""
        parts = _parts(table, 0, knots, self.line.knots_per_message)
        next_table = (Begin(table, 0, 0), *parts, Commit(table, 1))
        return replace(self, next_table=next_table, follows=0, in_turn=True)

    def adding(self, table: int, first: int, knots: Sequence[Knot]) -> Link:
        """Return the link that adds setpoints, from number `first` on, to the stream that plays."""
        return self._asked(*_parts(table, first, knots, self.line.knots_per_message))

    def stopping(self, now: bool = False) -> Link:
        """Return the link that wants the plate to brake, or to lose its current `now`.

        Whatever else was to be said is forgotten but the greeting, an Enable above all. A stop that
        is on its way already is sent again at once; a stronger one is not replaced by a weaker.
        """
        greeting = tuple(p for p in self.queue if isinstance(p.message, Hello | Trigger))
        stops = [p for p in self.queue if isinstance(p.message, Stop)]
        bare = replace(self, queue=greeting, next_table=())
        if stops and isinstance(stops[0].message, Stop) and stops[0].message.now >= int(now):
            return replace(bare, queue=(replace(stops[0], sent_at=float("-inf")), *greeting))
        link = bare._ordered(Stop(int(now)))
        return replace(link, queue=(link.queue[-1], *link.queue[:-1]))

    def enabling(self, stop: int) -> Link:
        """Return the link that asks, once, for current after the stop with a number."""
        return self._ordered(Enable(stop))

    def homing(self) -> Link:
        """Return the link that has the device, which must be off, forget where home is."""
        return self._ordered(Home())

    def _failing(self, reason: DriverReason, text: str) -> Link:
        return replace(self, failed=Report(Condition.GONE, reason, text))

    def without_refusal(self) -> Link:
        """Return the link without its refusal, which was reported."""
        return replace(self, refusal="")

    def _ordered(self, message: Message) -> Link:
        link = self._asked(message)
        return replace(link, answer=Answer(link.queue[-1].sequence, message))

    def _asked(self, *messages: Message) -> Link:
        numbers = [(self.sequence + i) % 2**16 for i in range(len(messages) + 1)]
        new = [Pending(n, m) for n, m in zip(numbers, messages, strict=False)]
        return replace(self, queue=(*self.queue, *new), sequence=numbers[-1])

    # What the device says

    def heard(self, packet: Packet, now: float) -> Link:
        """Return the link after a message that came at `now` [s]."""
        link, message = replace(self, heard_at=now), packet.message
        if isinstance(message, Telemetry):
            return link._reported(message)
        if isinstance(message, DriveTrouble):
            return replace(link, trouble=message)
        if isinstance(message, Pulse):
            if now - message.host_ns * 1e-9 > MOST_TRIP_S:
                return link  # it waited while we stood still, or answers no heartbeat of ours
            clock, line = link.clock.heard(message, now), link.line.heard(message, now)
            return replace(link, clock=clock, line=line)
        if isinstance(message, Capabilities):
            return link._greeted(message)
        if isinstance(message, Acknowledgement):
            return link._answered(message)
        return link

    def _reported(self, telemetry: Telemetry) -> Link:
        link = replace(
            self, telemetry=telemetry, fresh_telemetry=telemetry, telemetry_at=self.heard_at,
            clock=self.clock.stamped(telemetry.device_us, self.heard_at),
        )  # fmt: skip
        if telemetry.state in MOVABLE:
            return replace(link, trouble=None)
        # A device that has stopped takes no table, and must not find one when it is enabled.
        queue = tuple(p for p in self.queue if not isinstance(p.message, Begin | Knots | Commit))
        return replace(link, queue=queue, next_table=())

    def _greeted(self, device: Capabilities) -> Link:
        if device.version != VERSION or device.motors != MOTORS:
            why = f"device speaks version {device.version} for {device.motors} motors, allowed: "
            why += f"version {VERSION} for {MOTORS}"
            return self._failing(DriverReason.WRONG_DEVICE, why)
        if device.session != self.session:
            return self  # an answer to someone before us
        if self.device is not None and device.boot != self.device.boot:
            return self._failing(DriverReason.DEVICE_RESET, "device was reset")
        queue = tuple(p for p in self.queue if not isinstance(p.message, Hello))
        return replace(self, device=device, queue=queue)

    def _answered(self, answer: Acknowledgement) -> Link:
        if answer.status is Status.NO_SESSION and self.device is not None:
            return self._failing(DriverReason.DEVICE_RESET, "device was reset")
        about = [p for p in self.queue if p.sequence == answer.sequence and p.tries]
        if not about:
            return self
        message = about[0].message
        if isinstance(message, Knots) and answer.status in LATER:
            return self._missed(about[0])
        queue = tuple(p for p in self.queue if p.sequence != answer.sequence)
        link = replace(self, queue=queue)
        if self.answer is not None and self.answer.sequence == answer.sequence:
            link = replace(link, answer=replace(self.answer, status=answer.status))
        if answer.status is Status.DONE:
            # State and waiting table are known by the next telemetry: the last is from before.
            changed = isinstance(message, Commit | Home | Enable | Stop)
            return replace(link, fresh_telemetry=None if changed else self.fresh_telemetry)
        if isinstance(message, Stop | Enable | Home):
            return link
        name = type(message).__name__
        reason = f"device refuses {name}: {answer.status.name.lower().replace('_', ' ')}"
        if answer.status is Status.JUMP:
            reason = LATE_IN_MOTION
        queue = tuple(p for p in queue if not isinstance(p.message, Knots | Commit))
        return replace(link, queue=queue, refusal=reason)

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
        """Return the link after sending, and the packets to send at `now` [s], a stop first."""
        if self.failed:
            return self, []
        silence = SILENCE_S + self.line.round_s
        if now - self.heard_at > silence and self.device is not None:
            why = f"device has been silent for {silence:.2g} s"
            return self._failing(DriverReason.NO_ANSWER, why), []
        link = self._fed(now)._split(now)
        link = replace(link, flight=tuple(item for item in link.flight if item[0] > now))
        packets: list[Packet] = []
        for pending in link._stops(now):
            link = link._sent(pending, now, link._copies(pending.message), packets)
        link = link._beaten(now, packets)
        sendable = link._sendable(now)
        for pending in sendable:
            if pending.tries and now - pending.first_at > link._longest(pending.message):
                why = f"device does not answer {type(pending.message).__name__}"
                return link._failing(DriverReason.NO_ANSWER, why), []
            copies = link._copies(pending.message, len(sendable))
            if not link._room(pending.message, copies, now):
                break
            link = link._sent(pending, now, copies, packets)
        return link, packets

    def _longest(self, message: Message) -> float:
        """Longest time to try a command [s]."""
        if isinstance(message, Hello):
            return GREETING_S
        if isinstance(message, Knots):
            return float("inf")
        return GIVE_UP_S + 20 * self.line.round_s

    def _beaten(self, now: float, packets: list[Packet]) -> Link:
        """Return the link after a heartbeat, if one is due."""
        if self.device is None or now - self.heartbeat_at < self.line.heartbeat_s - 1e-9:
            return self
        beat = Heartbeat(round(now * 1e9))
        packets.append(Packet(self.sequence, beat))
        line = self.line.sent(frame_bytes(beat), now).beaten(beat.host_ns, now)
        return replace(self, line=line, heartbeat_at=now)

    def _copies(self, message: Message, abreast: int = 1) -> int:
        """How often to send a command at once; of a table's knots, which come again and again as
        long as they are not answered, those that are sent `abreast` share the copies."""
        size = frame_bytes(message)
        if not isinstance(message, Knots):
            return self.line.command_copies(size)
        return ceil(self.line.copies(size) / (1 if self.in_turn else abreast))

    def _sent(self, pending: Pending, now: float, copies: int, packets: list[Packet]) -> Link:
        """Return the link after sending copies of a command."""
        size = frame_bytes(pending.message)
        packets += [Packet(pending.sequence, pending.message)] * copies
        line = self.line.sent(copies * size, now)
        first_at = pending.first_at if pending.tries else now
        sent = replace(
            pending, first_at=first_at, sent_at=max(now, line.free_at), tries=pending.tries + 1
        )
        queue = tuple(sent if p.sequence == pending.sequence else p for p in self.queue)
        flight = self.flight
        if isinstance(pending.message, Knots):
            flight = (*flight, (line.free_at + line.round_s / 2, copies * size))
        retries = self.retries + (copies if pending.tries else copies - 1)
        return replace(self, queue=queue, line=line, flight=flight, retries=retries)

    def _fed(self, now: float) -> Link:
        """Return the link with the next table in an empty queue."""
        if self.queue or not self.next_table or self.device is None:
            return self
        telemetry = self.fresh_telemetry
        if self.follows and (telemetry is None or telemetry.waiting == self.follows):
            return self  # begun any earlier it would be refused
        return replace(self, next_table=())._asked(*self.next_table)

    def _in_flight(self, pending: Pending, now: float) -> bool:
        """Tell whether the answer to a command may still come."""
        if not pending.tries:
            return False
        wait = self.line.retry_s
        if isinstance(pending.message, Hello):
            wait = ANSWER_S if pending.tries < GREETING_TRIES else LATER_GREETING_S
        elif isinstance(pending.message, Knots):
            wait = self.line.round_s + KNOTS_ANSWER_S
        return now - pending.sent_at < wait

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

    def _stops(self, now: float) -> list[Pending]:
        """The stop to send now: before all else, whatever is on the line."""
        stops = [p for p in self.queue if isinstance(p.message, Stop)]
        return [p for p in stops if not self._in_flight(p, now)]

    def _sendable(self, now: float) -> list[Pending]:
        """Commands to send now: one, or as many knots as there are in a row."""
        queue = [p for p in self.queue if not isinstance(p.message, Stop)]
        if self.device is None or not queue or not isinstance(queue[0].message, Knots):
            return [p for p in queue[:1] if not self._in_flight(p, now)]
        knots = [p for p in queue if isinstance(p.message, Knots)]
        if self.line.lossy and not self.in_turn:  # the line is never idle: most must come again
            return sorted(knots, key=lambda p: p.sent_at)
        return [p for p in knots if not self._in_flight(p, now)]

    def _room(self, message: Message, copies: int, now: float) -> bool:
        """Tell whether the line, and for knots the device, has room for a message."""
        if self.line.free_at - now >= QUEUE_S:
            return False
        if not isinstance(message, Knots) or self.device is None or not self.flight:
            return True
        size = frame_bytes(message)
        most = self.device.window * FULL_BYTES
        return sum(n for _, n in self.flight) + copies * size <= most


def _parts(table: int, first: int, knots: Sequence[Knot], count: int) -> list[Message]:
    """Knots from number `first` on, `count` to a message."""
    starts = range(0, len(knots), count)
    return [Knots(table, (first + k) % 2**16, tuple(knots[k : k + count])) for k in starts]
