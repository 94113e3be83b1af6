"""Messages between the driver (host) and the motor controller (device), and their encoding.

docs/protocol.md specifies when and why each message is sent. `pack` encodes a message with its
sequence number, `parse` decodes and checks a message.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from enum import IntEnum, IntFlag
from math import isfinite
from typing import Any

from ..errors import FrameError

VERSION = 5
MOTORS = 4
BITS_PER_BYTE = 10
"""Bits per byte on a UART, including start and stop bit."""

TICK_S = 1e-8
"""Unit of the time of a knot [s]. With this unit, a table can last 42 s, and the rounding error of
a time is at most 5 ns."""

KNOTS_PER_MESSAGE = 4
"""Maximum number of knots in one packet."""

MAX_PULSE_MS = 8
"""Maximum pulse length of the camera's trigger line [ms]. A pulse must be shorter than the shortest
table, so that the line is low again before the next pulse."""

HEADER = struct.Struct("<BH")


class State(IntEnum):
    """State of the device."""

    OFF = 0  # the motors have no current
    HOMING = 1
    READY = 2  # the motors hold the plate at home
    PLAYING = 3
    BRAKING = 4


class Status(IntEnum):
    """The device's reply to a command."""

    DONE = 0
    NO_SESSION = 1  # no session, or the device was reset: the host must send a Hello first
    OLD = 2  # a later command has already been executed
    WRONG_STATE = 3
    WRONG_TABLE = 4  # another table is open, or the index of a knot is beyond the table's end
    INCOMPLETE = 5  # knots are missing or damaged
    # the first time is not 0, times do not increase, or the splice is not at a knot or too late
    WRONG_TIMES = 6
    LIMIT = 7  # the spline exceeds a limit of stroke, speed, acceleration, force or heat
    # the table starts neither at rest at home nor at a future splice, or it ends in motion
    JUMP = 8
    TOO_LONG = 9
    WRONG_STOP = 10  # the number in Enable is not the number of the current stop
    REPEATS = 11  # `repeats` is 0 or too large, or the table does not end in its initial state


class Fault(IntFlag):
    """Reasons why the device plays no cycle. All reasons except NO_HOME persist until a person
    enables the motors."""

    NONE = 0
    HOST_SILENT = 1
    STOPPED = 2
    LIMIT = 4
    SUPPLY = 8
    HARDWARE = 16
    HEAT = 32
    NO_HOME = 64  # the home position was not found since the last reset or Home command
    FOLLOWING = 128  # the following error of a motor was too large


class Trouble(IntEnum):
    """Fault of a drive that the device commands over a bus."""

    SILENT = 1  # the drive does not reply, or it sends no heartbeat
    RESET = 2  # the drive has restarted
    NOT_OPERATIONAL = 3  # the heartbeat reports another state than operational; code: the NMT state
    REFUSED = 4  # the drive refuses an object during set-up; code: SDO abort
    WRONG_DRIVE = 5  # an object has a wrong value; code: this value
    EMERGENCY = 6  # the drive sent an emergency; code: emergency code; object: error register
    FAULT = 7  # the statusword reports a fault; code: statusword
    LEFT = 8  # the drive has left the operational state; code: statusword
    NOT_ENABLED = 9  # the drive does not enter the operational state; code: statusword
    KEEPS = 10  # the drive keeps its current although it was disabled; code: statusword
    NO_POSITION = 11  # the drive does not report its position
    TWICE = 12  # two drives on the bus have the same node number
    BUS_OFF = 13
    OTHER_MASTER = 14  # another master commands the drives
    ERROR = 15  # an ODrive has left the operational state or has errors; code: the error flags
    NO_WATCHDOG = 16  # an ODrive would keep running if the board failed
    # the zero of a drive's position may have changed; a Home command clears this fault
    HOME_LOST = 17
    RANGE = 18  # the drive's position would overflow within the stroke; code: its position
    CROOKED = 19  # the reported positions are inconsistent with a rigid plate
    ASTRAY = 20  # the following error is too large; code: the error [um]


def _wire_format(code: str, count: int = 1, kind: Any = None) -> dict[str, Any]:
    """Return the metadata of a field that has `count` values. `code` is the format character of
    `struct`. `kind` is an enum or a tuple of the allowed values. None allows all values."""
    return {"code": code, "count": count, "kind": kind}


@dataclass(frozen=True)
class Knot:
    """Knot of a table: its time [TICK_S], and the travel [m], speed [m/s] and acceleration [m/s2]
    of the four motors."""

    ticks: int = field(metadata=_wire_format("I"))
    position: tuple[float, ...] = field(metadata=_wire_format("f", MOTORS))
    velocity: tuple[float, ...] = field(metadata=_wire_format("f", MOTORS))
    acceleration: tuple[float, ...] = field(metadata=_wire_format("f", MOTORS))


@dataclass(frozen=True)
class Hello:
    """Host: start a session with a new number."""

    version: int = field(metadata=_wire_format("B"))
    session: int = field(metadata=_wire_format("I"))


@dataclass(frozen=True)
class Heartbeat:
    """Host: periodic message that shows that the host works, with the host's clock time [ns]. The
    device replies with a Pulse."""

    host_ns: int = field(metadata=_wire_format("Q"))


@dataclass(frozen=True)
class Enable:
    """Host: enable the motors, because a person has checked the rig. The command ends the stop with
    the number `stop`. The device finds home if necessary, and holds the plate at home.

    `stop` is the number of the stop in the telemetry. An Enable with another number is refused.
    """

    stop: int = field(metadata=_wire_format("H"))


@dataclass(frozen=True)
class Stop:
    """Host: brake along the path and move the plate home. If `now` is 1, switch the current off
    immediately instead."""

    now: int = field(metadata=_wire_format("B", kind=(0, 1)))


@dataclass(frozen=True)
class Home:
    """Host: discard the home position. The next Enable searches for the home position again."""


@dataclass(frozen=True)
class Trigger:
    """Host: trigger the camera at this phase of each cycle or tail [1/65536 of its period], with
    this pulse length [ms]. A length of 0 disables the trigger."""

    phase: int = field(metadata=_wire_format("H"))
    pulse_ms: int = field(metadata=_wire_format("B", kind=tuple(range(MAX_PULSE_MS + 1))))


@dataclass(frozen=True)
class Begin:
    """Host: announce a table with its number of knots and their CRC-32. At the knot with the time
    `splice_ticks` [TICK_S], the next table starts. If there is no next table, the tail starts. If
    `splice_ticks` is 0, the table has no tail."""

    table: int = field(metadata=_wire_format("H"))
    knots: int = field(metadata=_wire_format("H"))
    crc: int = field(metadata=_wire_format("I"))
    splice_ticks: int = field(default=0, metadata=_wire_format("I"))


@dataclass(frozen=True)
class Knots:
    """Host: knots `first`, `first` + 1, ... of a table."""

    table: int = field(metadata=_wire_format("H"))
    first: int = field(metadata=_wire_format("H"))
    knots: tuple[Knot, ...]


@dataclass(frozen=True)
class Commit:
    """Host: start the announced table when the running table ends or reaches its splice. Play it
    `repeats` times, then rest.

    A table that has a tail or starts in motion is played only once.
    """

    table: int = field(metadata=_wire_format("H"))
    repeats: int = field(metadata=_wire_format("H"))


@dataclass(frozen=True)
class Capabilities:
    """Device: reply to Hello. The limits are in SI units. `boot` changes after a reset."""

    version: int = field(metadata=_wire_format("B"))
    session: int = field(metadata=_wire_format("I"))
    boot: int = field(metadata=_wire_format("I"))
    motors: int = field(metadata=_wire_format("B"))
    max_knots: int = field(metadata=_wire_format("H"))
    window: int = field(metadata=_wire_format("B"))
    watchdog_ms: int = field(metadata=_wire_format("H"))
    stroke_m: float = field(metadata=_wire_format("f"))
    speed: float = field(metadata=_wire_format("f"))
    accel: float = field(metadata=_wire_format("f"))
    force: float = field(metadata=_wire_format("f"))
    continuous_force: float = field(metadata=_wire_format("f"))  # continuous root mean square force
    following_m: float = field(
        metadata=_wire_format("f")
    )  # maximum following error; 0: not checked
    hold_ms: int = field(metadata=_wire_format("H"))  # maximum duration of a table's repetitions


@dataclass(frozen=True)
class Acknowledgement:
    """Device: result of the command with this sequence number."""

    sequence: int = field(metadata=_wire_format("H"))
    status: Status = field(metadata=_wire_format("B", kind=Status))


@dataclass(frozen=True)
class Pulse:
    """Device: reply to a Heartbeat with the host time in it [ns], and the device time at its
    arrival [us]."""

    host_ns: int = field(metadata=_wire_format("Q"))
    device_us: int = field(metadata=_wire_format("Q"))


@dataclass(frozen=True)
class Telemetry:
    """Device: measured travel [m] and acceleration [m/s2] of the motors at the device time [us]."""

    device_us: int = field(metadata=_wire_format("Q"))
    state: State = field(metadata=_wire_format("B", kind=State))
    faults: Fault = field(metadata=_wire_format("B", kind=Fault))
    # number of the present stop; without a present stop, number of the last stop
    stop: int = field(metadata=_wire_format("H"))
    table: int = field(metadata=_wire_format("H"))  # number of the table that plays; 0: no table
    ticks: int = field(
        metadata=_wire_format("I")
    )  # time since this play of the table began [TICK_S]
    waiting: int = field(
        metadata=_wire_format("H")
    )  # number of the table that plays next; 0: no table
    refused: int = field(metadata=_wire_format("H"))  # number of damaged frames, modulo 2^16
    position: tuple[float, ...] = field(metadata=_wire_format("f", MOTORS))
    acceleration: tuple[float, ...] = field(metadata=_wire_format("f", MOTORS))
    # maximum mean square force of a motor divided by its limit [-]
    heat: float = field(metadata=_wire_format("f"))
    # Maximum following error of a motor since the last telemetry [m].
    following_m: float = field(metadata=_wire_format("f"))
    # Longest computing time of a tick since the last telemetry, relative to the tick period.
    load: float = field(metadata=_wire_format("f"))


@dataclass(frozen=True)
class DriveTrouble:
    """Device: the first fault of a drive since the last enable, with the error codes of the
    drive."""

    # number of the motor; 0: the bus
    motor: int = field(metadata=_wire_format("B", kind=tuple(range(MOTORS + 1))))
    kind: Trouble = field(metadata=_wire_format("B", kind=Trouble))
    object: int = field(metadata=_wire_format("H"))
    code: int = field(metadata=_wire_format("I"))

    @property
    def text(self) -> str:
        """Description of the fault, for the user."""
        whose = f"motor_{self.motor}" if self.motor else "bus"
        errors = [name for bit, name in ODRIVE_ERRORS.items() if self.code >> bit & 1]
        return f"{whose}: " + TEXTS[self.kind].format(
            object=self.object, code=self.code, errors=", ".join(errors) or "none reported",
            abort=abort_text(self.code), allowed=ALLOWED.get(self.object, "see its manual"),
            meaning=emergency_text(self.code),
        )  # fmt: skip


def abort_text(code: int) -> str:
    """Return the code and the meaning of an SDO abort, by which a node refuses an object."""
    return f"abort {code:08X}h, {ABORTS.get(code, 'see its manual')}"


def emergency_text(code: int) -> str:
    """Return the meaning of an emergency code (also object 603Fh) in brackets. The result is empty
    if the code is unknown."""
    fitting = [text for start, text in EMERGENCIES.items() if f"{code:04X}".startswith(start)]
    return f" ({fitting[0]})" if fitting else ""


ABORTS = {
    0x06010002: "read only", 0x06020000: "no such object", 0x06040041: "cannot be mapped",
    0x06040042: "too many objects are mapped", 0x06070010: "wrong length",
    0x06090011: "no such subindex",
    0x06090030: "value not allowed", 0x06090031: "value too great", 0x06090032: "value too small",
    0x08000020: "cannot be stored", 0x08000021: "another interface controls the drive",
    0x08000022: "not possible in this state of the drive",
}  # fmt: skip
EMERGENCIES = {
    "8130": "heartbeat missed", "8611": "following error", "81": "communication", "2": "current",
    "3": "voltage", "4": "temperature", "5": "hardware", "6": "software", "7": "sensor",
    "FF": "manufacturer specific, see its manual",
}  # fmt: skip
"""Meanings of CANopen emergency codes, by their first digits. The first matching entry is used."""

ALLOWED = {
    0: "2, CANSimple of firmware 0.6", 0x1000: "...0192h, CiA 402",
    0x1018: "the serial of the rig file", 0x6061: "8, cyclic synchronous position",
    0x6502: "with bit 7, cyclic synchronous position",
}  # fmt: skip
"""Required values of the CANopen objects that the device reads when it sets up a drive. The values
are texts for messages. The key 0 is the protocol version of an ODrive."""


TEXTS = {
    Trouble.SILENT: "the drive does not answer",
    Trouble.RESET: "the drive was reset",
    Trouble.NOT_OPERATIONAL: "the drive is not operational (NMT state {code})",
    Trouble.REFUSED: "the drive refuses object {object:04X}h during set-up ({abort})",
    Trouble.WRONG_DRIVE: "wrong drive: object {object:04X}h is {code:X}h ({code}), "
    "allowed: {allowed}",
    Trouble.EMERGENCY: "emergency {code:04X}h, error register {object:02X}h{meaning}",
    Trouble.FAULT: "the drive is in fault (statusword {code:04X}h)",
    Trouble.LEFT: "the drive has left the enabled state (statusword {code:04X}h)",
    Trouble.NOT_ENABLED: "the drive does not become enabled (status {code:04X}h)",
    Trouble.KEEPS: "the drive does not switch its current off (status {code:04X}h): cut the power "
    "by hand",
    Trouble.NO_POSITION: "the drive does not report its position",
    Trouble.TWICE: "two drives have this node number",
    Trouble.BUS_OFF: "bus off: check wires, termination and bit rate",
    Trouble.OTHER_MASTER: "another master is on the bus",
    Trouble.ERROR: "errors of the drive: {errors} ({code:08X}h)",
    Trouble.NO_WATCHDOG: "the drive stays enabled without messages: set its enable_watchdog, and "
    "watchdog_timeout to 0.1 s",
    Trouble.HOME_LOST: "home is lost: let the plate hang at home, then call home, then enable",
    Trouble.RANGE: "position at home is {code:08X}h: the drive's range of positions ends "
    "within the stroke, so move the drive's zero",
    Trouble.ASTRAY: "the motor does not follow: its distance from the setpoint is {code} um",
    Trouble.CROOKED: "the motors' positions do not fit a rigid plate: a drive has lost counts or "
    "two drives are swapped",
}

ODRIVE_ERRORS = {
    0: "INITIALIZING", 1: "SYSTEM_LEVEL", 2: "TIMING_ERROR", 3: "MISSING_ESTIMATE",
    4: "BAD_CONFIG", 5: "DRV_FAULT", 6: "MISSING_INPUT", 8: "DC_BUS_OVER_VOLTAGE",
    9: "DC_BUS_UNDER_VOLTAGE", 10: "DC_BUS_OVER_CURRENT", 11: "DC_BUS_OVER_REGEN_CURRENT",
    12: "CURRENT_LIMIT_VIOLATION", 13: "MOTOR_OVER_TEMP", 14: "INVERTER_OVER_TEMP",
    15: "VELOCITY_LIMIT_VIOLATION", 16: "POSITION_LIMIT_VIOLATION", 24: "WATCHDOG_TIMER_EXPIRED",
    25: "ESTOP_REQUESTED", 26: "SPINOUT_DETECTED", 27: "BRAKE_RESISTOR_DISARMED",
    28: "THERMISTOR_DISCONNECTED", 30: "CALIBRATION_ERROR",
}  # fmt: skip
"""Names of the errors of an ODrive by bit (firmware 0.6)."""


Message = (
    Hello | Heartbeat | Enable | Stop | Home | Trigger | Begin | Knots | Commit
    | Capabilities | Acknowledgement | Pulse | Telemetry | DriveTrouble
)  # fmt: skip

TYPES: dict[int, type] = {
    0x01: Hello,
    0x02: Heartbeat,
    0x03: Enable,
    0x04: Stop,
    0x05: Home,
    0x06: Trigger,
    0x10: Begin,
    0x11: Knots,
    0x12: Commit,
    0x81: Capabilities,
    0x82: Acknowledgement,
    0x83: Pulse,
    0x84: Telemetry,
    0x85: DriveTrouble,
}
CODES = {kind: code for code, kind in TYPES.items()}


@dataclass(frozen=True)
class Packet:
    """A message and its sequence number, 0 to 65535."""

    sequence: int
    message: Message


def newer(sequence: int, than: int) -> bool:
    """Whether a sequence number is later than the number `than`. Numbers wrap around at 2^16."""
    return 0 < (sequence - than) % 2**16 < 2**15


def table_crc(knots: Iterable[Knot]) -> int:
    """Return the CRC-32 of a table's knots as they are encoded in the messages."""
    return zlib.crc32(b"".join(_pack_fields(knot) for knot in knots))


def pack(packet: Packet) -> bytes:
    """Return the bytes of a packet.

    Raises
    ------
    FrameError
        If a value does not fit its field.
    """
    message = packet.message
    try:
        head = HEADER.pack(CODES[type(message)], packet.sequence)
        body = _pack_fields(message)
        if isinstance(message, Knots):
            body += b"".join(_pack_fields(knot) for knot in message.knots)
    except (struct.error, OverflowError) as error:
        raise FrameError(f"{packet}: {error}") from None
    return head + body


def parse(packet: bytes) -> Packet:
    """Decode the bytes of a packet.

    Raises
    ------
    FrameError
        If the type is unknown, the length does not match the type, or a value is not allowed.
    """
    if len(packet) < HEADER.size:
        raise FrameError(f"packet has {len(packet)} bytes, allowed: {HEADER.size} or more")
    code, sequence = HEADER.unpack_from(packet)
    if code not in TYPES:
        raise FrameError(f"packet type is {code:#04x}, allowed: {', '.join(map(hex, TYPES))}")
    kind, body = TYPES[code], packet[HEADER.size :]
    if kind is not Knots:
        return Packet(sequence, _unpack_fields(kind, body))
    head, knot = LAYOUTS[Knots].size, LAYOUTS[Knot].size
    count, rest = divmod(len(body) - head, knot)
    if rest or not 1 <= count <= KNOTS_PER_MESSAGE:
        raise FrameError(f"Knots has {len(body)} bytes, allowed: {head} + {knot} * n, n = 1 to 4")
    starts = range(head, len(body), knot)
    table, first = LAYOUTS[Knots].unpack_from(body)
    knots = tuple(_unpack_fields(Knot, body[begin : begin + knot]) for begin in starts)
    return Packet(sequence, Knots(table, first, knots))


FIELDS = {kind: [f for f in fields(kind) if f.metadata] for kind in (*CODES, Knot)}
LAYOUTS = {
    kind: struct.Struct("<" + "".join(f.metadata["code"] * f.metadata["count"] for f in coded))
    for kind, coded in FIELDS.items()
}


def _pack_fields(item: Any) -> bytes:
    values: list[Any] = []
    for f in FIELDS[type(item)]:
        value = getattr(item, f.name)
        values += value if f.metadata["count"] > 1 else [value]
    return LAYOUTS[type(item)].pack(*values)


def _unpack_fields(kind: Any, body: bytes) -> Any:
    if len(body) != LAYOUTS[kind].size:
        raise FrameError(f"{kind.__name__} has {len(body)} bytes, allowed: {LAYOUTS[kind].size}")
    raw = LAYOUTS[kind].unpack(body)
    if not all(map(isfinite, raw)):
        raise FrameError(f"{kind.__name__} has a value that is not finite")
    values: list[Any] = []
    for f in FIELDS[kind]:
        count = f.metadata["count"]
        taken, raw = raw[:count], raw[count:]
        values.append(taken if count > 1 else _check_code(kind, f, taken[0]))
    return kind(*values)


def _check_code(kind: Any, f: Any, value: Any) -> Any:
    allowed = f.metadata["kind"]
    if allowed is None:
        return value
    if isinstance(allowed, tuple):
        if value in allowed:
            return value
    elif issubclass(allowed, IntFlag):
        if value & ~sum(allowed) == 0:
            return allowed(value)
    elif value in allowed.__members__.values():
        return allowed(value)
    raise FrameError(f"{kind.__name__}.{f.name} is {value}, allowed: {allowed}")
