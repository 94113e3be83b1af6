"""The C firmware on this machine and its twin in Python: orders in, what the device does out."""

import os
import subprocess
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from itertools import takewhile
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

STROKE_M, SPEED = 0.010, 1.0
SILENCE_S = 0.25
PERIOD_S = 0.1
BOOT = 0xCAFE
"""Of the device, which takes the number of its first stop from it."""

LIMITS = DeviceLimits.of_rig(load_rig())


@dataclass(frozen=True)
class Run:
    """What the device did: times [s], setpoints (n, 3, 4), messages, when current was switched on
    and off [s], and its state in the end."""

    times: np.ndarray
    setpoints: np.ndarray
    said: list[Packet]
    sent: bytes
    state: State
    faults: Fault
    refused: int
    stop: int
    switched: list[tuple[float, bool]]
    line: list[tuple[int, bool]]  # when the camera's line has changed [us], and to what

    def answers(self) -> dict[int, Status]:
        found = [p.message for p in self.said if isinstance(p.message, Acknowledgement)]
        return {m.sequence: m.status for m in found}


def run(device: Callable[..., str], *orders: bytes | float | str) -> Run:
    """Give the device bytes, seconds that pass, and lines as they are."""
    return heard(device(ordered(*orders)))


def ordered(*orders: bytes | float | str) -> str:
    lines = []
    for order in orders:
        if isinstance(order, bytes):
            lines.append(f"rx {order.hex()}\nrun 1000")
        else:
            lines.append(order if isinstance(order, str) else f"run {round(order * 1e6)}")
    return "\n".join([*lines, "run 1000", ""])


def heard(stdout: str) -> Run:
    """Read what a device has printed."""
    output = [line.split() for line in stdout.splitlines()]
    ticks = [line for line in output if line[0] == "at"]
    assert all(line[-1] != "off" for line in ticks)  # nothing is commanded without current
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
    """A closed table of 24 pieces from rest, peak travel near `size` [m]."""
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
    """All frames of a table, numbered from `first`; the last one is Commit."""
    messages: list[Message] = [Begin(table, len(knots), table_crc(knots), splice_ticks)]
    messages += [Knots(table, i, knots[i : i + 4]) for i in range(0, len(knots), 4)]
    messages.append(Commit(table, repeats))
    return [say(first + i, message) for i, message in enumerate(messages)]


def upload(
    table: int, knots: tuple[Knot, ...], first: int, repeats: int = 50, splice_ticks: int = 0
) -> bytes:
    """The bytes of them."""
    return b"".join(uploaded(table, knots, first, repeats, splice_ticks))


HELLO, ENABLE = say(99, Hello(VERSION, 77)), say(101, Enable(BOOT))
HOMEWARD = [0.2, say(1, Heartbeat(1)), 0.2, say(1, Heartbeat(1)), 0.15]
"""While the plate goes home."""

READY = [HELLO, ENABLE, *HOMEWARD]
GENTLE = wave(0.001)
COMMIT = 110 + 1 + 7  # sequence number of an upload's Commit, when its first is 110
UPLOAD_S = 0.02
"""Longer than the device takes to read such an upload and to look at it."""


def alive(seconds: float) -> list[bytes | float]:
    return [say(1, Heartbeat(5)), 0.1] * round(seconds / 0.1)


def spline(knots: tuple[Knot, ...]) -> BPoly:
    times = [k.ticks * 1e-8 for k in knots]
    return BPoly.from_derivatives(times, [[k.position, k.velocity, k.acceleration] for k in knots])


def changed(at: int, **values) -> tuple[Knot, ...]:
    knots = list(GENTLE)
    knots[at] = Knot(**(vars(knots[at]) | values))
    return tuple(knots)


class Twin:
    """What firmware/host is, with the device in Python; collects what it prints."""

    def __init__(self, *arguments: str) -> None:
        names = ("heat_s", "continuous_force", "force", "following_m")
        changes = dict(zip(names, map(float, arguments), strict=False))
        self.device = Device.started(replace(LIMITS, **changes), BOOT)
        self.lines: list[str] = []
        self._data, self._fault, self._late_us = b"", Fault.NONE, 0
        self._place = np.zeros((2, 4), np.float32)
        self._jammed, self._search, self._searched = False, 1, 0
        self._shown = self._high = False

    def obey(self, order: str) -> None:
        kind, _, value = order.partition(" ")
        if kind == "rx":
            self._data += bytes.fromhex(value)
        elif kind == "late":
            self._late_us += int(value)
        elif kind == "fault":
            self._fault = Fault(int(value))
        elif kind == "search":
            self._search = int(value)
        elif kind == "jam":
            self._jammed = value != "0"
        elif kind == "place":
            self._place = np.stack([np.full(4, value, np.float32), self._place[1]])
        elif kind == "load":
            self.device = replace(self.device, load=float(np.float32(value)))
        elif kind == "reset":
            old = self.device
            now_us = old.now_us + self._late_us
            self.device = replace(Device.started(old.limits, old.boot + 1, now_us), load=old.load)
            self._data, self._late_us = b"", 0
        elif kind == "run":
            end = self.device.now_us + self._late_us + int(value)
            while self.device.now_us < end:
                self._tick()
            motion, refused = self.device.motion, self.device.reader.refused % 2**16
            self.lines.append(f"state {motion.state:d} {motion.faults:d} {refused} {motion.stops}")

    def _tick(self) -> None:
        now_us, before = self.device.now_us + self._late_us + 1000, self.device.motion
        self._searched = self._searched + 1 if before.searches else 1
        found = self._searched >= self._search
        device, said, at = self.device.ticked(now_us, self._place, self._data, self._fault, found)
        if device.motion.enabled_us == now_us:
            self._searched = 1
        self._data, self._late_us = b"", 0
        told = [f"tx {frame.hex()}00" for frame in said.split(b"\0")[:-1]]
        moved = [] if at is None else [f"at {now_us} " + shown(at)]
        # Answers come before the setpoint, telemetry after it.
        late = [t for t in told if t[5:7] == "84"]
        self.lines += [t for t in told if t not in late] + moved + late
        on = device.motion.state is not State.OFF
        if on != self._shown:
            self.lines.append(f"drive {now_us} {on:d}")
        high = device.trigger.high
        if high != self._high:
            self.lines.append(f"trigger {now_us} {high:d}")
        if at is not None and not self._jammed:
            self._place = at[::2]
        self.device, self._shown, self._high = device, on, high


LAST: list[tuple[str, Twin, int]] = []
"""The twin after each order of its last run, and how many lines it had printed; the first order
are its arguments."""


def twin(orders: str, *arguments: str) -> str:
    """Do what firmware/host does, with the device in Python; returns what it prints.

    Orders that are those of the last run are not done again: a `Device` is a value.
    """
    wanted = [" ".join(arguments), *orders.splitlines()]
    same = takewhile(lambda pair: pair[0] == pair[1][0], zip(wanted, LAST, strict=False))
    del LAST[len(list(same)) :]
    if not LAST:
        LAST.append((wanted[0], Twin(*arguments), 0))
    _, last, printed = LAST[-1]
    device = copy(last)
    device.lines = last.lines[:printed]
    for order in wanted[len(LAST) :]:
        device.obey(order)
        LAST.append((order, copy(device), len(device.lines)))
    return "\n".join([*device.lines, ""])


def shown(at: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in at.ravel().tolist())


def running(program: Path):
    # To look for leaks takes half of the time, and only host.c has a heap.
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
    """Let time pass with a host that lives."""
    for _ in range(0, ms, 50):
        tell(bench, say(1, Heartbeat(1)))
        bench.run(50)


def enable(bench, sequence=101, ms=600):
    tell(bench, say(sequence, Enable(bench.stop)))
    live(bench, ms)


def said_by(bench, kind):
    packets = Reader().fed(bench.said)[1]
    return [m for m in (parse(p).message for p in packets) if isinstance(m, kind)]
