"""Host side of the serial protocol (docs/protocol.md) as an immutable state machine. The inputs are
requests (tables, stop, enable, home), received packets and the time. The outputs are the packets to
send and the state that the device reports. The module uses neither a port nor a clock."""

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

TIMEOUT_S = 1.0
"""Maximum time without a message, in addition to a round trip [s]. After a longer time, the device
counts as disconnected and the link is restarted. The device itself brakes after a quarter of this
time. The time is long, because a restart of the link stops the motors. A very lossy line must
therefore not appear disconnected. If 5 % of the bytes are lost, one in seven of the about 200
messages in this time arrives complete."""

GREETING_S = 5.0
"""Maximum time without an answer to the message Hello, which starts a session [s]."""

GREETING_TRIES = 30
"""Number of first Hello messages, which are sent at intervals of `ANSWER_S`."""

LATER_GREETING_S = 0.1
"""Interval between all later Hello messages [s]."""

GIVE_UP_S = 5.0
"""Maximum time without an answer to a command, in addition to twenty round trips [s]. Messages with
knots have no maximum time while the device sends messages, because lost knots only delay a
table."""

QUEUE_S = 0.008
"""More bytes are sent only if the transmission of the queued bytes takes at most this time [s].
This time is longer than the poll period (5 ms), so that the line stays busy. The time is also so
short that a stop does not wait long for earlier bytes."""

KNOTS_ANSWER_S = 0.01
"""Maximum time in which the device answers a message with knots, in addition to the round trip
[s]."""

MAX_ROUND_TRIP_S = 1.0
"""Pulses with a longer round trip are not used for the line model [s]."""

SESSION_STEP = 40_503
"""Difference between the first sequence numbers of successive sessions (Knuth's multiplicative
hashing)."""

MOVABLE = (State.READY, State.PLAYING)
"""States in which the device accepts a table."""

LATER = (Status.INCOMPLETE, Status.TOO_LONG)
"""Answers of the device to setpoints that must be sent again later. These setpoints arrived before
their predecessors, or while the device's buffer was full."""


LATE_IN_MOTION = "a cycle that begins in motion arrived too late: the plate comes to rest"
"""Message about a refused table that does not begin in the present state of the motors."""


@dataclass(frozen=True)
class Pending:
    """A command that the device has not answered yet.

    Attributes
    ----------
    sequence : int
    message : Message
    first_at : float
        Time at which the command was first sent [s].
    sent_at : float
        Time at which the last copy of the command has left the host [s].
    tries : int
        Number of times that the command was sent.
    """

    sequence: int
    message: Message
    first_at: float = 0.0
    sent_at: float = float("-inf")
    tries: int = 0


@dataclass(frozen=True)
class Answer:
    """Result of the last Stop, Enable or Home. `status` is None until the device has answered."""

    sequence: int
    message: Message
    status: Status | None = None


@dataclass(frozen=True)
class Link:
    """State of the link: the host's knowledge of the device, and the commands to send.

    Attributes
    ----------
    session : int
        Number of this session. Each link has a different session number.
    received_at : float
        Arrival time of the last message [s]. Before the first message, the time at which the link
        was created.
    line : LineModel
        Speed and losses of the line.
    queue : tuple of Pending
        Unanswered commands in order.
    next_table : tuple of Message
        Messages of the newest table, while another table is still being sent.
    follows : int
        Number of the table that `next_table` continues in motion. 0 if `next_table` begins at rest.
    sequence : int
        Sequence number of the last command.
    device : Capabilities or None
        Answer to Hello. None until the answer arrives.
    telemetry : Telemetry or None
        Last telemetry. None before the first telemetry.
    telemetry_at : float
        Arrival time of `telemetry` [s].
    fresh_telemetry : Telemetry or None
        Last telemetry. None after a command that changes the reported state, until the next
        telemetry arrives.
    trouble : DriveTrouble or None
        Last drive fault that the device reported since the motors were enabled. None if the device
        has reported no such fault.
    clock : DeviceClock
        Estimated offset between the clocks of host and device.
    heartbeat_at : float
        Time of the last heartbeat [s].
    answer : Answer or None
        Result of the last Stop, Enable or Home. None before the first result.
    flight : tuple of (float, int)
        Knots in transit to the device: their arrival times [s] and lengths [bytes].
    failed : Report or None
        Report of a link that has failed. None while the link works.
    refusal : str
        Text of the last refusal by the device. Empty if the device has refused nothing since the
        last `without_refusal`.
    retries : int
        Number of messages repeated so far.
    in_order : bool
        Whether the device accepts knots only in order. True for a stream, False for a table.
    """

    session: int
    received_at: float
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
    in_order: bool = False

    @classmethod
    def connecting(
        cls, session: int, now: float, baud: float = float("inf"), trigger: Trigger | None = None
    ) -> Link:
        """Return a link that will send Hello, and then the camera trigger if `trigger` is given.

        `baud` is the speed of the line [bit/s].
        """
        # Each session starts with a different sequence number. Therefore replies to commands of an
        # older session are not confused with replies to commands of this session.
        number = session * SESSION_STEP % 2**16
        link = cls(session, now, LineModel(baud), sequence=number)
        link = link._enqueue(Hello(VERSION, session))
        return link if trigger is None else link._enqueue(trigger)

    @property
    def busy(self) -> bool:
        """Whether a command still waits to be sent or to be answered."""
        return bool(self.queue or self.next_table)

    # Requests of the host

    def uploading(
        self,
        table: int,
        knots: Sequence[Knot],
        repeats: int,
        splice_ticks: int = 0,
        follows: int = 0,
    ) -> Link:
        """Return the link that sends a table. The device plays the table `repeats` times unless
        another table arrives.

        The tail of the table begins at `splice_ticks` [TICK_S]. 0 means no tail. If the table
        continues the table `follows` in motion, it is sent only while `follows` plays.

        A running upload is completed before the next upload starts. Otherwise a planner with a high
        rate would interrupt every upload. If several tables wait, only the newest table is kept.
        """
        begin = Begin(table, len(knots), table_crc(knots), splice_ticks)
        parts = _knots_messages(table, 0, knots, self.line.knots_per_message)
        upload = (begin, *parts, Commit(table, repeats))
        return replace(self, next_table=upload, follows=follows, in_order=False)

    def streaming(self, table: int, knots: Sequence[Knot]) -> Link:
        """Return the link that opens a stream with its first setpoints."""
        parts = _knots_messages(table, 0, knots, self.line.knots_per_message)
        next_table = (Begin(table, 0, 0), *parts, Commit(table, 1))
        return replace(self, next_table=next_table, follows=0, in_order=True)

    def adding(self, table: int, first: int, knots: Sequence[Knot]) -> Link:
        """Return the link that adds setpoints, starting with number `first`, to the current
        stream."""
        return self._enqueue(*_knots_messages(table, first, knots, self.line.knots_per_message))

    def stopping(self, now: bool = False) -> Link:
        """Return the link that requests a stop. The device brakes. If `now` is True, the device
        switches off the current immediately instead of braking.

        All other commands except Hello and Trigger are dropped, including an Enable. If a stop is
        already in transit, it is sent again immediately. A stop with `now` is not replaced by a
        stop without `now`.
        """
        greeting = tuple(p for p in self.queue if isinstance(p.message, Hello | Trigger))
        stops = [p for p in self.queue if isinstance(p.message, Stop)]
        bare = replace(self, queue=greeting, next_table=())
        if stops and isinstance(stops[0].message, Stop) and stops[0].message.now >= int(now):
            return replace(bare, queue=(replace(stops[0], sent_at=float("-inf")), *greeting))
        link = bare._request_order(Stop(int(now)))
        return replace(link, queue=(link.queue[-1], *link.queue[:-1]))

    def enabling(self, stop: int) -> Link:
        """Return the link that requests one enable, for the device's stop number `stop`."""
        return self._request_order(Enable(stop))

    def homing(self) -> Link:
        """Return the link that requests a new search for home. The motors must be off."""
        return self._request_order(Home())

    def _fail(self, reason: DriverReason, text: str) -> Link:
        return replace(self, failed=Report(Condition.GONE, reason, text))

    def without_refusal(self) -> Link:
        """Return the link without the text of the last refusal, after this text was reported."""
        return replace(self, refusal="")

    def _request_order(self, message: Message) -> Link:
        link = self._enqueue(message)
        return replace(link, answer=Answer(link.queue[-1].sequence, message))

    def _enqueue(self, *messages: Message) -> Link:
        numbers = [(self.sequence + i) % 2**16 for i in range(len(messages) + 1)]
        new = [Pending(n, m) for n, m in zip(numbers, messages, strict=False)]
        return replace(self, queue=(*self.queue, *new), sequence=numbers[-1])

    # Messages of the device

    def received(self, packet: Packet, now: float) -> Link:
        """Return the link after a message that arrived at `now` [s]."""
        link, message = replace(self, received_at=now), packet.message
        if isinstance(message, Telemetry):
            return link._after_telemetry(message)
        if isinstance(message, DriveTrouble):
            return replace(link, trouble=message)
        if isinstance(message, Pulse):
            if now - message.host_ns * 1e-9 > MAX_ROUND_TRIP_S:
                # the host has stalled, or the pulse is the reply to a heartbeat of another host
                return link
            clock, line = link.clock.after_pulse(message, now), link.line.received(message, now)
            return replace(link, clock=clock, line=line)
        if isinstance(message, Capabilities):
            return link._after_capabilities(message)
        if isinstance(message, Acknowledgement):
            return link._after_acknowledgement(message)
        return link

    def _after_telemetry(self, telemetry: Telemetry) -> Link:
        link = replace(
            self, telemetry=telemetry, fresh_telemetry=telemetry, telemetry_at=self.received_at,
            clock=self.clock.after_telemetry(telemetry.device_us, self.received_at),
        )  # fmt: skip
        if telemetry.state in MOVABLE:
            return replace(link, trouble=None)
        # Remove the waiting tables. A stopped device refuses tables, and after the next enable the
        # device must not receive old tables.
        queue = tuple(p for p in self.queue if not isinstance(p.message, Begin | Knots | Commit))
        return replace(link, queue=queue, next_table=())

    def _after_capabilities(self, device: Capabilities) -> Link:
        if device.version != VERSION or device.motors != MOTORS:
            why = f"device has protocol version {device.version} and {device.motors} motors, "
            why += f"allowed: version {VERSION} and {MOTORS} motors"
            return self._fail(DriverReason.WRONG_DEVICE, why)
        if device.session != self.session:
            return self  # the message belongs to an earlier session
        if self.device is not None and device.boot != self.device.boot:
            return self._fail(DriverReason.DEVICE_RESET, "device was reset")
        queue = tuple(p for p in self.queue if not isinstance(p.message, Hello))
        return replace(self, device=device, queue=queue)

    def _after_acknowledgement(self, answer: Acknowledgement) -> Link:
        if answer.status is Status.NO_SESSION and self.device is not None:
            return self._fail(DriverReason.DEVICE_RESET, "device was reset")
        about = [p for p in self.queue if p.sequence == answer.sequence and p.tries]
        if not about:
            return self
        message = about[0].message
        if isinstance(message, Knots) and answer.status in LATER:
            return self._repeat_lost_knots(about[0])
        queue = tuple(p for p in self.queue if p.sequence != answer.sequence)
        link = replace(self, queue=queue)
        if self.answer is not None and self.answer.sequence == answer.sequence:
            link = replace(link, answer=replace(self.answer, status=answer.status))
        if answer.status is Status.DONE:
            # The last telemetry does not contain the effect of this command, so wait for the next
            # telemetry.
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

    def _repeat_lost_knots(self, early: Pending) -> Link:
        """Return the link that repeats the setpoints up to the message `early`, which arrived too
        early.

        The line preserves the order, so unanswered setpoints that were sent before `early` were
        lost.
        """
        end = self.queue.index(early) + 1
        queue = tuple(
            replace(p, sent_at=float("-inf"))
            if isinstance(p.message, Knots) and p.tries and p.sent_at <= early.sent_at
            else p
            for p in self.queue[:end]
        )
        return replace(self, queue=queue + self.queue[end:])

    # Packets to send

    def due(self, now: float) -> tuple[Link, list[Packet]]:
        """Return the link after sending, and the packets to send at `now` [s]. A stop comes
        first."""
        if self.failed:
            return self, []
        timeout_s = TIMEOUT_S + self.line.round_s
        if now - self.received_at > timeout_s and self.device is not None:
            why = f"device has been silent for {timeout_s:.2g} s"
            return self._fail(DriverReason.NO_ANSWER, why), []
        link = self._enqueue_next_table(now)._split_knots(now)
        link = replace(link, flight=tuple(item for item in link.flight if item[0] > now))
        packets: list[Packet] = []
        for pending in link._due_stops(now):
            link = link._send_copies(pending, now, link._copy_count(pending.message), packets)
        link = link._send_heartbeat(now, packets)
        sendable = link._due_commands(now)
        for pending in sendable:
            if pending.tries and now - pending.first_at > link._max_repeat_s(pending.message):
                why = f"device does not answer {type(pending.message).__name__}"
                return link._fail(DriverReason.NO_ANSWER, why), []
            copies = link._copy_count(pending.message, len(sendable))
            if not link._has_space(pending.message, copies, now):
                break
            link = link._send_copies(pending, now, copies, packets)
        return link, packets

    def _max_repeat_s(self, message: Message) -> float:
        """Return the maximum time for which a command is repeated [s]."""
        if isinstance(message, Hello):
            return GREETING_S
        if isinstance(message, Knots):
            return float("inf")
        return GIVE_UP_S + 20 * self.line.round_s

    def _send_heartbeat(self, now: float, packets: list[Packet]) -> Link:
        """Return the link after a heartbeat, if a heartbeat is due."""
        if self.device is None or now - self.heartbeat_at < self.line.heartbeat_s - 1e-9:
            return self
        beat = Heartbeat(round(now * 1e9))
        packets.append(Packet(self.sequence, beat))
        line = self.line.sent(frame_bytes(beat), now).heartbeat_sent(beat.host_ns, now)
        return replace(self, line=line, heartbeat_at=now)

    def _copy_count(self, message: Message, abreast: int = 1) -> int:
        """Return the number of copies of a command.

        Unanswered knots of a table are repeated continuously. Therefore fewer copies are needed at
        once, and their number is divided by the number `abreast` of messages that are sent
        together.
        """
        size = frame_bytes(message)
        if not isinstance(message, Knots):
            return self.line.command_copies(size)
        return ceil(self.line.copies(size) / (1 if self.in_order else abreast))

    def _send_copies(
        self, pending: Pending, now: float, copies: int, packets: list[Packet]
    ) -> Link:
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

    def _enqueue_next_table(self, now: float) -> Link:
        """Return the link after the next table was moved to the queue, if the queue is empty."""
        if self.queue or not self.next_table or self.device is None:
            return self
        telemetry = self.fresh_telemetry
        if self.follows and (telemetry is None or telemetry.waiting == self.follows):
            # wait, because the device refuses the next table until the previous table plays
            return self
        return replace(self, next_table=())._enqueue(*self.next_table)

    def _is_in_flight(self, pending: Pending, now: float) -> bool:
        """Return whether the answer to a command may still arrive."""
        if not pending.tries:
            return False
        wait = self.line.retry_s
        if isinstance(pending.message, Hello):
            wait = ANSWER_S if pending.tries < GREETING_TRIES else LATER_GREETING_S
        elif isinstance(pending.message, Knots):
            wait = self.line.round_s + KNOTS_ANSWER_S
        return now - pending.sent_at < wait

    def _split_knots(self, now: float) -> Link:
        """Return the link in which each unanswered message with several knots is replaced by
        messages with one knot each.

        On a line that corrupts bytes, long messages rarely arrive complete.
        """
        queue: list[Pending] = []
        sequence = self.sequence
        for p in self.queue:
            message = p.message
            if (
                not isinstance(message, Knots)
                or len(message.knots) == 1
                or not p.tries
                or self._is_in_flight(p, now)
            ):
                queue.append(p)
                continue
            for i, knot in enumerate(message.knots):
                part = replace(message, first=(message.first + i) % 2**16, knots=(knot,))
                queue.append(replace(p, sequence=sequence, message=part))
                sequence = (sequence + 1) % 2**16
        return replace(self, queue=tuple(queue), sequence=sequence)

    def _due_stops(self, now: float) -> list[Pending]:
        """Return the stop that must be sent now, if any. A stop is sent even if the line is
        busy."""
        stops = [p for p in self.queue if isinstance(p.message, Stop)]
        return [p for p in stops if not self._is_in_flight(p, now)]

    def _due_commands(self, now: float) -> list[Pending]:
        """Return the commands that must be sent now: one command, or all knots if the first command
        contains knots."""
        queue = [p for p in self.queue if not isinstance(p.message, Stop)]
        if self.device is None or not queue or not isinstance(queue[0].message, Knots):
            return [p for p in queue[:1] if not self._is_in_flight(p, now)]
        knots = [p for p in queue if isinstance(p.message, Knots)]
        # Send all knots again, because the line loses most messages.
        if self.line.lossy and not self.in_order:
            return sorted(knots, key=lambda p: p.sent_at)
        return [p for p in knots if not self._is_in_flight(p, now)]

    def _has_space(self, message: Message, copies: int, now: float) -> bool:
        """Return whether the line and, for knots, the device's window have space for a message."""
        if self.line.free_at - now >= QUEUE_S:
            return False
        if not isinstance(message, Knots) or self.device is None or not self.flight:
            return True
        size = frame_bytes(message)
        capacity = self.device.window * FULL_BYTES
        return sum(n for _, n in self.flight) + copies * size <= capacity


def _knots_messages(table: int, first: int, knots: Sequence[Knot], count: int) -> list[Message]:
    """Return messages of `count` knots each. The first knot has the number `first`."""
    starts = range(0, len(knots), count)
    return [Knots(table, (first + k) % 2**16, tuple(knots[k : k + count])) for k in starts]
