"""Intake of plate cycles. The intake decides which received cycles are sent to the motors and which
are refused."""

from __future__ import annotations

import math
from collections.abc import Callable

from plate_core import CycleError, PlateCycle, PlateError
from plate_core.clock_steps import read_together
from plate_core.driver_status import DriverState, DriverStatus

from .clocks import Clocks
from .freshness import Freshness
from .playback import Playback
from .raw_cycle import check_length
from .setpoints import MAX_KNOTS, ScaledCycle
from .transports import Latch, TransportThread

__all__ = ["CycleIntake", "NotReadyError"]


class NotReadyError(CycleError):
    """Error: a cycle was received while the motors were not ready."""


class CycleIntake:
    """Check of all received cycles. A cycle is either sent to the motors or refused.

    Parameters
    ----------
    playback : Playback
    latch : Latch
    clocks : Clocks
    status : callable
        Function that returns the state of the motors.
    decode : callable
        Function that converts a serialized plate_cycle to the cycle and its stamp [ns]. The
        function raises a PlateError if the message or the cycle is invalid.
    second_publisher : callable
        Function that returns an error message if several nodes publish plate_cycle, otherwise an
        empty text.
    poll_tasks : callable
        Function that passes each waiting task_status message to `record_task`.

    Attributes
    ----------
    task_runs : bool
        Whether a task runs, according to the planner's last report.
    refusal : str
        Reason why the last cycle was refused. Empty if the last cycle was accepted.
    """

    def __init__(
        self,
        playback: Playback,
        latch: Latch,
        clocks: Clocks,
        *,
        status: Callable[[], DriverStatus],
        decode: Callable[[bytes], tuple[PlateCycle, int]],
        second_publisher: Callable[[], str],
        poll_tasks: Callable[[], None],
    ) -> None:
        self._playback, self._latch, self._clocks = playback, latch, clocks
        self._status, self._decode = status, decode
        self._second_publisher, self._poll_tasks = second_publisher, poll_tasks
        self._freshness = Freshness()
        self.task_runs, self.refusal = False, ""

    def begin(self) -> None:
        """Discard the records of earlier cycles and of the last refusal. `task_runs` does not
        change."""
        self._freshness, self.refusal = Freshness(clock=self._freshness.clock), ""

    def record_task(self, running: bool, stamp_ns: int | None) -> None:
        """Record a report of the planner.

        Parameters
        ----------
        running : bool
            Whether a task runs.
        stamp_ns : int or None
            Stamp of the planner's last request [ns]. None if unknown.
        """
        self.task_runs = running
        if stamp_ns is not None and not running:
            self._freshness = self._freshness.ended(stamp_ns)

    def observe(self) -> DriverStatus:
        """Return the status, and record when the motors became ready or this process stalled. Call
        this method about every 20 ms.

        In simulated time, stalls and steps of the clock are not recorded.
        """
        status = self._status()
        number = self._latch.number if status.state is DriverState.READY else None
        simulated = self._clocks.simulated()
        if simulated:
            now, clock_ns = 0.0, self._clocks.stamp_ns()
        else:
            now, clock_ns = read_together(self._clocks.steady_s, self._clocks.stamp_ns)
            self._freshness = self._freshness.with_clocks(now, clock_ns)
        self._freshness = self._freshness.with_state(number, now, clock_ns)
        return status

    def accept(
        self, data: bytes, size: int, source: bytes, transport: TransportThread
    ) -> ScaledCycle:
        """Check a cycle and send its motor table.

        Parameters
        ----------
        data : bytes
            First bytes of the serialized cycle.
        size : int
            Size of the whole message [bytes].
        source : bytes
            Key that identifies the publisher.
        transport : TransportThread

        Returns
        -------
        scaled : ScaledCycle
            The cycle as sent, and the factor that scales it down to the rig's limits.

        Raises
        ------
        PlateError
            If the cycle is refused. The error is a `NotReadyError` if the motors are not ready.
        """
        number, status = self._latch.number, self.observe()
        self._freshness = self._freshness.with_cycle(source, self._clocks.steady_s())
        if status.state is not DriverState.READY:  # check this reason before all other reasons
            self._playback.count_refused()
            raise NotReadyError(f"the driver is {status.text}")
        try:
            check_length(data, size, min(MAX_KNOTS, transport.max_knots))
            scaled = self._send_cycle(*self._decode(data), transport, number)
        except PlateError as error:
            self._playback.count_refused()
            self.refusal = str(error)
            raise
        self.refusal = ""
        return scaled

    def _send_cycle(
        self, cycle: PlateCycle, stamp_ns: int, transport: TransportThread, number: int
    ) -> ScaledCycle:
        now = self._clocks.playback_s()
        if self._clocks.simulated():  # the clock message may arrive later
            now = max(now, 1e-9 * stamp_ns)
        guard, scaled = self._playback.guard_for(transport).accepted(cycle, stamp_ns, now)
        if cycle.moves:
            # Poll the task status as late as possible, because the task may have ended since the
            # last poll.
            self._poll_tasks()
            guard = guard.lasting(self._clocks.steady_s() + self._remaining_s(cycle, stamp_ns))
        self._playback.send(transport, guard, number)
        if guard.correction is not None:
            self._playback.record_motion(stamp_ns, scaled.cycle)
        return scaled

    def _remaining_s(self, cycle: PlateCycle, stamp_ns: int) -> float:
        """Return the remaining time in which a moving cycle may be sent [s]. Raise an error if the
        time has expired."""
        if problem := self._second_publisher():
            raise CycleError(problem)
        simulated = self._clocks.simulated()
        if simulated:  # the clock message may arrive later
            clock_ns = max(self._clocks.stamp_ns(), stamp_ns)
        else:
            now, clock_ns = read_together(self._clocks.steady_s, self._clocks.stamp_ns)
            self._freshness = self._freshness.with_clocks(now, clock_ns)
        remaining = self._freshness.remaining_s(stamp_ns, clock_ns, cycle.period)
        return math.inf if simulated else remaining
