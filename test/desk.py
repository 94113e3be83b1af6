"""A device on a desk, the C firmware or its twin in Python: orders in, what it does out."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import BPoly

from plate_core import load_rig
from plate_core.serial_protocol import (
    Acknowledgement,
    Begin,
    Commit,
    Enable,
    Fault,
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
    frame,
    pack,
    parse,
    table_crc,
)  # fmt: skip
from plate_sim.device import Device, DeviceLimits

STROKE_M, SPEED = 0.010, 1.0
SILENCE_S = 0.25
PERIOD_S = 0.1


@dataclass(frozen=True)
class Run:
    """What the device did: times [s], setpoints (n, 3, 4), messages, and its state in the end."""

    times: np.ndarray
    setpoints: np.ndarray
    said: list[Packet]
    sent: bytes
    state: State
    faults: Fault
    refused: int

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
    return "\n".join(lines) + "\nrun 1000\n"


def heard(stdout: str) -> Run:
    """Read what a device has printed."""
    output = [line.split() for line in stdout.splitlines()]
    ticks = [line for line in output if line[0] == "at"]
    assert all(line[-1] != "off" for line in ticks)  # nothing is commanded without current
    sent = b"".join(bytes.fromhex(line[1]) for line in output if line[0] == "tx")
    reader, packets = Reader().fed(sent)
    assert reader == Reader()
    state, faults, refused = map(int, [line for line in output if line[0] == "state"][-1][1:])
    return Run(
        np.array([int(line[1]) * 1e-6 for line in ticks]),
        np.array([line[2:] for line in ticks], dtype=float).reshape(-1, 3, 4),
        [parse(p) for p in packets],
        sent,
        State(state),
        Fault(faults),
        refused,
    )


def say(sequence: int, message: Message) -> bytes:
    return frame(pack(Packet(sequence, message)))


def wave(size: float, phase: float = 0.0, moving: bool = False) -> tuple[Knot, ...]:
    """A closed table of 24 pieces, peak travel near `size` [m]: from rest, or moving throughout."""
    t = np.linspace(0, PERIOD_S, 25)
    w = 2 * np.pi / PERIOD_S
    lift = np.array([0.0, 0.5, 1.0, 1.5]) + phase
    angle = w * t[:, None] + lift
    q, v, a = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    if not moving:
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


def upload(table: int, knots: tuple[Knot, ...], first: int, repeats: int = 0) -> bytes:
    """All of a table's messages, numbered from `first`; the last one is Commit."""
    messages: list[Message] = [Begin(table, len(knots), table_crc(knots))]
    messages += [Knots(table, i, knots[i : i + 4]) for i in range(0, len(knots), 4)]
    messages.append(Commit(table, repeats))
    return b"".join(say(first + i, m) for i, m in enumerate(messages))


HELLO, HOME = say(99, Hello(1, 77)), say(100, Home())
READY = [
    HELLO,
    HOME,
    say(101, Enable()),
    0.2,
    say(1, Heartbeat(1)),
    0.2,
    say(1, Heartbeat(1)),
    0.15,
]
GENTLE = wave(0.001)
COMMIT = 110 + 1 + 7  # sequence number of an upload's Commit, when its first is 110


def alive(seconds: float) -> list[bytes | float]:
    return [say(1, Heartbeat(5)), 0.1] * round(seconds / 0.1)


def spline(knots: tuple[Knot, ...]) -> BPoly:
    times = [k.ticks * 1e-8 for k in knots]
    return BPoly.from_derivatives(times, [[k.position, k.velocity, k.acceleration] for k in knots])


def changed(at: int, **values) -> tuple[Knot, ...]:
    knots = list(GENTLE)
    knots[at] = Knot(**(vars(knots[at]) | values))
    return tuple(knots)


def twin(orders: str, *arguments: str) -> str:
    """Do what firmware/host/host.c does, with the device in Python; returns what it prints."""
    limits = DeviceLimits.of_rig(load_rig())
    changes = zip(("heat_s", "lasting", "force"), map(float, arguments), strict=False)
    limits = replace(limits, **dict(changes))
    device, data, fault, lines = Device.started(limits, 0xCAFE), b"", Fault.NONE, []
    for order in orders.splitlines():
        kind, _, value = order.partition(" ")
        if kind == "rx":
            data = bytes.fromhex(value)
        elif kind == "fault":
            fault = Fault(int(value))
        elif kind == "run":
            end = device.now_us + int(value)
            while device.now_us < end:
                device, said, at = device.ticked(device.now_us + 1000, data, fault)
                data = b""
                told = [f"tx {frame.hex()}00" for frame in said.split(b"\0")[:-1]]
                moved = [] if at is None else [f"at {device.now_us} " + shown(at)]
                # Answers come before the setpoint, telemetry after it.
                late = [t for t in told if t[5:7] == "84"]
                lines += [t for t in told if t not in late] + moved + late
            motion = device.motion
            lines.append(
                f"state {motion.state:d} {motion.faults:d} {device.reader.refused % 2**16}"
            )
    return "\n".join(lines) + "\n"


def shown(at: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in at.ravel().tolist())


def running(program: Path):
    def run(orders: str, *arguments: str) -> str:
        command = [str(program), *arguments]
        done = subprocess.run(command, input=orders, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
