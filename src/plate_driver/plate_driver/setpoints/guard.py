"""Conversion of accepted cycles to motor tables in the running driver, without ROS. The guard also
refuses cycles, detects that cycles no longer arrive, and collects statistics.

A guard is immutable. For each event there is a method that returns a new guard, and the time is an
argument. If a simulated clock is set back, the simulator was restarted. In this case, the guard
ignores earlier tables.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateCycle, Rig
from plate_core.motion import HOLD_CYCLES

from .limits import ScaledCycle
from .motor_table import RESTART_NS, Correction, MotorTable, check_order, plays, prepare
from .thermal import ThermalState

SENT_KEPT = 4
"""Number of sent cycles that are stored, because the device may be playing any of them. If a table
arrives late, the device plays the tail of an earlier table instead, and the next cycle continues
the earlier table. The solver stores the same number of cycles.
"""

EXPERIMENT_CYCLES = 9
"""Number of plays of a calibration cycle. The number is one more than the calibration needs. All
plays together last less than 10 s."""


@dataclass(frozen=True)
class Statistics:
    """Statistics of the cycles: counts since the start, and extreme values and problems since the
    last report.

    Attributes
    ----------
    cycles, refused, scaled, rests : int
        `cycles`, `refused` and `scaled` are the numbers of plate cycles that were accepted,
        refused, and accepted but scaled down. `rests` is the number of times that the plate came to
        rest because cycles no longer arrived.
    worst : float
        Maximum usage of any limit by a requested cycle, as a fraction of the limit.
    factor : float
        Minimum scaling factor of a cycle.
    late : float
        Maximum delay of a table [s]. The delay is the time since the previous table was sent, minus
        the period of the previous table's cycle.
    since : int
        Value of `cycles` at the last report.
    problems : tuple of str
        Problems since the last report. The list contains each problem only once.
    """

    cycles: int = 0
    refused: int = 0
    scaled: int = 0
    rests: int = 0
    worst: float = 0.0
    factor: float = 1.0
    late: float = 0.0
    since: int = 0
    problems: tuple[str, ...] = ()

    def accepted(self, scaled: ScaledCycle, late: float = 0.0) -> Statistics:
        """Count a cycle with the delay `late` [s], as defined for the attribute `late`."""
        new = replace(
            self,
            cycles=self.cycles + 1,
            worst=max(self.worst, scaled.requested.overall),
            factor=min(self.factor, scaled.factor),
            late=max(self.late, late),
        )
        if scaled.factor < 1:
            return replace(new, scaled=self.scaled + 1).noted("a cycle was scaled down")
        return new

    def noted(self, problem: str) -> Statistics:
        """Record a problem."""
        if problem in self.problems:
            return self
        return replace(self, problems=(*self.problems, problem))

    def reported(self) -> Statistics:
        """Reset the extreme values and problems for the next report."""
        return replace(self, worst=0.0, factor=1.0, late=0.0, since=self.cycles, problems=())

    def values(self, period_s: float) -> dict[str, str]:
        """Return the report of the last `period_s` [s] as names and values."""
        return {
            "rate_hz": f"{(self.cycles - self.since) / period_s:.2f}",
            "late_ms": f"{self.late * 1e3:.1f}",
            "cycles": str(self.cycles),
            "refused": str(self.refused),
            "scaled": str(self.scaled),
            "rests": str(self.rests),
            "worst_limit_fraction": f"{self.worst:.4f}",
            "factor": f"{self.factor:.4f}",
        }


@dataclass(frozen=True)
class Guard:
    """Check and conversion of cycles before they are sent to the motors.

    A table with a tail is played once, independently of `hold_cycles`. If no other table follows,
    the tail ends at rest.

    Attributes
    ----------
    rig : Rig
    hold_cycles, repeats : int
        `hold_cycles` is the number of plays of a cycle from rest to rest if no new cycle arrives.
        `repeats` has the same meaning as in `with_fades`.
    correction : callable or None
        Correction by a calibration. None if the rig is not calibrated.
    hold_s : float
        Maximum time for which the motors repeat a table [s].
    last_ns : int or None
        Stamp of the last accepted cycle. None before the first accepted cycle.
    table : MotorTable or None
        Last sent table. None if the plate rests.
    sent : tuple of PlateCycle
        Sent cycles that the device may be playing, the oldest first. Empty if the plate rests. The
        device itself checks whether a new table continues the table that plays.
    sent_at, lasts_s : float
        `sent_at` is the time at which the last table was sent [s]. `lasts_s` is the time from
        `sent_at` until the plate rests if no new table arrives [s].
    thermal : ThermalState
    statistics : Statistics
    """

    rig: Rig
    hold_cycles: int = HOLD_CYCLES
    repeats: int = 1
    correction: Correction | None = None
    hold_s: float = float("inf")
    last_ns: int | None = None
    table: MotorTable | None = None
    sent: tuple[PlateCycle, ...] = ()
    sent_at: float = 0.0
    lasts_s: float = 0.0
    thermal: ThermalState = field(default_factory=ThermalState)
    statistics: Statistics = field(default_factory=Statistics)

    @property
    def plays(self) -> int:
        """Number of times that the motors play the last table if no other table arrives."""
        assert self.table is not None
        cycle = self.table.cycle
        return plays(self.hold_cycles if cycle.tail is None else 1, self.hold_s, cycle.period)

    def accepted(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, ScaledCycle]:
        """Return the guard with a cycle's table, to be sent at `now` [s].

        Raises
        ------
        CycleError
            If the cycle is refused. This guard is unchanged.
        """
        check_order(self.last_ns, stamp_ns)
        guard, scaled = self.commanded(cycle, stamp_ns, now)
        late = 0.0 if self.table is None else now - self.sent_at - self.table.cycle.period
        statistics = self.statistics.accepted(scaled, max(0.0, late))
        return replace(guard, last_ns=stamp_ns, statistics=statistics), scaled

    def commanded(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, ScaledCycle]:
        """Return the guard with a cycle's table, without a check of the order of stamps.

        If the last table has ended or the clock was set back, the plate rests. In this case the new
        cycle cannot continue an earlier table.

        Raises
        ------
        CycleError
            If the plate cannot execute the cycle.
        """
        if self.over(now):  # the last table has ended since the last call of `at_time`
            return self.resting(now).commanded(cycle, stamp_ns, now)
        thermal = self.thermal.at_time(self.rig, now)
        # Upper bound of the time until the plate rests. The current table is played to its end
        # before the new table. Therefore the bound includes two additional plays, and the fade-in
        # and fade-out.
        duration_s = (
            (self.hold_cycles + 2) * (self.repeats + 2) * sum(p.period for p in cycle.parts)
        )
        allowed = thermal.allowed_load(self.rig, duration_s)
        table, scaled = prepare(
            self.rig, cycle, stamp_ns, self.repeats, allowed, self.correction, self.sent
        )
        thermal = thermal.under(scaled.usage.thermal_load)
        sent = (*self.sent, table.cycle)[-SENT_KEPT:]
        guard = replace(self, table=table, sent=sent, sent_at=now, thermal=thermal)
        # The current table is played to its end before the new table.
        first = 0.0 if self.table is None else self.table.length
        lasts_s = first + (guard.plays * table.cycle.period if table.tail is None else table.length)
        return replace(guard, lasts_s=lasts_s), scaled

    def lasting(self, until: float) -> Guard:
        """Return the guard with the latest time `until` at which its table may be sent [s, steady
        clock]."""
        assert self.table is not None
        return replace(self, table=replace(self.table, until=until))

    def experimenting(self, cycle: PlateCycle, now: float) -> tuple[Guard, PlateCycle]:
        """Return the guard with the table of a calibration cycle, and the scaled cycle."""
        patient = replace(self, hold_cycles=EXPERIMENT_CYCLES, correction=None)
        guard, scaled = patient.commanded(cycle, 0, now)
        return guard, scaled.cycle

    def after_experiment(self, before: Guard) -> Guard:
        """Return the guard with the settings of `before`, which is the guard before an
        experiment."""
        return replace(self, hold_cycles=before.hold_cycles, correction=before.correction)

    def refused(self) -> Guard:
        """Return the guard after a refused cycle."""
        more = replace(self.statistics, refused=self.statistics.refused + 1)
        return replace(self, statistics=more.noted("a cycle was refused"))

    def reported(self) -> Guard:
        """Return the guard after its statistics were reported."""
        return replace(self, statistics=self.statistics.reported())

    def noted(self, problem: str) -> Guard:
        """Return the guard with a recorded problem."""
        return replace(self, statistics=self.statistics.noted(problem))

    def resting(self, now: float) -> Guard:
        """Return the guard after the plate has stopped or come to rest."""
        thermal = self.thermal.at_time(self.rig, now).under(np.zeros(4))
        return replace(self.without_tables(), thermal=thermal)

    def without_tables(self) -> Guard:
        """Return the guard without the sent tables, so that the next cycle must begin at rest."""
        return replace(self, table=None, sent=())

    def over(self, now: float, times: float = 1.0) -> bool:
        """Return whether cycles no longer arrive.

        The result is True if the product of `times` and `lasts_s` has passed since the last table
        was sent, or if the clock was set back. A simulated time of 0 is ignored, because it means
        that no time was received yet.
        """
        if self.table is None:
            return False
        put_back = now > 0 and 1e9 * (self.sent_at - now) > RESTART_NS
        return put_back or now - self.sent_at > times * self.lasts_s

    def at_time(self, now: float) -> tuple[Guard, bool]:
        """Return the guard at `now` [s], and whether the plate now rests because no cycles
        arrive."""
        if not self.over(now):
            return self, False
        more = replace(self.statistics, rests=self.statistics.rests + 1)
        rests = replace(self.resting(now), statistics=more.noted("no more cycles arrived"))
        return replace(rests, sent_at=min(self.sent_at, now)), True

    def values(self, period_s: float, now: float) -> dict[str, str]:
        """Return the report of the last `period_s` [s] at `now` [s] as names and values."""
        thermal = self.thermal.at_time(self.rig, now)
        return self.statistics.values(period_s) | {
            "thermal_load": f"{float(np.max(thermal.rise)):.4f}",
            "winding_c": f"{thermal.celsius(self.rig):.1f}",
            "learned": str(self.correction is not None),
        }
