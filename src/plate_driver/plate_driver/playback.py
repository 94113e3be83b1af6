"""Playback of motor tables: sending of tables, detection of the end of playback, and computation of
the commanded state. This module does not use ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from plate_core import PlateCycle, Rig
from plate_core.motion import motor_state
from plate_core.status import INPUT_TIMEOUT_S

from .setpoints import Guard, MotorTable
from .transports import Latch, TransportThread

__all__ = ["Playback"]

MOTIONS_KEPT = 8
"""Number of sent cycles whose plate motions are stored. The device may still play these cycles, or
they may still wait."""


class Playback:
    """Playback of the driver's motor tables. The object sends tables, and records which table plays
    and when the plate rests.

    Parameters
    ----------
    guard : Guard
    latch : Latch
    publish : callable
        Function that publishes a table that was sent to motors.

    Attributes
    ----------
    guard : Guard
        Guard with the last table that was sent. The guard's methods `accepted`, `experimenting` and
        `commanded` prepare the next table.
    """

    def __init__(self, guard: Guard, latch: Latch, publish: Callable[[MotorTable], None]) -> None:
        self.guard, self._latch, self._publish = guard, latch, publish
        self._number = latch.number  # number of stops before the last table was sent
        # Plate motion of each corrected table. The keys are the stamps of the cycles [ns].
        self._motions: dict[int, PlateCycle] = {}

    @property
    def rig(self) -> Rig:
        """Rig. All tables stay within the limits of this rig."""
        return self.guard.rig

    def begin(self) -> None:
        """Discard the motions of earlier tables."""
        self._motions = {}

    def set_repeats(self, repeats: int) -> None:
        """Set the number of plays of a cycle that does not start at rest."""
        self.guard = replace(self.guard, repeats=repeats)

    def guard_for(self, transport: TransportThread) -> Guard:
        """Return the guard with the transport's present `hold_s`.

        After a stop, the returned guard has no tables, even if the motors were enabled again before
        the next call of `rest`.
        """
        stopped = self._number != self._latch.number
        guard = self.guard.without_tables() if stopped else self.guard
        return replace(guard, hold_s=transport.hold_s)

    def send(self, transport: TransportThread, guard: Guard, number: int) -> None:
        """Send the table that the guard contains, and store the guard for the next cycle.

        Parameters
        ----------
        transport : TransportThread
        guard : Guard
        number : int
            Number of stops that the latch had counted when the table was made.

        Raises
        ------
        CycleError
            If the motors were stopped after the table was made, or if the transport refuses the
            table.
        """
        assert guard.table is not None
        transport.send(guard.table, guard.plays, number)
        if transport.motors:
            self._publish(guard.table)
        self.guard, self._number = guard, number

    def send_push(
        self, transport: TransportThread, cycle: PlateCycle, stamp_ns: int, now: float
    ) -> float:
        """Play a motion from rest to rest once. If the plate is calibrated, the command is
        corrected by the measured response. Return the factor that scales the motion down to the
        rig's limits.

        Raises
        ------
        PlateError
            If the plate cannot perform this motion.
        """
        number, before = self._latch.number, self.guard_for(transport)
        guard, scaled = replace(before, hold_cycles=1).commanded(cycle, stamp_ns, now)
        self.send(transport, guard, number)
        self.guard = replace(guard, hold_cycles=before.hold_cycles)
        return scaled.factor

    def record_motion(self, stamp_ns: int, cycle: PlateCycle) -> None:
        """Record the plate's motion that a corrected table causes."""
        self._motions = dict([*self._motions.items(), (stamp_ns, cycle)][-MOTIONS_KEPT:])

    def motion(self, table: MotorTable) -> PlateCycle:
        """Return the plate's motion that a table causes."""
        return self._motions.get(table.stamp_ns, table.cycle)

    def rest(self, now: float) -> None:
        """Record that the plate rests."""
        self.guard = self.guard.resting(now)

    def note(self, problem: str) -> None:
        """Record a problem for the diagnostics."""
        self.guard = self.guard.noted(problem)

    def count_refused(self) -> None:
        """Count a refused cycle."""
        self.guard = self.guard.refused()

    def check_end(self, now: float) -> str:
        """Record whether the plate rests because cycles no longer arrive. Return a message if the
        plate rests for this reason, otherwise an empty text."""
        hold_s = self.guard.lasts_s
        self.guard, over = self.guard.at_time(now)
        return f"no plate_cycle for {hold_s:.3g} s: the plate rests" if over else ""

    def idle_s(self, now: float, ready_since: float) -> float | None:
        """Return the time without cycles [s] if the plate rests because cycles no longer arrive,
        otherwise None."""
        if self.guard.table is not None:
            return None
        idle = now - max(self.guard.sent_at, ready_since)
        return idle if idle > max(INPUT_TIMEOUT_S, self.guard.lasts_s) else None

    def commanded(self, now: float) -> tuple[list[float], list[float]]:
        """Return the travel [m] and speed [m/s] of each motor that are commanded at `now` [s]."""
        table = self.guard.table
        if table is None:
            return [0.0] * len(self.rig.motors), [0.0] * len(self.rig.motors)
        cycle, t = table.cycle, max(0.0, now - self.guard.sent_at)
        if cycle.tail is None:
            t %= cycle.period
        elif t > cycle.period:
            t, cycle = min(t - cycle.period, cycle.tail.period), cycle.tail
        q, qd, _ = motor_state(self.rig, cycle.pose(t), cycle.twist(t), cycle.accel(t))
        return q[0].tolist(), qd[0].tolist()
