"""Random and mutated frames into both parsers: the host's, in Python, and the firmware's, in C."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from harness import ROOT
from plate_core import FrameError
from plate_core.serial_protocol import (
    VERSION,
    Acknowledgement,
    Begin,
    Capabilities,
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
    Pulse,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    pack,
    parse,
    table_crc,
)
from plate_driver.transports import Link

CHUNK = 2000
"""Frames that are given at once."""

PART = 50
"""Frames between two looks at the firmware's setpoints."""

QUARANTINE = {"ASAN_OPTIONS": "quarantine_size_mb=1"}
"""The sanitizer keeps freed memory for a while, and would seem to grow."""

LIMITS = np.array([[0.010], [1.0], [100.0]]) * 1.002
"""Of the default rig: stroke [m], speed [m/s], acceleration [m/s2]."""

ZERO = (0.0,) * 4
SOURCES = ("*.c", "host/host.c", "host/motors.c")


def table(size: float) -> list[Knot]:
    """Knots of a table that swings by about `size` [m] in 0.1 s, from rest to rest."""
    t = np.linspace(0, 0.1, 25)
    w = 2 * np.pi / 0.1
    rise, slope, bend = (1 - np.cos(w * t)) / 2, w * np.sin(w * t) / 2, w**2 * np.cos(w * t) / 2
    rise[-1] = slope[-1] = 0
    q, v, a = (np.float32(size * values).astype(float) for values in (rise, slope, bend))
    ticks = np.round(t * 1e8).astype(int)
    return [Knot(int(ticks[k]), (q[k],) * 4, (v[k],) * 4, (a[k],) * 4) for k in range(len(ticks))]


def orders(number: int, stop: int = 0) -> list[bytes]:
    """What a host says, from Hello to Commit, as frames."""
    knots = table(0.003)
    said: list[Message] = [Hello(2, number), Home(), Enable(stop), Heartbeat(number)]
    said += [Begin(1, len(knots), table_crc(knots))]
    said += [Knots(1, i, tuple(knots[i : i + 4])) for i in range(0, len(knots), 4)]
    said += [Commit(1, 5), Stop(0), Stop(1)]
    return [frame(pack(Packet(i, message))) for i, message in enumerate(said)]


def reports() -> list[bytes]:
    """What a device says, as frames."""
    said: list[Message] = [
        Capabilities(VERSION, 5, 1, 4, 512, 8, 250, 0.01, 1.0, 100.0, 200.0, 100.0, 0.003, 10_000),
        Pulse(1, 2),
        *(Acknowledgement(number, status) for number in range(3) for status in Status),
        *(
            Telemetry(9, state, Fault.NONE, 7, 1, 3, 2, 0, ZERO, ZERO, 0.5, 1e-4, 0.1)
            for state in State
        ),
    ]
    return [frame(pack(Packet(i, message))) for i, message in enumerate(said)]


def spoilt(rng: np.random.Generator, frames: list[bytes], count: int) -> Iterator[bytes]:
    """Yield frames: whole, changed, cut, noise, or nonsense with a right CRC."""
    kinds, which = rng.integers(6, size=count), rng.integers(len(frames), size=count)
    for kind, number, share in zip(kinds, which, rng.random(count), strict=True):
        data = frames[number]
        at = int(share * len(data))
        if kind == 1:
            data = data[:at] + bytes([int(rng.integers(256))]) + data[at + 1 :]
        elif kind == 2:
            data = data[:at]
        elif kind == 3:
            data = rng.bytes(int(300 * share))
        elif kind == 4:
            data = frame(bytes([int(rng.integers(0, 20))]) + rng.bytes(int(240 * share)))
        elif kind == 5:
            data = data[:at] + data[at // 2 :]
        yield data


def fuzz_host(count: int, seed: int = 0) -> dict[str, object]:
    """Give frames to the host's reader, parser and link."""
    rng, reader, known = np.random.default_rng(seed), Reader(), reports()
    link = Link.begun(5, 0.0).uploading(1, table(0.001), 5)
    refused, understood, early = 0, 0, 0
    for done in range(0, count, CHUNK):
        stream = b"".join(spoilt(rng, known, CHUNK))
        reader, packets = reader.fed(stream)
        for data in packets:
            try:
                packet = parse(data)
            except FrameError:
                refused += 1
                continue
            understood += 1
            link, _ = link.heard(packet, done * 1e-3).due(done * 1e-3)
        if link.failed:
            link = Link.begun(5, done * 1e-3).uploading(1, table(0.001), 5)
        if done <= count // 10:
            early = memory("self")
    return {
        "side": "host: reader, parser, link (Python)", "frames": count,
        "understood": understood, "refused": refused + reader.refused,
        "crashes": 0, "growth_kb": memory("self") - early, "outside": 0,
    }  # fmt: skip


def build(folder: Path) -> Path | None:
    """Compile the firmware for this machine, with sanitizers if there are some."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    program = folder / "host"
    sources = [str(path) for pattern in SOURCES for path in (ROOT / "firmware").glob(pattern)]
    for extra in (["-fsanitize=address,undefined", "-fno-sanitize-recover=all"], []):
        command = [compiler, "-std=c99", "-O1", *extra, "-o", str(program), *sources, "-lm"]
        if subprocess.run(command, capture_output=True, timeout=200).returncode == 0:
            return program
    return None


class Desk:
    """The firmware as a process; looks at each setpoint that it commands."""

    def __init__(self, program: Path) -> None:
        self._process = subprocess.Popen(
            [str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | QUARANTINE,
        )  # fmt: skip
        self.setpoints, self.outside, self.stop = 0, 0, 0

    def give(self, data: bytes, run_us: int) -> bool:
        """Give it bytes, and time; returns whether it is still there."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"rx {data.hex()}\nrun {run_us}\n")
        self._process.stdin.flush()
        for line in self._process.stdout:
            kind, _, rest = line.partition(" ")
            if kind == "state":
                self.stop = int(rest.split()[3])
                return True
            if kind == "at":
                values = np.abs(np.array(rest.split()[1:13], float)).reshape(3, 4)
                self.setpoints += 1
                self.outside += bool(np.any(values > LIMITS))
        return False

    def memory(self) -> int:
        """Resident [kB]."""
        return memory(str(self._process.pid))

    def end(self) -> int:
        """Let it end; returns its exit code."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        return self._process.wait(20)


def fuzz_device(count: int, seed: int = 0) -> dict[str, object] | None:
    """Give frames to the firmware; None without a C compiler."""
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder))
        if program is None:
            return None
        desk, rng = Desk(program), np.random.default_rng(seed)
        done, early, growth, there = 0, 0, 0, True
        while done < count and there:
            hello, home, _, beat, *_ = orders(done)
            # It is enabled and plays again; then comes what may.
            for data, run_us in (
                (hello, 200_000), (beat, 200_000), (beat, 200_000), (beat, 200_000), (home, 5_000),
            ):  # fmt: skip
                there = there and desk.give(data, run_us)
            known = orders(done, desk.stop)
            _, _, enable, _, *rest = known
            for data, run_us in (
                (enable, 200_000),
                (beat, 200_000),
                (beat, 200_000),
                (b"".join(rest[:-2]), 30_000),
            ):
                there = there and desk.give(data, run_us)
            frames = list(spoilt(rng, known, CHUNK))
            for i in range(0, CHUNK, PART):
                there = there and desk.give(b"".join(frames[i : i + PART]), 5_000)
            done += CHUNK
            if there and done <= count // 10:
                early = desk.memory()
        if there:
            growth = desk.memory() - early
        return {
            "side": "device: firmware (C), sanitizers on", "frames": done,
            "crashes": int(desk.end() != 0), "growth_kb": growth,
            "setpoints": desk.setpoints, "outside": desk.outside,
        }  # fmt: skip


def memory(process: str) -> int:
    """Resident memory of a process [kB]."""
    text = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    return int(text.split("VmRSS:")[1].split()[0])
