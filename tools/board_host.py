"""A host by hand for the emulated board: honest, in a hurry, or hostile."""

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
"""Of a tick's period, 1 ms at 8 ns an instruction."""

LINE_BYTES = 92
"""Of a line of 921,600 baud in a tick."""

FLOOD_BYTES = 3500
"""Of one flood: as many as the board's ring holds, or nearly."""

BEAT_TICKS = 25
"""Between heartbeats, if nothing else is sent."""

WAIT_TICKS = 12_000
"""Longest wait for anything: longer than a table may be played again."""

FEW_PIECES = 24
"""Fewer cannot follow the wave: a table of them only twitches."""

PLAYED_TICKS = 300
"""Of a new table that are measured."""

HOSTS = itertools.count(1)
"""Hosts so far."""

STROKE_M, SPEED, ACCEL = 0.010, 1.0, 100.0
"""Of config/rig.yaml."""


@dataclass(frozen=True)
class Ticks:
    """What ticks took in a part of a measurement [instructions]; setpoints since the reset: longest
    step [m], most of travel [m], speed [m/s] and acceleration [m/s2]; ticks that ended too late."""

    median: float
    worst: int
    step_m: float
    most: tuple[float, float, float]
    late: int


class Host:
    """Speaks to an emulated board; time is the board's, in ticks.

    Parameters
    ----------
    board : EmulatedBoard
    pace : int
        Bytes that the line brings in a tick: 92 are 921,600 baud.
    """

    def __init__(self, board: EmulatedBoard, pace: int = LINE_BYTES) -> None:
        self.board, self._pace = board, pace
        self._reader = Reader()
        self.waiting = b""
        # Numbers of its own: what the line delivers late from a host before this one must not fit.
        self._sequence = self._session = 1000 * next(HOSTS)
        self._ticks = self._beat_at = 0
        self.telemetry: list[Telemetry] = []
        self.answers: dict[int, Status] = {}
        self.tick()

    @property
    def refused(self) -> int:
        """Damaged frames from the board."""
        return self._reader.refused

    def tick(self) -> None:
        """Let a tick pass: the line brings what waits, at its pace, and takes what is said."""
        size = min(self._pace, self.board.room()) if self.waiting else 0
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
        """Have the line bring whole frames, and a heartbeat after them."""
        self.waiting += frames + frame(pack(Packet(0, Heartbeat(1))))
        self._beat_at = self._ticks + BEAT_TICKS

    def sent_all(self) -> None:
        """Let time pass until all has been brought and read."""
        while self.waiting:
            self.tick()
        self.until(lambda: self.board.room() == RING_BYTES)

    def numbered(self, message: Message) -> bytes:
        """Return the frame that carries a message with the next sequence number."""
        self._sequence = (self._sequence + 1) % 2**16
        return frame(pack(Packet(self._sequence, message)))

    def framed(self, table: int, knots: tuple[Knot, ...], splice_ticks: int = 0) -> Iterator[bytes]:
        """Yield the frames of a table but for its Commit."""
        yield self.numbered(Begin(table, len(knots), table_crc(knots), splice_ticks))
        for first in range(0, len(knots), 4):
            yield self.numbered(Knots(table, first, knots[first : first + 4]))

    def until(self, reached: Callable[[], object]) -> None:
        """Let time pass until something is so."""
        end = self._ticks + WAIT_TICKS
        while not reached():
            if self._ticks >= end:
                raise TimeoutError(
                    f"not in {WAIT_TICKS} ticks: the board tells {self.telemetry[-1:]}"
                )
            self.tick()

    def rest(self, ticks: int) -> None:
        """Let time pass at the board."""
        for _ in range(ticks):
            self.tick()

    def now(self) -> Telemetry:
        """Return the next telemetry that comes."""
        count = len(self.telemetry)
        self.until(lambda: len(self.telemetry) > count)
        return self.telemetry[-1]

    def ask(self, message: Message) -> Status:
        """Send a command and return its answer."""
        data, sequence = self.numbered(message), self._sequence
        self.answers.pop(sequence, None)
        self.send(data)
        self.until(lambda: sequence in self.answers)
        return self.answers[sequence]

    def begin(self) -> None:
        """Say hello with a new session."""
        self._session += 1
        self.send(b"\0" + self.numbered(Hello(VERSION, self._session)))

    def enable(self) -> Status:
        """Clear the present stop, as a person would have it, and wait until home is held."""
        self.until(lambda: self.now().state is not State.BRAKING)
        status = self.ask(Enable(self.now().stop))
        self.until(lambda: self.now().state is not State.HOMING)
        return status

    def upload(
        self, table: int, knots: tuple[Knot, ...], repeats: int = 1, splice_ticks: int = 0
    ) -> Status:
        """Send a whole table; returns the answer to its Commit."""
        self.send(b"".join(self.framed(table, knots, splice_ticks)))
        return self.ask(Commit(table, repeats))

    def again(self) -> bytes:
        """Return the present Hello once more."""
        return frame(pack(Packet(self._sequence, Hello(VERSION, self._session))))

    def ticks_since(self, before: np.record, first: int) -> Ticks:
        """Sum up the ticks since an earlier record and number of telemetries."""
        record = self.board.record()
        worst = max(m.load for m in self.telemetry[first:]) * TICK_INSTRUCTIONS
        seen = float(record.step_m), tuple(record.most.tolist()), int(record.late)
        return Ticks(median_ticks(record, before), round(worst), *seen)


def wave(
    pieces: int, share: float = 0.98, period_s: float = 1.2, jitter: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[Knot, ...]:  # fmt: skip
    """Return a table that swings up to `share` of stroke, speed and acceleration at once.

    At 100 rad/s all three limits of config/rig.yaml are met together. Between knots the hulls of
    such a spline pass the limits where the spline does not, so that looking at it takes halvings.

    Parameters
    ----------
    jitter : float
        Knots are moved in time by up to this share of a piece.
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
    states = [(share * STROKE_M * row).astype(np.float32) for row in rows]
    return tuple(
        Knot(int(k), *(tuple(map(float, row)) for row in at))
        for k, *at in zip(ticks, *states, strict=True)
    )


def committed(host: Host, pieces: int, table: int) -> tuple[Status, Ticks]:
    """While a table plays send another one of so many pieces, commit it, and see it play."""
    if host.now().state is State.READY:
        host.upload(table, wave(48, 0.9), 8)
        host.until(lambda: host.now().state is State.PLAYING)
    before, first = host.board.record(), len(host.telemetry)
    size = 0.9 if pieces >= FEW_PIECES else 0.002
    status = host.upload(table + 1, wave(pieces, size), 1)
    if status is Status.DONE:
        host.until(lambda: host.now().table == table + 1)
        host.rest(PLAYED_TICKS)
    return status, host.ticks_since(before, first)


@dataclass
class Attack:
    """Hostile packets, all with the right CRC, from a seed."""

    rng: np.random.Generator
    host: Host
    kinds: dict[str, int] = field(default_factory=dict)
    table: int = 100

    def batch(self) -> bytes:
        """Return some packets of one kind, all framed."""
        kinds = (
            self.floods, self.nonsense, self.mutated, self.near, self.near, self.repeated,
            self.streams, self.wild,
        )  # fmt: skip
        kind = kinds[int(self.rng.integers(len(kinds)))]
        packets = list(kind())
        self.kinds[kind.__name__] = self.kinds.get(kind.__name__, 0) + len(packets)
        return b"".join(packets)

    def another(self) -> int:
        """Return a number for a table that was not used of late."""
        self.table = self.table % 60_000 + 1
        return self.table

    def floods(self) -> Iterator[bytes]:
        """The smallest frames, as many as the ring takes."""
        smallest = [frame(bytes([kind])) for kind in (1, 2, 3, 0x10, 0x11, 0x12, 0x55)]
        smallest += [frame(pack(Packet(0, Heartbeat(0)))), self.host.numbered(Home())]
        chosen = smallest[int(self.rng.integers(len(smallest)))]
        for _ in range(FLOOD_BYTES // len(chosen)):
            yield chosen

    def nonsense(self) -> Iterator[bytes]:
        """Any type, any bytes."""
        for _ in range(20):
            size = int(self.rng.integers(240))
            yield frame(bytes([int(self.rng.integers(0, 0x14))]) + self.rng.bytes(size))

    def mutated(self) -> Iterator[bytes]:
        """A table in which some bytes are others."""
        for framed in self.host.framed(self.another(), wave(24)):
            packet = bytearray(unframe(framed[:-1]))
            if self.rng.random() < 0.5:
                packet[int(self.rng.integers(3, len(packet)))] = int(self.rng.integers(256))
            yield frame(bytes(packet))
        yield self.host.numbered(Commit(self.table, int(self.rng.integers(1, 4))))

    def near(self) -> Iterator[bytes]:
        """A table that goes to the limits, and a little beyond, in large and small pieces."""
        pieces = int(self.rng.choice([30, 48, 60, 96, 150, 300, 511]))
        share = float(self.rng.choice([0.99, 1.0, 1.0015, 1.0019, 1.003]))
        knots = wave(pieces, share, jitter=0.3, rng=self.rng)
        yield from self.host.framed(self.another(), knots)
        yield self.host.numbered(Commit(self.table, int(self.rng.integers(1, 8))))

    def repeated(self) -> Iterator[bytes]:
        """The same again and again: Hello, Begin, Commit."""
        for _ in range(30):
            yield self.host.again()
            yield self.host.numbered(Begin(self.another(), 512, 1))
            yield self.host.numbered(Commit(self.table, 1))

    def streams(self) -> Iterator[bytes]:
        """A stream that goes to the limits, begun, filled beyond its room and committed."""
        table, knots = self.another(), wave(200, 1.0015)
        yield self.host.numbered(Begin(table, 0, 0))
        for first in range(0, 200, 4):
            message = Knots(table, first, knots[first : first + 4])
            yield self.host.numbered(message)
            if first == 100:
                yield self.host.numbered(Commit(table, 1))

    def wild(self) -> Iterator[bytes]:
        """Tables of any finite numbers, of periods of nothing and of minutes."""
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


def attacked(host: Host, packets: int, seed: int) -> tuple[Attack, Ticks]:
    """Send so many hostile packets to a board that plays whenever it can."""
    attack = Attack(np.random.default_rng(seed), host)
    before, first = host.board.record(), len(host.telemetry)
    while sum(attack.kinds.values()) < packets:
        if host.now().state not in (State.READY, State.PLAYING):
            host.begin()
            host.enable()
        if host.now().state is State.READY:
            host.upload(attack.another(), wave(48, 1.0), 8)
        host.send(attack.batch())
        host.sent_all()
    return attack, host.ticks_since(before, first)
