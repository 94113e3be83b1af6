"""Transport that publishes motor tables for the simulator. The simulator has no motors that must be
enabled."""

from __future__ import annotations

from collections.abc import Callable

from plate_core import Rig

from ..setpoints import MAX_KNOTS, MotorTable
from .transport import Condition, Measured, Order, Report, TransportContext


class SimTransport:
    """Transport that publishes motor tables. The simulator subscribes to them.

    A parameter of the simulator determines how often it repeats a table. The simulator has no
    motors, so this transport reports READY until a stop.

    Parameters
    ----------
    rig : Rig
    publish : callable
        Function that publishes a motor table. The node provides this function, so this module does
        not import ROS.
    """

    motors = False
    calibrates = False
    max_knots = MAX_KNOTS
    hold_s = float("inf")

    def __init__(self, rig: Rig, publish: Callable[[MotorTable], None]) -> None:
        self._rig, self._publish = rig, publish
        self._last: MotorTable | None = None
        self._stopped = False

    def open(self) -> None:
        """Do nothing."""

    def poll(self) -> list[Measured]:
        """Return no measurements."""
        return []

    def report(self) -> Report:
        """Return the state OFF after a stop, and otherwise READY."""
        return Report(Condition.OFF if self._stopped else Condition.READY)

    def send(self, table: MotorTable, repeats: int) -> None:
        """Publish the table."""
        self._last = table
        self._publish(table)

    def stop(self, cut: bool = False) -> Order:
        """If a table was sent, publish a table that keeps the plate at rest. The simulator plays
        this table after the end of its present cycle."""
        last, self._last, self._stopped = self._last, None, True
        if last is not None:
            self._publish(MotorTable.rest(self._rig, last.cycle.period, last.stamp_ns))
        return Order().complete()

    def enable(self) -> Order:
        """Set the state to READY."""
        self._stopped = False
        return Order().complete()

    def home(self) -> Order:
        """Do nothing. The simulator always knows the home position."""
        return Order().complete()

    def troubles(self) -> list[str]:
        """Return no problems."""
        return []

    def values(self) -> dict[str, str]:
        """Return no values."""
        return {}

    def close(self) -> None:
        """Publish rest."""
        self.stop()


def make_sim(context: TransportContext) -> SimTransport:
    """Return the transport to the simulator."""
    return SimTransport(context.rig, context.publish)
