"""The transport to the simulator, which has no motors."""

from __future__ import annotations

from collections.abc import Callable

from plate_core import Rig

from ..setpoints import MAX_KNOTS, MotorTable
from .transport import Condition, Measured, Order, Report, TransportContext


class SimTransport:
    """To the simulator, which listens to the published setpoints, and repeats them as often as its
    own parameter says. There are no motors: it is ready until it is stopped.

    Parameters
    ----------
    rig : Rig
    publish : callable
        Publishes a table; the node gives it, so that no ROS is needed here.
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
        """Nothing to open."""

    def poll(self) -> list[Measured]:
        """Nothing to measure."""
        return []

    def report(self) -> Report:
        """Say whether it was stopped."""
        return Report(Condition.OFF if self._stopped else Condition.READY)

    def send(self, table: MotorTable, repeats: int) -> None:
        """Publish the table."""
        self._last = table
        self._publish(table)

    def stop(self, cut: bool = False) -> Order:
        """Publish rest, if anything was sent: the simulator takes it at the end of its cycle."""
        last, self._last, self._stopped = self._last, None, True
        if last is not None:
            self._publish(MotorTable.rest(self._rig, last.cycle.period, last.stamp_ns))
        return Order().settle()

    def enable(self) -> Order:
        """Go on."""
        self._stopped = False
        return Order().settle()

    def home(self) -> Order:
        """Nothing: it never loses home."""
        return Order().settle()

    def troubles(self) -> list[str]:
        """Nothing goes wrong."""
        return []

    def values(self) -> dict[str, str]:
        """Nothing to report."""
        return {}

    def close(self) -> None:
        """Publish rest."""
        self.stop()


def make_sim(context: TransportContext) -> SimTransport:
    """Return the transport to the simulator."""
    return SimTransport(context.rig, context.publish)
