"""Relay without ROS. The relay decides which trajectory the controller gets next, and when.

A joint_trajectory_controller follows the newest trajectory at once and holds its last point.
Therefore the relay sends each motor table when the previous one ends. All tables begin and end at
rest at home. A cycle is always played with its tail, which brings the plate to rest. A cycle that
begins in motion is refused. If a table is sent late, the plate only rests a little longer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plate_core import CycleError, Rig
from plate_core.driver_status import DriverReason
from plate_core.motion import motor_state
from plate_driver.setpoints import MAX_KNOTS, MotorTable, unspliced
from plate_driver.transports import Condition, Measured, Order, Report

MAX_AGE_S = 0.25
"""Maximum age of joint states [s]."""

BRAKE_S, STEP_S, HOMEWARD_S = 0.2, 0.005, 0.5
"""Maximum duration of braking, time between two points of the braking trajectory, and duration of
the return to home [s]."""

AT_HOME_M = 1e-3
"""Maximum distance of a motor from home at which the motors can be enabled [m]."""

STILL_M, STILL_S = 2e-4, 0.1
"""The motors count as being at rest if they move by less than this distance [m] within this time
[s]."""

STOP_S = BRAKE_S + HOMEWARD_S + 0.5
"""Maximum time from a stop until the joint states show that the motors are at rest [s]."""

CANNOT_CUT = "a trajectory controller cannot cut the current: use the stop of the drives"
HELD = "at rest, but the motors have current: cut it at the drives before you touch the plate"


@dataclass(frozen=True)
class Trajectory:
    """Command to the controller: times (k,) from now [s], and travel [m], speed [m/s] and
    acceleration [m/s2] of the motors (k, 4). The controller interpolates with quintics."""

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


class Relay:
    """A transport of plate_driver. `plate_driver.transports.Transport` describes its methods.

    Parameters
    ----------
    rig : Rig
    command : callable
        Function that sends a Trajectory to the controller.
    publish : callable
        Function that publishes a table on motor_setpoints.
    clock : callable
        Function that returns a monotonic time [s].
    """

    motors = True
    calibrates = False
    max_knots = MAX_KNOTS
    hold_s = 10.0

    def __init__(
        self,
        rig: Rig,
        command: Callable[[Trajectory], None],
        publish: Callable[[MotorTable], None],
        clock: Callable[[], float],
    ) -> None:
        self._rig = rig
        self._command = command
        self._publish = publish
        self._clock = clock
        self._enabled = False
        self._next: tuple[MotorTable, int] | None = None
        self._playing: MotorTable | None = None
        self._plays_left = 0
        self._began = 0.0
        self._rests_at = float("-inf")  # time at which the last braking ends
        self._stop: tuple[Order, float] | None = None
        self._states: list[tuple[float, np.ndarray]] = []

    def open(self) -> None:
        """Do nothing. The joint states show whether the controller runs."""

    def receive(self, position: np.ndarray) -> None:
        """Record the motors' travel (4,) [m] from a joint state."""
        now = self._clock()
        recent = [state for state in self._states if now - state[0] <= 2 * STILL_S]
        self._states = [*recent, (now, position)]

    def poll(self) -> list[Measured]:
        """Send the next table when the previous one has ended. Return no measurements."""
        now = self._clock()
        self._settle_stop(now)
        playing = self._playing
        if playing is not None and now - self._began >= playing.cycle.period:
            self._plays_left -= 1
            if self._next is None and self._plays_left > 0:
                self._play(playing, now)
            elif self._next is None:
                self._playing = None
        ended = self._playing is None or now - self._began >= self._playing.cycle.period
        if self._next is not None and ended and now >= self._rests_at:
            (table, self._plays_left), self._next = self._next, None
            self._play(table, now)
        return []

    def report(self) -> Report:
        """Return the condition of the motors. A joint_trajectory_controller does not report whether
        current flows."""
        now = self._clock()
        if not self._states or now - self._states[-1][0] > MAX_AGE_S:
            return Report(Condition.GONE, DriverReason.NO_ANSWER, "no joint_states")
        if now < self._rests_at:
            return Report(Condition.BRAKING)
        if not self._enabled:
            return Report(Condition.OFF, DriverReason.OTHER, HELD)
        return Report(Condition.READY)

    def send(self, table: MotorTable, repeats: int) -> None:
        """Store a table. The relay sends the table when the current table has ended. Raises
        CycleError if the motors are not ready, or the table begins in motion."""
        if self.report().condition is not Condition.READY:
            raise CycleError(f"plate_cycle: the motors are {self.report().condition.value}")
        if not table.cycle.starts_at_rest:
            raise CycleError("plate_cycle: begins in motion, allowed: a cycle that begins at rest")
        table = MotorTable.of(self._rig, unspliced(table.cycle), table.stamp_ns)
        self._next = table, repeats
        self._publish(table)
        self.poll()

    def stop(self, cut: bool = False) -> Order:
        """Brake along the path and return to home. The relay cannot cut the current, so an order
        that requires this fails."""
        now, order = self._clock(), Order(STOP_S)
        self._enabled, self._next = False, None
        playing, self._playing = self._playing, None
        if playing is not None:
            along = now - self._began
            self._command(brake(self._rig, playing, along))
            self._rests_at = now + min(playing.cycle.period, BRAKE_S) + HOMEWARD_S
        if cut:
            return order.complete(CANNOT_CUT)
        self._stop = order, now
        return order

    def enable(self) -> Order:
        """Accept tables from now on. Refuse if no joint states arrive, or if the motors are away
        from home or braking."""
        now, order = self._clock(), Order()
        if not self._states or now - self._states[-1][0] > MAX_AGE_S:
            return order.complete(
                "no joint_states are received; check that joint_state_broadcaster runs"
            )
        if now < self._rests_at:
            return order.complete("the motors are braking")
        off = float(np.max(np.abs(self._states[-1][1])))
        if off > AT_HOME_M:
            return order.complete(f"a motor is {1e3 * off:.2g} mm from home, allowed: 1 mm")
        self._enabled = True
        return order.complete()

    def home(self) -> Order:
        """Refuse the homing, because the drives perform it themselves."""
        return Order().complete("the node cannot home the plate: home it with the drives")

    def troubles(self) -> list[str]:
        """Return no problems, because the report already contains all of them."""
        return []

    def values(self) -> dict[str, str]:
        """Return no values."""
        return {}

    def close(self) -> None:
        """Brake, and return to home."""
        self.stop()

    def _play(self, table: MotorTable, now: float) -> None:
        self._playing, self._began = table, now
        self._command(Trajectory(table.cycle.times, table.q, table.qd, table.qdd))

    def _settle_stop(self, now: float) -> None:
        """Complete the order to stop when the joint states show that the motors are at rest. After
        `STOP_S`, complete it with an error."""
        if self._stop is None:
            return
        order, requested_at = self._stop
        recent = [p for t, p in self._states if now - t <= STILL_S and t >= self._rests_at]
        if len(recent) > 1 and np.max(np.ptp(recent, axis=0)) < STILL_M:
            order.complete()
        elif now - requested_at > STOP_S:
            order.complete("joint_states do not show that the motors are at rest")
        if order.completed:
            self._stop = None


def brake(rig: Rig, table: MotorTable, along: float) -> Trajectory:
    """Return the trajectory that brakes on a table's path from the time `along` [s], and returns to
    home.

    The clock of the table is slowed down to a standstill (docs/protocol.md), so the plate stays on
    its path. With u = t / length, the rate of the clock is 1 - 3 u^2 + 2 u^3.
    """
    cycle = table.cycle
    length = min(cycle.period, BRAKE_S)
    t = np.append(np.arange(STEP_S, length, STEP_S), length)
    u = t / length
    rate = (1 - 3 * u**2 + 2 * u**3)[:, None]
    slowing = (6 * u * (u - 1) / length)[:, None]
    # `at` is the integral of `rate`. The path `at` stops at the end of the table.
    at = np.minimum(along + length * (u - u**3 + u**4 / 2), cycle.period)
    twist = cycle.twist(at)
    accel = cycle.accel(at) * rate**2 + slowing * twist
    states = motor_state(rig, cycle.pose(at), twist * rate, accel)
    home = [np.concatenate([state, np.zeros((1, 4))]) for state in states]
    home[1][-2] = home[2][-2] = 0.0
    return Trajectory(np.append(t, length + HOMEWARD_S), *home)
