"""The board of firmware/boards/stm32f405 in an emulator: built, started, its line and its record.

QEMU's `netduinoplus2` is an STM32F405. It runs with `-icount shift=3`: each instruction takes 8 ns
of virtual time, so that a tick's length, which the firmware measures by its timer, counts its
instructions. A byte takes no time on that line: a host that is to be real must keep its pace.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
import yaml

BOARD = Path(__file__).resolve().parents[1] / "firmware" / "boards" / "stm32f405"
ICOUNT_SHIFT = 3
INSTRUCTION_NS = 2**ICOUNT_SHIFT
RING_BYTES = 4096
"""`ROOM` of usart.c."""

RECORD = np.dtype(
    (
        np.record,
        [
            ("ticks", "<u4"), ("late", "<u4"), ("longest_ns", "<u4"), ("by_us", "<u4", 1024),
            ("setpoints", "<u4"), ("step_m", "<f4"), ("most", "<f4", 3),
            ("received", "<u4"), ("overruns", "<u4"), ("dropped", "<u4"),
        ],
    )
)  # fmt: skip
"""`Record` of board.h, what the board has seen since its reset: ticks, those that lasted into the
next one's time, the longest, and how many took so many microseconds; setpoints, the longest step of
a motor between two that are a tick apart [m], and most travel [m], speed [m/s] and acceleration
[m/s2] of all motors; bytes that came, times that the line ran over, frames that found no room."""

ANSWER_S = 60.0
"""The machine may be busy: longest wait for an answer of QEMU [s]."""

MOST_BYTES = 1024
"""Of memory that are asked for at once: QEMU takes twice as many."""

NEEDS = ("arm-none-eabi-gcc", "qemu-system-arm")
"""Of tools/needs.py."""


def built(out: Path, **options: str | Path) -> Path:
    """Build the firmware into a folder, with variables of its Makefile; returns plate.elf."""
    values = [f"{name}={value}" for name, value in options.items()] + [f"PYTHON={sys.executable}"]
    command = ["make", "-C", str(BOARD), f"BUILD={out}", *values]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return out / "plate.elf"


def unfollowed(rig: Path, folder: Path) -> Path:
    """Write a rig file without watch over the following error, for a plate that is not there."""
    facts = yaml.safe_load(rig.read_text(encoding="utf-8"))
    facts["limits"]["following_error_m"] = 0
    path = folder / rig.name
    path.write_text(yaml.safe_dump(facts), encoding="utf-8")
    return path


def symbols(elf: Path) -> dict[str, int]:
    """Return name and address of all that is linked."""
    listed = subprocess.run(
        ["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in listed.stdout.splitlines()]
    return {row[-1]: int(row[0], 16) for row in rows if len(row) == 3}


def median_ticks(record: np.record, before: np.record) -> float:
    """Median of the ticks since an earlier record [instructions, to 125]."""
    count = record.by_us - before.by_us
    middle = int(np.searchsorted(np.cumsum(count), np.sum(count) / 2))
    return (middle + 0.5) * 1e3 / INSTRUCTION_NS


class EmulatedBoard:
    """The board in QEMU, tick by tick: nothing depends on how busy the machine is.

    A debugger stops it when it has nothing to do until the next tick: QEMU then lets time jump to
    that, wherever it stands. It stops at data, for after a breakpoint or a step QEMU translates the
    whole program anew; at each tick's own, for it would not leave the place where it has stopped.
    Bytes are put into the ring of those that came, as if the line had brought them since the
    tick before: QEMU's own line has no pace. Use it as a context.

    Parameters
    ----------
    elf : Path
        What it runs.
    idle : str
        Name of two words, of which the board reads one when it has nothing to do: the first and the
        second one in turn, another one after each tick.
    more : sequence of str
        Words for QEMU.
    """

    def __init__(self, elf: Path, idle: str = "waits", more: Sequence[str] = ()) -> None:
        self.names = symbols(elf)
        self._elf, self._idle, self._more = elf, self.names[idle], more

    def __enter__(self) -> Self:
        self._line, line = socket.socketpair()
        debugger, gdb = socket.socketpair()
        with line, gdb:
            command = [
                "qemu-system-arm", "-M", "netduinoplus2", "-nodefaults", "-display", "none", "-S",
                "-kernel", str(self._elf), "-icount", f"shift={ICOUNT_SHIFT},sleep=off",
                "-chardev", f"socket,id=line,fd={line.fileno()}", "-serial", "chardev:line",
                "-chardev", f"socket,id=gdb,fd={gdb.fileno()}", "-gdb", "chardev:gdb", *self._more,
            ]  # fmt: skip
            self._machine = subprocess.Popen(command, pass_fds=(line.fileno(), gdb.fileno()))
        self._line.setblocking(False)
        self._debugger = Debugger(debugger)
        self._rest(0)
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()
        self._debugger.close()
        self._machine.terminate()
        self._machine.wait(10)

    def memory(self, name: str, size: int) -> bytes:
        """Return the bytes of a variable of the firmware."""
        return self._debugger.read(self.names[name], size)

    def record(self) -> np.record:
        """Return what the board has seen so far, as `RECORD`."""
        found: np.record = np.frombuffer(self.memory("record", RECORD.itemsize), RECORD)[0]
        return found

    def _rest(self, word: int) -> None:
        """Let it run until it has nothing to do, and reads one of the two words."""
        self._word = word
        self._debugger.go_to_read(self._idle + 4 * word)

    def tick(self, data: bytes = b"") -> bytes:
        """Let one tick pass, which finds these bytes come, `room` at most; returns answers."""
        if data:
            self._come(data)
        self._rest(1 - self._word)
        said = b""
        with contextlib.suppress(BlockingIOError):
            while some := self._line.recv(65_536):
                said += some
        return said

    def room(self) -> int:
        """How many bytes the board can be brought before it has read."""
        came, read = self._counts()
        return RING_BYTES - (came - read) % 2**32

    def _come(self, data: bytes) -> None:
        ring, (came, _) = self.names["received"], self._counts()
        place = came % RING_BYTES
        first = data[: RING_BYTES - place]
        self._debugger.write(ring + 8 + place, first)
        if first != data:
            self._debugger.write(ring + 8, data[len(first) :])
        self._debugger.write(ring, struct.pack("<I", (came + len(data)) % 2**32))

    def _counts(self) -> tuple[int, int]:
        """Return how many bytes have come, and were read."""
        return struct.unpack("<2I", self.memory("received", 8))


class Debugger:
    """As much of GDB's remote protocol as it takes to stop a machine and to change its memory.

    Parameters
    ----------
    line : socket
        To QEMU's server; the machine stands still.
    """

    def __init__(self, line: socket.socket) -> None:
        self._line, self._held = line, b""
        line.settimeout(ANSWER_S)
        self.ask(b"QStartNoAckMode")

    def close(self) -> None:
        """Hang up; the machine stays as it is."""
        self._line.close()

    def go_to_read(self, address: int) -> None:
        """Let the machine run until it is about to read a word."""
        self.order(f"Z3,{address:x},4")
        self.run(b"c")
        self.order(f"z3,{address:x},4")

    def run(self, order: bytes) -> None:
        """Let the machine run, or step, until it stops."""
        self._send(order)
        answer = self._answer()
        if answer[:3] not in (b"T05", b"S05"):
            raise RuntimeError(f"debugger: the machine has stopped: {answer!r}")

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of memory."""
        end, data = address + size, b""
        for begin in range(address, end, MOST_BYTES):
            some = min(MOST_BYTES, end - begin)
            data += bytes.fromhex(self.ask(f"m{begin:x},{some:x}".encode()).decode())
        return data

    def write(self, address: int, data: bytes) -> None:
        """Change bytes of memory."""
        self.order(f"M{address:x},{len(data):x}:{data.hex()}")

    def order(self, order: str) -> None:
        """Give an order that is answered OK."""
        answer = self.ask(order.encode())
        if answer != b"OK":
            raise RuntimeError(f"debugger: {order[:20]}: {answer!r}")

    def _send(self, order: bytes) -> None:
        self._line.sendall(b"$" + order + f"#{sum(order) % 256:02x}".encode())

    def ask(self, order: bytes) -> bytes:
        """Send an order and return its answer."""
        self._send(order)
        while (answer := self._answer())[:1] == b"T":
            pass  # some versions tell at once that the machine has stopped, others only when asked
        return answer

    def _answer(self) -> bytes:
        while b"#" not in self._held[:-2]:
            try:
                data = self._line.recv(4096)
            except TimeoutError:
                raise RuntimeError(f"debugger: no answer from QEMU in {ANSWER_S:g} s") from None
            if not data:
                raise RuntimeError("debugger: QEMU has closed the line")
            self._held += data
        answer, _, rest = self._held.partition(b"#")
        self._held = rest[2:]
        return answer.partition(b"$")[2]
