"""Transport thread and latch. A separate thread polls the transport, so that no message can delay a
stop. The latch counts stops. After a stop, it blocks cycles until the motors are enabled again."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from plate_core import CycleError, PlateError
from plate_core.driver_status import DriverReason

from ..setpoints import MotorTable
from .transport import STOPPED_SINCE, Condition, Measured, Order, Report, Transport

T = TypeVar("T")

POLL_PERIOD_S = 0.002
"""Time between two polls of the transport [s]. An upload takes about twenty polls."""

NO_MOTORS_PERIOD_S = 0.02
"""Time between two polls of a transport without motors [s]. Such a transport uploads nothing, so it
needs fewer polls."""

BUSY = "the transport is busy"

BUSY_S = 0.3
"""Maximum time to wait for a transport that another thread uses [s]."""

CLOSE_S = 2.0
"""Maximum time to wait for the end of a transport's thread [s]."""

ANSWER_S = 0.3
"""Maximum time to wait for the result of an order [s]. This limit ensures that the caller gets a
reply within 0.5 s."""

SHOWN_S = 0.1
"""Maximum time from a measurement to the deadline of a stop [s]. Only measurements after this time
can show that the stop has succeeded. All messages that the device sent before the stop arrive
earlier."""

REMEMBERED = 2000
"""Maximum number of measurements that are stored until `measured` is called. They cover 20 s."""

URGENT = -15
"""Niceness (Linux scheduling priority) of the threads that stop motors. The process needs the
capability CAP_SYS_NICE to set this value."""


@contextlib.contextmanager
def high_priority() -> Iterator[None]:
    """Give this thread, and threads that are started in the context, a high priority."""
    thread_id = threading.get_native_id()
    before = os.getpriority(os.PRIO_PROCESS, thread_id)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, thread_id, URGENT)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, thread_id, before)


class Latch:
    """Blocks cycles after a stop, and stores the reason of the stop.

    A latch is thread-safe. A latch still exists after its transport was closed. The latch numbers
    the stops. A table that was prepared before a stop is therefore never sent after the stop.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason, self._number = DriverReason.NONE, 0
        # numbers of the stops that the enable commands in progress will clear
        self._enabling: list[int] = []
        # the last stop, if the device did not acknowledge it in time
        self.late: Order | None = None
        # system time of the last enable [ns], which is different for each enable
        self.enabled_ns = 0

    @property
    def reason(self) -> DriverReason:
        """Reason why the latch is closed. NONE if the latch is open."""
        return self._reason

    @property
    def number(self) -> int:
        """Number of stops so far."""
        return self._number

    @property
    def enabling(self) -> bool:
        """Whether an enable is in progress and no stop was requested since the enable began."""
        return self._number in self._enabling

    @property
    def unanswered(self) -> bool:
        """Whether the last stop was not acknowledged in time, and is still not acknowledged."""
        late = self.late
        return late is not None and not late.done

    def close(
        self, reason: DriverReason, over: tuple[DriverReason, ...] = (DriverReason.NONE,)
    ) -> None:
        """Count a stop. `reason` replaces the current reason if the current reason is in `over`, or
        if `over` is empty."""
        with self._lock:
            self._number += 1
            if not over or self._reason in over:
                self._reason = reason

    def enable_started(self, number: int) -> None:
        """Record that an enable has started. The enable applies to the stop `number`."""
        self._enabling.append(number)

    def enable_ended(self, number: int) -> None:
        """Record the end of an enable, successful or not."""
        self._enabling.remove(number)

    def open(self, number: int) -> bool:
        """Open the latch, unless the motors were stopped again after the stop `number`. Return
        whether the latch is open."""
        with self._lock:
            if number != self._number:
                return False
            self._reason, self.late = DriverReason.NONE, None
            self.enabled_ns = max(time.time_ns(), self.enabled_ns + 1)
            return True


@dataclass(frozen=True)
class _Enable:
    """A running enable: its stop number, the transport's order, the caller's order, and its
    deadline (steady clock [s])."""

    number: int
    order: Order
    result: Order
    end: float


class TransportThread:
    """Polls a transport every few milliseconds on a separate thread, and makes all other calls of
    its methods.

    Parameters
    ----------
    transport : Transport
        Transport that is already open.
    latch : Latch
    on_defect : callable
        Function that is called with an unexpected exception of the transport. After such an
        exception, the motors are stopped, and their state is GONE.
    """

    def __init__(
        self, transport: Transport, latch: Latch, on_defect: Callable[[Exception], None]
    ) -> None:
        self._transport, self._latch, self._on_defect = transport, latch, on_defect
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._measured: deque[Measured] = deque(maxlen=REMEMBERED)
        self._measured_at = float("-inf")
        self._enables: list[_Enable] = []
        self._stop = Order().complete()  # last stop
        # one entry per postponed stop, which states whether to switch off the motor current
        self._postponed_stops: list[bool] = []
        self._troubles: list[str] = []
        self._thread = threading.Thread(
            target=self._poll_periodically, name="transport", daemon=True
        )
        self.report: Report = transport.report()
        # Whether a device was ever connected.
        self.met = self.report.condition is not Condition.GONE

    @property
    def motors(self) -> bool:
        """Whether the transport has motors that need an enable. `Transport` describes this property
        and the next three."""
        return self._transport.motors

    @property
    def calibrates(self) -> bool:
        return self._transport.calibrates

    @property
    def max_knots(self) -> int:
        return self._transport.max_knots

    @property
    def hold_s(self) -> float:
        return self._transport.hold_s

    def start(self) -> None:
        """Start the polling thread."""
        self._thread.start()

    def poll(self) -> None:
        """Poll the transport once."""
        with self._lock:
            self._call_guarded(self._poll_transport)
            self._call_guarded(self._send_postponed_stops)
            self._complete_enables()

    def _send_postponed_stops(self) -> None:
        while self._postponed_stops:
            self._transport.stop(self._postponed_stops.pop())

    def _poll_transport(self) -> None:
        measured = self._transport.poll()
        self._measured.extend(measured)
        self._troubles += [t for t in self._transport.troubles() if t not in self._troubles]
        self._update_report()
        if measured:
            self._measured_at = measured[-1].time
            if self.report.condition is Condition.OFF:
                # The motors are off, even if the device has not acknowledged the stop.
                self._latch.late = None

    def _complete_enables(self) -> None:
        """Complete the enables that have succeeded, failed or timed out. Open the latch if an
        enable has succeeded."""
        for enable in list(self._enables):
            completed, failure = enable.order.completed, enable.order.failure
            if not completed and time.monotonic() < enable.end:
                continue
            opened = completed and not failure and self._latch.open(enable.number)
            if not completed:
                failure = f"the motors are not ready after {enable.order.max_s:.2g} s"
            elif not failure and not opened:
                failure = STOPPED_SINCE
            self._enables.remove(enable)
            self._latch.enable_ended(enable.number)
            enable.result.complete(failure)
            if not opened and (not completed or enable.order.done):
                # The enable command has failed. Switch off the motors, because the command may have
                # switched them on.
                self._call_guarded(self._transport.stop)

    def _call_guarded(self, call: Callable[[], T]) -> T | None:
        """Call the function `call`. Return None if the function raises an unexpected exception. The
        caller must hold the lock.

        A transport may be third-party code. Any exception except a PlateError stops the motors and
        blocks all cycles. Such an exception must not end this thread, or the thread that replies to
        stops.
        """
        try:
            return call()
        except PlateError:
            raise
        except Exception as error:
            why = f"the transport has a defect: {error!r}"
            self.report = Report(Condition.GONE, DriverReason.DEFECT, why)
            with contextlib.suppress(Exception):  # this call may fail because of the same defect
                self._transport.stop()
            self._on_defect(error)
            return None

    def _poll_periodically(self) -> None:
        period_s = POLL_PERIOD_S if self.motors else NO_MOTORS_PERIOD_S
        with high_priority():
            while not self._ended.wait(period_s):
                self.poll()

    def _execute_order(self, call: Callable[[], Order]) -> Order:
        """Call a method of the transport that executes an order of a person."""
        if not self._lock.acquire(timeout=BUSY_S):
            return Order().complete(BUSY)
        try:
            order = self._call_guarded(call)
            if order is None:
                return Order().complete(self.report.text)
            self._call_guarded(self._update_report)
            self._complete_enables()
            return order
        finally:
            self._lock.release()

    def _update_report(self) -> None:
        self.report = self._transport.report()
        self.met |= self.report.condition is not Condition.GONE

    # Calls from other threads

    def send(self, table: MotorTable, repeats: int, number: int) -> None:
        """Send a motor table. `number` is the value of `Latch.number` when the table was made.

        Raises
        ------
        CycleError
            If the motors were stopped after the table was made, or if the transport refuses the
            table.
        """
        with self._lock:
            if self._latch.reason or self._latch.number != number:
                raise CycleError("the plate was stopped in the meantime")

            table.check_age(time.monotonic())

            def send_table() -> bool:
                self._transport.send(table, repeats)
                return True

            if not self._call_guarded(send_table):
                raise CycleError(self.report.text)

    def stop(self, cut: bool = False) -> Order:
        """Stop the motors as described in `Transport.stop`. If another thread uses the transport
        for too long, the next poll stops the motors."""
        order = self._stop = self._execute_order(lambda: self._transport.stop(cut))
        if order.failure == BUSY:
            self._postponed_stops.append(cut)
        return order

    @property
    def stopping(self) -> bool:
        """Whether a stop is still in progress."""
        return bool(self._postponed_stops) or not self._stop.completed

    def stopped(self, order: Order, cut: bool, end: float) -> bool:
        """Wait at most until the time `end` (steady clock [s]) for a stop to succeed. Return
        whether the stop has succeeded.

        A stop has also succeeded if a recent measurement shows that the motors have no current.
        Unless `cut` is True, motors that brake are sufficient.
        """
        stopped = (Condition.OFF,) if cut else (Condition.OFF, Condition.BRAKING)

        def is_stopped() -> bool:
            return self._measured_at > end - SHOWN_S and self.report.condition in stopped

        while (
            not is_stopped() and (remaining_s := end - time.monotonic()) > 0 and not order.completed
        ):
            order.wait(min(remaining_s, 2 * POLL_PERIOD_S))
        return order.done if order.completed else is_stopped()

    def enable(self, number: int) -> Order:
        """Enable the motors as described in `Transport.enable`. `number` is the value of
        `Latch.number` at the time of the request.

        When the motors are ready, the latch opens and the order is done. If the motors do not
        become ready, the order fails with the reason. The latch opens even if no caller waits for
        the order.
        """

        def enable_transport() -> Order:
            if self._latch.number != number:
                return Order().complete(STOPPED_SINCE)
            order = self._transport.enable()
            result = Order(order.max_s)
            end = time.monotonic() + order.max_s
            self._latch.enable_started(number)
            self._enables.append(_Enable(number, order, result, end))
            return result

        return self._execute_order(enable_transport)

    def home(self) -> Order:
        """Request that the motors search for home again, see `Transport.home`."""
        return self._execute_order(self._transport.home)

    def measured(self) -> list[Measured]:
        """Return the measurements that arrived since the last call of this method."""
        with self._lock:
            measured = list(self._measured)
            self._measured.clear()
            return measured

    def troubles(self) -> list[str]:
        """Return the problems that occurred since the last call of this method."""
        with self._lock:
            troubles, self._troubles = self._troubles, []
            return troubles

    def values(self) -> dict[str, str]:
        """Return values for the diagnostics, by name, see `Transport.values`."""
        with self._lock:
            return self._call_guarded(self._transport.values) or {}

    def close(self) -> None:
        """Stop the motors, wait at most `ANSWER_S` for the confirmation, and release the
        transport."""
        order = self.stop()
        if self._thread.is_alive():
            order.wait(ANSWER_S)
            self._ended.set()
            self._thread.join(CLOSE_S)
        if self._lock.acquire(timeout=BUSY_S):
            try:
                self._call_guarded(self._transport.close)
            finally:
                self._lock.release()
