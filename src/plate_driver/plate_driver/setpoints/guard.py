"""What the driver passes on to the motors and what it refuses, without ROS, and counts of both.

Pure: time is an argument, and what happens returns a new guard. A clock that is put back, as a
simulated one is when the simulator starts again, has begun anew: what was sent before is over.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateCycle, Rig

from .limits import Fit
from .motor_table import RESTART_NS, Correction, MotorTable, check_order, plays, prepare
from .thermal import ThermalState

EXPERIMENT_CYCLES = 9
"""Times that a calibration's cycle is played: one more than is measured, and less than 10 s."""


@dataclass(frozen=True)
class Statistics:
    """Counts since the start; extremes and problems since the last report.

    Attributes
    ----------
    cycles, refused, scaled, rests : int
        Plate cycles accepted, refused, accepted but scaled down, and times that the plate came to
        rest because no more came.
    worst : float
        Greatest fraction of a limit that any cycle asked for.
    factor : float
        Smallest factor that a cycle was scaled with.
    late : float
        Longest that a cycle came after the last one's end [s].
    since : int
        Cycles accepted before this report.
    problems : tuple of str
        What went wrong, each once.
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

    def accepted(self, fit: Fit, late: float = 0.0) -> Statistics:
        """Count a cycle that was sent, so much after the last one's end [s]."""
        new = replace(
            self,
            cycles=self.cycles + 1,
            worst=max(self.worst, fit.asked.overall),
            factor=min(self.factor, fit.factor),
            late=max(self.late, late),
        )
        if fit.factor < 1:
            return replace(new, scaled=self.scaled + 1).noted("a cycle was scaled down")
        return new

    def noted(self, problem: str) -> Statistics:
        """Note what went wrong."""
        if problem in self.problems:
            return self
        return replace(self, problems=(*self.problems, problem))

    def reported(self) -> Statistics:
        """Begin the next report."""
        return replace(self, worst=0.0, factor=1.0, late=0.0, since=self.cycles, problems=())

    def values(self, period_s: float) -> dict[str, str]:
        """Return the report of the last `period_s`, name to value."""
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
    """Between what comes in and the motors.

    A table with a tail is played once, whatever `hold_cycles` says: where no other one follows it
    ends at rest by itself.

    Attributes
    ----------
    rig : Rig
    hold_cycles, repeats : int
        Periods that a cycle from rest to rest is played without a new one; see `with_fades`.
    correction : callable or None
        What was learned of the plate.
    hold_s : float
        Longest time for which the motors play a table again [s].
    last_ns : int or None
        Stamp of the last cycle accepted.
    table : MotorTable or None
        The last one sent; None: the plate rests.
    sent_at, lasts_s : float
        When the last one was sent, and how long after that the plate rests without a new one [s].
    thermal : ThermalState
    statistics : Statistics
    """

    rig: Rig
    hold_cycles: int = 2
    repeats: int = 1
    correction: Correction | None = None
    hold_s: float = float("inf")
    last_ns: int | None = None
    table: MotorTable | None = None
    sent_at: float = 0.0
    lasts_s: float = 0.0
    thermal: ThermalState = field(default_factory=ThermalState)
    statistics: Statistics = field(default_factory=Statistics)

    @property
    def plays(self) -> int:
        """Times that the motors play the last table, unless another one comes."""
        assert self.table is not None
        cycle = self.table.cycle
        return plays(self.hold_cycles if cycle.tail is None else 1, self.hold_s, cycle.period)

    def accepted(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, Fit]:
        """Return the guard with a cycle's table, to be sent at `now` [s].

        Raises
        ------
        CycleError
            If the cycle is refused: this guard stays as it is.
        """
        check_order(self.last_ns, stamp_ns)
        guard, fit = self.commanded(cycle, stamp_ns, now)
        late = 0.0 if self.table is None else now - self.sent_at - self.table.cycle.period
        statistics = self.statistics.accepted(fit, max(0.0, late))
        return replace(guard, last_ns=stamp_ns, statistics=statistics), fit

    def commanded(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, Fit]:
        """Return the guard with a cycle's table, whatever mode and order are.

        Raises
        ------
        CycleError
            If it is none that this plate could do.
        """
        thermal = self.thermal.at_time(self.rig, now)
        # It may be played once more than that: what plays now goes on to its end.
        longest = (self.hold_cycles + 2) * (self.repeats + 2) * sum(p.period for p in cycle.parts)
        allowed = thermal.allowed_load(self.rig, longest)
        before = None if self.table is None else self.table.cycle
        table, fit = prepare(
            self.rig, cycle, stamp_ns, self.repeats, allowed, self.correction, before
        )
        thermal = thermal.under(fit.usage.thermal_load)
        guard = replace(self, table=table, sent_at=now, thermal=thermal)
        lasts_s = guard.plays * table.cycle.period
        if table.tail is not None:  # what plays now goes on to its end before
            lasts_s = table.length + (0.0 if self.table is None else self.table.length)
        return replace(guard, lasts_s=lasts_s), fit

    def lasting(self, until: float) -> Guard:
        """Return the guard whose table is too old from `until` on [s, steady clock]."""
        assert self.table is not None
        return replace(self, table=replace(self.table, until=until))

    def experimenting(self, cycle: PlateCycle, now: float) -> tuple[Guard, PlateCycle]:
        """Return the guard with the table of a calibration's cycle, and what it makes of that."""
        patient = replace(self, hold_cycles=EXPERIMENT_CYCLES, correction=None)
        guard, fitted = patient.commanded(cycle, 0, now)
        return guard, fitted.cycle

    def after_experiment(self, before: Guard) -> Guard:
        """Return the guard with the settings of one from before an experiment."""
        return replace(self, hold_cycles=before.hold_cycles, correction=before.correction)

    def refused(self) -> Guard:
        """Return the guard after a cycle that it did not take."""
        more = replace(self.statistics, refused=self.statistics.refused + 1)
        return replace(self, statistics=more.noted("a cycle was refused"))

    def reported(self) -> Guard:
        """Return the guard whose statistics were reported."""
        return replace(self, statistics=self.statistics.reported())

    def noted(self, problem: str) -> Guard:
        """Return the guard that knows what is wrong with the transport."""
        return replace(self, statistics=self.statistics.noted(problem))

    def resting(self, now: float) -> Guard:
        """Return the guard of a plate that is brought to rest, or has come to rest by itself."""
        thermal = self.thermal.at_time(self.rig, now).under(np.zeros(4))
        return replace(self, table=None, thermal=thermal)

    def over(self, now: float, times: float = 1.0) -> bool:
        """Tell whether cycles have ceased to come: `times` as long as the last table lasts has
        passed, or the clock was put back. At 0 a simulated clock has not been heard yet."""
        if self.table is None:
            return False
        put_back = now > 0 and 1e9 * (self.sent_at - now) > RESTART_NS
        return put_back or now - self.sent_at > times * self.lasts_s

    def watched(self, now: float) -> tuple[Guard, bool]:
        """Return the guard at `now` [s], and whether it rests since cycles ceased to come."""
        if not self.over(now):
            return self, False
        more = replace(self.statistics, rests=self.statistics.rests + 1)
        rests = replace(self.resting(now), statistics=more.noted("cycles ceased to come"))
        return replace(rests, sent_at=min(self.sent_at, now)), True

    def values(self, period_s: float, now: float) -> dict[str, str]:
        """Return what is to be reported of the last `period_s` at `now` [s], name to value."""
        thermal = self.thermal.at_time(self.rig, now)
        return self.statistics.values(period_s) | {
            "thermal_load": f"{float(np.max(thermal.rise)):.4f}",
            "winding_c": f"{thermal.celsius(self.rig):.1f}",
            "learned": str(self.correction is not None),
        }
