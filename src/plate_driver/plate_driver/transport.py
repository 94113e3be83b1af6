"""Where motor tables go: one interface, so that the node does not know what moves the plate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from plate_core import PlateError

from .motor_table import MotorTable


class Transport(Protocol):
    """The way to the motors."""

    @property
    def connected(self) -> bool:
        """Whether the motors are there."""

    def open(self) -> None:
        """Make it ready to send; a PlateError says what is missing."""

    def send(self, table: MotorTable) -> None:
        """Hand over a table: the motors take it at their next cycle boundary."""

    def stop(self) -> None:
        """Have the motors brake now, if they can, and stay off."""

    def enable(self) -> None:
        """Let the next table move them again."""

    def home(self) -> None:
        """Have them find home."""

    def close(self) -> None:
        """Release it. Sending nothing more: the rest table was sent before."""


class SimTransport:
    """To the simulator, which listens to the published setpoints.

    Parameters
    ----------
    publish : callable
        Publishes a table; the node gives it, so that no ROS is needed here.
    """

    def __init__(self, publish: Callable[[MotorTable], None]) -> None:
        self._publish = publish

    connected = True

    def open(self) -> None:
        """Nothing to open."""

    def send(self, table: MotorTable) -> None:
        """Publish the table."""
        self._publish(table)

    def stop(self) -> None:
        """Nothing: it takes the rest table at the end of its cycle."""

    def enable(self) -> None:
        """Nothing: it is never off."""

    def home(self) -> None:
        """Nothing: it never loses home."""

    def close(self) -> None:
        """Nothing to close."""


def check_transport(name: str, port: str) -> None:
    """Refuse a transport that does not exist, or lacks its port."""
    if name not in ("sim", "serial"):
        raise PlateError(f"transport is {name!r}, allowed: sim, serial")
    if name == "serial" and not port:
        raise PlateError("port is '', allowed with transport serial: the name of a serial port")
