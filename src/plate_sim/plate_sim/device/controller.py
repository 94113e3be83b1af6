"""The device as a state machine: sessions, commands, watchdog, telemetry (firmware/controller.c).

No port and no clock of its own: bytes and time are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core.errors import FrameError
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
    Knots,
    Message,
    Packet,
    Pulse,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    newer,
    pack,
    parse,
)
from plate_core.serial_protocol.messages import MOTORS, VERSION

from .changed import changed
from .limits import DeviceLimits
from .motion import BRAKE_S, REST, Motion
from .stream import MAX_KNOTS, Stream
from .table import Draft, Table

WINDOW = 8
"""Messages of knots that may be on their way."""

WATCHDOG_US = 250_000
TELEMETRY_US = 10_000
JUMP_M, JUMP_SPEED = np.float32(2e-6), np.float32(2e-3)
"""How far a table may begin from where the plate is [m], [m/s]: rounding."""


@dataclass(frozen=True)
class Device:
    """A motor controller with ideal drives.

    Attributes
    ----------
    limits : DeviceLimits
    boot : int
        Another number after each reset.
    session : int or None
        Of the host that is obeyed.
    answered, answer
        Newest command that is done in order, and its answer.
    now_us, heard_us, told_us : int
        Time now, of the host's last frame, and of the last telemetry [us].
    motion : Motion
    draft : Draft, Stream or None
        The second buffer.
    heat : (4,)
        Mean square of each motor's force, of late [N2].
    measured : (2, 4)
        Position and acceleration of the motors.
    board : Fault
        Of the board, now.
    sent : int
        Messages so far.
    """

    limits: DeviceLimits
    boot: int
    reader: Reader = field(default_factory=Reader)
    session: int | None = None
    answered: int = 0
    answer: Status = Status.DONE
    now_us: int = 0
    heard_us: int = 0
    told_us: int = 0
    motion: Motion = field(default_factory=Motion)
    draft: Draft | Stream | None = None
    heat: np.ndarray = field(default_factory=lambda: np.zeros(MOTORS))
    measured: np.ndarray = field(default_factory=lambda: REST[:2])
    board: Fault = Fault.NONE
    sent: int = 0

    @classmethod
    def started(cls, limits: DeviceLimits, boot: int, now_us: int = 0) -> Device:
        """Return a device that has just been switched on."""
        return cls(limits, boot, now_us=now_us, heard_us=now_us, told_us=now_us)

    def ticked(
        self,
        now_us: int,
        data: bytes = b"",
        faults: Fault = Fault.NONE,
        home_found: bool = True,
        measured: np.ndarray | None = None,
    ) -> tuple[Device, bytes, np.ndarray | None]:
        """Return the device at a later time, what it says, and what it commands.

        Parameters
        ----------
        now_us : int
            Its clock [us].
        data : bytes
            What has come.
        faults : Fault
            Of the board, now: SUPPLY, HARDWARE.
        home_found : bool
            Whether the search for home has ended.
        measured : (2, 4), optional
            Position [m] and acceleration [m/s2]; if missing, as commanded last.

        Returns
        -------
        Device, bytes, and the setpoint (3, 4), or None while current is off.
        """
        dt = (now_us - self.now_us) * 1e-6
        device, said = changed(self, now_us=now_us, board=faults), b""
        if measured is not None:
            device = changed(device, measured=measured)
        if data:
            reader, packets = self.reader.fed(data)
            device = changed(device, reader=reader)
            for packet in packets:
                device, answer = device._obeyed(packet)
                said += answer
        motion = device.motion
        if faults:
            motion = motion.off(faults)
        if motion.state is not State.OFF and now_us - device.heard_us > WATCHDOG_US:
            motion = motion.braked(Fault.HOST_SILENT)
        motion, at = motion.stepped(dt, home_found)
        if at is not None and not np.all(np.abs(at) <= self.limits.commanded):
            motion, at = motion.off(Fault.LIMIT), None
        heat = device._warmed(dt, at)
        if motion.state is not State.OFF and not np.all(heat <= self.limits.bearable):
            motion = motion.braked(Fault.HEAT)
        draft = device.draft if motion.playing is device.motion.playing else None  # taken over
        device = changed(device, motion=motion, heat=heat, draft=draft)
        if at is not None and measured is None:
            device = changed(device, measured=at[::2])
        if now_us - device.told_us >= TELEMETRY_US:
            device, told = changed(device, told_us=now_us)._say(device._telemetry())
            said += told
        return device, said, at

    def _warmed(self, dt: float, at: np.ndarray | None) -> np.ndarray:
        """Return the heat after `dt` [s] of a setpoint, or of none."""
        share = min(dt / float(np.float32(self.limits.heat_s)), 1.0)
        force = np.zeros(MOTORS) if at is None else self.limits.forces(at[2])
        return np.asarray(self.heat + share * (force * force - self.heat))

    # What it says

    def _say(self, message: Message) -> tuple[Device, bytes]:
        data = frame(pack(Packet(self.sent, message)))
        return changed(self, sent=(self.sent + 1) % 2**16), data

    def _capabilities(self, session: int) -> Capabilities:
        limits = self.limits
        return Capabilities(
            VERSION, session, self.boot, MOTORS, MAX_KNOTS, WINDOW, WATCHDOG_US // 1000,
            limits.stroke_m, limits.speed, limits.accel, limits.force, limits.lasting,
        )  # fmt: skip

    def _telemetry(self) -> Telemetry:
        motion = self.motion
        moving = motion.state is State.PLAYING or (
            motion.state is State.BRAKING and motion.homeward is None
        )
        position, accel = (tuple(row) for row in self.measured.tolist())
        return Telemetry(
            self.now_us,
            motion.state,
            motion.faults,
            motion.playing.table if moving and motion.playing is not None else 0,
            motion.waiting.table if motion.waiting is not None else 0,
            self.reader.refused % 2**16,
            position,
            accel,
            float(np.max(self.heat) / self.limits.bearable),
        )

    # What it is told

    def _obeyed(self, data: bytes) -> tuple[Device, bytes]:
        try:
            packet = parse(data)
        except FrameError:
            return self, b""
        message, number = packet.message, packet.sequence
        if isinstance(message, Capabilities | Acknowledgement | Pulse | Telemetry):
            return self, b""
        device = changed(self, heard_us=self.now_us)
        if isinstance(message, Hello):
            return device._greeted(number, message)
        if isinstance(message, Stop):
            device, status = device._stopped(number, bool(message.now))
        elif device.session is None:
            status = Status.NO_SESSION
        elif isinstance(message, Heartbeat):
            return device._say(Pulse(message.host_ns, device.now_us))
        elif isinstance(message, Knots):
            device, status = device._filled(message)
        else:
            device, status = device._ordered(number, message)
        return device._say(Acknowledgement(number, status))

    def _greeted(self, number: int, hello: Hello) -> tuple[Device, bytes]:
        if hello.version != VERSION:
            return self._say(self._capabilities(0))
        device = self
        if hello.session != self.session:
            motion = self.motion
            if motion.state is not State.OFF:
                motion = motion.braked(Fault.STOPPED)
            device = changed(
                self, motion=changed(motion, waiting=None), draft=None, session=hello.session,
                answered=number, answer=Status.DONE,
            )  # fmt: skip
        return device._say(device._capabilities(hello.session))

    def _stopped(self, number: int, now: bool) -> tuple[Device, Status]:
        motion = self.motion
        if now:
            motion = motion.off(Fault.STOPPED)
        elif motion.state is not State.OFF:
            motion = motion.braked(Fault.STOPPED)
        device = changed(self, motion=motion)
        if newer(number, self.answered):
            device = changed(device, answered=number, answer=Status.DONE)
        return device, Status.DONE

    def _ordered(
        self, number: int, message: Enable | Home | Begin | Commit
    ) -> tuple[Device, Status]:
        """Done in order, and once."""
        if number == self.answered:
            return self, self.answer
        if not newer(number, self.answered):
            return self, Status.OLD
        if isinstance(message, Enable):
            device, status = self._enabled()
        elif isinstance(message, Home):
            device, status = self._home()
        elif isinstance(message, Begin):
            device, status = self._begun(message)
        else:
            device, status = self._committed(message)
        return changed(device, answered=number, answer=status), status

    def _enabled(self) -> tuple[Device, Status]:
        motion = self.motion
        if motion.state in (State.READY, State.PLAYING):
            return self, Status.DONE
        if motion.state is not State.OFF or self.board or motion.faults & Fault.NO_HOME:
            return self, Status.WRONG_STATE
        start = np.stack([self.measured[0], REST[1], REST[2]])
        motion = changed(motion, faults=Fault.NONE, start=start).going_home(State.HOMING)
        return changed(self, motion=motion), Status.DONE

    def _home(self) -> tuple[Device, Status]:
        if self.motion.state is not State.OFF:
            return self, Status.WRONG_STATE
        return changed(self, motion=changed(self.motion, state=State.HOMING)), Status.DONE

    def _begun(self, begin: Begin) -> tuple[Device, Status]:
        device = changed(self, motion=changed(self.motion, waiting=None), draft=None)
        if begin.table == 0 or begin.knots == 1:
            return device, Status.WRONG_TABLE
        if begin.knots == 0:
            return changed(device, draft=Stream.opened(begin.table)), Status.DONE
        if begin.knots > MAX_KNOTS:
            return device, Status.TOO_LONG
        return changed(device, draft=Draft(begin.table, begin.knots, begin.crc)), Status.DONE

    def _filled(self, message: Knots) -> tuple[Device, Status]:
        draft, end = self.draft, message.first + len(message.knots)
        playing, id = self.motion.playing, message.table
        if self.motion.state is not State.PLAYING or not isinstance(playing, Stream):
            playing = None
        if playing is not None and playing.table == id:
            return self._streamed(playing, message)
        if isinstance(draft, Stream) and draft.table == id:
            added, _, status = draft.added(message.first, message.knots, 0.0, self.limits)
            waits = self.motion.waiting is not None
            motion = changed(self.motion, waiting=added) if waits else self.motion
            return changed(self, draft=added, motion=motion), status
        if (
            draft is None
            or isinstance(draft, Stream)
            or draft.table != message.table
            or end > draft.count
        ):
            return self, Status.WRONG_TABLE
        if self.motion.waiting is not None:
            return self, Status.DONE  # a repetition: the table has been looked at
        return changed(self, draft=draft.filled(message.first, message.knots)), Status.DONE

    def _streamed(self, stream: Stream, message: Knots) -> tuple[Device, Status]:
        """Add knots to the stream that plays."""
        motion = self.motion
        if stream.rests and motion.time + BRAKE_S / 2 > stream.period:
            return self, Status.WRONG_STATE  # at its end: too late to go on, since a brake must fit
        added, time, status = stream.added(message.first, message.knots, motion.time, self.limits)
        return changed(self, motion=changed(motion, playing=added, time=time)), status

    def _committed(self, commit: Commit) -> tuple[Device, Status]:
        motion, draft = self.motion, self.draft
        if motion.state not in (State.READY, State.PLAYING):
            return self, Status.WRONG_STATE
        if draft is None or draft.table != commit.table:
            return self, Status.WRONG_TABLE
        endless = isinstance(draft, Stream)
        if motion.state is State.PLAYING and (endless or isinstance(motion.playing, Stream)):
            return self, Status.WRONG_STATE  # a stream has no end to begin at
        table: Table | None
        if isinstance(draft, Draft):
            status, table = draft.checked(self.limits)
        else:  # it must always be able to brake
            whole = len(draft.ticks) >= 2 and draft.period >= BRAKE_S
            status, table = (Status.DONE, draft) if whole else (Status.INCOMPLETE, None)
        if table is None:
            return self, status
        position, speed = motion.start[0], REST[1]
        if motion.state is State.PLAYING and motion.playing is not None:
            position, speed = motion.playing.position[-1], motion.playing.velocity[-1]
        jump = np.abs(table.position[0] - position), np.abs(table.velocity[0] - speed)
        if not (np.all(jump[0] <= JUMP_M) and np.all(jump[1] <= JUMP_SPEED)):
            return self, Status.JUMP
        motion = changed(motion, waiting=table, next_repeats=commit.repeats)
        return changed(self, motion=motion), Status.DONE
