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
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml

BOARD = Path(__file__).resolve().parents[1] / "firmware" / "boards" / "stm32f405"
ICOUNT_SHIFT = 3
INSTRUCTION_NS = 2**ICOUNT_SHIFT
TICK_BINS = 1024
RING_BYTES = 4096
"""`ROOM` of usart.c."""


RECORD = struct.Struct(f"<3I{TICK_BINS}II4f3I")
"""`Record` of board.h."""

ANSWER_S = 60.0
"""The machine may be busy: longest wait for an answer of QEMU [s]."""

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
    """The board in QEMU, tick by tick: nothing depends on how busy the machine is.

    A debugger stops it when it has nothing to do until the next tick: QEMU then lets time jump to
    that, wherever it stands. It stops at data, for after a breakpoint or a step QEMU translates the
    whole program anew; at each tick's own, for it would not leave the place where it has stopped.
    Bytes are put into the ring of those that came, as if the line had brought them since the
    tick before: QEMU's own line has no pace. Use it as a context.

    Parameters
    ----------
    elf, folder : Path
        What it runs, and where its files are meanwhile.
    idle : str
        Name of two words, of which the board reads one when it has nothing to do: the first and the
        second one in turn, another one after each tick.
    """

    def __init__(self, elf: Path, folder: Path, idle: str = "waits") -> None:
        self.names = symbols(elf)
        self._elf, self._idle = elf, self.names[idle]
        self._folder = Path(tempfile.mkdtemp(dir=folder))
        self.more: list[str] = []  # words for QEMU

    def __enter__(self) -> Self:
        control, line, gdb = (self._folder / name for name in ("qmp", "line", "gdb"))
        command = [
            "qemu-system-arm", "-M", "netduinoplus2", "-nodefaults", "-display", "none",
            "-kernel", str(self._elf), "-icount", f"shift={ICOUNT_SHIFT},sleep=off", "-S",
            "-chardev", f"socket,id=line,path={line},server=on,wait=off", "-serial", "chardev:line",
            "-qmp", f"unix:{control},server=on,wait=off", *self.more,
        ]  # fmt: skip
        self._machine = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._qmp = _connected(control, self._machine)
        self._heard = self._said = b""
        self._answer()
        self.order("qmp_capabilities")
        self._line = _connected(line, self._machine)
        self._line.setblocking(False)
        while "disconnected" in str(self.order("query-chardev")):
            time.sleep(1e-3)
        self.order("human-monitor-command", **{
            "command-line": f"gdbserver unix:{gdb},server=on,wait=off"
        })  # fmt: skip
        self._debugger = Debugger(
            _connected(gdb, self._machine), [self._line, self._qmp], self._listen
        )
        self._rest(0)
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()
        self._debugger.close()
        self._qmp.close()
        self._machine.terminate()
        self._machine.wait(10)
        shutil.rmtree(self._folder)

    def order(self, name: str, **arguments: Any) -> Any:
        """Give QEMU an order (QMP) and return its answer."""
        order = {"execute": name, "arguments": arguments}
        self._qmp.sendall(json.dumps(order).encode())
        while True:
            answer = self._answer()
            if "error" in answer:
                raise RuntimeError(f"{name}: {answer['error']['desc']}")
            if "return" in answer:
                return answer["return"]

    def _answer(self) -> dict[str, Any]:
        """Return what QEMU says next: a greeting, an answer or an event."""
        while b"\n" not in self._heard:
            data = self._qmp.recv(65_536)
            if not data:
                raise RuntimeError("QEMU has closed the line for orders")
            self._heard += data
        line, _, self._heard = self._heard.partition(b"\n")
        return dict(json.loads(line))

    def memory(self, name: str, size: int) -> bytes:
        """Return the bytes of a variable of the firmware."""
        file = self._folder / "memory"
        self.order("pmemsave", val=self.names[name], size=size, filename=str(file))
        return file.read_bytes()

    def record(self) -> Record:
        """Return what the board has seen so far."""
        return Record.of_bytes(self.memory("record", RECORD.size))

    def _rest(self, word: int) -> None:
        """Let it run until it has nothing to do, and reads one of the two words."""
        self._word = word
        self._debugger.go_to_read(self._idle + 4 * word)

    def tick(self, data: bytes = b"") -> bytes:
        """Let one tick pass, which finds these bytes come, `room` at most; returns answers."""
        if data:
            self._come(data)
        self._rest(1 - self._word)
        self._listen()
        said, self._said = self._said, b""
        return said

    def _listen(self) -> None:
        """Read what the board says, and QEMU of each stop: it waits if nobody reads."""
        while select.select([self._qmp], [], [], 0)[0] and self._qmp.recv(65_536):
            pass
        with contextlib.suppress(BlockingIOError):
            while data := self._line.recv(65_536):
                self._said += data

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
        return struct.unpack("<2I", self._debugger.read(self.names["received"], 8))


class Debugger:
    """As much of GDB's remote protocol as it takes to stop a machine and to change its memory.

    Parameters
    ----------
    line : socket
        Of QEMU's server; the machine stands still.
    others : list of socket
        On which something may come meanwhile.
    listen : callable
        Reads it.
    """

    def __init__(
        self, line: socket.socket, others: list[socket.socket], listen: Callable[[], None]
    ) -> None:
        self._line, self._others, self._listen = line, others, listen
        self._held = b""
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
        return bytes.fromhex(self.ask(f"m{address:x},{size:x}".encode()).decode())

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
            ready, _, _ = select.select([self._line, *self._others], [], [], ANSWER_S)
            if not ready:
                raise RuntimeError(f"debugger: no answer from QEMU in {ANSWER_S:g} s")
            if ready != [self._line]:
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
