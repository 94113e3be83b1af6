"""Execution of a calibration, which plays the experiments and stores the response."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from plate_core import PlateError
from plate_core.driver_status import DriverState, DriverStatus

from ..clocks import Clocks
from ..playback import Playback
from ..transports import Latch, Measured, TransportThread
from .calibration import Calibration, Experiment, check_writable, save_response

__all__ = ["CalibrationRun"]

PLAYS_MARGIN = 2.0
"""An experiment fails if it takes longer than this multiple of its planned duration."""


class CalibrationRun:
    """Execution of calibrations. The object plays the experiments of a calibration one after the
    other, and stores the result of the last calibration.

    Parameters
    ----------
    playback : Playback
    latch : Latch
    clocks : Clocks
    log : callable
        Function that logs a text. The second argument of the function states whether the text is an
        error.

    Attributes
    ----------
    failed : bool
        Whether the last calibration has failed.
    """

    def __init__(
        self,
        playback: Playback,
        latch: Latch,
        clocks: Clocks,
        log: Callable[[str, bool], None],
    ) -> None:
        self._playback = playback
        self._latch = latch
        self._clocks = clocks
        self._log = log
        self._experiment: Experiment | None = None
        self._path = ""
        self._outcome, self.failed = "", False  # result of the last calibration

    @property
    def running(self) -> bool:
        """Whether a calibration runs."""
        return self._experiment is not None

    @property
    def text(self) -> str:
        """Progress of the running calibration, or result of the last calibration. Empty before the
        first calibration."""
        experiment = self._experiment
        return self._outcome if experiment is None else experiment.calibration.progress

    def start(self, transport: TransportThread | None, status: DriverStatus, path: str) -> None:
        """Start a calibration whose response is written to the file `path`.

        Raises
        ------
        PlateError
            If the calibration cannot be started.
        """
        if not path:
            raise PlateError("calibration_file is '', allowed: the name of a file")
        if transport is None or not transport.calibrates:
            raise PlateError(
                "this transport cannot calibrate, allowed: transport serial with streams false"
            )
        if any(motor.drive for motor in self._playback.rig.motors):
            raise PlateError(
                "the rig's motors have drives, which report no acceleration, allowed: bridges"
            )
        if status.state is not DriverState.READY:
            raise PlateError(f"the driver is {status.text}, allowed: ready")
        try:
            check_writable(path)
            self._path, self._outcome, self.failed = path, "", False
            calibration = Calibration.start(self._playback.rig)
            self._begin_experiment(transport, calibration, self._clocks.playback_s())
        except PlateError:
            self._experiment = None
            raise

    def record(self, measured: Measured) -> None:
        """Add a measurement to the running experiment."""
        if self._experiment is not None:
            self._experiment = self._experiment.with_sample(measured)

    def step(self, transport: TransportThread, now: float) -> None:
        """Continue the calibration at `now` [s]. Start the next experiment when the current
        experiment is done. Store the response at the end."""
        experiment = self._experiment
        assert experiment is not None
        try:
            if not experiment.over:
                if self._playback.guard.over(now, PLAYS_MARGIN):
                    raise PlateError("the motors did not play the experiment to its end")
                return
            calibration = experiment.finished()
            if calibration.cycle is not None:
                self._begin_experiment(transport, calibration, now)
                return
            save_response(self._path, calibration.response)
            self._end_run(
                f"done: {self._path} is written, and used after the next configure",
                now,
                failed=False,
            )
        except PlateError as error:
            self.fail(str(error), now)

    def fail(self, reason: str, now: float) -> None:
        """End a running calibration and discard its measurements. `reason` becomes its result."""
        if self._experiment is not None:
            self._end_run(f"failed: {reason}", now, failed=True)

    def cancel(self) -> None:
        """End a running calibration without a result."""
        self._experiment = None

    def _begin_experiment(
        self, transport: TransportThread, calibration: Calibration, now: float
    ) -> None:
        experiment = Experiment(calibration)
        number = self._latch.number
        before = self._playback.guard_for(transport)
        guard, played = before.experimenting(experiment.cycle, now)
        self._experiment = replace(experiment, played=played)
        self._playback.send(transport, guard, number)
        self._playback.guard = guard.after_experiment(before)
        self._log(f"calibration: {experiment.calibration.progress}", False)

    def _end_run(self, text: str, now: float, failed: bool) -> None:
        self._outcome, self.failed = text, failed
        self._log(f"calibration {text}", failed)
        self._experiment = None
        self._playback.rest(now)
