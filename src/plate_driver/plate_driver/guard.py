"""The driver without ROS: what it passes on to the motors, what it refuses, when it lets them rest.

Pure: time is an argument, and what happens returns a new guard and, perhaps, a table to send.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from plate_core import CycleError, PlateCycle, Rig

from .heat import Heat
from .limits import Fit
from .motor_table import Correction, MotorTable, check_order, prepare
from .record import Record
from .watchdog import Watchdog

EXPERIMENT_CYCLES = 20
"""Cycles of a calibration's experiment until the watchdog bites: twice what it takes."""


class Mode(Enum):
    """What the driver lets through."""

    READY = "ready"
    DISABLED = "disabled, call enable"
    STOPPED = "stopped by emergency stop, call enable"
    CALIBRATING = "calibrating"


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
    mode : Mode
    last_ns : int or None
        Stamp of the last cycle accepted.
    table : MotorTable or None
        The last one sent.
    sent_at : float
        When that was [s].
    watchdog, heat, record :
        See there.
    """

    rig: Rig
    hold_cycles: int = 5
    repeats: int = 1
    correction: Correction | None = None
    mode: Mode = Mode.READY
    last_ns: int | None = None
    table: MotorTable | None = None
    sent_at: float = 0.0
    watchdog: Watchdog = field(default_factory=Watchdog)
    heat: Heat = field(default_factory=Heat)
    record: Record = field(default_factory=Record)

    def accepted(self, cycle: PlateCycle, stamp_ns: int, now: float) -> tuple[Guard, Fit]:
        """Return the guard with a cycle's table, to be sent at `now` [s].

        Raises
        ------
        CycleError
            If the cycle is refused: this guard stays as it is.
        """
        if self.mode is not Mode.READY:
            raise CycleError(f"the driver is {self.mode.value}")
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
        # Until the watchdog bites it may be played once more than that: it began in the middle.
        longest = (self.hold_cycles + 2) * (self.repeats + 2) * cycle.period
        room = heat.room(self.rig, longest)
        table, fit = prepare(self.rig, cycle, stamp_ns, self.repeats, room, self.correction)
        watchdog = self.watchdog.fed(now, table.cycle.period, self.hold_cycles)
        heat = heat.under(fit.usage.heat)
        return replace(self, table=table, sent_at=now, watchdog=watchdog, heat=heat), fit

    def experimenting(self, cycle: PlateCycle, now: float) -> tuple[Guard, PlateCycle]:
        """Return the guard with the table of a calibration's cycle, and what it makes of that.

        Nobody feeds the watchdog meanwhile: it bites if the calibration does not go on.
        """
        patient = replace(self, hold_cycles=EXPERIMENT_CYCLES, correction=None)
        guard, fitted = patient.commanded(cycle, 0, now)
        guard = replace(guard, hold_cycles=self.hold_cycles, correction=self.correction)
        return guard, fitted.cycle

    def refused(self) -> Guard:
        """Return the guard after a cycle that it did not take."""
        return replace(self, record=self.record.refusal())

    def troubled(self, trouble: str) -> Guard:
        """Return the guard that has heard what is wrong with the transport."""
        return replace(self, record=self.record.trouble(trouble))

    def resting(self, now: float) -> tuple[Guard, MotorTable | None]:
        """Return the guard with the plate at home, and the table for it; None if it never moved."""
        guard = replace(self, watchdog=self.watchdog.rested())
        if self.table is None:
            return guard, None
        table = MotorTable.rest(self.rig, self.table.cycle.period, self.table.stamp_ns)
        heat = self.heat.now(self.rig, now).under(np.zeros(4))
        return replace(guard, table=table, sent_at=now, heat=heat), table

    def watched(self, now: float) -> tuple[Guard, MotorTable | None]:
        """Return the guard at `now` [s], and the table that brings the plate to rest if it must."""
        guard = replace(self, watchdog=self.watchdog.synchronised(now))
        if not guard.watchdog.tripped(now):
            return guard, None
        guard = replace(guard, record=guard.record.rest())
        return guard.resting(now)

    def values(self, period_s: float, now: float) -> dict[str, str]:
        """Return what is to be reported of the last `period_s` at `now` [s], name to value."""
        heat = self.heat.now(self.rig, now)
        return self.record.values(period_s) | {
            "heat": f"{float(np.max(heat.share)):.4f}",
            "winding_c": f"{heat.celsius(self.rig):.1f}",
            "learned": str(self.correction is not None),
        }

    def turned(self, mode: Mode, now: float) -> tuple[Guard, MotorTable | None]:
        """Return the guard in another mode, with the plate at home."""
        return replace(self, mode=mode).resting(now)
