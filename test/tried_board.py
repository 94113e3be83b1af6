"""The emulated board with functions for tests: reset, jump to an address, log of written
registers."""

import re
import struct
import subprocess
from pathlib import Path

from emulated_board import EmulatedBoard

WRITTEN = re.compile(
    r"^(\S+): unimplemented device write \(size 4, offset (0x[0-9a-f]+), value (0x[0-9a-f]+)\)",
    re.MULTILINE,
)
BSRR, ENABLE_HIGH, ENABLE_LOW = 0x18, 1 << 10, 1 << 26
"""Offset of GPIOB's register that sets and resets pins, and the bits of PB10 in it."""


def assembled(source: str, elf: Path) -> Path:
    """Assemble a program for the board's processor, and return its path."""
    command = [
        "arm-none-eabi-gcc", "-nostdlib", "-mcpu=cortex-m4", "-x", "assembler", "-",
        "-Wl,-Ttext=0x08000100,--section-start=.vectors=0x08000000,-Tbss=0x20000000,-e,start",
        "-o", str(elf),
    ]  # fmt: skip
    subprocess.run(command, input=source, text=True, check=True, timeout=60)
    return elf


class TriedBoard(EmulatedBoard):
    """Board that logs the values written to units that QEMU does not model."""

    def __init__(self, elf: Path, folder: Path) -> None:
        self._log = folder / "log"
        super().__init__(elf, more=["-d", "unimp", "-D", str(self._log)])

    def reset(self) -> None:
        """Reset the chip, and let it start. Its memory keeps its content."""
        self._debugger.order(f"qRcmd,{b'system_reset'.hex()}")
        self._run_until_idle(0)

    def jump(self, address: int) -> None:
        """Let the processor continue at an address, valid or invalid."""
        # QEMU sets no registers before this query.
        self._debugger.ask(b"qXfer:features:read:target.xml:0,ff")
        self._debugger.order(f"Pf={struct.pack('<I', address).hex()}")
        self.walk(1000)

    def walk(self, instructions: int) -> None:
        """Execute a number of instructions, without interrupts."""
        for _ in range(instructions):
            self._debugger.run(b"s")

    def write(self, data: bytes) -> None:
        """Send bytes on QEMU's line. The line has no baud rate: bytes arrive when the board reads
        them."""
        self._line.setblocking(True)
        self._line.sendall(data)
        self._line.setblocking(False)

    def written(self) -> list[tuple[str, int, int]]:
        """Return the values written to these units: name of the unit, offset of the register,
        value."""
        log = self._log.read_text(encoding="utf-8")
        return [(unit, int(at, 16), int(value, 16)) for unit, at, value in WRITTEN.findall(log)]

    def enabled(self) -> bool:
        """Whether the pin that enables the bridges was last set high."""
        sets = [v for unit, at, v in self.written() if (unit, at) == ("GPIOB", BSRR)]
        sets = [v for v in sets if v & (ENABLE_HIGH | ENABLE_LOW)]
        return bool(sets) and sets[-1] == ENABLE_HIGH
