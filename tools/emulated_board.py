"""The board of firmware/boards/stm32f405 in an emulator: built, started, its line and its record.

QEMU's `netduinoplus2` is an STM32F405. It runs with `-icount shift=3`: each instruction takes 8 ns
of virtual time, so that a tick's length, which the firmware measures by its timer, counts its
instructions. A byte takes no time on that line: a host that is to be real must keep its pace.
"""

from __future__ import annotations

import contextlib
import json
import select
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

BOARD = Path(__file__).resolve().parents[1] / "firmware" / "boards" / "stm32f405"
ICOUNT_SHIFT = 3
INSTRUCTION_NS = 2**ICOUNT_SHIFT
TICK_BINS = 1024
RING_BYTES = 4096
"""`ROOM` of usart.c."""

TICK_BYTES = 128
"""That a tick reads (`controller.h`)."""

RECORD = struct.Struct(f"<3I{TICK_BINS}II4f3I")
"""`Record` of board.h."""

ANSWER_S = 60.0
"""The machine may be busy: longest wait for an answer of QEMU [s]."""

POKE_S = 0.2
"""Without a word from QEMU it is woken [s]."""

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
    """The board in QEMU, in real time as far as the machine can. Use it as a context; `port` is its
    line: a pseudo-terminal's path."""

    _options: ClassVar[tuple[str, ...]] = ("-icount", f"shift={ICOUNT_SHIFT}")

    def __init__(self, elf: Path, folder: Path) -> None:
        self.names = symbols(elf)
        self._elf = elf
        self._folder = Path(tempfile.mkdtemp(dir=folder))
        self._control = self._folder / "qmp"
        self.port = ""

    def __enter__(self) -> Self:
        command = [
            "qemu-system-arm", "-M", "netduinoplus2", "-nodefaults", "-display", "none",
            "-kernel", str(self._elf), *self._options,
            "-chardev", self._chardev(), "-serial", "chardev:line",
            "-qmp", f"unix:{self._control},server=on,wait=off",
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

    def _chardev(self) -> str:
        return "pty,id=line"

    def __exit__(self, *_: object) -> None:
        self._answers.close()
        self._qmp.close()
        self._machine.terminate()
        self._machine.wait(10)
        shutil.rmtree(self._folder)

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
        file = self._folder / "memory"
        self.order("pmemsave", val=self.names[name], size=size, filename=str(file))
        return file.read_bytes()

    def record(self) -> Record:
        """Return what the board has seen so far."""
        return Record.of_bytes(self.memory("record", RECORD.size))

    def reset(self) -> None:
        """Reset the chip; its memory keeps what it held."""
        self.order("system_reset")


class SteppedBoard(EmulatedBoard):
    """The board in QEMU, tick by tick: nothing depends on how busy the machine is.

    A debugger stops it when it has nothing to do until the next tick: QEMU then lets time jump to
    that. Bytes are put into the ring of those that came, as if the line had brought them since the
    tick before: QEMU's own line has no pace.
    """

    _options = ("-icount", f"shift={ICOUNT_SHIFT},sleep=off", "-S")

    def _chardev(self) -> str:
        return f"socket,id=line,path={self._folder / 'line'},server=on,wait=off"

    def __enter__(self) -> Self:
        super().__enter__()
        self._out = _connected(self._folder / "line", self._machine)
        self._out.setblocking(False)
        while "disconnected" in str(self.order("query-chardev")):
            time.sleep(1e-3)
        gdb = self._folder / "gdb"
        self.order("human-monitor-command", **{
            "command-line": f"gdbserver unix:{gdb},server=on,wait=off"
        })  # fmt: skip
        self._said = b""
        self._debugger = Debugger(
            _connected(gdb, self._machine), self._out, self._listen,
            lambda: self.order("query-status"),
        )  # fmt: skip
        self._debugger.stop_at(self.names["idle"])
        self._debugger.go()
        return self

    def __exit__(self, *_: object) -> None:
        self._out.close()
        self._debugger.close()
        super().__exit__()

    def tick(self, data: bytes = b"") -> bytes:
        """Let one tick pass, which finds these bytes come; returns what was said in it.

        Raises
        ------
        RuntimeError
            If the board has no room for so many bytes.
        """
        if data:
            self._come(data)
        self._debugger.go()
        self._listen()
        said, self._said = self._said, b""
        return said

    def _listen(self) -> None:
        """Read what the board says; QEMU waits if nobody does."""
        with contextlib.suppress(BlockingIOError):
            while data := self._out.recv(65_536):
                self._said += data

    def _come(self, data: bytes) -> None:
        ring = self.names["received"]
        came, read = struct.unpack("<2I", self._debugger.read(ring, 8))
        if came - read + len(data) > RING_BYTES:
            raise RuntimeError(f"{len(data)} bytes, room in the ring: {RING_BYTES - came + read}")
        place = came % RING_BYTES
        first = data[: RING_BYTES - place]
        self._debugger.write(ring + 8 + place, first)
        if first != data:
            self._debugger.write(ring + 8, data[len(first) :])
        self._debugger.write(ring, struct.pack("<I", (came + len(data)) % 2**32))


class Debugger:
    """As much of GDB's remote protocol as it takes to stop a machine and to change its memory.

    Parameters
    ----------
    line : socket
        Of QEMU's server; the machine stands still.
    other : socket
        On which something may come meanwhile.
    listen : callable
        Reads it.
    poke : callable
        Asks QEMU something, so that it wakes up; raises where it has ended.
    """

    def __init__(
        self, line: socket.socket, other: socket.socket, listen: Callable[[], None],
        poke: Callable[[], object],
    ) -> None:  # fmt: skip
        self._line, self._other, self._listen, self._poke = line, other, listen, poke
        self._held = b""
        self._ask(b"QStartNoAckMode")
        self._ask(b"Qqemu.sstep=1")  # time goes on in a single step, which may be a wait

    def close(self) -> None:
        """Hang up; the machine stays as it is."""
        self._line.close()

    def stop_at(self, address: int) -> None:
        """Have the machine stop where it comes to an address."""
        self._order(f"Z0,{address:x},2")

    def go(self) -> None:
        """Let the machine run until it stops again."""
        for order in (b"s", b"c"):  # it would not leave the address where it has stopped
            self._send(order)
            answer = self._answer()
            if answer[:3] not in (b"T05", b"S05"):
                raise RuntimeError(f"debugger: the machine has stopped: {answer!r}")

    def read(self, address: int, size: int) -> bytes:
        """Return bytes of memory."""
        return bytes.fromhex(self._ask(f"m{address:x},{size:x}".encode()).decode())

    def write(self, address: int, data: bytes) -> None:
        """Change bytes of memory."""
        self._order(f"M{address:x},{len(data):x}:{data.hex()}")

    def _order(self, order: str) -> None:
        answer = self._ask(order.encode())
        if answer != b"OK":
            raise RuntimeError(f"debugger: {order[:20]}: {answer!r}")

    def _send(self, order: bytes) -> None:
        self._line.sendall(b"$" + order + f"#{sum(order) % 256:02x}".encode())

    def _ask(self, order: bytes) -> bytes:
        self._send(order)
        while (answer := self._answer())[:1] == b"T":
            pass  # some versions tell at once that the machine has stopped, others only when asked
        return answer

    def _answer(self) -> bytes:
        while b"#" not in self._held[:-2]:
            ready, _, _ = select.select([self._line, self._other], [], [], POKE_S)
            if not ready:
                self._poke()
            if self._other in ready:
                self._listen()
            if self._line not in ready:
                continue
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
            line.settimeout(ANSWER_S)
            return line
    raise RuntimeError(f"qemu-system-arm ended with {machine.returncode}")
