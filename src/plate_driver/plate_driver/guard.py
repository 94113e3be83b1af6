"""The driver without ROS: what it passes on to the motors, what it refuses, what it takes note of.

Pure: time is an argument, on a clock that never runs back, and what happens returns a new guard.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from plate_core import PlateCycle, Rig

from .heat import Heat
from .limits import Fit
from .motor_table import Correction, MotorTable, check_order, plays, prepare
from .record import Record
from .watchdog import Watchdog

EXPERIMENT_CYCLES = 9
"""Times that a calibration's cycle is played: one more than is measured, and less than 10 s."""


@dataclass(frozen=True)
class Guard:
    """Between what comes in and the motors.

    Attributes
    ----------
    rig : Rig
    hold_cycles, repeats : int
        Periods that the plate goes on without a new cycle; see `transition.table`.
    correction : callable or None
        What was learned of the plate.
    hold_s : float
        Longest time for which the motors play a table again [s].
    last_ns : int or None
        Stamp of the last cycle accepted.
    table : MotorTable or None
        The last one sent; None: the plate rests.
    sent_at : float
        When that was [s].
    watchdog, heat, record :
        See there.
    """

    rig: Rig
    hold_cycles: int = 5
    repeats: int = 1
    correction: Correction | None = None
    hold_s: float = float("inf")
    last_ns: int | None = None
    table: MotorTable | None = None
    sent_at: float = 0.0
    watchdog: Watchdog = field(default_factory=Watchdog)
    heat: Heat = field(default_factory=Heat)
    record: Record = field(default_factory=Record)

    @property
    def plays(self) -> int:
        """Times that the motors play the last table, unless another one comes."""
        assert self.table is not None
        return plays(self.hold_cycles, self.hold_s, self.table.cycle.period)

    def accepted(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, Fit]:
        """Return the guard with a cycle's table, to be sent at `now` [s].

        Raises
        ------
        CycleError
            If the cycle is refused: this guard stays as it is.
        """
        check_order(self.last_ns, stamp_ns)
        guard, fit = self.commanded(cycle, stamp_ns, now)
        late = now - self.sent_at if self.watchdog.fed_at is not None else 0.0
        record = self.record.accepted(fit, max(0.0, late - self._due))
        return replace(guard, last_ns=stamp_ns, record=record), fit

    @property
    def _due(self) -> float:
        """When the next cycle should come, after the last one [s]."""
        return self.table.cycle.period if self.table is not None else 0.0

    def commanded(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, Fit]:
        """Return the guard with a cycle's table, whatever mode and order are.

        Raises
        ------
        CycleError
            If it is none that this plate could do.
        """
        heat = self.heat.now(self.rig, now)
        # It may be played once more than that: what plays now goes on to its end.
        longest = (self.hold_cycles + 2) * (self.repeats + 2) * cycle.period
        room = heat.room(self.rig, longest)
        table, fit = prepare(self.rig, cycle, stamp_ns, self.repeats, room, self.correction)
        heat = heat.under(fit.usage.heat)
        guard = replace(self, table=table, sent_at=now, heat=heat)
        watchdog = self.watchdog.fed(now, guard.plays * table.cycle.period)
        return replace(guard, watchdog=watchdog), fit

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
        return replace(self, record=self.record.refusal())

    def reported(self) -> Guard:
        """Return the guard whose record was told."""
        return replace(self, record=self.record.reported())

    def holding(self, hold_s: float) -> Guard:
        """Return the guard of motors that play a table again for so long [s]."""
        return replace(self, hold_s=hold_s)

    def troubled(self, trouble: str) -> Guard:
        """Return the guard that has heard what is wrong with the transport."""
        return replace(self, record=self.record.trouble(trouble))

    def resting(self, now: float) -> Guard:
        """Return the guard of a plate that is brought to rest, or has come to rest by itself."""
        heat = self.heat.now(self.rig, now).under(np.zeros(4))
        return replace(self, table=None, heat=heat, watchdog=self.watchdog.rested())

    def watched(self, now: float) -> tuple[Guard, bool]:
        """Return the guard at `now` [s], and whether it rests since cycles ceased to come."""
        if not self.watchdog.tripped(now):
            return self, False
        return replace(self.resting(now), record=self.record.rest()), True

    def values(self, period_s: float, now: float) -> dict[str, str]:
        """Return what is to be reported of the last `period_s` at `now` [s], name to value."""
        heat = self.heat.now(self.rig, now)
        return self.record.values(period_s) | {
            "heat": f"{float(np.max(heat.share)):.4f}",
            "winding_c": f"{heat.celsius(self.rig):.1f}",
            "learned": str(self.correction is not None),
        }
