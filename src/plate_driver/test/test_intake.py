"""Intake and playback of cycles, with a transport in this process: no ROS, no waiting."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import CycleError, PlateCycle, PlateError, load_rig
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.motion import motor_state
from plate_driver.calibration import CalibrationRun, Response
from plate_driver.clocks import Clocks
from plate_driver.cycle_starts import StartReporter
from plate_driver.intake import CycleIntake, NotReadyError
from plate_driver.playback import Playback
from plate_driver.setpoints import Guard
from plate_driver.transports import Latch, Measured, SimTransport, TransportThread

pytest.importorskip("shaking")  # only in the workspace
from cuts import cut
from shaking import shaking

RIG = load_rig()
CALM = shaking(0.0005, 0.3)
FIRST, SECOND = cut(CALM, 0, 16), cut(CALM, 16, 32)
"""Cycles of 0.1 s with tails of 0.05 s. The first begins at rest, the second follows it."""

READY = DriverStatus(DriverState.READY, text="ready")
STAMP_NS = 10**18
"""Wall time at 0 s of the steady clock."""


class Desk:
    """Intake of a driver whose clock, state and inputs a test sets."""

    def __init__(self, response=None):
        self.now = 100.0
        self.status = READY
        self.second = ""
        self.polls = 0
        self.tables, self.latch = [], Latch()
        self.on_poll = lambda: None
        clocks = Clocks(lambda: self.now, self.stamp_ns, lambda: False)
        correction = None if response is None else response.command
        self.playback = Playback(Guard(RIG, correction=correction), self.latch, self.tables.append)
        self.transport = TransportThread(SimTransport(RIG, self.tables.append), self.latch, print)
        self.intake = CycleIntake(
            self.playback, self.latch, clocks,
            status=lambda: self.status, decode=lambda data: (self.cycle, self.stamp),
            second_publisher=lambda: self.second, poll_tasks=self.poll,
        )  # fmt: skip
        self.calibration = CalibrationRun(self.playback, self.latch, clocks, lambda *_: None)

    def stamp_ns(self):
        return STAMP_NS + round(1e9 * self.now)

    def poll(self):
        self.polls += 1
        self.on_poll()

    def send(self, cycle, age_s=0.0, source=b"solver"):
        self.cycle, self.stamp = cycle, self.stamp_ns() - round(1e9 * age_s)
        return self.intake.accept(b"", 0, source, self.transport)

    def refuse(self, match, *args, **options):
        count = len(self.tables)
        with pytest.raises(CycleError, match=match):
            self.send(*args, **options)
        assert len(self.tables) == count
        assert self.intake.refusal.startswith(match)


@pytest.fixture(name="desk", autouse=True)
def _desk(monkeypatch):
    desk = Desk()
    monkeypatch.setattr("plate_driver.transports.thread.time.monotonic", lambda: desk.now)
    return desk


def test_an_accepted_cycle_is_sent_and_counted(desk):
    scaled = desk.send(FIRST)
    assert scaled.factor == 1
    [table] = desk.tables
    assert table.stamp_ns == desk.stamp_ns()
    q, _, _ = motor_state(RIG, FIRST.knot_pose, FIRST.knot_twist, FIRST.knot_accel)
    np.testing.assert_allclose(table.q[: len(q)], q, atol=1e-12)
    assert desk.playback.guard.statistics.cycles == 1


def test_a_cycle_is_refused_with_the_reason(desk):
    desk.status = DriverStatus(DriverState.STOPPED, text="stopped")
    with pytest.raises(NotReadyError, match="the driver is stopped"):
        desk.send(FIRST)
    assert desk.intake.refusal == ""
    desk.status = READY
    desk.now += 0.1
    desk.refuse("plate_cycle is for an image 1.00 s old", FIRST, age_s=1.0)
    desk.second = "2 nodes publish plate_cycle (a, b), allowed: one"
    desk.refuse("2 nodes publish plate_cycle", FIRST)
    desk.second = ""
    assert desk.playback.guard.statistics.refused == 3
    desk.send(FIRST)
    assert desk.intake.refusal == ""


def test_a_task_that_ends_while_its_cycle_arrives_moves_nothing(desk):
    desk.on_poll = lambda: desk.intake.record_task(False, desk.stamp)
    desk.refuse("plate_cycle is for a task that has ended", FIRST)
    polls = desk.polls
    desk.send(PlateCycle.rest(0.1))
    assert desk.polls == polls  # a cycle at rest needs no task
    desk.now += 0.1
    desk.on_poll = lambda: desk.intake.record_task(True, desk.stamp)
    desk.send(FIRST)
    assert desk.intake.task_runs
    desk.now += 0.1
    desk.on_poll = lambda: desk.intake.record_task(False, None)  # a truncated report
    desk.send(SECOND)
    assert not desk.intake.task_runs


def test_a_cycle_that_arrived_before_a_stop_is_not_sent_after_it(desk):
    desk.on_poll = lambda: desk.latch.close(2)
    desk.refuse("the plate was stopped in the meantime", FIRST)
    assert desk.playback.guard.table is None


def test_a_cycle_continues_no_table_from_before_a_stop(desk):
    """Also if the motors were enabled again before their state was read."""
    desk.send(FIRST)
    desk.now += 0.05
    desk.send(SECOND)
    desk.latch.close(DriverReason.EMERGENCY_STOP)
    assert desk.latch.open(desk.latch.number)
    desk.now += 0.01
    desk.refuse("plate_cycle: begins in motion", SECOND)
    desk.send(FIRST)
    desk.now += 0.05
    desk.send(SECOND)


def test_a_push_from_before_a_stop_is_not_sent_after_it(desk):
    """The stop, and an enable, come while the push is computed."""

    def stopped(*_):
        desk.latch.close(DriverReason.EMERGENCY_STOP)
        desk.latch.open(desk.latch.number)
        return Guard(RIG).commanded(shaking(0.001), 1, desk.now)

    guard = desk.playback.guard
    slow = type("Slow", (Guard,), {"commanded": stopped})
    desk.playback.guard = slow(RIG)
    with pytest.raises(CycleError, match="the plate was stopped in the meantime"):
        desk.playback.send_push(desk.transport, shaking(0.001), desk.stamp_ns(), desk.now)
    assert desk.tables == []
    desk.playback.guard = guard


def test_a_push_is_played_once_and_keeps_the_settings(desk):
    desk.playback.guard = replace(desk.playback.guard, hold_cycles=5)
    factor = desk.playback.send_push(desk.transport, shaking(0.1), desk.stamp_ns(), desk.now)
    assert 0 < factor < 0.2
    assert desk.playback.guard.hold_cycles == 5
    assert desk.playback.guard.lasts_s == pytest.approx(0.1)
    step_s = 1e-5
    before, (_, speed), after = (
        desk.playback.commanded(desk.now + 0.04 + step) for step in (-step_s, 0.0, step_s)
    )
    change = np.subtract(after[0], before[0]) / (2 * step_s)
    np.testing.assert_allclose(change, speed, rtol=1e-4, atol=1e-5)
    assert np.max(np.abs(speed)) > 0.01
    assert desk.playback.check_end(desk.now + 0.09) == ""
    assert desk.playback.check_end(desk.now + 0.11).startswith("no plate_cycle for 0.1 s")
    assert desk.playback.commanded(desk.now + 0.11) == ([0.0] * 4, [0.0] * 4)


def test_the_start_of_a_corrected_table_is_reported_with_the_motion_of_the_plate():
    response = Response.identity(RIG, np.arange(1.0, 100.0))
    desk = Desk(replace(response, matrix=2 * response.matrix))
    reporter = StartReporter(desk.playback, desk.now)
    scaled = desk.send(shaking(0.0005))
    [table] = desk.tables
    half = np.max(np.abs(table.cycle.knot_pose)) / np.max(np.abs(scaled.cycle.knot_pose))
    assert half == pytest.approx(0.5, abs=0.05)
    began = desk.now
    desk.now += 0.01
    zero = (0.0,) * 4
    measured = Measured(desk.now, desk.now, 1, zero, zero, table, began)
    cycle, start, problem = reporter.update(measured, desk.now)
    assert (start, problem) == (began, "")
    np.testing.assert_array_equal(cycle.knot_pose, scaled.cycle.knot_pose)
    late = replace(measured, began=began - 1.0)
    _, start, problem = reporter.update(late, desk.now)
    assert start is None
    assert "table 1 has played for 1.01 s" in problem
    assert desk.playback.guard.statistics.problems


def test_a_calibration_is_refused_with_the_reason(desk, tmp_path):
    start = desk.calibration.start
    with pytest.raises(PlateError, match="calibration_file is ''"):
        start(desk.transport, READY, "")
    path = str(tmp_path / "response.npz")
    with pytest.raises(PlateError, match="this transport cannot calibrate"):
        start(desk.transport, READY, path)
    desk.transport._transport.calibrates = True
    with pytest.raises(PlateError, match="the driver is calibrating, allowed: ready"):
        start(desk.transport, DriverStatus(DriverState.CALIBRATING, text="calibrating"), path)
    with pytest.raises(PlateError, match="cannot be written"):
        start(desk.transport, READY, str(tmp_path / "nowhere" / "response.npz"))
    assert not desk.calibration.running
    assert desk.calibration.text == ""


def test_a_calibration_that_is_not_played_to_its_end_fails(desk, tmp_path):
    desk.transport._transport.calibrates = True
    hold_cycles = desk.playback.guard.hold_cycles
    desk.calibration.start(desk.transport, READY, str(tmp_path / "response.npz"))
    assert desk.calibration.running
    assert desk.calibration.text.endswith("shaking the plate in x")
    assert desk.playback.guard.hold_cycles == hold_cycles
    lasts_s = desk.playback.guard.lasts_s
    desk.calibration.step(desk.transport, desk.now + lasts_s)
    assert desk.calibration.running
    desk.calibration.step(desk.transport, desk.now + 2.1 * lasts_s)
    assert not desk.calibration.running
    assert desk.calibration.failed
    assert desk.calibration.text.startswith("failed: the motors did not play")
    assert desk.playback.guard.table is None
