"""The C firmware as a process in simulated time, on a line that damages, loses and delays bytes;
and the driver's serial transport on it."""

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from shaking import PERIOD, from_rest
from shaking import shaking as shaking_cycle

from plate_core import PlateError, load_rig
from plate_core.rig import Drive
from plate_core.serial_protocol import (
    Acknowledgement,
    Message,
    Reader,
    State,
    frame,
    parse,
)  # fmt: skip
from plate_driver.setpoints import MotorTable, prepare
from plate_driver.transports import (
    Condition,
    Measured,
    Order,
    SerialTransport,
)  # fmt: skip
from plate_sim.device import DeviceLimits, c_header

FIRMWARE = Path(__file__).resolve().parents[1] / "firmware"
STRICT = [
    "-std=c99", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion",
    "-Wfloat-conversion", "-Werror",
]  # fmt: skip
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

RIG = load_rig()
TICK_S = 1e-3


def compiled(folder: Path, *patterns: str) -> Path:
    """Compile files of firmware/ for this machine, with headers of a folder. Return the program."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler `cc` on this machine: the firmware is not tested")
    program = folder / "plate"
    sources = sorted(str(path) for pattern in patterns for path in FIRMWARE.glob(pattern))
    for extra in (SANITIZED, []):  # not every compiler has sanitizers
        command = [compiler, *STRICT, *extra, f"-I{folder}", "-o", str(program), *sources, "-lm"]
        built = subprocess.run(command, capture_output=True, text=True, timeout=120)
        if built.returncode == 0:
            return program
    pytest.fail(built.stderr)


def compiled_leader(folder: Path, drives: Sequence[Drive], program: str) -> Path:
    """Compile the firmware that leads drives over the bus of this machine."""
    header = c_header(DeviceLimits.of_rig(RIG), "rig.yaml", drives)
    (folder / "limits_rig.h").write_text(header, encoding="utf-8")
    sources = ("*.c", "drives/axes.c", f"drives/{program}.c", "host/host.c", "host/can.c")
    return compiled(folder, *sources)


def shaking(amplitude: float, turns: int = 2) -> MotorTable:
    """Return the table of a cycle that starts at rest, with an amplitude [m]."""
    return prepare(RIG, shaking_cycle(amplitude, PERIOD, turns), 1)[0]


def long_table() -> MotorTable:
    """Return a table of 64 pieces in 0.2 s."""
    wave = 5e-4 * np.sin(np.pi * np.arange(64) / 64) ** 4
    return prepare(RIG, from_rest(0.2, np.outer(wave, [1, 1, 0])), 1)[0]


@dataclass
class SimulatedFirmware:
    """The firmware as a process, its time, and the line to it with all its possible faults."""

    program: Path
    options: tuple[str, ...] = ()  # thermal time constant of the motors [s], continuous force [N]
    damage: float = 0.0  # fraction of bytes that are changed
    loss: float = 0.0  # fraction of bytes that are lost
    delay: float = 0.0  # [s], each way
    fast: float = 0.0  # fraction by which its clock, and so the plate, is faster than the host's
    cut: bool = False
    withholds: bool = False  # acknowledgements
    now: float = 0.0
    to_device: list[tuple[float, bytes]] = field(default_factory=list)
    to_host: list[tuple[float, bytes]] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    setpoints: list[list[float]] = field(default_factory=list)
    wire: list[tuple[float, bytes]] = field(default_factory=list)  # bytes from the host
    current: bool = False
    stop: int = 0  # number of the last stop, counted by the device

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(4)
        self.own = 0.5  # number of ticks of the device so far
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [self.program, *self.options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.started = self.now

    def end(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.read()
        self.process.stdout.close()
        assert self.process.wait(10) == 0

    def reset(self) -> None:
        self.end()
        self.start()

    def spoilt(self, data: bytes) -> bytes:
        if not (self.damage or self.loss):
            return data
        noise = self.rng.random((2, len(data)))
        changed = (b ^ int(self.rng.integers(1, 256)) if n < self.damage else b
                   for b, n in zip(data, noise[0], strict=True))  # fmt: skip
        kept = zip(changed, noise[1], strict=True)
        return bytes(b for b, n in kept if n >= self.loss)

    def arrival(self, way: list[tuple[float, bytes]]) -> float:
        """Return the arrival time of bytes that are sent now. A line keeps their order, even if its
        delay changes."""
        return max([self.now + self.delay, *(at for at, _ in way[-1:])])

    def tick(self, count: int = 1) -> None:
        """Advance the device by a number of ticks, without the host."""
        assert self.process.stdin is not None
        times = []
        for _ in range(count):
            self.now += TICK_S
            times.append(self.now)
            arrived = b"".join(d for at, d in self.to_device if at <= self.now)
            self.to_device = [item for item in self.to_device if item[0] > self.now]
            before, self.own = self.own, self.own + 1 + self.fast
            ticks = int(self.own) - int(before)
            order = (f"rx {arrived.hex()}\n" if arrived else "") + f"run {1000 * ticks}\n"
            self.process.stdin.write(order)
        self.process.stdin.flush()
        for now in times:
            self.now = now
            self.hear()

    def hear(self) -> None:
        """Read the output of the device for one tick."""
        assert self.process.stdout is not None
        for line in iter(self.process.stdout.readline, ""):
            kind, *words = line.split()
            if kind == "tx" and not self.cut:
                data = self.spoilt(self.let_through(bytes.fromhex(words[0])))
                self.to_host.append((self.arrival(self.to_host), data))
            elif kind == "at":
                self.setpoints.append([self.now, *map(float, words[1:])])
            elif kind == "drive":
                self.current = bool(int(words[1]))
            elif kind == "state":
                self.states.append(State(int(words[0])))
                self.stop = int(words[3])
                return
        pytest.fail("the firmware has ended")

    def let_through(self, data: bytes) -> bytes:
        if not self.withholds:
            return data
        packets = Reader().fed(data)[1]
        reported = [p for p in packets if not isinstance(parse(p).message, Acknowledgement)]
        return b"".join(map(frame, reported))

    def order(self, line: str) -> None:
        """Send the board an order that does not come over the line."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")

    def messages(self, since: float = 0.0) -> list[Message]:
        """Return the messages that the host has written, before any fault of the line."""
        data = b"".join(data for at, data in self.wire if at >= since)
        return [parse(packet).message for packet in Reader().fed(data)[1]]

    # The port

    def read(self, size: int) -> bytes:
        if self.cut:
            raise OSError("device reports readiness to read but returned no data")
        arrived = b"".join(d for at, d in self.to_host if at <= self.now)
        self.to_host = [item for item in self.to_host if item[0] > self.now]
        return arrived

    def write(self, data: bytes) -> int:
        self.wire.append((self.now, data))
        self.to_device.append((self.arrival(self.to_device), self.spoilt(data)))
        return len(data)

    def close(self) -> None:
        self.to_host = []  # written bytes still arrive, although the port is closed

    def opened(self) -> "SimulatedFirmware":
        if self.cut:
            raise PlateError("port is '/dev/plate', allowed: a serial port that opens")
        return self

    # Played setpoints

    def check_limits(self) -> None:
        rows = np.array(self.setpoints).reshape(-1, 13)
        assert np.max(np.abs(rows[:, 1:5]), initial=0.0) <= RIG.limits.stroke_m
        assert np.max(np.abs(rows[:, 5:9]), initial=0.0) <= RIG.limits.speed

    def check_smooth(self) -> None:
        """Check that position and speed do not jump between ticks, with or without current."""
        rows = np.array(self.setpoints)
        dt = np.diff(rows[:, 0])
        near = dt < 1.5 * TICK_S
        q, v, a = rows[:, 1:5], rows[:, 5:9], rows[:, 9:13]
        steps = TICK_S * (v[1:] + v[:-1]) / 2 - TICK_S**2 * np.diff(a, axis=0) / 12
        np.testing.assert_allclose(np.diff(q, axis=0)[near], steps[near], atol=5e-8)


REPEATS = 5


def link(firmware: SimulatedFirmware, streams: bool = False, seed: int = 7) -> SerialTransport:
    transport = SerialTransport(firmware.opened, lambda: firmware.now, seed, streams)
    transport.open()
    return transport


def pass_time(
    firmware: SimulatedFirmware, transport: SerialTransport, seconds: float
) -> list[Measured]:
    """Advance the time. The host polls every 5 ms."""
    measured = []
    ticks, done = round(seconds / TICK_S), 0
    for look in range(0, ticks, 5):
        firmware.tick(look + 1 - done)
        done = look + 1
        measured += transport.poll()
    firmware.tick(ticks - done)
    return measured


def settled(firmware: SimulatedFirmware, transport: SerialTransport, order: Order) -> Order:
    """Advance the time until an order is settled, or its maximum time is over."""
    end = firmware.now + order.max_s
    while not order.completed and firmware.now < end:
        pass_time(firmware, transport, 0.005)
    return order


def enabled(firmware: SimulatedFirmware, seed: int = 7) -> SerialTransport:
    """Return a transport with enabled motors."""
    transport = link(firmware, seed=seed)
    while transport.report().condition is Condition.GONE and firmware.now < 10:
        pass_time(firmware, transport, 0.1)
    order = settled(firmware, transport, transport.enable())
    assert order.done, order.failure
    return transport


def play(
    firmware: SimulatedFirmware, transport: SerialTransport, seconds: float, size: float = 0.002
) -> set[int]:
    """Send a table in every period, and return the numbers of the played tables."""
    tables: set[int] = set()
    for n in range(round(seconds / PERIOD)):
        if transport.report().condition is Condition.READY:
            transport.send(shaking(size if n % 2 else size / 2), REPEATS)
        tables |= {m.table for m in pass_time(firmware, transport, PERIOD)}
    return tables - {0}
