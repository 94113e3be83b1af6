"""When the plate begins cycles, as the device's telemetry tells. Pure; time is an argument.

A device may be wrong of how long a table has played. Where that cannot be, by the device's clock,
the table's period and our time, no start is taken from it: the planner would find parts elsewhere.
Whether the device's clock itself can be true, `transports.device_clock` tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from .transports import Measured
from .transports.device_clock import DRIFT

__all__ = ["CycleStarts"]

SAME_START = 0.5
"""Starts of a table less than this fraction of a cycle apart are one: clocks are not quite one."""

MARGIN_S = 3e-3
"""What is nearer than this is the same time [s]: less than the time between two telemetries, and
more than a table that begins at a tick of the device may be late."""

AHEAD_S = 0.1
"""How far ahead of our time telemetry may be [s]: the device's clock is known by round trips."""


@dataclass(frozen=True)
class CycleStarts:
    """What is known of the cycle that runs. Times on the host's clock [s].

    Attributes
    ----------
    until : float
        When the cycle that was told last ends, with its tail; before the first, now.
    began : float
        When it began.
    table : int
        The table whose play it is; 0: the motors rest.
    last : Measured or None
        The telemetry before, if it is believed.
    slip : float
        By how much tables have begun later than whole periods apart, of late, by the device's own
        clock [s].
    """

    until: float
    began: float = float("-inf")
    table: int = 0
    last: Measured | None = None
    slip: float = 0.0

    def heard(
        self, new: Measured, period: float, now: float
    ) -> tuple[CycleStarts, float | None, str]:
        """Take in telemetry; a tail is a cycle of its own.

        Parameters
        ----------
        new : Measured
        period : float
            Of the cycle that plays, or of one of rest [s].
        now : float

        Returns
        -------
        starts : CycleStarts
        began : float or None
            When a cycle began that was not told of yet.
        problem : str
            Why the telemetry cannot be; empty if it can.
        """
        if new.doubt:
            return replace(self, last=None, slip=0.0), None, new.doubt
        seen = replace(self, last=new, slip=0.0)
        if not new.table:
            if new.time < self.until:
                return seen, None, ""
            return seen._told(new, self.until, period), self.until, ""
        if new.playing is None:
            return seen, None, ""
        slip, problem = self._problem(new, new.playing.cycle.period, now)
        seen = replace(seen, slip=slip)
        same = new.table == self.table and new.began - self.began < SAME_START * period
        if problem or same:
            return seen, None, problem
        return seen._told(new, new.began, new.playing.length), new.began, ""

    def _told(self, new: Measured, began: float, length: float) -> CycleStarts:
        until = max(began + length, new.time)
        return replace(self, table=new.table, began=began, until=until)

    def _problem(self, new: Measured, period: float, now: float) -> tuple[float, str]:
        """Return the new slip, and why telemetry of a table of `period` [s] cannot be."""
        played = new.time - new.began
        if played > period + MARGIN_S:
            return 0.0, f"played for {played:.3g} s, allowed: {period:.3g} s, its period"
        if new.time > now + AHEAD_S:
            return 0.0, f"measured {new.time - now:.3g} s ahead of our time"
        last = self.last
        if last is None or new.device_s < last.device_s:
            return 0.0, ""
        began = new.device_s - played
        if not last.table or last.playing is None:
            if began < last.device_s - MARGIN_S:
                passed = new.device_s - last.device_s
                return 0.0, f"played for {played:.3g} s, but did not {passed:.3g} s ago"
            return 0.0, ""
        before = last.playing.cycle.period
        later = began - (last.device_s - (last.time - last.began))
        off = later - round(later / before) * before
        if last.table != new.table:
            if later < before - MARGIN_S:
                return 0.0, f"began {later:.3g} s after the table before, allowed: {before:.3g} s"
            if abs(off) > MARGIN_S:  # the plate rested meanwhile
                return 0.0, ""
        slip = self.slip + off
        if abs(slip) > MARGIN_S:
            return 0.0, f"began {slip:.3g} s later than whole periods ago, allowed: {MARGIN_S:g} s"
        forgiven = DRIFT * (new.device_s - last.device_s)
        return slip - min(max(slip, -forgiven), forgiven), ""
