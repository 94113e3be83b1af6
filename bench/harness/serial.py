"""The closed loop over the serial line, in simulated time: the driver's transport, a line with its
troubles, the device, the simulated plate; all but ROS and the operating system.

The device's clock rules: an image is taken at each of its boundaries; the answer reaches the driver
`ANSWER_S` later, and is uploaded while the cycle before it is played.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from harness.judge import Verdict, Watch
from harness.loop import HOLD_CYCLES, IDLE_PERIOD, Setup
from plate_core import CycleError, PlateCycle, PlateError, Rig, load_rig
from plate_core.serial_protocol import State
from plate_core.tasks import load_scenario
from plate_driver.motor_table import prepare
from plate_driver.serial_transport import SerialTransport
from plate_driver.transport import Condition, Order
from plate_planner import Planner
from plate_planner.progress import Progress
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule, Segment
from plate_sim.plate_motion import PlateMotion
from plate_sim.simulation import Simulation
from plate_solver import Controller
from plate_vision import Tracker, make_vision, observe

ANSWER_S = 0.05
"""From an image to the driver [s]: what detector, planner and solver take together, and margin."""

POLL_TICKS = 5
"""Ticks of 1 ms between two looks of the driver at its port."""

SHORTEST_S = 0.02
"""Stretches that are shorter have no image of their own [s]."""

LOOK_S = 1.0
"""What the operator takes to look at the rig and to enable again, after a stop was told [s]."""

CALM_S = 3.0
"""Longest time that a plate without a new cycle takes to come to rest [s]."""


class Port:
    """The driver's end of the line."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator

    def _check(self) -> None:
        if not self._emulator.connected:
            raise OSError("the device is gone")

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
        raise PlateError("port is 'device', allowed: a serial port that opens (it is gone)")
    return Port(emulator)


@dataclass
class Ending:
    """How a run ended.

    Attributes
    ----------
    phase, text : str
        Of the planner; what the driver last said was wrong.
    time_s : float
        Of the device's clock [s].
    dropped : int
        Parts.
    verdict : Verdict
        On what the device commanded.
    resting : bool
        Whether the motors were off or held at home a while after the end.
    retries, refused, troubles
        Of the driver.
    late, images : int
        Cycles that were played again since the next one was late, and images.
    enables : int
        Times that the operator has enabled.
    """

    phase: str
    text: str
    time_s: float
    dropped: int
    verdict: Verdict
    resting: bool
    retries: int
    refused: int
    late: int
    images: int
    troubles: dict[str, int] = field(default_factory=dict)
    enables: int = 0


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


class Loop:
    """A run; `go` plays it to its end."""

    def __init__(self, setup: Setup, rig: Rig, schedule: FaultSchedule) -> None:
        self.watch = Watch(rig)
        self._rig, self._scenario = rig, load_scenario(setup.scenario)
        self.emulator = Emulator(DeviceLimits.of_rig(rig), setup.seed, schedule, self.watch.see)
        self.transport = SerialTransport(
            lambda: opened(self.emulator), lambda: self.emulator.now, seed=setup.seed
        )
        self._simulation = Simulation(
            rig, self._scenario, setup.seed, setup.dirt, noise=setup.noise,
            mu_scale=setup.mu_scale, model=setup.model,
        )  # fmt: skip
        self._vision, self._tracker = make_vision(rig), Tracker()
        self._planner = Planner(rig, self._scenario, setup.planner)
        self._state = self._planner.start(self._planner.initial())
        self._controller = Controller(rig, setup.method, seed=setup.seed)
        self._answers: list[tuple[float, PlateCycle]] = []
        self._sent: list[PlateCycle] = []
        self._looked_at = float("-inf")
        self.operator = Operator(self.transport)
        self._troubles: dict[str, int] = {}
        self._ticks, self._late, self._images, self._table = 0, 0, 0, 0
        self._newest = ""  # trouble

    def go(self, each_tick: Callable[[Loop], None] | None = None) -> Ending:
        """Run until the planner ends the task, then let the plate come to rest."""
        self.transport.open()
        progress: Progress | None = None
        while progress is None or not progress.ended:
            for stretch in self._tick():
                progress = self._followed(stretch) or progress
            if each_tick is not None:
                each_tick(self)
        time_s = self.emulator.now
        self._answers = []
        while self.emulator.now - time_s < CALM_S and not self._resting:
            self._tick()
        text = progress.text + (f" ({self._newest})" if self._newest else "")
        return Ending(
            progress.phase, text, time_s, self._simulation.state.dropped, self.watch.verdict(),
            self._resting, self.transport.retries, self.transport.refused, self._late, self._images,
            self._troubles, self.operator.enables,
        )  # fmt: skip

    @property
    def _resting(self) -> bool:
        """Whether the motors are off, or held at home."""
        return self.emulator.device.motion.state in (State.OFF, State.READY)

    def _tick(self) -> list[Segment]:
        """Let a millisecond pass for all."""
        stretches = self.emulator.tick()
        self.watch.moved(self.emulator.plate[0])
        now = self.emulator.now
        self._ticks += 1
        while self._answers and self._answers[0][0] <= now:
            self._send(self._answers.pop(0)[1], now)
        if self._ticks % POLL_TICKS == 0:
            self.transport.poll()
            self.operator.look(now)
            for trouble in self.transport.troubles():
                self._troubles[trouble] = self._troubles.get(trouble, 0) + 1
                self._newest = trouble
        return stretches

    def _send(self, cycle: PlateCycle, now: float) -> None:
        table, _ = prepare(self._rig, cycle, round(now * 1e9))
        try:
            self.transport.send(table, HOLD_CYCLES)
        except CycleError:  # the device is not ready: driver_state gives the reason
            return
        self._sent = [*self._sent[-1:], table.cycle]

    def _followed(self, stretch: Segment) -> Progress | None:
        """Move the parts, look, plan and solve; returns the planner's progress, if it looked."""
        motion = PlateMotion.of_motors(self._rig, stretch.times, stretch.motors)
        self._simulation.run(motion)
        if stretch.end - self._looked_at < SHORTEST_S:
            return None
        self._looked_at = now = stretch.end
        image = self._simulation.look()
        if image is None:
            return None
        self._images += 1
        self._late += 0 < stretch.table == self._table
        self._table = stretch.table
        self._tracker = observe(self._vision, self._tracker, image, now)
        self._state, wanted, progress = self._planner.plan(self._state, self._tracker.parts, now)
        # As the solver's node: the cycle that was sent last is the one that runs now.
        running = self._sent[-1] if self._sent else PlateCycle.rest(IDLE_PERIOD)
        answer = self._controller.answer(wanted, running)
        self._answers.append((self.emulator.now + ANSWER_S, answer.cycle))
        return progress


def serial_run(
    setup: Setup, schedule: FaultSchedule | None = None, event: str = "", at: float = 0.0
) -> Ending:
    """Run a task over the serial line.

    Parameters
    ----------
    schedule : FaultSchedule, optional
        What goes wrong all the time.
    event : str
        `disconnect`, `reset` or `brown_out`: happens once, ...
    at : float
        ... at this time [s], wherever the plate is in its cycle.
    """
    left = [event] if event else []

    def befall(loop: Loop) -> None:
        if left and loop.emulator.now >= at:
            getattr(loop.emulator, left.pop())()

    return Loop(setup, load_rig(), schedule or FaultSchedule()).go(befall)
