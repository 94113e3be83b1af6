"""A transport in a thread of its own: nothing that messages do can hold up a stop."""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator

from plate_core import CycleError

from .motor_table import MotorTable
from .transport import Measured, Order, Report, Transport

POLL_PERIOD_S = 0.005
"""Time between two looks at the transport [s]: an upload takes some ten of them."""

REMEMBERED = 2000
"""Measurements that are kept until somebody asks for them: 20 s of them."""


URGENT = -15
"""Niceness of the threads that stop motors, where the system allows it (CAP_SYS_NICE)."""


@contextlib.contextmanager
def urgent() -> Iterator[None]:
    """Give this thread, and those that it begins meanwhile, precedence over all that is no stop."""
    own = threading.get_native_id()
    before = os.getpriority(os.PRIO_PROCESS, own)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, own, URGENT)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, own, before)


class Latch:
    """Why no cycle is let through; it outlives transports. Threads may share it.

    Each stop has a number, so that what was prepared before one is never sent after it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason, self._number = "", 0

    @property
    def reason(self) -> str:
        """What was stopped, and what to do; empty: open."""
        return self._reason

    @property
    def number(self) -> int:
        """Stops so far."""
        return self._number

    def close(self, reason: str, over: tuple[str, ...] = ("",)) -> None:
        """Count a stop; its reason replaces one of those in `over` only, unless that is empty."""
        with self._lock:
            self._number += 1
            if not over or self._reason in over:
                self._reason = reason

    def open(self, number: int) -> bool:
        """Let cycles through again, unless there was a stop since the one with a number."""
        with self._lock:
            if number != self._number:
                return False
            self._reason = ""
            return True


class Keeper:
    """Looks after a transport every few milliseconds; everyone else speaks to it through here.

    Parameters
    ----------
    transport : Transport
        Already open.
    latch : Latch
    wrong : callable
        Told, in this thread, what a defect of the transport raises: the motors are stopped then.
    """

    def __init__(
        self, transport: Transport, latch: Latch, wrong: Callable[[Exception], None]
    ) -> None:
        self._transport, self._latch, self._wrong = transport, latch, wrong
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._measured: deque[Measured] = deque(maxlen=REMEMBERED)
        self._troubles: list[str] = []
        self._thread = threading.Thread(target=self._run, name="transport", daemon=True)
        self.report: Report = transport.report()

    @property
    def motors(self) -> bool:
        """Whether there are motors that need an enable."""
        return self._transport.motors

    @property
    def calibrates(self) -> bool:
        """Whether what it measures is good for a calibration."""
        return self._transport.calibrates

    @property
    def max_knots(self) -> int:
        """Most knots of a table."""
        return self._transport.max_knots

    @property
    def hold_s(self) -> float:
        """Longest time for which a table is played again [s]."""
        return self._transport.hold_s

    def start(self) -> None:
        """Begin to look after it."""
        self._thread.start()

    def look(self) -> None:
        """Look after it once."""
        with self._lock:
            self._measured.extend(self._transport.poll())
            self._troubles += [t for t in self._transport.troubles() if t not in self._troubles]
            self.report = self._transport.report()

    def _run(self) -> None:
        with urgent():
            self._look_on()

    def _look_on(self) -> None:
        while not self._ended.wait(POLL_PERIOD_S):
            try:
                self.look()
            except Exception as error:  # a defect must be told, and must not end the looking
                self._wrong(error)

    # What threads ask

    def send(self, table: MotorTable, repeats: int, number: int) -> None:
        """Send a table that was made when the latch had counted so many stops.

        Raises
        ------
        CycleError
            If there was a stop since, or the transport does not take it.
        """
        with self._lock:
            if self._latch.reason or self._latch.number != number:
                raise CycleError("the plate was stopped meanwhile")
            self._transport.send(table, repeats)

    def stop(self, cut: bool = False) -> Order:
        """Stop, see `Transport.stop`."""
        with self._lock:
            order = self._transport.stop(cut)
            self.report = self._transport.report()
            return order

    def enable(self) -> Order:
        """Enable, see `Transport.enable`."""
        with self._lock:
            order = self._transport.enable()
            self.report = self._transport.report()
            return order

    def home(self) -> Order:
        """Home, see `Transport.home`."""
        with self._lock:
            return self._transport.home()

    def measured(self) -> list[Measured]:
        """Return what was measured since the last call."""
        with self._lock:
            told = list(self._measured)
            self._measured.clear()
            return told

    def troubles(self) -> list[str]:
        """Return what went wrong since the last call."""
        with self._lock:
            told, self._troubles = self._troubles, []
            return told

    def values(self) -> dict[str, str]:
        """Return what is to be reported since the last call."""
        with self._lock:
            return self._transport.values()

    def close(self) -> None:
        """Stop the motors, wait for the answer, and release the transport."""
        order = self.stop()
        if self._thread.is_alive():
            order.wait()
            self._ended.set()
            self._thread.join()
        with self._lock:
            self._transport.close()
