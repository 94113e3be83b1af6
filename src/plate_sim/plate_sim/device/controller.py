"""The device as a state machine: sessions, commands, watchdog, telemetry (firmware/controller.c).

No port and no clock of its own: bytes and time are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import FrameError
from plate_core.serial_protocol import (
    MOTORS,
    VERSION,
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    DriveTrouble,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knots,
    Message,
    Packet,
    Pulse,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
    frame,
    newer,
    pack,
    parse,
)

from .limits import BRAKE_ROOM, SLACK, DeviceLimits
from .motion import BRAKE_TICKS, REST, ZERO, Motion
from .piece import PIECE_WORK
from .table import MAX_KNOTS, REST_M, REST_SPEED, PendingTable, Stream, changed
from .trigger import TriggerLine

WINDOW = 8
"""Messages of knots that may be on their way."""

WATCHDOG_US = 250_000
TELEMETRY_US, MOST_TELEMETRY_US = 10_000, 100_000
HOLD_MS = 10_000
"""Longest time that a table is played again."""

TICKS_PER_MS = 100_000
"""Of TICK_S."""

TICK_BYTES, TICK_PACKETS, TICK_WORK = 128, 4, 24
"""What a tick does at most: bytes read, packets obeyed, work of checking tables."""

MOST_TICK_US = 2_000
"""A later tick still moves the plate on by this much only."""

MOST_HEAT_US = 1_000_000
"""Between two ticks."""

FOLLOWING_TICKS = 3
"""Consecutive ticks with too large a following error that are a fault."""


@dataclass(frozen=True)
class Adding:
    """A message whose knots are being added to a stream: no more bytes are read before its end.

    Attributes
    ----------
    sequence : int
    message : Knots
    left : int or None
        Halvings left of the piece before the next knot, if it was begun, ...
    keeps : bool
        ... and whether it keeps the limits.
    """

    sequence: int
    message: Knots
    left: int | None = None
    keeps: bool = True


@dataclass(frozen=True)
class Committing:
    """A Commit that is answered when its table has been checked."""

    sequence: int
    repeats: int


@dataclass(frozen=True)
class Device:
    """A motor controller with ideal drives.

    Attributes
    ----------
    limits : DeviceLimits
    boot : int
        Another number after each reset.
    motion : Motion
    backlog : bytes
        That came and were not read yet.
    session : int or None
        Of the host that is obeyed.
    answered, answer
        Newest command that is done in order, and its answer.
    last_stop : tuple of int, or None
        Sequence and kind of the Stop of this session that was answered last.
    now_us, frame_us, telemetry_us : int
        Time now, of the host's last frame, and of the last telemetry [us].
    pending : PendingTable, Stream or None
        What is being filled.
    adding : Adding or None
    committing : Committing or None
    heat, heat_remainder : (4,)
        Running mean square of each motor's force, and what rounding has left out of it [N2].
    measured : (2, 4)
        Position and acceleration of the motors.
    follows : bool
        Whether a setpoint was commanded in the tick before.
    following_ticks : int
        Consecutive ticks with too large a following error.
    following_m : float32
        Largest following error since the last telemetry [m].
    board : Fault
        Of the board, now.
    load : float
        Longest tick since the last telemetry, over its period, as the board tells; 0: unknown.
    trigger : TriggerLine
        The camera's.
    sent : int
        Messages so far.
    """

    limits: DeviceLimits
    boot: int
    motion: Motion
    reader: Reader = field(default_factory=Reader)
    backlog: bytes = b""
    session: int | None = None
    answered: int = 0
    answer: Status = Status.DONE
    last_stop: tuple[int, int] | None = None
    now_us: int = 0
    frame_us: int = 0
    telemetry_us: int = 0
    pending: PendingTable | Stream | None = None
    adding: Adding | None = None
    committing: Committing | None = None
    heat: np.ndarray = field(default_factory=lambda: ZERO)
    heat_remainder: np.ndarray = field(default_factory=lambda: ZERO)
    measured: np.ndarray = field(default_factory=lambda: REST[:2])
    follows: bool = False
    following_ticks: int = 0
    following_m: np.float32 = field(default_factory=np.float32)
    board: Fault = Fault.NONE
    load: float = 0.0
    trigger: TriggerLine = field(default_factory=TriggerLine)
    sent: int = 0

    @classmethod
    def started(cls, limits: DeviceLimits, boot: int, now_us: int = 0) -> Device:
        """Return a device that has just been switched on."""
        motion = Motion(stops=boot % 2**16)
        return cls(limits, boot, motion, now_us=now_us, frame_us=now_us, telemetry_us=now_us)

    def ticked(
        self,
        now_us: int,
        measured: np.ndarray,
        data: bytes = b"",
        faults: Fault = Fault.NONE,
        home_found: bool = True,
        line_idle: bool = True,
    ) -> tuple[Device, bytes, np.ndarray | None]:
        """Return the device at a later time, the bytes it sends, and what it commands.

        Parameters
        ----------
        now_us : int
            Its clock [us].
        measured : (2, 4)
            Position [m] and acceleration [m/s2] of the motors, float32.
        data : bytes
            That have come.
        faults : Fault
            Of the board, now: SUPPLY, HARDWARE.
        home_found : bool
            Whether the search for home ends, if there is one.
        line_idle : bool
            Whether all that was sent has left.

        Returns
        -------
        Device, bytes, and the setpoint (3, 4), or None while current is off.
        """
        passed = now_us - self.now_us
        dt_us = min(passed, MOST_TICK_US)
        device, sent, work = changed(self, now_us=now_us)._measured(measured), b"", TICK_WORK
        if faults != self.board:
            device = device._with_faults(faults)
        if data or self.backlog or self.adding is not None:
            device, sent, work = changed(device, backlog=self.backlog + data)._received(work)
        if isinstance(device.pending, PendingTable):
            device, more = device._checked(device.pending, work)
            sent += more
        motion = device.motion
        if motion.state is not State.OFF and now_us - device.frame_us > WATCHDOG_US:
            motion = motion.braked(Fault.HOST_SILENT)
        motion, at = motion.stepped(now_us, dt_us, home_found, measured[0])
        if at is not None:
            if setpoint_allowed(device.limits, at, motion.commanded, dt_us):
                motion = changed(motion, commanded=at)
            else:
                motion, at = motion.off(Fault.LIMIT), None
        heat, remainder = device._heated(min(passed, MOST_HEAT_US), at)
        if motion.state is not State.OFF and not (heat <= self.limits.continuous_square).all():
            motion = motion.braked(Fault.HEAT)
        device = changed(
            device, motion=motion, heat=heat, heat_remainder=remainder,
            follows=at is not None, trigger=device._triggered(motion),
        )  # fmt: skip
        silent_us = now_us - device.telemetry_us  # a slow line carries less of it, but never none
        if silent_us >= TELEMETRY_US and (line_idle or silent_us >= MOST_TELEMETRY_US):
            device, more = changed(device, telemetry_us=now_us)._sent(device._telemetry())
            device, sent = changed(device, following_m=np.float32(0)), sent + more
        return device, sent, at

    def _measured(self, measured: np.ndarray) -> Device:
        """Compare where the motors are with what was commanded in the tick before."""
        if not self.follows:
            return changed(self, measured=measured, following_ticks=0)
        error = np.abs(measured[0] - self.motion.commanded[0])
        limit = self.limits.following_m
        too_far = limit > 0 and not (error <= np.float32(limit)).all()
        device = changed(
            self, measured=measured, following_m=np.fmax(self.following_m, np.fmax.reduce(error)),
            following_ticks=self.following_ticks + 1 if too_far else 0,
        )  # fmt: skip
        if device.following_ticks < FOLLOWING_TICKS:
            return device
        motion = device.motion.off(Fault.FOLLOWING)
        return changed(device, motion=motion, following_ticks=0)

    def _with_faults(self, faults: Fault) -> Device:
        """Each fault of the board that appears anew is a stop, also while the motors are off."""
        motion, appeared = self.motion, faults & ~self.board
        if appeared:
            motion = motion.stopped(True, appeared)
        return changed(self, motion=motion, board=faults)

    def _received(self, work: int) -> tuple[Device, bytes, int]:
        """Read and obey what has come, as far as a tick goes; returns the work that is left."""
        device, sent = self, b""
        if device.adding is not None:
            device, sent, work = device._added(device.adding, work)
        data, left, packets = device.backlog, TICK_BYTES, TICK_PACKETS
        while data and left and packets and device.adding is None:
            size = data.find(b"\0", 0, left) + 1 or min(left, len(data))
            reader, came = device.reader.fed(data[:size])
            data, left, packets = data[size:], left - size, packets - len(came)
            device = changed(device, reader=reader)
            for packet in came:
                device, answer, work = device._obeyed(packet, work)
                sent += answer
        return changed(device, backlog=data), sent, work

    def _checked(self, pending: PendingTable, work: int) -> tuple[Device, bytes]:
        """Check the table that is being filled; answer Commit when all has been checked."""
        device = self
        if not pending.decided:
            pending = pending.checked(self.limits, work)
            device = changed(self, pending=pending)
        if self.committing is None:
            return device, b""
        if self.motion.state not in (State.READY, State.PLAYING):
            return device._answered(self.committing, Status.WRONG_STATE)
        if not pending.decided:
            return device, b""
        status, made, motion = pending.status, pending.made, self.motion
        if made is not None and not made.begins_home and not motion.joins(made):
            status, made = Status.JUMP, None
        if made is not None:  # in place of one that waited
            motion = changed(motion, waiting=made, next_repeats=self.committing.repeats)
            device = changed(device, motion=motion, pending=None)
        return device._answered(self.committing, status)

    def _answered(self, commit: Committing, status: Status) -> tuple[Device, bytes]:
        """Answer a Commit that waits for it."""
        answer = status if self.answered == commit.sequence else self.answer
        device = changed(self, committing=None, answer=answer)
        return device._sent(Acknowledgement(commit.sequence, status))

    def _heated(self, dt_us: int, at: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return heat and its remainder after a setpoint, or none.

        What is added in a tick is little beside the sum, so the rounding error is carried on
        (Kahan 1965).
        """
        if at is None and self.heat is ZERO:  # cold since the start
            return ZERO, ZERO
        fraction = np.float32(dt_us) * np.float32(1e-6) / np.float32(self.limits.heat_s)
        force = ZERO if at is None else self.limits.forces(at[2])
        more = min(fraction, np.float32(1)) * (force * force - self.heat) + self.heat_remainder
        heat = self.heat + more
        return heat, more - (heat - self.heat)

    def _triggered(self, motion: Motion) -> TriggerLine:
        """Return the camera's line after the motion of this tick."""
        table = motion.playing if motion.state is State.PLAYING else None
        if table is None or isinstance(table, Stream):
            return self.trigger.stepped(self.now_us, 0, 0)
        return self.trigger.stepped(self.now_us, *table.part(motion.time))

    # What it sends

    def _sent(self, message: Message) -> tuple[Device, bytes]:
        data = frame(pack(Packet(self.sent, message)))
        return changed(self, sent=(self.sent + 1) % 2**16), data

    def _capabilities(self, session: int) -> Capabilities:
        limits = self.limits
        return Capabilities(
            VERSION, session, self.boot, MOTORS, MAX_KNOTS, WINDOW, WATCHDOG_US // 1000,
            limits.stroke_m, limits.speed, limits.accel, limits.force, limits.continuous_force,
            limits.following_m, HOLD_MS,
        )  # fmt: skip

    def _telemetry(self) -> Telemetry:
        motion = self.motion
        moving = motion.state is State.PLAYING or (
            motion.state is State.BRAKING and motion.return_us is None
        )
        finite = np.where(np.isfinite(self.measured), self.measured, np.float32(0))
        position, accel = (tuple(row) for row in finite.tolist())
        playing = motion.playing if moving else None
        return Telemetry(
            self.now_us,
            motion.state,
            motion.faults,
            motion.stops,
            0 if playing is None else playing.table,
            0 if playing is None or isinstance(playing, Stream) else motion.time,
            motion.waiting.table if motion.waiting is not None else 0,
            self.reader.refused % 2**16,
            position,
            accel,
            float(np.max(self.heat) / self.limits.continuous_square),
            float(self.following_m) if np.isfinite(self.following_m) else 0.0,
            self.load,
        )

    # What it receives

    def _obeyed(self, data: bytes, work: int) -> tuple[Device, bytes, int]:
        try:
            packet = parse(data)
        except FrameError:
            return self, b"", work
        message, number = packet.message, packet.sequence
        if isinstance(message, Capabilities | Acknowledgement | Pulse | Telemetry | DriveTrouble):
            return self, b"", work
        device = changed(self, frame_us=self.now_us)
        if isinstance(message, Knots) and self.session is not None:
            return device._filled(number, message, work)
        if isinstance(message, Hello):
            device, sent = device._greeted(number, message)
        elif isinstance(message, Stop):
            device, sent = device._stopped(number, message.now)
        elif isinstance(message, Knots) or self.session is None:
            device, sent = device._sent(Acknowledgement(number, Status.NO_SESSION))
        elif isinstance(message, Trigger):
            line = changed(device.trigger, phase=message.phase, pulse_ms=message.pulse_ms)
            answer = Acknowledgement(number, Status.DONE)
            device, sent = changed(device, trigger=line)._sent(answer)
        elif isinstance(message, Heartbeat):
            device, sent = device._sent(Pulse(message.host_ns, device.now_us))
        else:
            device, sent = device._ordered(number, message)
        return device, sent, work

    def _greeted(self, number: int, hello: Hello) -> tuple[Device, bytes]:
        if hello.version != VERSION:
            return self._sent(self._capabilities(0))
        device = self
        if hello.session != self.session:
            motion = self.motion
            if motion.state is not State.OFF:
                motion = motion.stopped(False, Fault.STOPPED)
            device = changed(
                self, motion=changed(motion, waiting=None), pending=None, committing=None,
                session=hello.session, answered=number, answer=Status.DONE, last_stop=None,
                trigger=TriggerLine(),
            )  # fmt: skip
        return device._sent(device._capabilities(hello.session))

    def _stopped(self, number: int, now: int) -> tuple[Device, bytes]:
        """Always done; a repetition of the last one is a stop only where it still ends anything."""
        motion = self.motion
        still = (State.OFF,) if now else (State.OFF, State.BRAKING)
        if self.last_stop != (number, now) or motion.state not in still:
            motion = motion.stopped(bool(now), Fault.STOPPED)
        motion = changed(motion, faults=motion.faults | Fault.STOPPED)
        device = changed(self, motion=motion, last_stop=(number, now))
        if newer(number, self.answered):
            device = changed(device, answered=number, answer=Status.DONE)
        return device._sent(Acknowledgement(number, Status.DONE))

    def _ordered(
        self, number: int, message: Enable | Home | Begin | Commit
    ) -> tuple[Device, bytes]:
        """Done in order, and once."""
        device, sent = self, b""
        if self.committing is not None and number == self.committing.sequence:
            return self, b""  # it will be answered
        if number == self.answered:
            return self._sent(Acknowledgement(number, self.answer))
        if not newer(number, self.answered):
            return self._sent(Acknowledgement(number, Status.OLD))
        if self.committing is not None:
            device, sent = self._answered(self.committing, Status.OLD)
        if isinstance(message, Enable):
            device, status = device._enabled(message.stop)
        elif isinstance(message, Home):
            device, status = device._home()
        elif isinstance(message, Begin):
            device, status = device._begun(message)
        else:
            device, status = device._committed(number, message)
        device = changed(device, answered=number, answer=status)
        if device.committing is not None:
            return device, sent
        device, more = device._sent(Acknowledgement(number, status))
        return device, sent + more

    def _enabled(self, stop: int) -> tuple[Device, Status]:
        motion = self.motion
        if stop != motion.stops:
            return self, Status.WRONG_STOP
        if motion.state is State.BRAKING or self.board:
            return self, Status.WRONG_STATE
        if motion.state is State.OFF:
            motion = motion.enabled(self.now_us)
        return changed(self, motion=motion), Status.DONE

    def _home(self) -> tuple[Device, Status]:
        motion = self.motion
        if motion.state is not State.OFF:
            return self, Status.WRONG_STATE
        motion = changed(motion, faults=motion.faults | Fault.NO_HOME)
        return changed(self, motion=motion), Status.DONE

    def _begun(self, begin: Begin) -> tuple[Device, Status]:
        device = changed(self, pending=None)
        if begin.table == 0 or begin.knots == 1:
            return device, Status.WRONG_TABLE
        if begin.knots == 0 and begin.splice_ticks:
            return device, Status.WRONG_TIMES  # a stream goes on without one
        if begin.knots == 0:
            return changed(device, pending=Stream.opened(begin.table)), Status.DONE
        if begin.knots > MAX_KNOTS:
            return device, Status.TOO_LONG
        pending = PendingTable(begin.table, begin.knots, begin.crc, begin.splice_ticks)
        return changed(device, pending=pending), Status.DONE

    def _stream(self, table: int) -> Stream | None:
        """The stream with a number, while knots may be added to it."""
        playing = self.motion.playing if self.motion.state is State.PLAYING else None
        for stream in (playing, self.motion.waiting, self.pending):
            if isinstance(stream, Stream) and stream.table == table:
                return stream
        return None

    def _filled(self, number: int, message: Knots, work: int) -> tuple[Device, bytes, int]:
        """Knots for the table that is open, or for a stream."""
        pending, end = self.pending, message.first + len(message.knots)
        if self._stream(message.table) is not None:
            return self._added(Adding(number, message), work)
        device, status = self, Status.WRONG_TABLE
        table = pending if isinstance(pending, PendingTable) else None
        if table is not None and table.table == message.table and end <= table.count:
            device = changed(self, pending=table.filled(message.first, message.knots))
            status = Status.DONE
        device, sent = device._sent(Acknowledgement(number, status))
        return device, sent, work

    def _added(self, adding: Adding, work: int) -> tuple[Device, bytes, int]:
        """Add a message's knots to its stream, or as many as there is work for."""
        device, message, status = self, adding.message, Status.DONE
        while status is Status.DONE:
            stream, motion = device._stream(message.table), device.motion
            if stream is None:
                status = Status.WRONG_TABLE
                break
            plays, known = stream is motion.playing, stream.known(message.first)
            time = motion.time if plays else 0
            if plays and stream.rests and time + BRAKE_TICKS // 2 > stream.period_ticks:
                status = Status.WRONG_STATE  # at its end: too late, since a brake must fit
            elif known is None:
                status = Status.INCOMPLETE
            elif known >= len(message.knots):
                break
            elif work <= 0:
                return changed(device, adding=adding), b"", work
            else:
                knot = message.knots[known]
                status = stream.refusal(knot, time)
                if status is Status.DONE and len(stream.ticks):
                    left = adding.left
                    if left is None:
                        check = stream.check(knot, self.limits)
                        left, work = check.halvings, work - PIECE_WORK
                        adding = changed(adding, keeps=check.keeps)
                    done = min(left, max(work, 0))
                    work -= done
                    if left > done:
                        adding = changed(adding, left=left - done)
                        return changed(device, adding=adding), b"", work
                    status = Status.DONE if adding.keeps else Status.LIMIT
                    adding = changed(adding, left=None)
                if status is Status.DONE:
                    device = device._extended(stream, *stream.added(knot, time))
        device, sent = changed(device, adding=None)._sent(Acknowledgement(adding.sequence, status))
        return device, sent, work

    def _extended(self, stream: Stream, longer: Stream, time: int) -> Device:
        """A stream has become longer: the one that plays, or waits, or is being filled."""
        motion = self.motion
        if stream is motion.playing:
            return changed(self, motion=changed(motion, playing=longer, time=time))
        if stream is motion.waiting:
            return changed(self, motion=changed(motion, waiting=longer))
        return changed(self, pending=longer)

    def _committed(self, number: int, commit: Commit) -> tuple[Device, Status]:
        """Whether what was filled may be taken over; that of a table remains to be checked."""
        motion, pending = self.motion, self.pending
        if motion.state not in (State.READY, State.PLAYING):
            return self, Status.WRONG_STATE
        if pending is None or pending.table != commit.table:
            return self, Status.WRONG_TABLE
        endless = isinstance(pending, Stream)
        if motion.state is State.PLAYING and (endless or isinstance(motion.playing, Stream)):
            return self, Status.WRONG_STATE  # a stream has no end to begin at
        if commit.repeats == 0 or (endless and commit.repeats != 1):
            return self, Status.REPEATS
        away = np.abs(motion.commanded[0]) > REST_M
        if motion.state is State.READY and away.any():
            return self, Status.JUMP  # a stream has ended elsewhere: only stop and enable lead home
        if isinstance(pending, Stream):
            if len(pending.ticks) < 2 or pending.period_ticks < BRAKE_TICKS:
                return self, Status.INCOMPLETE  # it must always be able to brake
            if not pending.begins_home:
                return self, Status.JUMP
            motion = changed(motion, waiting=pending, next_repeats=commit.repeats)
            return changed(self, motion=motion, pending=None), Status.DONE
        if len(pending.knots) < pending.count:
            return self, Status.INCOMPLETE
        held = commit.repeats * pending.period_ticks
        if commit.repeats > 1 and not (pending.closes and held <= HOLD_MS * TICKS_PER_MS):
            return self, Status.REPEATS
        return changed(self, committing=Committing(number, commit.repeats)), Status.DONE


def setpoint_allowed(limits: DeviceLimits, at: np.ndarray, before: np.ndarray, dt_us: int) -> bool:
    """Tell whether a setpoint may be commanded after the one before.

    A brake adds at most 1.5 (v / Tb)^2 / accel, a tenth, to the table's acceleration; where one
    table follows another both may be as far from rest at home as a table may.
    """
    dt = np.float32(dt_us) * np.float32(1e-6)
    speed, accel = np.float32(limits.speed) * SLACK, np.float32(limits.accel) * BRAKE_ROOM
    steps = np.array([[speed * dt + REST_M], [accel * dt + 2 * REST_SPEED]], np.float32)
    return bool(
        (np.abs(at) <= limits.commanded).all() and (np.abs(at[:2] - before[:2]) <= steps).all()
    )
