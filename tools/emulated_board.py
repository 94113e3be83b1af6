"""Build the firmware of firmware/boards/stm32f405, and run the program in the emulator QEMU.

QEMU's machine `netduinoplus2` has an STM32F405. With `-icount shift=3` each instruction takes 8 ns
of virtual time. The firmware measures the length of a tick by its timer, so this length is
proportional to the number of instructions. The emulated line has no baud rate, so a realistic host
must limit its own rate.
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
"""Size of the board's receive ring [bytes], `ROOM` in usart.c."""

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
"""`Record` of board.h: the board's counts and maximum values since its reset.

ticks, late, longest_ns, by_us: Number of ticks, number of ticks that lasted beyond the start of the
next tick, longest tick [ns], histogram of tick lengths [us].
setpoints, step_m, most: Number of setpoints, maximum step of a motor between setpoints of
    successive ticks [m], maximum travel [m], speed [m/s] and acceleration [m/s2] of all motors.
received, overruns, dropped: Number of received bytes, of receiver overruns, and of frames that did
    not fit into the send buffer.
"""

ANSWER_S = 60.0
"""Maximum wait for a reply of QEMU [s]. The value is large, because the computer can be busy."""

MAX_BYTES = 1024
"""Maximum number of bytes per memory request. This number is half of QEMU's limit."""

NEEDS = ("arm-none-eabi-gcc", "qemu-system-arm")
"""Required programs, by their names in tools/needs.py."""


def build_firmware(out: Path, **options: str | Path) -> Path:
    """Build the firmware into a folder, with these Makefile variables. Return the path of
    plate.elf."""
    values = [f"{name}={value}" for name, value in options.items()] + [f"PYTHON={sys.executable}"]
    command = ["make", "-C", str(BOARD), f"BUILD={out}", *values]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return out / "plate.elf"


def rig_without_following_check(rig: Path, folder: Path) -> Path:
    """Write a rig file without supervision of the following error, because the emulated board has
    no plate. Return the path of the file."""
    facts = yaml.safe_load(rig.read_text(encoding="utf-8"))
    facts["limits"]["following_error_m"] = 0
    path = folder / rig.name
    path.write_text(yaml.safe_dump(facts), encoding="utf-8")
    return path


def read_symbols(elf: Path) -> dict[str, int]:
    """Return the addresses of all symbols in a linked program, by name."""
    listed = subprocess.run(
        ["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in listed.stdout.splitlines()]
    return {row[-1]: int(row[0], 16) for row in rows if len(row) == 3}


def median_ticks(record: np.record, before: np.record) -> float:
    """Return the median tick length since an earlier record [instructions]. The resolution is 125
    instructions."""
    count = record.by_us - before.by_us
    middle = int(np.searchsorted(np.cumsum(count), np.sum(count) / 2))
    return (middle + 0.5) * 1e3 / INSTRUCTION_NS


class EmulatedBoard:
    """The board in QEMU, simulated tick by tick. The result does not depend on the computer's load.

    A debugger stops the board when it is idle until the next tick. QEMU's virtual time then jumps
    to this tick. The debugger uses a read watchpoint, because QEMU translates the whole program
    again after a breakpoint or a single step. The watched word alternates between two words from
    tick to tick. With a single word, the board would stop at this word again at once. Received
    bytes are written into the board's receive ring, as if they had arrived during the tick. Use the
    object as a context manager.

    Parameters
    ----------
    elf : Path
        Program to run.
    idle : str
        Name of an array of two words. The idle board reads one word in one tick, and the other word
        in the next tick.
    more : sequence of str
        Additional arguments of QEMU.
    """

    def __init__(self, elf: Path, idle: str = "waits", more: Sequence[str] = ()) -> None:
        self.names = read_symbols(elf)
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
        self._run_until_idle(0)
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
        """Return the board's `RECORD`."""
        found: np.record = np.frombuffer(self.memory("record", RECORD.itemsize), RECORD)[0]
        return found

    def _run_until_idle(self, word: int) -> None:
        """Run until the board is idle and reads the given word (0 or 1) of the array `idle`."""
        self._word = word
        self._debugger.go_to_read(self._idle + 4 * word)

    def tick(self, data: bytes = b"") -> bytes:
        """Simulate one tick in which the board receives `data`, at most `free_bytes` bytes. Return
        the bytes that the board has sent."""
        if data:
            self._receive(data)
        self._run_until_idle(1 - self._word)
        sent = b""
        with contextlib.suppress(BlockingIOError):
            while some := self._line.recv(65_536):
                sent += some
        return sent

    def free_bytes(self) -> int:
        """Return the free space in the board's receive ring [bytes]."""
        received, read = self._byte_counts()
        return RING_BYTES - (received - read) % 2**32

    def _receive(self, data: bytes) -> None:
        ring, (received, _) = self.names["received"], self._byte_counts()
        place = received % RING_BYTES
        first = data[: RING_BYTES - place]
        self._debugger.write(ring + 8 + place, first)
        if first != data:
            self._debugger.write(ring + 8, data[len(first) :])
        self._debugger.write(ring, struct.pack("<I", (received + len(data)) % 2**32))

    def _byte_counts(self) -> tuple[int, int]:
        """Return the number of bytes that the board has received, and the number of bytes that it
        has read."""
        return struct.unpack("<2I", self.memory("received", 8))


class Debugger:
    """Client for the part of GDB's remote protocol that stops a machine and accesses its memory.

    Parameters
    ----------
    line : socket
        Socket connected to QEMU's GDB server. The machine is halted.
    """

    def __init__(self, line: socket.socket) -> None:
        self._line, self._held = line, b""
        line.settimeout(ANSWER_S)
        self.ask(b"QStartNoAckMode")

    def close(self) -> None:
        """Close the connection. The machine keeps its state."""
        self._line.close()

    def go_to_read(self, address: int) -> None:
        """Run the machine until it reads the word at an address."""
        self.order(f"Z3,{address:x},4")
        self.run(b"c")
        self.order(f"z3,{address:x},4")

    def run(self, order: bytes) -> None:
        """Send an order that runs the machine, and wait until it stops."""
        self._send(order)
        answer = self._read_reply()
        if answer[:3] not in (b"T05", b"S05"):
            raise RuntimeError(f"debugger: the processor has stopped: {answer!r}")

    def read(self, address: int, size: int) -> bytes:
        """Return `size` bytes of memory from an address."""
        end, data = address + size, b""
        for begin in range(address, end, MAX_BYTES):
            some = min(MAX_BYTES, end - begin)
            data += bytes.fromhex(self.ask(f"m{begin:x},{some:x}".encode()).decode())
        return data

    def write(self, address: int, data: bytes) -> None:
        """Write bytes to memory at an address."""
        self.order(f"M{address:x},{len(data):x}:{data.hex()}")

    def order(self, order: str) -> None:
        """Send an order that must be answered with OK."""
        answer = self.ask(order.encode())
        if answer != b"OK":
            raise RuntimeError(f"debugger: {order[:20]}: {answer!r}")

    def _send(self, order: bytes) -> None:
        self._line.sendall(b"$" + order + f"#{sum(order) % 256:02x}".encode())

    def ask(self, order: bytes) -> bytes:
        """Send an order and return its answer."""
        self._send(order)
        while (answer := self._read_reply())[:1] == b"T":
            pass  # ignore stop reports, which some QEMU versions send without a request
        return answer

    def _read_reply(self) -> bytes:
        while b"#" not in self._held[:-2]:
            try:
                data = self._line.recv(4096)
            except TimeoutError:
                raise RuntimeError(f"debugger: no answer from QEMU in {ANSWER_S:g} s") from None
            if not data:
                raise RuntimeError("debugger: QEMU has closed the connection")
            self._held += data
        answer, _, rest = self._held.partition(b"#")
        self._held = rest[2:]
        return answer.partition(b"$")[2]
