"""The firmware as a program and in the simulator: orders as input, behaviour of the device as
output."""

import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import BPoly

from plate_core import load_rig  # fmt: skip
from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Acknowledgement,
    Begin,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Knot,
    Knots,
    Message,
    Packet,
    Reader,
    State,
    Status,
    frame,
    pack,
    parse,
    table_crc,
)
from plate_sim.device import Device, DeviceLimits

STROKE_M, SPEED, ACCEL = 0.010, 1.0, 100.0
SLACK = 1.002
"""Factor on the limits, because the splines of the motors differ from the plate's
(docs/protocol.md)."""

STEP_M = 2e-6
SILENCE_S = 0.25
PERIOD_S = 0.1
BOOT = 0xCAFE
"""Boot number of the device, from which it derives the number of its first stop."""

LIMITS = DeviceLimits.of_rig(load_rig())


@dataclass(frozen=True)
class Run:
    """Behaviour of the device: times [s], setpoints (n, 3, 4), messages, times at which the current
    was switched on or off [s], and final state."""

    times: np.ndarray
    setpoints: np.ndarray
    packets: list[Packet]
    sent: bytes
    state: State
    faults: Fault
    refused: int
    stop: int
    switched: list[tuple[float, bool]]
    line: list[tuple[int, bool]]  # changes of the camera's line: time [us], value

    def answers(self) -> dict[int, Status]:
        found = [p.message for p in self.packets if isinstance(p.message, Acknowledgement)]
        return {m.sequence: m.status for m in found}


def run(device: Callable[..., str], *orders: bytes | float | str) -> Run:
    """Run the device with orders: bytes to receive, durations [s], or lines of its input."""
    return parse_run(device(ordered(*orders)))


def assert_bounded(done: Run) -> None:
    """Check that all setpoints are within the limits, and that each step is within the speed
    limit."""
    q, v, a = np.abs(np.moveaxis(done.setpoints, 1, 0))
    assert np.all(q <= STROKE_M * SLACK)
    assert np.all(v <= SPEED * SLACK)
    assert np.all(a <= ACCEL * 1.1)
    dt = np.diff(done.times)
    on_end = dt < 2.5e-3  # otherwise the current was off between them, or the tick was late
    steps = np.max(np.abs(np.diff(done.setpoints[:, 0], axis=0)), axis=1)
    assert np.all(steps[on_end] <= SPEED * SLACK * dt[on_end] + STEP_M)
    late = ~on_end & (np.abs(done.setpoints[1:, 1]).max(axis=1) > 0.05)
    assert np.all(steps[late] <= SPEED * SLACK * 2e-3 + STEP_M)


def ordered(*orders: bytes | float | str) -> str:
    lines = []
    for order in orders:
        if isinstance(order, bytes):
            lines.append(f"rx {order.hex()}\nrun 1000")
        else:
            lines.append(order if isinstance(order, str) else f"run {round(order * 1e6)}")
    return "\n".join([*lines, "run 1000", ""])


def parse_run(stdout: str) -> Run:
    """Parse the output of a device."""
    output = [line.split() for line in stdout.splitlines()]
    ticks = [line for line in output if line[0] == "at"]
    assert all(line[-1] != "off" for line in ticks)  # there is no setpoint without current
    sent = b"".join(bytes.fromhex(line[1]) for line in output if line[0] == "tx")
    reader, packets = Reader().fed(sent)
    assert reader == Reader()
    last = [line for line in output if line[0] == "state"][-1]
    state, faults, refused, stop = map(int, last[1:])
    return Run(
        np.array([int(line[1]) * 1e-6 for line in ticks]),
        np.array([line[2:] for line in ticks], dtype=float).reshape(-1, 3, 4),
        [parse(p) for p in packets],
        sent,
        State(state),
        Fault(faults),
        refused,
        stop,
        [(int(line[1]) * 1e-6, line[2] == "1") for line in output if line[0] == "drive"],
        [(int(line[1]), line[2] == "1") for line in output if line[0] == "trigger"],
    )


def say(sequence: int, message: Message) -> bytes:
    return frame(pack(Packet(sequence, message)))


def wave(size: float, phase: float = 0.0) -> tuple[Knot, ...]:
    """Return a closed table of 24 pieces that begins at rest, with a maximum travel of about `size`
    [m]."""
    t = np.linspace(0, PERIOD_S, 25)
    w = 2 * np.pi / PERIOD_S
    lift = np.array([0.0, 0.5, 1.0, 1.5]) + phase
    angle = w * t[:, None] + lift
    q, v, a = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    s, ds, dds = (1 - np.cos(w * t)) / 2, w * np.sin(w * t) / 2, w**2 * np.cos(w * t) / 2
    s, ds, dds = s[:, None] ** 2, 2 * s[:, None] * ds[:, None], (
        2 * ds[:, None] ** 2 + 2 * s[:, None] * dds[:, None]
    )  # fmt: skip
    q, v, a = s * q, ds * q + s * v, dds * q + 2 * ds * v + s * a
    for end in (0, -1):
        q[end] = v[end] = 0
    ticks = np.round(t * 1e8).astype(int)
    rows = zip(ticks, size * q, size * v, size * a, strict=True)
    return tuple(
        Knot(int(k), *(tuple(map(float, np.float32(x))) for x in states)) for k, *states in rows
    )


def uploaded(
    table: int, knots: tuple[Knot, ...], first: int, repeats: int = 50, splice_ticks: int = 0
) -> list[bytes]:
    """Return all frames of a table, with sequence numbers from `first` on. The last one is
    Commit."""
    messages: list[Message] = [Begin(table, len(knots), table_crc(knots), splice_ticks)]
    messages += [Knots(table, i, knots[i : i + 4]) for i in range(0, len(knots), 4)]
    messages.append(Commit(table, repeats))
    return [say(first + i, message) for i, message in enumerate(messages)]


def upload(
    table: int, knots: tuple[Knot, ...], first: int, repeats: int = 50, splice_ticks: int = 0
) -> bytes:
    """Return the bytes of these frames."""
    return b"".join(uploaded(table, knots, first, repeats, splice_ticks))


HELLO, ENABLE = say(99, Hello(VERSION, 77)), say(101, Enable(BOOT))
HOMEWARD = [0.2, say(1, Heartbeat(1)), 0.2, say(1, Heartbeat(1)), 0.15]
"""Orders during the motion to home."""

READY = [HELLO, ENABLE, *HOMEWARD]
GENTLE = wave(0.001)
COMMIT = 110 + 1 + 7  # sequence number of the Commit of an upload that begins with 110
UPLOAD_S = 0.02
"""Time that exceeds the time in which the device reads and checks such an upload [s]."""


def alive(seconds: float) -> list[bytes | float]:
    return [say(1, Heartbeat(5)), 0.1] * round(seconds / 0.1)


def spline(knots: tuple[Knot, ...]) -> BPoly:
    times = [k.ticks * 1e-8 for k in knots]
    return BPoly.from_derivatives(times, [[k.position, k.velocity, k.acceleration] for k in knots])


def changed(at: int, **values) -> tuple[Knot, ...]:
    knots = list(GENTLE)
    knots[at] = Knot(**(vars(knots[at]) | values))
    return tuple(knots)


class Simulated:
    """Replacement of firmware/host with the simulator's device. It collects the output lines."""

    def __init__(self, *arguments: str) -> None:
        names = ("heat_s", "continuous_force", "force", "following_m")
        changes = dict(zip(names, map(float, arguments), strict=False))
        self.limits = replace(LIMITS, **changes)
        self.device = Device(self.limits, BOOT)
        self.lines: list[str] = []
        self._data, self._fault, self._now_us = b"", Fault.NONE, 0
        self._place = np.zeros((2, 4), np.float32)
        self._jammed, self._search, self._searched = False, 1, 0
        self._shown = self._high = False

    def obey(self, order: str) -> None:
        kind, _, value = order.partition(" ")
        if kind == "rx":
            self._data += bytes.fromhex(value)
        elif kind == "late":
            self._now_us += int(value)
        elif kind == "fault":
            self._fault = Fault(int(value))
        elif kind == "search":
            self._search = int(value)
        elif kind == "jam":
            self._jammed = value != "0"
        elif kind == "reset":
            self.device = Device(self.limits, self.device.boot + 1, self._now_us)
            self._data = b""
        elif kind == "run":
            end, device = self._now_us + int(value), self.device
            while self._now_us < end:
                self._tick(device)
            reported = (device.state, device.faults, device.refused, device.stops)
            self.lines.append("state " + " ".join(map(str, reported)))

    def _tick(self, device: Device) -> None:
        self._now_us += 1000
        self._searched = self._searched + 1 if device.searches else 1
        found = self._searched >= self._search
        sent, at = device.tick(self._now_us, self._place, self._data, self._fault, found)
        if device.enabled_us == self._now_us:
            self._searched = 1
        self._data = b""
        reported = [f"tx {frame.hex()}00" for frame in sent.split(b"\0")[:-1]]
        moved = [] if at is None else [f"at {self._now_us} " + shown(at)]
        # Replies are printed before the setpoint, telemetry after it.
        late = [t for t in reported if t[5:7] == "84"]
        self.lines += [t for t in reported if t not in late] + moved + late
        on = device.state != State.OFF
        if on != self._shown:
            self.lines.append(f"drive {self._now_us} {on:d}")
        if device.triggered != self._high:
            self.lines.append(f"trigger {self._now_us} {device.triggered:d}")
        if at is not None and not self._jammed:
            self._place = at[::2].copy()
        self._shown, self._high = on, device.triggered


def simulated(orders: str, *arguments: str) -> str:
    """Execute the orders of firmware/host with the simulator's device, and return the output."""
    device = Simulated(*arguments)
    for order in orders.splitlines():
        device.obey(order)
    return "\n".join([*device.lines, ""])


def shown(at: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in at.ravel().tolist())


def running(program: Path):
    # The search for leaks takes half of the time, and only host.c has a heap.
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=0"}

    def run(orders: str, *arguments: str) -> str:
        command = [str(program), *arguments]
        done = subprocess.run(
            command, input=orders, capture_output=True, text=True, timeout=60, env=environment
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def tell(bench, data):
    bench.order(f"rx {data.hex()}")


def live(bench, ms):
    """Advance the time while the host sends heartbeats."""
    for _ in range(0, ms, 50):
        tell(bench, say(1, Heartbeat(1)))
        bench.run(50)


def enable(bench, sequence=101, ms=600):
    tell(bench, say(sequence, Enable(bench.stop)))
    live(bench, ms)


def boot(bench):
    """Switch the drives on, and wait until the firmware has set them up."""
    bench.run(5)
    for drive in bench.drives:
        drive.boot()
    bench.run(300)
    tell(bench, HELLO)
    bench.run(5)


def ready(bench):
    boot(bench)
    enable(bench, ms=bench.home_ms)
    assert (bench.state, bench.faults) == (State.READY, 0)


def playing(bench, plate, size=0.004):
    ready(bench)
    bench.plate = plate
    for data in uploaded(7, plate.wave(size), 200, 90):
        tell(bench, data)
    live(bench, 150)
    assert bench.state == State.PLAYING


def said_by(bench, kind):
    packets = Reader().fed(bench.written)[1]
    return [m for m in (parse(p).message for p in packets) if isinstance(m, kind)]
