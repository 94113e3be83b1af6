"""Random events for the driver's objects, its serial transport and the firmware, in simulated time:
cycles that continue any earlier one, stops, enables, stalls, resets, lost lines and pushes."""

import types
from dataclasses import dataclass, field

import numpy as np
import pytest
from cuts import cut
from shaking import shaking

from harness.serial import PlateCheck, open_port
from plate_core import CycleError, PlateCycle, PlateError, load_rig
from plate_core.driver_status import DriverReason, DriverState
from plate_core.serial_protocol import State
from plate_driver.calibration import CalibrationRun
from plate_driver.clocks import Clocks
from plate_driver.intake import CycleIntake, NotReadyError
from plate_driver.playback import Playback
from plate_driver.setpoints import Guard
from plate_driver.status import driver_status
from plate_driver.transports import LATE_IN_MOTION, Latch, SerialTransport, TransportThread
from plate_sim.device import DeviceLimits, Emulator, FaultSchedule

RIG = load_rig()
EVENTS = 50
WALL_NS = 10**18
"""Wall time at 0 s of the steady clock."""

JUMP_M = 4e-6
"""Twice the firmware's tolerance of rest at home (`REST_M`): a table may end, and the next one may
begin, this far from it."""

BRAKED_S = 1.0
"""Brake of 0.2 s, motion home of 0.5 s, and the way of the stop over the line."""


@dataclass
class Driver:
    """The driver's node without ROS. All times are those of the device."""

    seed: int
    streams: bool
    rows: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    defects: list = field(default_factory=list)
    stalled_until: float = 0.0

    def __post_init__(self):
        self.rng, self.judge, self.latch = (
            np.random.default_rng(self.seed),
            PlateCheck(RIG),
            Latch(),
        )
        self.emulator = Emulator(DeviceLimits.of_rig(RIG), self.seed, FaultSchedule(), self.see)
        serial = SerialTransport(
            lambda: open_port(self.emulator), self.time, self.seed, self.streams, limits=RIG.limits
        )
        serial.open()
        self.transport = TransportThread(serial, self.latch, self.defects.append)
        clocks = Clocks(self.time, self.stamp_ns, lambda: False)
        guard = Guard(RIG, hold_cycles=int(self.rng.choice([1, 1, 2])))
        self.playback = Playback(guard, self.latch, lambda _: None)
        self.calibration = CalibrationRun(self.playback, self.latch, clocks, lambda *_: None)
        self.intake = CycleIntake(
            self.playback, self.latch, clocks,
            status=lambda: self.status, decode=lambda _: (self.cycle, self.stamp_ns()),
            second_publisher=lambda: "", poll_tasks=lambda: None,
        )  # fmt: skip

    def time(self):
        return self.emulator.now

    def stamp_ns(self):
        return WALL_NS + round(1e9 * self.time())

    def see(self, now, at):
        self.judge.update(now, at)
        self.rows.append((now, None if at is None else at.copy()))

    @property
    def status(self):
        return driver_status(True, self.latch, self.transport.report, False)

    def run(self, seconds):
        for _ in range(max(1, round(1e3 * seconds))):
            self.emulator.tick()
            tick = self.emulator.now_us // 1000
            if self.time() < self.stalled_until:
                continue
            if tick % 2 == 0:
                self.transport.poll()
            if tick % 20 == 0:
                self.watch()

    def watch(self):
        self.notes += [(self.time(), text) for text in self.transport.troubles()]
        if self.intake.observe().state is not DriverState.READY:
            self.playback.rest(self.time())
        else:
            self.playback.check_end(self.time())

    def send(self, cycle):
        self.cycle = cycle
        self.intake.accept(b"", 0, b"solver", self.transport)

    def stop(self, cut):
        self.latch.close(DriverReason.EMERGENCY_STOP)
        self.transport.stop(cut)

    def enable(self):
        """A person enables until the motors are ready."""
        for _ in range(80):
            if self.status.state is DriverState.READY:
                return
            if self.status.state is not DriverState.ENABLING:
                self.transport.enable(self.latch.number)
            self.run(0.1)
        raise AssertionError(self.status.text)

    def moved(self, since):
        """Time when the motors last had a speed after a time [s]. 0: never."""
        return max((t for t, at in self.rows if t > since and at is not None and at[1].any()),
                   default=0.0)  # fmt: skip


SIZES = 2e-4, 5e-4
WAVES = {
    streams: [shaking(size, period) for size in SIZES]
    for streams, period in ((False, 0.8), (True, 4.0))
}
"""Motions from which the cycles are cut. A stream is sent 0.3 s ahead, so its cycles are longer."""

PIECES = 6
"""Pieces of a cycle: 0.1 s, or 0.5 s of a stream."""


class Solver:
    """Sends cycles that begin at rest, or continue any of its earlier ones."""

    def __init__(self, rng, streams):
        self.rng, self.waves, self.sent = rng, WAVES[streams], []

    def next(self):
        """A cycle, and how to record it if the driver has accepted it."""
        kind = self.rng.choice(["next", "earlier", "first", "rest", "whole"],
                               p=[0.5, 0.2, 0.15, 0.05, 0.1])  # fmt: skip
        if kind == "rest":
            return PlateCycle.rest(0.1), None
        if kind == "whole":
            return shaking(1e-3 * self.rng.random(), 0.1), None
        wave, at = int(self.rng.integers(2)), 0
        if kind != "first" and self.sent:
            back = 1 if kind == "next" else self.rng.integers(1, 7)
            wave, at = self.sent[-min(len(self.sent), int(back))]
        if at + 2 * PIECES > len(self.waves[wave].times):
            wave, at = 0, 0
        return cut(self.waves[wave], at, at + PIECES, 0.05), (wave, at + PIECES)


def happen(driver, solver, counts):
    """One random event."""
    rng, event = driver.rng, driver.rng.random()
    if event < 0.82:
        cycle, place = solver.next()
        try:
            driver.send(cycle)
            counts["moving" if not cycle.starts_at_rest else "from rest"] += 1
            solver.sent += [] if place is None else [place]
        except NotReadyError:
            driver.enable()
            solver.sent = []
        except CycleError:
            counts["refused"] += 1
            solver.sent = solver.sent[:-1]
    elif event < 0.87:
        driver.stop(cut=bool(rng.random() < 0.3))
        stopped = driver.time()
        driver.run(BRAKED_S)
        assert driver.emulator.state is State.OFF
        driver.run(0.5)
        assert driver.moved(stopped + BRAKED_S) == 0
        driver.enable()
        solver.sent = []
        counts["stops"] += 1
    elif event < 0.91:
        stall = rng.choice([0.05, 0.2, 0.4, 1.5])
        driver.stalled_until = driver.time() + stall
        driver.run(stall)
        counts["stalls"] += 1
    elif event < 0.95:
        try:
            size = rng.choice([1e-4, 2e-3])
            driver.playback.send_push(
                driver.transport, shaking(size), driver.stamp_ns(), driver.time()
            )
            counts["pushes"] += 1
        except PlateError:
            counts["refused"] += 1
    else:
        (driver.emulator.disconnect if event < 0.98 else driver.emulator.reset)()
        counts["losses"] += 1
    driver.run(rng.choice([0.1, 0.03, 0.14, 0.4], p=[0.7, 0.1, 0.1, 0.1]))


@pytest.mark.parametrize("streams", [False, True])
def test_the_plate_never_jumps_and_comes_to_rest_with_random_events(monkeypatch, streams):
    counts = dict.fromkeys(
        ("moving", "from rest", "refused", "stops", "stalls", "pushes", "losses", "late"), 0
    )
    for seed in range(4):
        driver = Driver(seed, streams)
        clock = types.SimpleNamespace(monotonic=driver.time, time_ns=driver.stamp_ns)
        monkeypatch.setattr("plate_driver.transports.thread.time", clock)
        driver.enable()
        solver = Solver(driver.rng, streams)
        for _ in range(EVENTS):
            happen(driver, solver, counts)
        end = driver.time() + driver.playback.guard.lasts_s + BRAKED_S
        driver.run(end - driver.time() + 1.0)
        assert driver.moved(end) == 0
        assert driver.playback.guard.sent == ()
        verdict = driver.judge.verdict()
        assert verdict.worst <= 1.002, verdict
        assert verdict.jump < JUMP_M, verdict
        assert driver.defects == []
        counts["late"] += sum(text == LATE_IN_MOTION for _, text in driver.notes)
    assert min(n for name, n in counts.items() if name != "late" or not streams) > 2, counts
