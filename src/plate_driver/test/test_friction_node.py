"""The driver's services that measure friction: when a measurement is allowed, and what ends it."""

import shutil

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("shaking")  # of the workspace's own tests

from driven import CALM, EMERGENCY, Driven, at_rest
from rclpy.serialization import serialize_message

from plate_core import Parts, PlateCycle, load_rig
from plate_core.driver_status import DriverState
from plate_core.rig import default_rig_path
from plate_core.ros import cycle_to_msg, msg_to_motors, parts_to_msg, to_time
from plate_driver.friction import Push, slip
from plate_interfaces.msg import Friction, TaskStatus
from plate_interfaces.srv import MeasureFriction

RIG = load_rig()
G = RIG.friction.gravity
MU = {"black_1": 0.3, "grey_1": 0.34}


@pytest.fixture
def driven(monkeypatch, tmp_path):
    rig = shutil.copy(default_rig_path(), tmp_path / "rig.yaml")
    made = Driven(monkeypatch, f"rig_file:={rig}")
    yield made
    made.close()


class Plate:
    """Parts under the tables that the driver sends, and images of them."""

    def __init__(self, driven):
        self.driven, self.tables = driven, len(driven.setpoints)
        self.place = {"black_1": np.array([-0.1, 0.0]), "grey_1": np.array([0.1, 0.0])}

    def pass_time(self, seconds):
        for _ in range(round(seconds / 0.1)):
            self.driven.pass_time(0.1)
            for msg in self.driven.setpoints[self.tables :]:
                self.move(msg_to_motors(RIG, msg))
            self.tables = len(self.driven.setpoints)
            parts = Parts.make(tuple(self.place), np.array([*self.place.values()]))
            msg = parts_to_msg(parts, to_time(self.driven.clock.time_ns()))
            self.driven.node._friction._on_parts(msg)

    def move(self, cycle):
        if cycle.tail is None:
            return
        axis = int(np.argmax(np.max(np.abs(cycle.knot_pose), axis=0)[:2]))
        push = Push(axis, int(np.sign(cycle.knot_pose[-1, axis])), 0.0, cycle)
        lags = slip(push, np.array([*MU.values()]), 0.0, G)
        for name, lag in zip(MU, lags, strict=True):
            self.place[name] = self.place[name] - lag * push.sign * np.eye(2)[axis]


def start(driven, on=True):
    return driven.call("measure_friction", MeasureFriction.Request(start=on))


def last_report(driven):
    return driven.published["friction"][-1]


@pytest.mark.parametrize("factor", [1.0, 0.9])
def test_friction_is_measured_and_written_and_cycles_are_accepted_again(
    driven, monkeypatch, factor
):
    """Also if the limits permit less than the push that was intended."""
    plate, playback = Plate(driven), driven.node.playback

    def less(transport, cycle, stamp_ns, now, send_push=playback.send_push):
        return factor * send_push(transport, cycle.scaled(factor), stamp_ns, now)

    monkeypatch.setattr(playback, "send_push", less)
    refused = driven.call("write_friction")
    assert (refused.success, refused.message[:26]) == (False, "friction was not measured;")
    answer = start(driven)
    assert answer.success
    assert driven.node.status.state is DriverState.CALIBRATING
    assert driven.send(CALM).startswith("the driver is calibrating")
    again = start(driven)
    assert (again.success, "one measurement at a time" in again.message) == (False, True)
    for _ in range(200):
        plate.pass_time(1.0)
        if last_report(driven).state != Friction.RUNNING:
            break
    assert last_report(driven).state == Friction.DONE, last_report(driven).text
    assert last_report(driven).header.stamp == answer.started
    assert {part.id: part.mu for part in last_report(driven).parts} == pytest.approx(MU, rel=0.01)
    assert driven.node.status.state is DriverState.READY
    assert isinstance(driven.send(CALM), int)
    written = driven.call("write_friction")
    assert written.success, written.message
    assert load_rig(driven.node.options.rig_file).friction.mu == pytest.approx(0.32, abs=0.002)


def test_a_task_or_motors_that_are_not_ready_come_first(driven):
    msg = TaskStatus(state=TaskStatus.RUNNING)
    data = serialize_message(msg)
    driven.node.take_task(data, len(data), b"planner")
    assert start(driven).message == "a task runs, allowed: no task; end it with stop"
    data = serialize_message(TaskStatus(state=TaskStatus.DONE))
    driven.node.take_task(data, len(data), b"planner")
    driven.call("emergency_stop")
    assert "allowed: ready" in start(driven).message
    assert not driven.setpoints


def test_a_friction_measurement_without_images_fails(driven):
    assert start(driven).success
    driven.pass_time(6.0)
    assert last_report(driven).state == Friction.FAILED
    assert "no message of parts within 5 s" in last_report(driven).text
    assert driven.node.status.state is DriverState.READY
    assert not driven.setpoints


def test_simulated_time_that_stops_ends_it(monkeypatch):
    """As in lockstep: the simulator waits for a cycle, and publishes its image again and again."""
    driven = Driven(monkeypatch, "use_sim_time:=true")
    parts = Parts.make(("black_1", "grey_1"), np.array([[-0.1, 0.0], [0.1, 0.0]]))
    try:
        assert start(driven).success
        for _ in range(4):
            driven.node._friction._on_parts(parts_to_msg(parts, to_time(1)))
            driven.pass_time(1.0)
            assert last_report(driven).state == Friction.RUNNING
        assert driven.send(CALM, 1).startswith("the driver is calibrating")
        driven.pass_time(2.0)
        assert last_report(driven).state == Friction.FAILED
        assert last_report(driven).text.startswith("friction: simulated time has stopped")
        assert "In lockstep" in last_report(driven).text
        assert driven.node.status.state is DriverState.READY
        assert not driven.setpoints  # one image in four copies is not four images
        assert isinstance(driven.send(PlateCycle.rest(0.1), 1), int)  # the simulator continues
    finally:
        driven.close()


def test_a_stop_or_a_cancel_ends_the_measurement(driven):
    plate = Plate(driven)
    start(driven)
    plate.pass_time(5.0)
    assert (
        start(driven, on=False).message
        == "canceled: the plate comes to rest after the current push"
    )
    assert last_report(driven).state == Friction.FAILED
    count = len(driven.setpoints)
    plate.pass_time(5.0)
    assert len(driven.setpoints) == count
    assert start(driven, on=False).message == "no measurement of friction was running"
    start(driven)
    plate.pass_time(5.0)
    driven.call("emergency_stop")
    plate.pass_time(1.0)
    assert last_report(driven).state == Friction.FAILED
    assert last_report(driven).text == EMERGENCY
    assert at_rest(driven.setpoints[-1])


def test_images_count_from_the_end_of_a_push_that_begins_late(driven):
    """Where starts of cycles are reported, as by the simulator on a busy computer."""
    plate, server = Plate(driven), driven.node._friction

    def begin(cycle):
        server._on_start(cycle_to_msg(cycle, to_time(driven.clock.time_ns())))

    begin(PlateCycle.rest(0.1))
    start(driven)
    plate.pass_time(1.0)
    sent = server._running_cycle
    assert sent is not None
    plate.pass_time(3.0)  # far longer than the push lasts: it has not begun
    assert not server._images
    begin(sent)
    plate.pass_time(sum(part.period for part in sent.parts))
    assert not server._images
    plate.pass_time(2.0)
    assert server._running_cycle is not sent  # the next one was sent
    plate.pass_time(8.0)
    assert last_report(driven).state == Friction.FAILED
    assert last_report(driven).text == "friction: a push has not begun within 5 s"
