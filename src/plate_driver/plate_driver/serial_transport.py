"""Motor tables over a serial port: opens it, keeps the link alive, begins anew when it fails."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import serial

from plate_core import CycleError, PlateError
from plate_core.errors import FrameError
from plate_core.serial_protocol import (
    Fault,
    Packet,
    Reader,
    State,
    Telemetry,
    frame,
    pack,
    parse,
)

from .link import HARMLESS, Link
from .motor_table import MotorTable
from .unrolled import Unrolled, finer, knots

BAUD = 921_600
REOPEN_S = (0.1, 0.2, 0.4, 0.8)
"""Waits between attempts to begin anew [s]; the last one from then on."""

LEAD_S = 0.3
"""How far a stream is ahead of the device [s]: it brakes when 0.1 s are left."""

READ_BYTES = 65_536
"""Most bytes read at once: a second of what the device can say at 921,600 baud is less."""


class Port(Protocol):
    """What is used of `serial.Serial`: reading and writing return at once."""

    def read(self, size: int) -> bytes: ...

    def write(self, data: bytes) -> int | None: ...

    def close(self) -> None: ...


class _Serial(serial.Serial):
    """A port whose writing returns at once too; pyserial's waits, or turns in circles."""

    def write(self, data: bytes) -> int:
        """Write what fits; returns how many bytes that is."""
        try:
            return os.write(self.fileno(), data)
        except BlockingIOError:
            return 0


def open_port(name: str) -> Port:
    """Open a serial port.

    Raises
    ------
    PlateError
        If it is not there or cannot be used.
    """
    try:
        port: Port = _Serial(name, BAUD, timeout=0, exclusive=True)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise PlateError(f"port is {name!r}, allowed: a serial port that opens ({error})") from None
    return port


@dataclass(frozen=True)
class Measured:
    """Telemetry and when it was measured, on the host's clock [s]."""

    telemetry: Telemetry
    time: float


class SerialTransport:
    """To a motor controller that speaks docs/protocol.md.

    Parameters
    ----------
    make_port : callable
        Opens the port; called again after a failure.
    clock : callable
        Time that never runs back [s].
    seed : int
        Where session numbers begin: another one for each run.
    streams : bool
        Whether setpoints are streamed, not sent ahead cycle by cycle.
    """

    def __init__(
        self,
        make_port: Callable[[], Port],
        clock: Callable[[], float],
        seed: int,
        streams: bool = False,
    ) -> None:
        self._streams = streams
        self._row: Unrolled | None = None
        self._row_began: float | None = None  # on the device's clock [s]
        self.least_lead_s = float("inf")
        self._make_port, self._clock, self._session = make_port, clock, seed
        self._port: Port | None = None
        self._reader = Reader()
        self._link = Link.begun(self._session, 0.0)
        self._newest: MotorTable | None = None
        self._table = 0
        self._failures = 0
        self._reopen_at = 0.0
        self._troubles: list[str] = []
        self.refused = 0
        self.retries = 0

    @property
    def connected(self) -> bool:
        """Whether the device has answered, and not fallen silent since."""
        return self._port is not None and self._link.device is not None

    def open(self) -> None:
        """Open the port and say hello; a PlateError says what is missing."""
        self._connect(self._make_port())

    def send(self, table: MotorTable) -> None:
        """Upload a table: the device takes it at its next cycle boundary.

        Raises
        ------
        CycleError
            If the device cannot hold so many knots.
        """
        device = self._link.device
        if device is not None and len(table.q) > device.max_knots:
            raise CycleError(
                f"plate_cycle: {len(table.q)} knots, allowed by the device: {device.max_knots}"
            )
        self._newest = table
        if self._row is not None:
            self._row = self._row.followed_by(finer(table))
        else:
            self._upload()
        self.poll()

    def poll(self) -> list[Measured]:
        """Read, answer and repeat; call it every few milliseconds. Returns what was measured."""
        now = self._clock()
        if self._port is None:
            self._reopen(now)
            return []
        self.least_lead_s = min(self.least_lead_s, self._lead(now))
        measured = []
        try:
            reader, packets = self._reader.fed(self._port.read(READ_BYTES))
            self.refused += reader.refused - self._reader.refused
            self._reader = reader
            for data in packets:
                telemetry = self._heard(data, now)
                if telemetry is not None:
                    when = self._link.clock.host_time(telemetry.device_us)
                    measured.append(Measured(telemetry, min(when, now)))
            self._stream(now)
            link, due = self._link.due(now)
            self.retries += link.retries - self._link.retries
            self._link = link
            if due:
                self._write(self._port, due)
        except OSError as error:
            self._fail(f"serial port: {error}", now)
            return measured
        if self._link.failed:
            self._fail(self._link.failed, now)
        elif self._link.refusal:
            self._tell(self._link.refusal)
            self._link = self._link.forgiven()
            self._row = None  # the device would miss what follows: it brakes, and is begun anew
        return measured

    def _write(self, port: Port, due: list[Packet]) -> None:
        # A zero first ends whatever noise has left on the line.
        data = b"\0" + b"".join(frame(pack(packet)) for packet in due)
        if port.write(data) != len(data):
            self._tell("serial line is full: what is lost is repeated")

    @property
    def busy(self) -> bool:
        """Whether something is still on its way to the device."""
        return self._link.busy

    def troubles(self) -> list[str]:
        """Return what went wrong since the last call."""
        told, self._troubles = self._troubles, []
        return told

    def values(self) -> dict[str, str]:
        """Return what is to be reported since the last call, name to value."""
        lead, self.least_lead_s = self.least_lead_s, float("inf")
        told = {"retries": str(self.retries), "frames_refused": str(self.refused)}
        return told | ({"least_lead_ms": f"{1e3 * lead:.1f}"} if np.isfinite(lead) else {})

    def stop(self, now: bool = False) -> None:
        """Have the device brake, or take the current away at once; the last table is forgotten."""
        self._newest = self._row = None
        self._link = self._link.stopping(now)
        self.poll()

    def home(self) -> None:
        """Have the device find home; it refuses unless its motors are off."""
        self._link = self._link.homing()

    def enable(self) -> None:
        """Let the next table enable the motors, whatever the device stopped for: once."""
        self._link = self._link.enabling()

    def close(self) -> None:
        """Have the device brake, and release the port."""
        if self._port is not None:
            self.stop()
        self._newest = self._row = None
        self._release()

    def _tell(self, trouble: str) -> None:
        if trouble not in self._troubles:
            self._troubles.append(trouble)

    def _heard(self, data: bytes, now: float) -> Telemetry | None:
        try:
            packet = parse(data)
        except FrameError:
            self.refused += 1
            return None
        before = self._link.device
        self._link = self._link.heard(packet, now)
        if before is None and self._link.device is not None:
            self._failures = 0
        message = packet.message
        if not isinstance(message, Telemetry):
            return None
        if message.faults & ~HARMLESS:
            self._tell(f"device has stopped: {message.faults!r}")
        if message.state is State.OFF and message.faults & Fault.HOST_SILENT and not self.busy:
            self._upload()  # it did not hear us for a while, and has braked
        # Until a pulse has come nobody knows when it was.
        return message if np.isfinite(self._link.clock.trip_s) else None

    def _upload(self) -> None:
        if self._newest is None:
            return
        self._table = self._table % 65_535 + 1
        if not self._streams:
            self._link = self._link.uploading(self._table, knots(self._newest))
            return
        self._row, first = Unrolled.of(finer(self._newest)).until(LEAD_S)
        self._row_began = None
        self._link = self._link.streaming(self._table, first)

    def _lead(self, now: float) -> float:
        """How far the stream is ahead of the device [s]; infinite if none plays."""
        if self._row is None or self._row_began is None:
            return float("inf")
        return self._row.time - (now - self._link.clock.offset_s - self._row_began)

    def _stream(self, now: float) -> None:
        """Add to the stream what keeps it `LEAD_S` ahead of the device."""
        row, told = self._row, self._link.telemetry
        if row is None or told is None or told.table != self._table:
            return
        if not np.isfinite(self._link.clock.trip_s):
            return  # nobody knows what the time is there
        if self._row_began is None:
            self._row_began = told.device_us * 1e-6
        self._row, more = row.until(row.time - self._lead(now) + LEAD_S)
        if more:
            self._link = self._link.adding(self._table, row.told, more)

    def _connect(self, port: Port) -> None:
        self._port, self._reader = port, Reader()
        self._session = (self._session + 1) % 2**32
        self._link = Link.begun(self._session, self._clock())
        self._upload()

    def _reopen(self, now: float) -> None:
        if now < self._reopen_at:
            return
        try:
            self._connect(self._make_port())
        except PlateError as error:
            self._fail(str(error), now)

    def _fail(self, reason: str, now: float) -> None:
        self._tell(reason)
        self._release()
        self._reopen_at = now + REOPEN_S[min(self._failures, len(REOPEN_S) - 1)]
        self._failures += 1

    def _release(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except OSError as error:
                self._tell(f"serial port: {error}")
