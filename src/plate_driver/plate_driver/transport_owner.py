"""Owner of the driver's transport. A stop reaches the motors in every lifecycle state. If no
transport is open, the owner opens a temporary transport for the stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from plate_core import PlateError, Rig

from .status import UNANSWERED
from .transports import ANSWER_S, BUSY_S, Condition, Latch, Order, Transport, TransportThread

__all__ = ["TransportOwner"]

SETTLED_PERIOD_S = 0.02
"""Time between checks whether the stop of a temporary transport is complete (successful or failed)
[s]."""

OFF_PERIOD_S = 0.01
"""Time between checks whether the motors are off [s]."""

REST_S = 3.0
"""Maximum time to wait until the motors have braked, gone home and switched off [s]."""


class TransportOwner:
    """Owner of the driver's transport. The owner opens and closes the transport, and stops the
    motors.

    `stop` may be called from any thread and in any lifecycle state. If `stop` opens a temporary
    transport, this transport is closed when the stop is complete (successful or failed). The
    temporary transport is also closed when `open` or `close` is called.

    Parameters
    ----------
    latch : Latch
    read_rig : callable
        Function that returns the rig for a temporary transport.
    make : callable
        Function that returns a new transport for a rig. The transport is not open yet.
    on_defect : callable
        See `TransportThread`.

    Attributes
    ----------
    latch : Latch
        Latch that blocks cycles after a stop.
    current : TransportThread or None
        The open transport, unless it is temporary.
    temporary : TransportThread or None
        Transport that was opened for a stop.
    """

    def __init__(
        self,
        latch: Latch,
        read_rig: Callable[[], Rig],
        make: Callable[[Rig], Transport],
        on_defect: Callable[[Exception], None],
    ) -> None:
        self.latch = latch
        self._read_rig, self._make, self._on_defect = read_rig, make, on_defect
        self.current: TransportThread | None = None
        self.temporary: TransportThread | None = None
        # lock that a thread holds while it opens or closes a transport
        self._changing = threading.Lock()

    def open(self, rig: Rig) -> TransportThread:
        """Open the transport, and close a temporary transport."""
        with self._changing:
            self._close_temporary()
            self.current = self._start_transport(rig)
            return self.current

    def close(self) -> None:
        """Stop and close the open transports. The transports still execute a stop that another
        thread requests at the same time."""
        if self.current is not None:
            self.current.close()
            self.current = None
        with self._changing:
            self._close_temporary()

    def stop(self, cut: bool) -> bool:
        """Stop the motors. If `cut` is True, cut the power of the motors.

        Return within `ANSWER_S` whether the device has confirmed the stop. If the device has not
        confirmed the stop, the attempts continue after the return.
        """
        end = time.monotonic() + ANSWER_S
        try:
            while True:
                transport = self.current
                if transport is not None:
                    order = transport.stop(cut)
                else:
                    transport, order = self._stop_without_current(cut)
                done = transport.stopped(order, cut, end)
                if done or transport in (self.current, self.temporary):
                    # if this condition is false, the transport was closed during the wait, so try
                    # again
                    break
        except PlateError as error:
            done, order = False, Order().complete(str(error))
        self.latch.late = None if done else order
        return done

    def rest(self) -> str:
        """Stop the motors of the current transport, and wait until they are off.

        Return an error message. The message is empty if the motors are off or no device was ever
        connected.
        """
        transport = self.current
        assert transport is not None
        order, end = transport.stop(), time.monotonic() + ANSWER_S
        done = transport.stopped(order, cut=False, end=end)
        self.latch.late = order if transport.met and not done else None
        if not done:
            # If no device was ever connected, the motors have no current.
            return UNANSWERED if transport.met else ""
        end = time.monotonic() + REST_S
        while transport.report.condition not in (Condition.OFF, Condition.GONE):
            if time.monotonic() > end:
                return f"the plate still moves after {REST_S:g} s"
            time.sleep(OFF_PERIOD_S)
        return ""

    def _start_transport(self, rig: Rig) -> TransportThread:
        """Open a transport and start its thread."""
        made = self._make(rig)
        made.open()
        thread = TransportThread(made, self.latch, self._on_defect)
        thread.start()
        return thread

    def _stop_without_current(self, cut: bool) -> tuple[TransportThread, Order]:
        """Stop the motors with a temporary transport, or with the current transport if it was
        opened in the meantime."""
        if not self._changing.acquire(timeout=BUSY_S):
            raise PlateError("the driver is opening or closing its transport")
        try:
            if self.current is not None:
                return self.current, self.current.stop(cut)
            if self.temporary is None:
                self.temporary = self._start_transport(self._read_rig())
                keep = self._keep_temporary
                threading.Thread(target=keep, name="temporary", daemon=True).start()
            return self.temporary, self.temporary.stop(cut)
        finally:
            self._changing.release()

    def _close_temporary(self) -> None:
        temporary, self.temporary = self.temporary, None
        if temporary is not None:
            temporary.close()

    def _keep_temporary(self) -> None:
        """Keep the temporary transport open until its stop is complete (successful or failed)."""
        while self.temporary is not None:
            time.sleep(SETTLED_PERIOD_S)
            with self._changing:
                if self.temporary is not None and not self.temporary.stopping:
                    self._close_temporary()
