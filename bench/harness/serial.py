"""The closed loop over the serial line, in simulated time.

The simulation consists of the driver's transport, a serial line with faults, the device (motor
controller), and an independent check of its setpoints. The simulated time advances in ticks of the
device, 1 ms each. An image is taken whenever the device finishes a segment of a cycle. The next
cycle reaches the driver `ANSWER_S` after the image. The driver uploads this cycle while the
previous cycle is played.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from record.limits import corner_accels, motor_forces

from plate_bringup.loop import Moment, Setup, run
from plate_core import CycleError, PlateCycle, PlateError, Rig, load_rig
from plate_core.motion import HOLD_CYCLES, IDLE_S, plate_state
from plate_core.serial_protocol import State
from plate_driver.setpoints import MotorTable
from plate_driver.transports import Condition, Order, SerialTransport
from plate_sim import PlateMotion
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, Segment

ANSWER_S = 0.05
"""Time from an image until the next cycle reaches the driver [s]. This time covers the computation
of detector, planner and solver, plus a margin."""

POLL_TICKS = 2
"""Period at which the driver polls its port [ticks of 1 ms]."""

MIN_S = 0.02
"""Minimum length of a segment [s]. No image is taken at the end of a shorter segment."""

INSPECT_S = 1.0
"""Time from the report of a stop until the operator enables the motors again [s]. This delay
represents a check of the rig."""

SETTLE_S = 3.0
"""Maximum time until a plate without a new cycle is at rest [s]."""

ROUNDING = 2e-3
"""Fraction by which a setpoint can exceed a limit. The limits are checked for the plate's motion,
and the splines of the motors differ slightly from this motion."""

JUMP_M = 2e-6
"""Maximum deviation of a setpoint from the interpolation of its neighbours [m]. Rounding in the
serial protocol causes deviations below this value."""


class Port:
    """The driver's end of the simulated serial line."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator

    def _check_connected(self) -> None:
        if not self._emulator.connected:
            raise OSError("the device is disconnected")

    def read(self, size: int) -> bytes:
        """Return the bytes that have arrived."""
        self._check_connected()
        return self._emulator.to_host.arrived(self._emulator.now)

    def write(self, data: bytes) -> int:
        """Send bytes. Return their number."""
        self._check_connected()
        self._emulator.to_device.sent(data, self._emulator.now)
        return len(data)

    def close(self) -> None:
        """Do nothing, because there is nothing to release."""


def open_port(emulator: Emulator) -> Port:
    """Return the driver's port. Raise PlateError if the device is disconnected."""
    if not emulator.connected:
        raise PlateError("port is 'device', which is disconnected, allowed: a connected device")
    return Port(emulator)


@dataclass
class Operator:
    """Simulated operator, who enables the motors at the start, and `INSPECT_S` after the report of
    each stop. Nothing else enables the motors.

    Attributes
    ----------
    transport : SerialTransport
    enables : int
        Number of times that the operator has enabled the motors.
    """

    transport: SerialTransport
    enables: int = 0
    _order: Order | None = None
    _since: float | None = None

    def check(self, now: float) -> None:
        """Check the driver's report at the time `now` [s]. Enable the motors at the start, or if
        they have been off for `INSPECT_S`."""
        if self.transport.report().condition is not Condition.OFF:
            self._since = None
            return
        waiting = self._order is not None and not self._order.completed
        self._since = now if self._since is None else self._since
        if not waiting and now - self._since >= (INSPECT_S if self.enables else 0.0):
            self._order, self._since = self.transport.enable(), now
            self.enables += 1


class SerialLine:
    """Transport of the closed loop (`plate_bringup.loop.Transport`) over a simulated serial line to
    a simulated device.

    Parameters
    ----------
    rig : Rig
    seed : int
        Seed of the line's faults.
    schedule : FaultSchedule
        Permanent faults of the line.
    event : str
        Single fault during the run: `disconnect`, `reset` or `brown_out`. Empty: no such fault.
    at : float
        Time of this fault [s]. The fault can occur within a cycle.
    """

    def __init__(
        self, rig: Rig, seed: int, schedule: FaultSchedule, event: str = "", at: float = 0.0
    ) -> None:
        self.plate_check = PlateCheck(rig)
        self.emulator = Emulator(DeviceLimits.of_rig(rig), seed, schedule, self.plate_check.update)
        self.transport = SerialTransport(
            lambda: open_port(self.emulator), lambda: self.emulator.now, seed=seed
        )
        self.operator = Operator(self.transport)
        self.now, self.began = 0.0, 0.0
        self.troubles: Counter[str] = Counter()
        self._rig, self._event, self._at = rig, event, at
        self._waiting: list[tuple[float, MotorTable]] = []
        self._segments: list[Segment] = []
        self._ticks = 0
        self.transport.open()

    @property
    def running(self) -> PlateCycle:
        """Cycle, or tail of a cycle, that the device plays."""
        device = self.emulator.device
        table = self.transport.sent.get(device.playing)
        if table is None or device.play is None:
            return PlateCycle.rest(IDLE_S)
        tail, (_, _, into) = table.cycle.tail, device.play
        return table.cycle if tail is None or into < device.table()[2] else tail

    def send(self, table: MotorTable) -> None:
        """Accept a table. The driver gets the table `ANSWER_S` after the image."""
        self._waiting.append((self.emulator.now + ANSWER_S, table))

    def play(self, until: float) -> list[PlateMotion]:
        """Simulate until an image is due. Return the plate's motions until then.

        Images are taken only at the ends of the device's segments.
        """
        if np.isfinite(until):
            raise PlateError(
                "image_rate is above 0 with a serial line, allowed: 0 (a triggered camera)"
            )
        motions = []
        while True:
            while not self._segments:
                self._segments += self._tick()
            segment = self._segments.pop(0)
            motions.append(PlateMotion.of_motors(self._rig, segment.times, segment.motors))
            if segment.end - self.now >= MIN_S:
                self.now = self.began = segment.end
                return motions

    def settle(self) -> None:
        """Discard waiting tables, and simulate until the plate is at rest, for at most
        `SETTLE_S`."""
        self._waiting, began = [], self.emulator.now
        while self.emulator.now - began < SETTLE_S and not self.resting:
            self._tick()

    @property
    def resting(self) -> bool:
        """Whether the motors are off, or held at home."""
        return self.emulator.state in (State.OFF, State.READY)

    def _tick(self) -> list[Segment]:
        """Advance all parts of the simulation by 1 ms. Return the segments that the device
        finished."""
        segments = self.emulator.tick()
        self.plate_check.moved(self.emulator.plate[0])
        now = self.emulator.now
        self._ticks += 1
        while self._waiting and self._waiting[0][0] <= now:
            self._upload_table(self._waiting.pop(0)[1])
        if self._ticks % POLL_TICKS == 0:
            self.transport.poll()
            self.operator.check(now)
            self.troubles.update(self.transport.troubles())
        if self._event and now >= self._at:
            getattr(self.emulator, self._event)()
            self._event = ""
        return segments

    def _upload_table(self, table: MotorTable) -> None:
        # ignore a refused table, because driver_status reports the reason
        with suppress(CycleError):
            self.transport.send(table, HOLD_CYCLES if table.tail is None else 1)


def serial_run(
    setup: Setup, schedule: FaultSchedule | None = None, event: str = "", at: float = 0.0
) -> tuple[Moment, SerialLine]:
    """Run a task over the serial line, with faults as in `SerialLine`. Return the state of the loop
    at its last moment, and the line. The line is simulated until the plate is at rest."""
    rig = load_rig()
    line = SerialLine(rig, setup.seed, schedule or FaultSchedule(), event, at)
    *_, last = run(setup, rig, line)
    line.settle()
    return last, line


@dataclass(frozen=True)
class Verdict:
    """Maximum of each quantity over all setpoints of the device, as a fraction of the rig's limit.

    Attributes
    ----------
    stroke, speed, force : float
        Maximum travel, speed and force of the motors, as fractions of the limits.
    accel : float
        Maximum acceleration of the motors and the plate's corners, as a fraction of the limit.
    jump : float
        Maximum deviation of the step between two setpoints from the step computed with Hermite's
        rule [m].
    travel : float
        Maximum actual travel of the motors as a fraction of the stroke, including times without
        current.
    """

    stroke: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    force: float = 0.0
    jump: float = 0.0
    travel: float = 0.0

    @property
    def worst(self) -> float:
        """Maximum fraction of any limit."""
        return max(self.stroke, self.speed, self.accel, self.force, self.travel)

    @property
    def kept(self) -> bool:
        """Whether no limit was exceeded by more than `ROUNDING`, and no setpoint jumped."""
        return bool(self.worst <= 1 + ROUNDING and self.jump < JUMP_M)


@dataclass
class PlateCheck:
    """Independent check of a device's setpoints against all limits, at every tick."""

    rig: Rig
    _setpoints: list[tuple[float, np.ndarray]] = field(default_factory=list)
    _travel: float = 0.0

    def update(self, now: float, setpoint: np.ndarray | None) -> None:
        """Record a setpoint (3, 4) at a time [s]: position, speed, acceleration. None: no
        current."""
        if setpoint is not None:
            self._setpoints.append((now, setpoint))

    def moved(self, travel: np.ndarray) -> None:
        """Record the actual positions of the motors (4,) [m]."""
        self._travel = max(self._travel, float(np.max(np.abs(travel))))

    def verdict(self) -> Verdict:
        """Return the maximum fractions of all setpoints so far."""
        limits = self.rig.limits
        travel = self._travel / limits.stroke_m
        if not self._setpoints:
            return Verdict(travel=travel)
        times = np.array([now for now, _ in self._setpoints])
        q, qd, qdd = np.array([setpoint for _, setpoint in self._setpoints], float).transpose(
            1, 0, 2
        )
        # The tolerance is infinite, because the consistency of the four motors is not checked here.
        motion = plate_state(self.rig, q, qd, qdd, np.inf)
        corners = float(np.max(np.abs(corner_accels(self.rig, motion))))
        return Verdict(
            float(np.max(np.abs(q))) / limits.stroke_m,
            float(np.max(np.abs(qd))) / limits.speed,
            max(float(np.max(np.abs(qdd))), corners) / limits.accel,
            float(np.max(np.abs(motor_forces(self.rig, motion)))) / limits.force,
            _max_hermite_deviation(times, q, qd, qdd),
            travel,
        )


def _max_hermite_deviation(
    times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> float:
    """Return the maximum deviation of a step between two setpoints from Hermite's rule [m].

    Hermite's rule computes the step dq of a position over a time dt from the speeds v0, v1 and the
    accelerations a0, a1 at both ends: dq = dt (v0 + v1)/2 - dt^2 (a1 - a0)/12. Steps over pauses
    without current are not checked.
    """
    dt = np.diff(times)
    step = dt[:, None] * (qd[1:] + qd[:-1]) / 2 - dt[:, None] ** 2 * (qdd[1:] - qdd[:-1]) / 12
    miss = np.abs(np.diff(q, axis=0) - step)[dt < 1.5 * np.min(dt, initial=np.inf)]
    return float(np.max(miss, initial=0.0))
