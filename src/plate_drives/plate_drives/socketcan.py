"""The transport `socketcan`: this computer commands the drives over a CAN interface of Linux.

The board's firmware runs as a separate real-time process, firmware/boards/linux. The driver node
communicates with this process as with a board. Tables, limits, tails, stops and drives are
therefore handled in the same way. In contrast to a board, the process may send setpoints too late.
The transport measures this delay. If the delay is too large for the rig, the transport stops the
plate.
"""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from plate_core import PlateError, Rig
from plate_core.driver_status import DriverReason
from plate_core.rig import Limits
from plate_driver.transports import (
    Condition,
    Measured,
    Order,
    Port,
    Report,
    SerialTransport,
    TransportContext,
)
from plate_sim.device import DeviceLimits, c_header

__all__ = ["HostPort", "HostTransport", "build", "make", "open_can", "program_of"]

SOURCES = Path(__file__).parent / "firmware"
"""Folder of the firmware's sources. In the source tree, the folder is a symbolic link. In the
installed package, it is a copy."""
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")

ENDED = "the process that controls the drives has ended"
FADE = 1e-3
"""Fraction by which the recorded maximum delay of setpoints decreases with each telemetry message.
The resulting time constant is about 10 s."""


def build(header: str, kind: str, folder: Path, *files: str) -> Path:
    """Compile the firmware for this computer. Return the path of the program.

    Parameters
    ----------
    header : str
        Limits and drives of a rig, see `plate_sim.device.c_header`.
    kind : str
        Kind of the drives: cia402 or odrive.
    folder : Path
        Folder of the program.
    files : str
        Further sources in firmware/, for the board.

    Raises
    ------
    PlateError
        If the firmware cannot be compiled.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "limits_rig.h").write_text(header, encoding="utf-8")
    program, names = folder / "plate", ("drives/axes.c", f"drives/{kind}.c", *files)
    sources = [*sorted(SOURCES.glob("*.c")), *(SOURCES / name for name in names)]
    command = ["cc", *FLAGS, f"-I{folder}", "-o", str(program), *map(str, sources), "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except OSError as error:
        raise PlateError(f"the firmware cannot be compiled: cc: {error.strerror}") from None
    if done.returncode:
        raise PlateError(f"the firmware cannot be compiled: {done.stderr.strip()}")
    return program


@lru_cache(maxsize=1)
def _compile_program(header: str, kind: str) -> tuple[Path, tempfile.TemporaryDirectory[str]]:
    """Compile the program only once per process. Compilation takes a second or more, which would
    delay a stop that must open a transport."""
    folder = tempfile.TemporaryDirectory(prefix="plate-")
    return build(header, kind, Path(folder.name), "boards/linux/board.c"), folder


def program_of(rig: Rig) -> Path:
    """Return the firmware for this computer and a rig.

    Raises
    ------
    PlateError
        If the rig is not suitable for this transport, or the firmware cannot be compiled.
    """
    drives = [motor.drive for motor in rig.motors if motor.drive is not None]
    if not drives:
        raise PlateError("motors: drive is bridge, but socketcan requires cia402 or odrive")
    if not rig.limits.following_error_m:
        raise PlateError(
            "limits: following_error_m is 0, but socketcan requires a value above 0, because it "
            "limits the delay of setpoints"
        )
    header = c_header(DeviceLimits.of_rig(rig), "the rig file", drives)
    try:
        return _compile_program(header, drives[0].kind)[0]
    # an OSError is raised, for example, if the disk is full
    except (OSError, subprocess.TimeoutExpired) as error:
        raise PlateError(f"the firmware cannot be compiled: {error}") from None


def open_can(channel: str) -> socket.socket:
    """Open a CAN interface of Linux. Raise a PlateError if the interface does not exist or is
    down."""
    try:
        can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        can.bind((channel,))
        if error := can.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):  # the interface is down
            raise OSError(error, os.strerror(error))
    except OSError as why:
        raise PlateError(f"CAN interface {channel} does not open ({why})") from None
    return can


class HostPort:
    """Firmware that runs in a separate process. The class has the methods of a serial port.

    When the port is closed or the driver process ends, the firmware brakes the motors, disables the
    drives and ends.

    Parameters
    ----------
    program : path
    channel : str
        Name of the bus. Only one process may command a bus.
    opened : callable
        Function that opens the bus. The function returns a socket whose datagrams are of the type
        `struct can_frame`.
    ticks : int, optional
        File descriptor from which the firmware reads its ticks, for tests. Default: a timer.

    Raises
    ------
    PlateError
        If the bus does not open, another process still commands the bus, or the program does not
        start.
    """

    def __init__(
        self,
        program: Path,
        channel: str,
        opened: Callable[[str], socket.socket] = open_can,
        ticks: int | None = None,
    ) -> None:
        with socket.socket(socket.AF_UNIX) as lock, opened(channel) as can:
            try:
                # The bound socket is a lock. The lock is released when the firmware's process has
                # ended.
                lock.bind(f"\0plate_drives {channel}")
            except OSError:
                raise PlateError(f"{channel} is still in use by another driver process") from None
            passed = (can.fileno(), *(() if ticks is None else (ticks,)))
            try:
                self._process = subprocess.Popen(
                    [program, *map(str, passed)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                    # A process in a separate session does not receive Ctrl-C.
                    pass_fds=(*passed, lock.fileno()), start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise PlateError(
                    f"{program} does not start ({error.strerror}), allowed: a folder for temporary "
                    "files (TMPDIR) that allows programs to run"
                ) from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin, self._process.stdout
        for pipe in (self._in, self._out):
            os.set_blocking(pipe.fileno(), False)

    def read(self, size: int) -> bytes:
        """Return the available bytes. Raise an OSError if the process has ended."""
        try:
            data = os.read(self._out.fileno(), size)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(ENDED)
        return data

    def write(self, data: bytes) -> int:
        """Write bytes without blocking, and return the number of written bytes. Raise an OSError if
        the process has ended."""
        try:
            return os.write(self._in.fileno(), data)
        except BlockingIOError:
            return 0
        except BrokenPipeError:
            raise OSError(ENDED) from None

    def close(self) -> None:
        """Close the pipes to the firmware's process. The process then ends."""
        self._in.close()
        self._out.close()
        threading.Thread(target=self._process.wait, daemon=True).start()


class HostTransport(SerialTransport):
    """Transport to the firmware that runs as a process on this computer.

    Parameters
    ----------
    make_port : callable
        Function that starts the firmware.
    limits : Limits
        Limits of the rig.
    clock : callable
        Function that returns the monotonic time [s].
    seed : int
        Number of the first session with the firmware. The number must differ between runs.

    Attributes
    ----------
    allowed_ms : float
        Maximum allowed delay of a setpoint [ms]. During this delay, a motor at its maximum speed
        moves by the maximum following error.
    """

    def __init__(
        self, make_port: Callable[[], Port], limits: Limits, clock: Callable[[], float], seed: int
    ) -> None:
        super().__init__(make_port, clock, seed, limits=limits)
        self.allowed_ms = 1e3 * limits.following_error_m / limits.speed
        self._late_ms = 0.0
        self._too_late = ""

    def poll(self) -> list[Measured]:
        """Poll the firmware as in `SerialTransport`. Stop the plate if setpoints are too late for
        the rig."""
        measured = super().poll()
        self._late_ms = max(
            self.load, self._late_ms * (1 - FADE) ** len(measured)
        )  # a tick is 1 ms, so `load` is in ms
        ready = not self._too_late and self.report().condition is Condition.READY
        if ready and self._late_ms > self.allowed_ms:
            self._too_late = self._lateness_text()
            self.stop()
        return measured

    def enable(self) -> Order:
        """Request that the motors are enabled. The request fails if recent setpoints were too late
        for the rig."""
        if self._late_ms > self.allowed_ms:
            return Order().complete(self._lateness_text())
        self._too_late = ""
        return super().enable()

    def report(self) -> Report:
        """Return the state of the motors. If late setpoints have stopped the motors, the report
        contains this reason."""
        report = super().report()
        if self._too_late and report.condition in (Condition.OFF, Condition.BRAKING):
            return Report(report.condition, DriverReason.OTHER, self._too_late)
        return report

    def values(self) -> dict[str, str]:
        """Return values for the diagnostics, by name."""
        values = super().values()
        if "device_load" in values:
            values["setpoints_late_ms"] = values.pop("device_load")
        return values

    def _lateness_text(self) -> str:
        return (
            f"setpoints were {self._late_ms:.1f} ms late, allowed: {self.allowed_ms:.1f} ms "
            "(following_error_m / speed_mps); this computer is too busy for this rig"
        )


def make(context: TransportContext) -> HostTransport:
    """Return the transport to the drives on the CAN interface of the parameter `port`."""
    channel, rig = str(context.parameters["port"]), context.rig
    if not channel:
        raise PlateError("port is '', but socketcan requires a CAN interface, such as can0")
    if rig.camera.trigger is not None:
        raise PlateError(
            "camera: trigger_phase is given, but socketcan requires a free-running camera"
        )
    program = program_of(rig)
    return HostTransport(
        lambda: HostPort(program, channel), rig.limits, context.clock, context.seed
    )
