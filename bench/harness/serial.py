"""The closed loop over the serial line, in simulated time: the driver's transport, a line with its
faults, the device, and an independent judge of what the device commands.

The device's clock rules: an image is taken at each of its boundaries; the answer reaches the driver
`ANSWER_S` later, and is uploaded while the cycle before it is played.
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
"""From an image to the driver [s]: what detector, planner and solver take together, and margin."""

POLL_TICKS = 2
"""Ticks of 1 ms between two looks of the driver at its port."""

SHORTEST_S = 0.02
"""Segments that are shorter have no image of their own [s]."""

LOOK_S = 1.0
"""What the operator takes to look at the rig and to enable again, after a stop was told [s]."""

SETTLE_S = 3.0
"""Longest time that a plate without a new cycle takes to come to rest [s]."""

ROUNDING = 2e-3
"""Share by which a limit may be passed: what the motors' splines may differ from the plate's."""

JUMP_M = 2e-6
"""A setpoint may miss what those around it promise by this much [m]: rounding of the wire."""


class Port:
    """The driver's end of the line."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator

    def _check(self) -> None:
        if not self._emulator.connected:
            raise OSError("the device is disconnected")

    def read(self, size: int) -> bytes:
        """Take what has come."""
        self._check()
        return self._emulator.to_host.arrived(self._emulator.now)

    def write(self, data: bytes) -> int:
        """Send."""
        self._check()
        self._emulator.to_device.sent(data, self._emulator.now)
        return len(data)

    def close(self) -> None:
        """Nothing to release."""


def opened(emulator: Emulator) -> Port:
    """Open the port, if it is there."""
    if not emulator.connected:
        raise PlateError("port is 'device', which is disconnected, allowed: an open serial port")
    return Port(emulator)


@dataclass
class Operator:
    """A person at the rig: enables at the start, and after each stop once he has looked at the rig,
    at what was told. Nothing else brings the current back.

    Attributes
    ----------
    enables : int
        Times that he has enabled so far.
    """

    transport: SerialTransport
    enables: int = 0
    _order: Order | None = None
    _since: float | None = None

    def look(self, now: float) -> None:
        """Look at what the driver reports at a time [s]."""
        if self.transport.report().condition is not Condition.OFF:
            self._since = None
            return
        waiting = self._order is not None and not self._order.settled
        self._since = now if self._since is None else self._since
        if not waiting and now - self._since >= (LOOK_S if self.enables else 0.0):
            self._order, self._since = self.transport.enable(), now
            self.enables += 1


class SerialLine:
    """The closed loop's transport (`plate_bringup.loop.Transport`) over a line and a device.

    Parameters
    ----------
    rig : Rig
    seed : int
        Of the line's faults.
    schedule : FaultSchedule
        What goes wrong all the time.
    event : str
        `disconnect`, `reset` or `brown_out`: happens once, ...
    at : float
        ... at this time [s], wherever the plate is in its cycle.
    """

    def __init__(
        self, rig: Rig, seed: int, schedule: FaultSchedule, event: str = "", at: float = 0.0
    ) -> None:
        self.judge = Judge(rig)
        self.emulator = Emulator(DeviceLimits.of_rig(rig), seed, schedule, self.judge.update)
        self.transport = SerialTransport(
            lambda: opened(self.emulator), lambda: self.emulator.now, seed=seed
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
        """The cycle, or tail of one, that the device plays."""
        device = self.emulator.device
        table = self.transport.sent.get(device.playing)
        if table is None or device.play is None:
            return PlateCycle.rest(IDLE_S)
        tail, (_, _, into) = table.cycle.tail, device.play
        return table.cycle if tail is None or into < device.table()[2] else tail

    def send(self, table: MotorTable) -> None:
        """Take an answer, which the driver gets `ANSWER_S` later."""
        self._waiting.append((self.emulator.now + ANSWER_S, table))

    def play(self, until: float) -> list[PlateMotion]:
        """Let time pass until an image is due; returns the plate's motions until then.

        Its images come at the ends of the device's segments: it knows of no others.
        """
        if np.isfinite(until):
            raise PlateError("image_rate is given with a serial line, allowed: a triggered camera")
        motions = []
        while True:
            while not self._segments:
                self._segments += self._tick()
            segment = self._segments.pop(0)
            motions.append(PlateMotion.of_motors(self._rig, segment.times, segment.motors))
            if segment.end - self.now >= SHORTEST_S:
                self.now = self.began = segment.end
                return motions

    def settle(self) -> None:
        """Let the plate come to rest: no more answers come."""
        self._waiting, began = [], self.emulator.now
        while self.emulator.now - began < SETTLE_S and not self.resting:
            self._tick()

    @property
    def resting(self) -> bool:
        """Whether the motors are off, or held at home."""
        return self.emulator.state in (State.OFF, State.READY)

    def _tick(self) -> list[Segment]:
        """Let a millisecond pass for all."""
        segments = self.emulator.tick()
        self.judge.moved(self.emulator.plate[0])
        now = self.emulator.now
        self._ticks += 1
        while self._waiting and self._waiting[0][0] <= now:
            self._upload(self._waiting.pop(0)[1])
        if self._ticks % POLL_TICKS == 0:
            self.transport.poll()
            self.operator.look(now)
            self.troubles.update(self.transport.troubles())
        if self._event and now >= self._at:
            getattr(self.emulator, self._event)()
            self._event = ""
        return segments

    def _upload(self, table: MotorTable) -> None:
        with suppress(CycleError):  # the device is not ready: driver_status gives the reason
            self.transport.send(table, HOLD_CYCLES if table.tail is None else 1)


def serial_run(
    setup: Setup, schedule: FaultSchedule | None = None, event: str = "", at: float = 0.0
) -> tuple[Moment, SerialLine]:
    """Run a task over the serial line, with what goes wrong (see `SerialLine`); returns the last
    moment, and the line after the plate was given time to come to rest."""
    rig = load_rig()
    line = SerialLine(rig, setup.seed, schedule or FaultSchedule(), event, at)
    *_, last = run(setup, rig, line)
    line.settle()
    return last, line


@dataclass(frozen=True)
class Verdict:
    """Greatest shares of the rig's limits in any setpoint that was commanded.

    Attributes
    ----------
    stroke, speed, force : float
        Of the motors.
    accel : float
        Of the motors, and of the plate's corners.
    jump : float
        Greatest difference of two setpoints from what their speeds say [m].
    travel : float
        Of the stroke, by the plate as it really moved, without current too.
    """

    stroke: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    force: float = 0.0
    jump: float = 0.0
    travel: float = 0.0

    @property
    def worst(self) -> float:
        """Greatest share of any limit."""
        return max(self.stroke, self.speed, self.accel, self.force, self.travel)

    @property
    def kept(self) -> bool:
        """Whether all limits were kept, and nothing jumped."""
        return bool(self.worst <= 1 + ROUNDING and self.jump < JUMP_M)


@dataclass
class Judge:
    """An independent judge of what a device commands: all limits, at every tick."""

    rig: Rig
    _setpoints: list[tuple[float, np.ndarray]] = field(default_factory=list)
    _travel: float = 0.0

    def update(self, now: float, at: np.ndarray | None) -> None:
        """Note a setpoint (3, 4) at a time [s]: position, speed, acceleration; None: no current."""
        if at is not None:
            self._setpoints.append((now, at))

    def moved(self, travel: np.ndarray) -> None:
        """Note where the motors (4,) really are [m]."""
        self._travel = max(self._travel, float(np.max(np.abs(travel))))

    def verdict(self) -> Verdict:
        """Judge all setpoints so far."""
        limits = self.rig.limits
        travel = self._travel / limits.stroke_m
        if not self._setpoints:
            return Verdict(travel=travel)
        times = np.array([now for now, _ in self._setpoints])
        q, qd, qdd = np.array([at for _, at in self._setpoints], float).transpose(1, 0, 2)
        # With infinite tolerance: whether the four agree is not asked here.
        motion = plate_state(self.rig, q, qd, qdd, np.inf)
        corners = float(np.max(np.abs(corner_accels(self.rig, motion))))
        return Verdict(
            float(np.max(np.abs(q))) / limits.stroke_m,
            float(np.max(np.abs(qd))) / limits.speed,
            max(float(np.max(np.abs(qdd))), corners) / limits.accel,
            float(np.max(np.abs(motor_forces(self.rig, motion)))) / limits.force,
            _jump(times, q, qd, qdd),
            travel,
        )


def _jump(times: np.ndarray, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> float:
    """Greatest miss [m] of Hermite's rule from a tick to the next; pauses without current aside."""
    dt = np.diff(times)
    step = dt[:, None] * (qd[1:] + qd[:-1]) / 2 - dt[:, None] ** 2 * (qdd[1:] - qdd[:-1]) / 12
    miss = np.abs(np.diff(q, axis=0) - step)[dt < 1.5 * np.min(dt, initial=np.inf)]
    return float(np.max(miss, initial=0.0))
