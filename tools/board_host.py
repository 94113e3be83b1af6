"""A test host for the emulated board, written on top of `plate_core.serial_protocol`.

`Host` sends commands and tables over an emulated serial line of limited baud rate. The function
`upload_while_playing` measures the length of the board's ticks with a valid table, and
`attack_board` with hostile packets.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from emulated_board import RING_BYTES, EmulatedBoard, median_ticks

from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Acknowledgement,
    Begin,
    Commit,
    Enable,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    Message,
    Packet,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    pack,
    parse,
    table_crc,
    unframe,
)

TICK_INSTRUCTIONS = 125_000
"""Number of instructions in a tick of 1 ms, at 8 ns per instruction."""

LINE_BYTES = 92
"""Number of bytes that a line of 921,600 baud carries per tick."""

FLOOD_BYTES = 3500
"""Size of one flood [bytes]. A flood nearly fills the board's receive ring (`RING_BYTES`)."""

BEAT_TICKS = 25
"""Time between heartbeats while nothing else is sent [ticks]."""

WAIT_TICKS = 12_000
"""Maximum wait for a condition [ticks]. This wait is longer than the time for which a table may be
repeated."""

FEW_PIECES = 24
"""Minimum number of polynomial pieces that can represent the motion of `wave_table`. With fewer
pieces, `upload_while_playing` uses a tiny amplitude."""

PLAYED_TICKS = 300
"""Number of ticks after the start of a new table in which the tick lengths are measured."""

HOSTS = itertools.count(1)
"""Counter of `Host` objects. Each host gets separate sequence numbers."""

STROKE_M, SPEED, ACCEL = 0.010, 1.0, 100.0
"""Limits of config/rig.yaml: stroke [m], speed [m/s], acceleration [m/s2]."""


@dataclass(frozen=True)
class Ticks:
    """Tick lengths in a part of a measurement, and maximum values since the board's reset.

    Attributes
    ----------
    median, worst
        Length of the ticks in this part [instructions].
    step_m : float
        Maximum step between successive setpoints since the reset [m].
    most : tuple of float
        Maximum travel [m], speed [m/s] and acceleration [m/s2] since the reset.
    late : int
        Number of ticks since the reset that ended after the next tick was due.
    """

    median: float
    worst: int
    step_m: float
    most: tuple[float, float, float]
    late: int


class Host:
    """Host that communicates with an emulated board. Times are counted in ticks of the board.

    Parameters
    ----------
    board : EmulatedBoard
    pace : int
        Number of bytes that the line carries to the board per tick; 92 for 921,600 baud.
    """

    def __init__(self, board: EmulatedBoard, pace: int = LINE_BYTES) -> None:
        self.board, self._pace = board, pace
        self._reader = Reader()
        self.waiting = b""
        # Each host object uses other sequence numbers. Therefore late replies to an earlier host of
        # the same board do not match.
        self._sequence = self._session = 1000 * next(HOSTS)
        self._ticks = self._beat_at = 0
        self.telemetry: list[Telemetry] = []
        self.answers: dict[int, Status] = {}
        self.tick()

    @property
    def refused(self) -> int:
        """Number of damaged frames received from the board."""
        return self._reader.refused

    def tick(self) -> None:
        """Simulate one tick: the line carries waiting bytes to the board, `pace` at most, and the
        board's packets are received."""
        size = min(self._pace, self.board.free_bytes()) if self.waiting else 0
        now, self.waiting = self.waiting[:size], self.waiting[size:]
        self._ticks += 1
        self._reader, packets = self._reader.fed(self.board.tick(now))
        for message in (parse(packet).message for packet in packets):
            if isinstance(message, Telemetry):
                self.telemetry.append(message)
            elif isinstance(message, Acknowledgement):
                self.answers[message.sequence] = message.status
        if not self.waiting and self._ticks >= self._beat_at:
            self.send(b"")

    def send(self, frames: bytes) -> None:
        """Queue whole frames for the line, with a heartbeat after them."""
        self.waiting += frames + frame(pack(Packet(0, Heartbeat(1))))
        self._beat_at = self._ticks + BEAT_TICKS

    def sent_all(self) -> None:
        """Simulate until the board has received and read all queued bytes."""
        while self.waiting:
            self.tick()
        self.until(lambda: self.board.free_bytes() == RING_BYTES)

    def numbered(self, message: Message) -> bytes:
        """Return the frame that carries a message with the next sequence number."""
        self._sequence = (self._sequence + 1) % 2**16
        return frame(pack(Packet(self._sequence, message)))

    def framed(self, table: int, knots: tuple[Knot, ...], splice_ticks: int = 0) -> Iterator[bytes]:
        """Yield the frames of a table, except its Commit."""
        yield self.numbered(Begin(table, len(knots), table_crc(knots), splice_ticks))
        for first in range(0, len(knots), 4):
            yield self.numbered(Knots(table, first, knots[first : first + 4]))

    def until(self, reached: Callable[[], object]) -> None:
        """Simulate until a condition is true.

        Raises
        ------
        TimeoutError
            If the condition is not true within `WAIT_TICKS`.
        """
        end = self._ticks + WAIT_TICKS
        while not reached():
            if self._ticks >= end:
                raise TimeoutError(
                    f"not reached in {WAIT_TICKS} ticks, the board's last telemetry: "
                    f"{self.telemetry[-1:]}"
                )
            self.tick()

    def rest(self, ticks: int) -> None:
        """Simulate a number of ticks."""
        for _ in range(ticks):
            self.tick()

    def now(self) -> Telemetry:
        """Simulate until the next telemetry arrives, and return it."""
        count = len(self.telemetry)
        self.until(lambda: len(self.telemetry) > count)
        return self.telemetry[-1]

    def ask(self, message: Message) -> Status:
        """Send a command, and return the status in the board's acknowledgement."""
        data, sequence = self.numbered(message), self._sequence
        self.answers.pop(sequence, None)
        self.send(data)
        self.until(lambda: sequence in self.answers)
        return self.answers[sequence]

    def begin(self) -> None:
        """Send a Hello with a new session number."""
        self._session += 1
        self.send(b"\0" + self.numbered(Hello(VERSION, self._session)))

    def enable(self) -> Status:
        """Enable after the current stop, as an operator does, and wait until homing has ended."""
        self.until(lambda: self.now().state is not State.BRAKING)
        status = self.ask(Enable(self.now().stop))
        self.until(lambda: self.now().state is not State.HOMING)
        return status

    def upload(
        self, table: int, knots: tuple[Knot, ...], repeats: int = 1, splice_ticks: int = 0
    ) -> Status:
        """Send a whole table. Return the status of the table's Commit."""
        self.send(b"".join(self.framed(table, knots, splice_ticks)))
        return self.ask(Commit(table, repeats))

    def again(self) -> bytes:
        """Return the frame of another Hello of the current session."""
        return frame(pack(Packet(self._sequence, Hello(VERSION, self._session))))

    def ticks_since(self, before: np.record, first: int) -> Ticks:
        """Return the tick lengths since an earlier record. `first` is the index of the first
        telemetry that is used."""
        record = self.board.record()
        worst = max(m.load for m in self.telemetry[first:]) * TICK_INSTRUCTIONS
        seen = float(record.step_m), tuple(record.most.tolist()), int(record.late)
        return Ticks(median_ticks(record, before), round(worst), *seen)


def wave_table(
    pieces: int, fraction: float = 0.98, period_s: float = 1.2, jitter: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[Knot, ...]:  # fmt: skip
    """Return a table whose motion reaches the fraction `fraction` of all three limits: stroke,
    speed and acceleration.

    The motion is q = s(t) sin(w t + phase) with the envelope s. With w = 100 rad/s a sine reaches
    all three limits of config/rig.yaml. The convex hulls of the spline exceed the limits, although
    the spline does not. Therefore the board's check must bisect the pieces.

    Parameters
    ----------
    jitter : float
        Width of the range of random shifts of the knots in time, in lengths of a piece.
    """
    rate = ACCEL / SPEED
    t = np.linspace(0, period_s, pieces + 1)
    if rng is not None:
        t[1:-1] += jitter * period_s / pieces * rng.uniform(-0.5, 0.5, pieces - 1)
    u, slope = np.minimum(t, period_s - t) / (period_s / 3), 3 / period_s
    signs = np.where(t < period_s / 2, slope, -slope)
    moving = u < 1
    u = np.minimum(u, 1)
    s = u**3 * (10 - u * (15 - 6 * u))
    ds = 30 * u**2 * (1 - u) ** 2 * signs * moving
    dds = 60 * u * (1 - u) * (1 - 2 * u) * slope**2 * moving
    s, ds, dds = (x[:, None] for x in (s, ds, dds))
    angle = rate * t[:, None] + np.array([0.0, 0.5, 1.0, 1.5])
    q, v, a = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    rows = (s * q, ds * q + s * v, dds * q + 2 * ds * v + s * a)
    ticks = np.round(t * 1e8).astype(int)
    states = [(fraction * STROKE_M * row).astype(np.float32) for row in rows]
    return tuple(
        Knot(int(k), *(tuple(map(float, row)) for row in state))
        for k, *state in zip(ticks, *states, strict=True)
    )


def upload_while_playing(host: Host, pieces: int, table: int) -> tuple[Status, Ticks]:
    """Upload a second table of `pieces` pieces while a table plays, and let it play for
    `PLAYED_TICKS`. Return the status of the table's Commit, and the tick lengths during this
    time."""
    if host.now().state is State.READY:
        host.upload(table, wave_table(48, 0.9), 8)
        host.until(lambda: host.now().state is State.PLAYING)
    before, first = host.board.record(), len(host.telemetry)
    size = 0.9 if pieces >= FEW_PIECES else 0.002
    status = host.upload(table + 1, wave_table(pieces, size), 1)
    if status is Status.DONE:
        host.until(lambda: host.now().table == table + 1)
        host.rest(PLAYED_TICKS)
    return status, host.ticks_since(before, first)


@dataclass
class Attack:
    """Random hostile packets. All packets have a valid CRC."""

    rng: np.random.Generator
    host: Host
    kinds: dict[str, int] = field(default_factory=dict)
    table: int = 100

    def batch(self) -> bytes:
        """Return framed packets of one randomly chosen kind."""
        kinds = (
            self.floods, self.nonsense, self.mutated, self.near, self.near, self.repeated,
            self.streams, self.wild,
        )  # fmt: skip
        kind = kinds[int(self.rng.integers(len(kinds)))]
        packets = list(kind())
        self.kinds[kind.__name__] = self.kinds.get(kind.__name__, 0) + len(packets)
        return b"".join(packets)

    def another(self) -> int:
        """Return a table number that was not used recently."""
        self.table = self.table % 60_000 + 1
        return self.table

    def floods(self) -> Iterator[bytes]:
        """Yield copies of one of the smallest frames. The copies nearly fill the board's receive
        ring."""
        smallest = [frame(bytes([kind])) for kind in (1, 2, 3, 0x10, 0x11, 0x12, 0x55)]
        smallest += [frame(pack(Packet(0, Heartbeat(0)))), self.host.numbered(Home())]
        chosen = smallest[int(self.rng.integers(len(smallest)))]
        for _ in range(FLOOD_BYTES // len(chosen)):
            yield chosen

    def nonsense(self) -> Iterator[bytes]:
        """Yield packets of random type, length and content."""
        for _ in range(20):
            size = int(self.rng.integers(240))
            yield frame(bytes([int(self.rng.integers(0, 0x14))]) + self.rng.bytes(size))

    def mutated(self) -> Iterator[bytes]:
        """Yield the frames of a table, with a random byte changed in about half of them."""
        for framed in self.host.framed(self.another(), wave_table(24)):
            packet = bytearray(unframe(framed[:-1]))
            if self.rng.random() < 0.5:
                packet[int(self.rng.integers(3, len(packet)))] = int(self.rng.integers(256))
            yield frame(bytes(packet))
        yield self.host.numbered(Commit(self.table, int(self.rng.integers(1, 4))))

    def near(self) -> Iterator[bytes]:
        """Yield the frames of a table whose motion just keeps or slightly exceeds the limits."""
        pieces = int(self.rng.choice([30, 48, 60, 96, 150, 300, 511]))
        fraction = float(self.rng.choice([0.99, 1.0, 1.0015, 1.0019, 1.003]))
        knots = wave_table(pieces, fraction, jitter=0.3, rng=self.rng)
        yield from self.host.framed(self.another(), knots)
        yield self.host.numbered(Commit(self.table, int(self.rng.integers(1, 8))))

    def repeated(self) -> Iterator[bytes]:
        """Yield the frames of Hello, Begin and Commit, each repeatedly."""
        for _ in range(30):
            yield self.host.again()
            yield self.host.numbered(Begin(self.another(), 512, 1))
            yield self.host.numbered(Commit(self.table, 1))

    def streams(self) -> Iterator[bytes]:
        """Yield the frames of a stream near the limits. The stream has more knots than the board
        can store, and a Commit in the middle."""
        table, knots = self.another(), wave_table(200, 1.0015)
        yield self.host.numbered(Begin(table, 0, 0))
        for first in range(0, 200, 4):
            message = Knots(table, first, knots[first : first + 4])
            yield self.host.numbered(message)
            if first == 100:
                yield self.host.numbered(Commit(table, 1))

    def wild(self) -> Iterator[bytes]:
        """Yield the frames of a table with random finite numbers of any size. The duration of the
        table is between 0 s and some minutes."""
        count = int(self.rng.integers(2, 40))
        size = 10.0 ** self.rng.integers(-9, 9)
        ticks = np.cumsum(self.rng.integers(0, 10 ** int(self.rng.integers(1, 8)), count))
        rows = (size * self.rng.standard_normal((count, 3, 4))).astype(np.float32)
        knots = tuple(
            Knot(int(k) % 2**32, *(tuple(map(float, x)) for x in row))
            for k, row in zip(ticks, rows, strict=True)
        )
        if self.rng.random() < 0.7:
            rest = (0.0,) * 4
            last = replace(knots[-1], position=rest, velocity=rest, acceleration=rest)
            knots = (Knot(0, rest, rest, rest), *knots[1:-1], last)
        yield from self.host.framed(self.another(), knots)
        yield self.host.numbered(Commit(self.table, 1))
        if self.rng.random() < 0.1:
            yield self.host.numbered(Stop(int(self.rng.integers(2))))


def attack_board(host: Host, packets: int, seed: int) -> tuple[Attack, Ticks]:
    """Send at least `packets` hostile packets to a board. Between batches, make the board play a
    valid table if it is at rest. Return the attack, and the tick lengths during the attack."""
    attack = Attack(np.random.default_rng(seed), host)
    before, first = host.board.record(), len(host.telemetry)
    while sum(attack.kinds.values()) < packets:
        if host.now().state not in (State.READY, State.PLAYING):
            host.begin()
            host.enable()
        if host.now().state is State.READY:
            host.upload(attack.another(), wave_table(48, 1.0), 8)
        host.send(attack.batch())
        host.sent_all()
    return attack, host.ticks_since(before, first)
