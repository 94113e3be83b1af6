"""Master of a CAN bus with the services of CANopen (CiA 301), for all interfaces of python-can.

The module uses no other threads. The module receives frames only in the methods `Master.frames` and
`Master.wait`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from plate_core import PlateError
from plate_core.serial_protocol import DriveTrouble, Trouble, abort_text

__all__ = ["Master", "open_bus", "trouble_text"]

OWN_NODE = 127
NODES = range(1, OWN_NODE)
NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO = 0x180
RPDO = 0x200
ANSWER, REQUEST, HEARTBEAT = 0x580, 0x600, 0x700

LOST_ARBITRATION = 0x002
"""Identifier of an error frame by which some adapters report a lost arbitration."""

ANSWER_S = 0.3
"""Maximum wait for a node's reply [s]."""


class Refused(PlateError):
    """A node has refused a request by an abort. `code` is the abort code."""

    def __init__(self, node: int, index: int, sub: int, code: int) -> None:
        self.code = code
        super().__init__(f"node {node} refuses object {index:04X}h:{sub:02X} ({abort_text(code)})")


def trouble_text(motor: int, kind: Trouble, index: int = 0, code: int = 0) -> str:
    """Return the text of a fault of a motor's drive. `driver_status` contains the same text if a
    board commands the drives."""
    return DriveTrouble(motor, kind, index, code % 2**32).text


@dataclass
class Received:
    """Messages that were received from a node.

    Attributes
    ----------
    answers : list of bytes
        Replies to requests (service data objects, SDOs) since this list was cleared.
    places : list of bytes
        Process data (TPDOs) since this list was cleared.
    beat_at : float
        Time of the last heartbeat [s].
    state : int or None
        State of the node in the last heartbeat. None before the first heartbeat.
    boots : int
        Number of boot-up messages of the node since this counter was set to 0.
    emergency : (int, int) or None
        Error code and error register of the node's first emergency message. None if the node has
        sent none.
    """

    answers: list[bytes] = field(default_factory=list)
    places: list[bytes] = field(default_factory=list)
    beat_at: float = float("-inf")
    state: int | None = None
    boots: int = 0
    emergency: tuple[int, int] | None = None


class Master:
    """Master of a CAN bus, by means of python-can. The bus must have no other master."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self.received = {node: Received() for node in NODES}
        self.other_master = False
        """Whether frames that only another master can send were received."""

    @property
    def now(self) -> float:
        """Monotonic time [s]."""
        return time.monotonic()

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Send a frame. Raise a PlateError if the bus does not accept it."""
        import can

        frame = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            self._bus.send(frame, timeout=0.1)
        except (can.CanError, OSError) as error:
            raise PlateError(
                f"the CAN bus does not accept a frame ({error}); check the drives' supply, "
                "wires, termination and bit rate"
            ) from None

    def frames(self, until: float) -> Iterator[tuple[int, bytes]]:
        """Yield the identifier and the data of each frame that is received until the time `until`
        [s]. Raise a PlateError if the bus fails or reports an error."""
        import can

        while True:
            try:
                message = self._bus.recv(max(0.0, until - self.now))
            except (can.CanError, OSError) as error:
                raise PlateError(f"the CAN bus has failed ({error})") from None
            if message is not None and message.is_error_frame:
                if message.arbitration_id != LOST_ARBITRATION:
                    raise PlateError("error on the CAN bus; check wires, termination and bit rate")
            elif message is not None and not (message.is_extended_id or message.is_remote_frame):
                yield message.arbitration_id, bytes(message.data)
            if self.now >= until:
                return

    def close(self) -> None:
        """Close the bus, even if it has failed."""
        import can

        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def wait(self, seconds: float, done: Callable[[], object] = lambda: False) -> None:
        """Receive frames for `seconds` [s], or until `done` returns a true value."""
        for identifier, data in self.frames(self.now + seconds):
            self._process_frame(identifier, data)
            if done():
                return

    def _process_frame(self, identifier: int, data: bytes) -> None:
        kind, received = identifier & 0x780, self.received.get(identifier & 0x7F)
        if identifier in (NMT, SYNC, HEARTBEAT + OWN_NODE) or kind in (RPDO, REQUEST):
            self.other_master = True
        elif received is None:
            return
        elif kind == ANSWER and len(data) == 8:
            received.answers.append(data)
        elif kind == TPDO and len(data) == 6:
            received.places.append(data)
        elif kind == HEARTBEAT and len(data) == 1:
            received.beat_at, received.state = self.now, data[0] & 0x7F
            received.boots += data[0] == 0
        elif kind == EMERGENCY and len(data) >= 3 and any(data[:2]):
            received.emergency = received.emergency or (int.from_bytes(data[:2], "little"), data[2])

    def answering(self, index: int) -> list[int]:
        """Request an object from all nodes. Return the numbers of the nodes that reply. A node that
        refuses the request is included."""
        for node in NODES:
            self.received[node].answers.clear()
            self._request_object(node, 0x40, index, 0)
            # wait after each 16 requests, because CAN adapters buffer only few frames
            if node % 16 == 0:
                self.wait(0.01)
        self.wait(ANSWER_S)
        return [node for node in NODES if self.received[node].answers]

    def read(self, node: int, index: int, sub: int = 0, signed: bool = False) -> int:
        """Read an object of a node, and return its value.

        Raises
        ------
        PlateError
            If the node does not reply, the value has more than four bytes, or the node refuses the
            request. If the node refuses, the error is a `Refused`.
        """
        answer = self._transfer_object(node, 0x40, index, sub)
        if answer[0] & 0xE2 != 0x42:
            raise PlateError(f"node {node}: object {index:04X}h is longer than four bytes")
        size = 4 - (answer[0] >> 2 & 3 if answer[0] & 1 else 0)
        return int.from_bytes(answer[4 : 4 + size], "little", signed=signed)

    def write(self, node: int, index: int, sub: int, value: int, size: int) -> None:
        """Set an object of a node to a value of 1, 2 or 4 bytes. The function raises the same
        errors as `read`."""
        self._transfer_object(node, 0x23 | (4 - size) << 2, index, sub, value)

    def _request_object(
        self, node: int, command: int, index: int, sub: int, value: int = 0
    ) -> bytes:
        """Send a request for an object. Return the bytes by which the reply identifies this
        object."""
        name = index.to_bytes(2, "little") + bytes([sub])
        self.send(REQUEST + node, bytes([command]) + name + (value % 2**32).to_bytes(4, "little"))
        return name

    def _transfer_object(
        self, node: int, command: int, index: int, sub: int, value: int = 0
    ) -> bytes:
        answers = self.received[node].answers
        answers.clear()
        name = self._request_object(node, command, index, sub, value)
        self.wait(ANSWER_S, lambda: answers and answers[-1][1:4] == name)
        if not answers or answers[-1][1:4] != name:
            raise PlateError(f"node {node} does not answer within {ANSWER_S} s")
        if answers[-1][0] == 0x80:
            raise Refused(node, index, sub, int.from_bytes(answers[-1][4:], "little"))
        return answers[-1]


def open_bus(interface: str, channel: str, bitrate: int) -> Any:
    """Open a CAN bus with python-can, and return it. Raise a PlateError if python-can is missing or
    the bus does not open."""
    try:
        import can
    except ImportError:
        raise PlateError("python-can is not installed: pip install python-can") from None
    try:
        return can.Bus(interface=interface, channel=channel, bitrate=bitrate)
    except (can.CanError, OSError, ImportError, TypeError, ValueError) as error:
        known = ", ".join(sorted(can.interfaces.VALID_INTERFACES))
        raise PlateError(
            f"CAN bus {interface} {channel} does not open ({error}), allowed: a bus that exists "
            f"and is up, with an interface of {known}"
        ) from None
