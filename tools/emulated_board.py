"""The board of firmware/boards/stm32f405 in an emulator: built, started, its line and its record.

QEMU's `netduinoplus2` is an STM32F405. It runs with `-icount shift=3`: each instruction takes 8 ns
of virtual time, so that a tick's length, which the firmware measures by its timer, counts its
instructions. A byte takes no time on that line: a host that is to be real must keep its pace.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

BOARD = Path(__file__).resolve().parents[1] / "firmware" / "boards" / "stm32f405"
ICOUNT_SHIFT = 3
INSTRUCTION_NS = 2**ICOUNT_SHIFT
TICK_BINS = 1024
RING_BYTES = 4096
"""`ROOM` of usart.c."""

PART = 1024
"""Bytes written at once by the debugger."""

RECORD = struct.Struct(f"<3I{TICK_BINS}II4f3I")
"""`Record` of board.h."""

TOOLS = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
    "make": "make",
}
"""What is needed, and the Debian packages that hold it."""


def missing() -> str:
    """Return which packages to install; nothing if all tools are there."""
    packages = [package for tool, package in TOOLS.items() if shutil.which(tool) is None]
    return " ".join(packages)


def built(out: Path, **options: str | Path) -> Path:
    """Build the firmware into a folder, with variables of its Makefile; returns plate.elf."""
    values = [f"{name}={value}" for name, value in options.items()]
    command = ["make", "-C", str(BOARD), f"BUILD={out}", *values]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return out / "plate.elf"


def symbols(elf: Path) -> dict[str, int]:
    """Return name and address of all that is linked."""
    listed = subprocess.run(
        ["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in listed.stdout.splitlines()]
    return {row[-1]: int(row[0], 16) for row in rows if len(row) == 3}


@dataclass(frozen=True)
class Record:
    """What the board has seen since its reset; `Record` of board.h, times in instructions.

    Attributes
    ----------
    ticks, late : int
        Ticks, and those that lasted into the next one's time.
    longest : int
        Instructions of the longest tick.
    by_us : (1024,)
        Number of ticks that took so many microseconds.
    setpoints : int
    step_m : float
        Longest step of a motor between two setpoints a tick apart [m].
    most : tuple of float
        Travel [m], speed [m/s], acceleration [m/s2] of the setpoints: most of all motors.
    received, overruns, dropped : int
        Bytes that came, times that the line ran over, frames that found no room.
    """

    ticks: int
    late: int
    longest: int
    by_us: np.ndarray
    setpoints: int
    step_m: float
    most: tuple[float, float, float]
    received: int
    overruns: int
    dropped: int

    @classmethod
    def of_bytes(cls, data: bytes) -> Record:
        """Read it as it stands in the board's memory."""
        values = RECORD.unpack(data)
        ticks, late, longest_ns = values[:3]
        by_us = np.array(values[3 : 3 + TICK_BINS])
        setpoints, step, *most = values[3 + TICK_BINS : 8 + TICK_BINS]
        return cls(
            ticks, late, longest_ns // INSTRUCTION_NS, by_us, setpoints, step,
            (most[0], most[1], most[2]), *values[8 + TICK_BINS :],
        )  # fmt: skip

    def median(self, before: Record | None = None) -> float:
        """Median of the ticks, those after an earlier record [instructions, to 125]."""
        count = self.by_us if before is None else self.by_us - before.by_us
        middle = int(np.searchsorted(np.cumsum(count), np.sum(count) / 2))
        return (middle + 0.5) * 1e3 / INSTRUCTION_NS


class EmulatedBoard:
    """The board in QEMU. Use it as a context; `port` is its line: a pseudo-terminal's path."""

    def __init__(self, elf: Path, folder: Path) -> None:
        self._elf = elf
        self._names = symbols(elf)
        self._control = folder / f"qmp-{os.getpid()}-{id(self):x}"
        self._memory = self._control.with_suffix(".memory")
        self._debug = self._control.with_suffix(".gdb")
        self._debugger: Debugger | None = None
        self._machine: subprocess.Popen[bytes] | None = None
        self.port = ""

    def __enter__(self) -> Self:
        command = [
            "qemu-system-arm", "-M", "netduinoplus2", "-nodefaults", "-display", "none",
            "-icount", f"shift={ICOUNT_SHIFT}", "-kernel", str(self._elf),
            "-chardev", "pty,id=line", "-serial", "chardev:line",
            "-qmp", f"unix:{self._control},server=on,wait=off",
            "-gdb", f"unix:{self._debug},server=on,wait=off",
        ]  # fmt: skip
        self._machine = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._qmp = _connected(self._control, self._machine)
        self._answers = self._qmp.makefile("r")
        json.loads(self._answers.readline())
        self.order("qmp_capabilities")
        [line] = [c for c in self.order("query-chardev") if c["label"] == "line"]
        self.port = line["filename"].removeprefix("pty:")
        return self

    def __exit__(self, *_: object) -> None:
        assert self._machine is not None
        self._qmp.close()
        if self._debugger is not None:
            self._debugger.close()
        self._machine.terminate()
        self._machine.wait(10)
        for path in (self._control, self._memory, self._debug):
            path.unlink(missing_ok=True)

    def order(self, name: str, **arguments: Any) -> Any:
        """Give QEMU an order (QMP) and return its answer."""
        order = {"execute": name, "arguments": arguments}
        self._qmp.sendall(json.dumps(order).encode())
        while True:
            answer = json.loads(self._answers.readline())
            if "error" in answer:
                raise RuntimeError(f"{name}: {answer['error']['desc']}")
            if "return" in answer:
                return answer["return"]

    def memory(self, name: str, size: int) -> bytes:
        """Return the bytes of a variable of the firmware."""
        self.order("pmemsave", val=self._names[name], size=size, filename=str(self._memory))
        return self._memory.read_bytes()

    def record(self) -> Record:
        """Return what the board has seen so far."""
        return Record.of_bytes(self.memory("record", RECORD.size))

    def hear(self, data: bytes) -> None:
        """Put bytes into the board's ring of those that came, as if the line had brought them.

        QEMU's line brings 20 to 50 bytes in a millisecond, half of the real one. A full ring is the
        most that a line of any speed can do to a tick. The line must be quiet meanwhile.
        """
        if self._debugger is None:
            assert self._machine is not None
            self._debugger = Debugger(_connected(self._debug, self._machine))
        ring = self._names["received"]
        self._debugger.pause()
        came, read = struct.unpack("<2I", self._debugger.read(ring, 8))
        if came - read + len(data) > RING_BYTES:
            raise RuntimeError(f"{len(data)} bytes, room in the ring: {RING_BYTES - came + read}")
        for at in range(0, len(data), PART):
            part, place = data[at : at + PART], (came + at) % RING_BYTES
            first = part[: RING_BYTES - place]
            self._debugger.write(ring + 8 + place, first)
            if first != part:
                self._debugger.write(ring + 8, part[len(first) :])
        self._debugger.write(ring, struct.pack("<I", (came + len(data)) % 2**32))
        self._debugger.go()

    def room(self) -> int:
        """How many bytes `hear` could add [bytes]."""
        came, read = struct.unpack("<2I", self.memory("received", 8))
        return RING_BYTES - (came - read) % 2**32

    def reset(self) -> None:
        """Reset the chip; its memory keeps what it held."""
        self.order("system_reset")


class Debugger:
    """As much of GDB's remote protocol as it takes to change the memory of a machine."""

    def __init__(self, line: socket.socket) -> None:
        self._line = line  # the machine has stopped as it was connected
        self._running = False
        self._held = b""
        self._ask(b"QStartNoAckMode")

    def close(self) -> None:
        """Let the machine go, for good."""
        if not self._running:
            self.go()
        self._line.close()

    def pause(self) -> None:
        """Stop the machine, and its time."""
        if self._running:
            self._line.sendall(b"\x03")
            self._answer()
            self._running = False

    def go(self) -> None:
        """Let the machine run."""
        self._send(b"c")
        self._running = True

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of memory."""
        return bytes.fromhex(self._ask(f"m{address:x},{size:x}".encode()).decode())

    def write(self, address: int, data: bytes) -> None:
        """Change bytes of memory."""
        answer = self._ask(f"M{address:x},{len(data):x}:{data.hex()}".encode())
        if answer != b"OK":
            raise RuntimeError(f"debugger: write at {address:#x}: {answer!r}")

    def _send(self, order: bytes) -> None:
        self._line.sendall(b"$" + order + f"#{sum(order) % 256:02x}".encode())

    def _ask(self, order: bytes) -> bytes:
        self._send(order)
        while (answer := self._answer())[:1] == b"T":
            pass  # some versions tell at once that the machine has stopped, others only when asked
        return answer

    def _answer(self) -> bytes:
        while b"#" not in self._held[:-2]:
            data = self._line.recv(4096)
            if not data:
                raise RuntimeError("debugger: QEMU has closed the line")
            self._held += data
        answer, _, rest = self._held.partition(b"#")
        self._held = rest[2:]
        return answer.partition(b"$")[2]


def _connected(path: Path, machine: subprocess.Popen[bytes]) -> socket.socket:
    """Connect to a socket that QEMU makes as it starts."""
    line = socket.socket(socket.AF_UNIX)
    while machine.poll() is None:
        try:
            line.connect(str(path))
        except OSError:
            time.sleep(0.01)
        else:
            line.settimeout(20)
            return line
    raise RuntimeError(f"qemu-system-arm ended with {machine.returncode}")
