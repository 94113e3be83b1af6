"""Content of the driver's diagnostics. This module computes the content from the states of the
driver's other objects."""

from __future__ import annotations

from plate_core.driver_status import DriverStatus
from plate_core.status import Finding

from .calibration import CalibrationRun
from .clocks import Clocks
from .intake import CycleIntake
from .playback import Playback
from .status import health
from .transport_problems import TransportProblems
from .transports import TransportThread

__all__ = ["DriverDiagnostics"]


class DriverDiagnostics:
    """Computation of the level, message and values of the driver's diagnostics.

    Parameters
    ----------
    playback : Playback
    intake : CycleIntake
    calibration : CalibrationRun
    problems : TransportProblems
    clocks : Clocks
    period_s : float
        Period of the diagnostics [s].
    """

    def __init__(
        self,
        playback: Playback,
        intake: CycleIntake,
        calibration: CalibrationRun,
        problems: TransportProblems,
        clocks: Clocks,
        period_s: float,
    ) -> None:
        self._playback, self._intake, self._calibration = playback, intake, calibration
        self._problems, self._clocks, self._period_s = problems, clocks, period_s
        self._ready_since = 0.0
        self._values: dict[str, str] = {}  # values of the last diagnostics
        self._retries = 0  # number of repeated messages between the last two diagnostics

    def begin(self, now: float) -> None:
        """Restart the measurement of the time without cycles, at the time `now` on the playback
        clock [s]."""
        self._ready_since = now

    def record_ready(self, ready: bool, now: float) -> None:
        """Record whether cycles are accepted or a calibration runs, at the time `now` on the
        playback clock [s]."""
        # `min` is necessary if the clock was set back.
        self._ready_since = min(self._ready_since, now) if ready else now

    def finding(self, status: DriverStatus, failure: Exception | None) -> Finding:
        """Return the severity level and its reason. `failure` is the error of the last lifecycle
        transition."""
        lasting = [str(failure)] if failure is not None else []
        if self._calibration.failed:
            lasting.append(f"calibration {self._calibration.text}")
        if self._values.get("following_watched") == "no":
            lasting.append("following error is not checked: limits.following_error_m is 0")
        idle_s = self._playback.idle_s(self._clocks.playback_s(), self._ready_since)
        if idle_s is not None and self._intake.refusal:
            lasting.append(f"the last cycle was refused: {self._intake.refusal}")
        unplayed = self._problems.unplayed(self._clocks.steady_s())
        statistics, task_runs = self._playback.guard.statistics, self._intake.task_runs
        return health(status, statistics, self._retries, idle_s, task_runs, lasting, unplayed)

    def values(self, status: DriverStatus, transport: TransportThread | None) -> dict[str, str]:
        """Return the values of the diagnostics, by name."""
        values = self._playback.guard.values(self._period_s, self._clocks.playback_s())
        values["state"] = status.text
        if self._calibration.text:
            values["calibration"] = self._calibration.text
        if transport is not None:
            values |= dict(transport.report.values) | transport.values()
        before, now = (int(v.get("retries", "0")) for v in (self._values, values))
        self._retries, self._values = max(0, now - before), values
        return values

    def reported(self) -> None:
        """Reset the counts for the next diagnostics."""
        self._playback.guard = self._playback.guard.reported()
