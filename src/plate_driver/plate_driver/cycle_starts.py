"""Start times of the plate's cycles, derived from the device's telemetry. This module uses neither
ROS nor a clock: all times are arguments. Each telemetry message is checked against the device's
clock, the table's period and the host's time. Cycle starts from inconsistent messages are not
reported. The planner would otherwise predict wrong part positions. The device's clock is checked
elsewhere, in `transports.device_clock`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from plate_core import PlateCycle

from .playback import Playback
from .transports import Measured
from .transports.device_clock import DRIFT

__all__ = ["CycleStarts", "StartReporter"]

SAME_START = 0.5
"""Maximum difference between two measured start times of the same play of a table, as a fraction of
its cycle. The start times differ slightly, because the conversion between the clocks of host and
device varies."""

MARGIN_S = 3e-3
"""Two times with a smaller difference count as equal [s]. This tolerance is shorter than the
interval between two telemetry messages. This tolerance is longer than the delay of table starts,
which occur only at ticks of the device."""

AHEAD_S = 0.1
"""Maximum time by which telemetry may be ahead of the host's time [s]. Telemetry can be ahead,
because the offset between the clocks is estimated from round-trip times."""

REST_CYCLE_S = 0.1
"""Period of the reported cycle while the motors rest [s]."""

NO_START = "cycle_started is not published, because the device reports impossible times"
"""Warning about a device that reports an impossible playing time of a table."""


@dataclass(frozen=True)
class CycleStarts:
    """State of the current cycle. Times are on the host's clock [s] except where noted.

    Attributes
    ----------
    until : float
        End of the last reported cycle, including its tail. Initially the creation time.
    began : float
        Start of the last reported cycle. Initially minus infinity.
    table : int
        Number of the table of the last reported cycle. 0 if the motors rest.
    last : Measured or None
        Previous telemetry, or None if it was rejected.
    slip : float
        Recent delay of table starts relative to whole periods, on the device's clock [s].
    """

    until: float
    began: float = float("-inf")
    table: int = 0
    last: Measured | None = None
    slip: float = 0.0

    def updated(
        self, new: Measured, period: float, now: float
    ) -> tuple[CycleStarts, float | None, str]:
        """Update the state with telemetry. A tail counts as a separate cycle.

        Parameters
        ----------
        new : Measured
            The telemetry.
        period : float
            Period of the current cycle, or of a rest cycle [s].
        now : float
            Current time [s].

        Returns
        -------
        starts : CycleStarts
        began : float or None
            Start of a cycle that was not reported before. None if there is no new cycle.
        problem : str
            Reason why the telemetry is inconsistent. Empty if it is consistent.
        """
        if new.clock_problem:
            return replace(self, last=None, slip=0.0), None, new.clock_problem
        seen = replace(self, last=new, slip=0.0)
        if not new.table:
            if new.time < self.until:
                return seen, None, ""
            return seen._add_start(new, self.until, period), self.until, ""
        if new.playing is None:
            return seen, None, ""
        slip, problem = self._check_telemetry(new, new.playing.cycle.period, now)
        seen = replace(seen, slip=slip)
        same = new.table == self.table and new.began - self.began < SAME_START * period
        if problem or same:
            return seen, None, problem
        return seen._add_start(new, new.began, new.playing.length), new.began, ""

    def _add_start(self, new: Measured, began: float, length: float) -> CycleStarts:
        until = max(began + length, new.time)
        return replace(self, table=new.table, began=began, until=until)

    def _check_telemetry(self, new: Measured, period: float, now: float) -> tuple[float, str]:
        """Return the new value of `slip` [s] and the reason why the telemetry is inconsistent. The
        reason is empty if the telemetry is consistent.

        `period` [s] is the period of the table that plays.
        """
        played = new.time - new.began
        if played > period + MARGIN_S:
            return 0.0, f"has played for {played:.3g} s, allowed: up to {period:.3g} s (its period)"
        if new.time > now + AHEAD_S:
            ahead = new.time - now
            return 0.0, f"was reported {ahead:.3g} s in the future, allowed: at most {AHEAD_S:g} s"
        last = self.last
        if last is None or new.device_s < last.device_s:
            return 0.0, ""
        began = new.device_s - played
        if not last.table or last.playing is None:
            if began < last.device_s - MARGIN_S:
                passed = new.device_s - last.device_s
                return 0.0, f"has played for {played:.3g} s, but did not play {passed:.3g} s ago"
            return 0.0, ""
        before = last.playing.cycle.period
        later = began - (last.device_s - (last.time - last.began))
        off = later - round(later / before) * before
        if last.table != new.table:
            if later < before - MARGIN_S:
                allowed = f"allowed: at least {before:.3g} s"
                return 0.0, f"began {later:.3g} s after the last table, {allowed}"
            # The plate rested between the two tables, so the delay of this table is unknown.
            if abs(off) > MARGIN_S:
                return 0.0, ""
        slip = self.slip + off
        if abs(slip) > MARGIN_S:
            return 0.0, f"began {slip:.3g} s off a multiple of its period, allowed: {MARGIN_S:g} s"
        forgiven = DRIFT * (new.device_s - last.device_s)
        return slip - min(max(slip, -forgiven), forgiven), ""


class StartReporter:
    """Computation of the messages on the topic cycle_started from telemetry. A tail is reported as
    a separate cycle. While the motors rest, cycles at rest are reported.

    Parameters
    ----------
    playback : Playback
        Playback of the driver. The guard of this object records inconsistent telemetry.
    now : float
        Time on the host's steady clock [s].
    """

    def __init__(self, playback: Playback, now: float) -> None:
        self._playback, self._starts = playback, CycleStarts(now)

    def update(self, measured: Measured, now: float) -> tuple[PlateCycle, float | None, str]:
        """Update the state with telemetry.

        Returns
        -------
        cycle : PlateCycle
            The plate's motion in the current cycle.
        began : float or None
            Start of this cycle on the steady clock [s]. None if the start was reported before.
        problem : str
            Warning if the telemetry is inconsistent, otherwise an empty text.
        """
        cycle = PlateCycle.rest(REST_CYCLE_S)
        if measured.table and measured.playing is not None:
            cycle = self._playback.motion(measured.playing)
        self._starts, began, problem = self._starts.updated(measured, cycle.period, now)
        if problem:
            self._playback.note(NO_START)
            problem = f"{NO_START}: table {measured.table} {problem}"
        return cycle, began, problem
