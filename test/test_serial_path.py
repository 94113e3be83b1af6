"""The driver's serial transport against the C firmware, byte by byte, in simulated time."""

import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BPoly

from plate_core import CycleError, PlateCycle, PlateError, load_rig
from plate_core.serial_protocol import Fault, State
from plate_driver.motor_table import MotorTable, prepare
from plate_driver.serial_transport import Measured, SerialTransport

RIG = load_rig()
PERIOD = 0.1
TICK_S = 1e-3


def shaking(amplitude: float, turns: int = 2) -> MotorTable:
    """Table of a cycle that starts at rest; amplitude [m]."""
    t = np.arange(48) * PERIOD / 48
    wave = np.sin(np.pi * t / PERIOD) ** 4
    phase = 2 * np.pi * turns * t / PERIOD
    pose = np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    cycle = PlateCycle.from_samples(PERIOD, amplitude * pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0
    return prepare(RIG, PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel), 1)[0]


@dataclass
class Desk:
    """The firmware as a process, its time, and the line to it with all that may go wrong."""

    program: Path
    damage: float = 0.0  # share of bytes that change
    loss: float = 0.0  # share of bytes that vanish
    delay: float = 0.0  # [s], each way
    cut: bool = False
    now: float = 0.0
    to_device: list[tuple[float, bytes]] = field(default_factory=list)
    to_host: list[tuple[float, bytes]] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    setpoints: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(4)
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [self.program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
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
        noise = self.rng.random((2, len(data)))
        changed = (b ^ int(self.rng.integers(1, 256)) if n < self.damage else b
                   for b, n in zip(data, noise[0], strict=True))  # fmt: skip
        kept = zip(changed, noise[1], strict=True)
        return bytes(b for b, n in kept if n >= self.loss)

    def tick(self) -> None:
        """Let one tick of the device pass."""
        self.now += TICK_S
        arrived = b"".join(d for at, d in self.to_device if at <= self.now)
        self.to_device = [item for item in self.to_device if item[0] > self.now]
        order = (f"rx {arrived.hex()}\n" if arrived else "") + "run 1000\n"
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(order)
        self.process.stdin.flush()
        for line in iter(self.process.stdout.readline, ""):
            kind, *words = line.split()
            if kind == "tx" and not self.cut:
                data = self.spoilt(bytes.fromhex(words[0]))
                self.to_host.append((self.now + self.delay, data))
            elif kind == "at":
                self.setpoints.append([self.now, *map(float, words[1:])])
            elif kind == "state":
                self.states.append(State(int(words[0])))
                return
        pytest.fail("the firmware has ended")

    # The port

    def read(self, size: int) -> bytes:
        if self.cut:
            raise OSError("device reports readiness to read but returned no data")
        arrived = b"".join(d for at, d in self.to_host if at <= self.now)
        self.to_host = [item for item in self.to_host if item[0] > self.now]
        return arrived

    def write(self, data: bytes) -> int:
        self.to_device.append((self.now + self.delay, self.spoilt(data)))
        return len(data)

    def close(self) -> None:
        self.to_host, self.to_device = [], []

    def opened(self) -> "Desk":
        if self.cut:
            raise PlateError("port is '/dev/plate', allowed: a serial port that opens")
        return self

    # What was played

    def check_limits(self) -> None:
        rows = np.array(self.setpoints)
        assert np.max(np.abs(rows[:, 1:5])) <= RIG.limits.stroke_m
        assert np.max(np.abs(rows[:, 5:9])) <= RIG.limits.speed

    def check_smooth(self) -> None:
        """No jump of position or speed from tick to tick, current on or not."""
        rows = np.array(self.setpoints)
        dt = np.diff(rows[:, 0])
        near = dt < 1.5 * TICK_S
        q, v, a = rows[:, 1:5], rows[:, 5:9], rows[:, 9:13]
        steps = TICK_S * (v[1:] + v[:-1]) / 2 - TICK_S**2 * np.diff(a, axis=0) / 12
        np.testing.assert_allclose(np.diff(q, axis=0)[near], steps[near], atol=5e-8)


@pytest.fixture(name="desk")
def _desk(program):
    desk = Desk(program)
    yield desk
    desk.end()


def link(desk: Desk) -> SerialTransport:
    transport = SerialTransport(desk.opened, lambda: desk.now, seed=7)
    transport.open()
    return transport


def pass_time(desk: Desk, transport: SerialTransport, seconds: float) -> list[Measured]:
    """Let time pass; the host looks every 5 ms."""
    measured = []
    for tick in range(round(seconds / TICK_S)):
        desk.tick()
        if tick % 5 == 0:
            measured += transport.poll()
    return measured


def test_tables_arrive_and_are_played(desk):
    transport = link(desk)
    first, second = shaking(0.0005), shaking(0.0008, turns=3)
    transport.send(first)
    pass_time(desk, transport, 1.0)
    assert desk.states[-1] is State.PLAYING
    transport.send(second)
    measured = pass_time(desk, transport, 0.5)
    assert transport.troubles() == []
    assert (transport.retries, transport.refused) == (0, 0)
    desk.check_limits()
    desk.check_smooth()
    # The last cycle is the second table, as scipy draws it.
    rows = np.array(desk.setpoints)
    knots = np.stack([second.q, second.qd, second.qdd], axis=1)
    spline = BPoly.from_derivatives(second.cycle.times.copy(), knots)
    began = next(row[0] for row in desk.setpoints if any(row[1:5])) - TICK_S
    last = rows[-100:]
    t = (last[:, 0] - began + 1e-9) % PERIOD
    np.testing.assert_allclose(last[:, 1:5], spline(t), atol=2e-8)
    # Telemetry is on the host's clock to a tick or so: the line has no delay here.
    assert 45 <= len(measured) <= 55
    for sample in measured:
        row = rows[np.argmin(np.abs(rows[:, 0] - sample.telemetry.device_us * 1e-6))]
        np.testing.assert_allclose(sample.telemetry.position, row[1:5], rtol=1e-6, atol=1e-12)
        assert abs(sample.time - sample.telemetry.device_us * 1e-6) < 3e-3
    transport.close()
    pass_time(desk, transport, 0.02)


def test_upload_takes_a_fraction_of_a_cycle(desk):
    transport = link(desk)
    transport.send(shaking(0.0005))
    pass_time(desk, transport, 1.0)
    transport.send(shaking(0.0008))
    ticks = 0
    while transport.poll()[-1:] == [] or ticks < 1:
        desk.tick()
        ticks += 1
    # 13 knot messages by a window of 8, looked after every tick: a handful of turns.
    for _ in range(20):
        desk.tick()
        measured = transport.poll()
        if measured and measured[-1].telemetry.waiting == 2:
            return
    pytest.fail("the second table was not in the second buffer after 20 ms")


@pytest.mark.parametrize(
    ("damage", "loss", "delay"),
    [(0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.02), (0.003, 0.003, 0.02)],
)
def test_bad_lines(desk, damage, loss, delay):
    desk.damage, desk.loss, desk.delay = damage, loss, delay
    transport = link(desk)
    transport.send(shaking(0.002))
    tables: set[int] = set()
    for n in range(40):
        tables |= {m.telemetry.table for m in pass_time(desk, transport, 0.1)}
        transport.send(shaking(0.002 if n % 2 else 0.001))
    desk.check_limits()
    desk.check_smooth()
    assert len(tables - {0}) >= 3, transport.troubles()
    if damage or loss:
        assert transport.retries > 0
        assert transport.refused > 0


def test_disconnection(desk):
    transport = link(desk)
    transport.send(shaking(0.002))
    pass_time(desk, transport, 1.0)
    assert desk.states[-1] is State.PLAYING
    desk.cut = True
    pass_time(desk, transport, 2.0)
    # The device brakes 0.25 s after it heard the last word, within a cycle, and is off at home.
    braking = [i for i, s in enumerate(desk.states) if s is State.BRAKING]
    assert 1.2 <= braking[0] * TICK_S <= 1.26
    assert desk.states[-1] is State.OFF
    assert any("port is" in t for t in transport.troubles())
    desk.cut = False
    pass_time(desk, transport, 2.0)
    assert desk.states[-1] is State.PLAYING
    desk.check_limits()
    desk.check_smooth()


def test_reset(desk):
    transport = link(desk)
    transport.send(shaking(0.002))
    pass_time(desk, transport, 1.0)
    desk.reset()
    pass_time(desk, transport, 1.5)
    assert "device was reset" in transport.troubles()
    assert desk.states[-1] is State.PLAYING
    desk.check_limits()


def test_close_stops_the_plate(desk):
    transport = link(desk)
    transport.send(shaking(0.002))
    pass_time(desk, transport, 1.0)
    written = desk.to_device
    transport.close()
    desk.to_device = written  # what was written is on its way, although the port is closed
    for _ in range(700):
        desk.tick()
    assert desk.states[-1] is State.OFF
    # At once, not by the watchdog.
    assert State.BRAKING in desk.states[1000:1010]


def test_hardware_fault_is_told_and_nothing_starts_again(desk):
    transport = link(desk)
    transport.send(shaking(0.002))
    pass_time(desk, transport, 1.0)
    desk.process.stdin.write("fault 8\n")
    pass_time(desk, transport, 0.1)
    desk.process.stdin.write("fault 0\n")
    transport.send(shaking(0.002))
    pass_time(desk, transport, 1.0)
    assert desk.states[-1] is State.OFF
    assert any(repr(Fault.SUPPLY) in t for t in transport.troubles())


def test_long_tables_are_refused(desk):
    transport = link(desk)
    pass_time(desk, transport, 0.1)
    cycle = PlateCycle.from_samples(1.0, np.zeros((600, 3)))
    with pytest.raises(CycleError, match="601 knots, allowed by the device: 512"):
        transport.send(prepare(RIG, cycle, 1)[0])
