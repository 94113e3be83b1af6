"""The simulator node in a graph of its own: time, answers, refusals."""

# ruff: noqa: E402  (without ROS these tests are left out, before anything of it is imported)

import os

import numpy as np
import pytest
import yaml
from shaking import bump

from plate_core import PlateCycle, PlateError, config_path, load_rig

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from stepped_clock import SteppedExecutor
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import (
    CAMERA,
    DATA,
    LATCHED,
    image_to_array,
    motors_to_msg,
    msg_to_cycle,
    msg_to_parts,
    nanoseconds,
    start_nodes,
    to_time,
)
from plate_interfaces.msg import DriverStatus
from plate_interfaces.msg import Parts as PartsMsg
from plate_interfaces.srv import MoveRobot, OpenHopper, PlacePart, RemovePart
from plate_sim.node import START_NS, SimulatorNode
from plate_sim.world import RANGES

RIG = load_rig()
MAX_S = 20.0
"""Maximum time without a message until a test fails [s]."""


def push():
    return bump(4e-3, 0.05)


class Loop:
    """A simulator, and a node that receives its messages and answers each image by `answer(index,
    stamp)`."""

    clock = None
    """Of the test."""

    def __init__(self, answer=None, **parameters):
        arguments = ["--ros-args", "-r", f"__ns:=/test_{os.getpid()}"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={str(value).lower()}"]
        rclpy.init(args=arguments)
        self.answer = answer
        self.images = []
        self.infos = []
        self.truths = []
        self.reports = []
        self.ear = Node("ear")
        for kind, topic, received, qos in (
            (CameraInfo, "camera_info", self.infos.append, CAMERA),
            (PartsMsg, "ground_truth", self.truths.append, DATA),
            (DiagnosticArray, "diagnostics", self.reports.append, DATA),
            (Image, "image_raw", self.on_image, CAMERA),
        ):
            self.ear.create_subscription(kind, topic, received, qos)
        self.tables = self.ear.create_publisher(JointTrajectory, "motor_setpoints", DATA)
        self.simulator = SimulatorNode()
        start_nodes(self.simulator)
        self.executor = SteppedExecutor(self.clock)
        self.executor.add_node(self.ear)
        self.executor.add_node(self.simulator)

    def on_image(self, msg):
        if not self.images or self.images[-1].header.stamp != msg.header.stamp:
            self.images.append(msg)
        if self.answer is not None:
            self.tables.publish(self.answer(len(self.images) - 1, msg.header.stamp))

    def spin(self, done, longest_s=MAX_S):
        end = self.clock.monotonic() + longest_s
        while not done() and self.clock.monotonic() < end:
            self.executor.spin_once()
        return done()

    @property
    def stamps(self):
        return [nanoseconds(msg.header.stamp) for msg in self.images]

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.simulator.destroy_node()
        self.ear.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture(autouse=True)
def _time(clock, monkeypatch):
    monkeypatch.setattr(Loop, "clock", clock)


def good(index, stamp):
    return motors_to_msg(RIG, push(), stamp)


def lockstep_run(seed, count=6):
    with Loop(good, lockstep=True, seed=seed) as loop:
        assert loop.spin(lambda: len(loop.images) >= count and len(loop.truths) >= count)
        pixels = [image_to_array(msg).copy() for msg in loop.images[:count]]
        return loop.stamps[:count], pixels, [msg_to_parts(msg) for msg in loop.truths[-1:]]


def test_lockstep_repeats_a_run_to_the_last_bit():
    stamps, pixels, truths = lockstep_run(seed=3)
    # Cycle 0 rests; the answer to image k is cycle k + 1.
    assert stamps == [START_NS, *(START_NS + 100_000_000 + k * 50_000_000 for k in range(5))]
    again = lockstep_run(seed=3)
    assert again[0] == stamps
    assert all(np.array_equal(a, b) for a, b in zip(pixels, again[1], strict=True))
    assert not np.array_equal(pixels[0], lockstep_run(seed=4, count=1)[1][0])
    assert truths[0].ids[:2] == ("black_1", "black_2")


def test_stamps_keep_to_the_system_clock_when_that_is_set():
    with Loop(good) as loop:
        assert loop.spin(lambda: len(loop.images) >= 2)
        loop.simulator._next_ns -= 3_600_000_000_000  # as seen from a clock that was put forward
        assert loop.spin(lambda: len(loop.images) >= 5)
        assert abs(loop.stamps[-1] - loop.clock.ns) < 60e9


def test_lockstep_waits_and_requests_again():
    with Loop(lockstep=True) as loop:
        assert loop.spin(lambda: len(loop.infos) >= 2)
        assert len(loop.images) == 1
        loop.answer = good
        assert loop.spin(lambda: len(loop.images) >= 3)
        assert (loop.infos[0].width, loop.infos[0].height) == (640, 480)
        assert np.array_equal(np.reshape(loop.infos[0].k, (3, 3)), RIG.camera.lens.matrix)


def missed_run(seed, count=8):
    options = {"lockstep": True, "missed_images": 0.5, "seed": seed, "hold_cycles": 2}
    with Loop(good, **options) as loop:
        assert loop.spin(lambda: len(loop.images) >= count)
        loop.answer = None
        loop.reports.clear()
        assert loop.spin(lambda: bool(loop.reports))
        values = {item.key: item.value for item in loop.reports[-1].status[0].values}
        return loop.stamps[:count], values


def test_lockstep_continues_after_a_missed_image_as_real_time_does():
    stamps, values = missed_run(seed=4)
    # A cycle takes 50 ms where a table is played or held, 100 ms where the plate rests.
    steps = np.diff(stamps) // 50_000_000
    assert np.all(np.diff(stamps) % 50_000_000 == 0)
    assert np.all(steps[1:] >= 1)
    assert steps.max() > 1
    assert int(values["missed images"]) >= np.count_nonzero(steps[1:] > 1) > 0
    assert int(values["held cycles"]) >= 1
    assert values["disturbances"] == "missed_images 0.5"
    assert missed_run(seed=4)[0] == stamps


@pytest.mark.parametrize("change", ["reset", "place", "remove", "noise"])
def test_in_real_time_the_next_image_shows_what_a_person_changed(change):
    with Loop(scenario="sort_4", seed=7, noise=0.0, idle_period=0.5) as loop:
        assert loop.spin(lambda: len(loop.images) >= 2)
        before = image_to_array(loop.images[-1])
        if change == "reset":
            assert call(loop, Trigger, "reset").success
        elif change == "place":
            assert call(loop, PlacePart, "place_part", type="grey", x=0.28, y=0.14).success
        elif change == "remove":
            assert call(loop, RemovePart, "remove_part", id="grey_1").success
        else:
            assert not set_parameters(loop, noise=5.0)
        count = len(loop.images)
        assert loop.spin(lambda: len(loop.images) > count)
        assert not np.array_equal(image_to_array(loop.images[count]), before)


def test_reset_puts_the_parts_down_as_the_next_seed_would():
    with Loop(lockstep=True, scenario="sort_4", seed=7, noise=0.0) as loop:
        assert loop.spin(lambda: len(loop.truths) == 1)
        client = loop.ear.create_client(Trigger, "simulator/reset")
        assert loop.spin(client.service_is_ready)
        future = client.call_async(Trigger.Request())
        assert loop.spin(future.done)
        assert future.result().message == "parts are at new positions, seed 8"
        loop.answer = good
        assert loop.spin(lambda: len(loop.truths) >= 2)
        seeds = [msg_to_parts(msg).position for msg in loop.truths[:2]]
    with Loop(lockstep=True, scenario="sort_4", seed=8, noise=0.0) as loop:
        assert loop.spin(lambda: len(loop.truths) == 1)
        assert np.array_equal(msg_to_parts(loop.truths[0]).position, seeds[1])
        assert not np.array_equal(*seeds)


def call(loop, kind, name, of="simulator/", **request):
    """The answer of a service of the simulator."""
    client = loop.ear.create_client(kind, of + name)
    assert loop.spin(client.service_is_ready)
    future = client.call_async(kind.Request(**request))
    assert loop.spin(future.done)
    return future.result()


def set_parameters(loop, **values):
    """Why it was refused; empty if it was not."""
    parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    results = call(loop, SetParameters, "set_parameters", parameters=parameters).results
    return "; ".join(result.reason for result in results if not result.successful)


def test_parts_are_put_down_and_taken_off_by_hand():
    with Loop(lockstep=True, scenario="sort_4", noise=0.0) as loop:
        assert loop.spin(lambda: len(loop.truths) == 1)
        reply = call(loop, PlacePart, "place_part", type="grey", x=0.28, y=0.14)
        assert (reply.success, reply.id) == (True, "grey_3")
        assert reply.message == "new: grey_3 is at (0.280, 0.140) m"
        assert call(loop, PlacePart, "place_part", id="grey_1", x=0.28, y=-0.14, angle=0.1).success
        reply = call(loop, PlacePart, "place_part", id="grey_2", x=0.28, y=0.14)
        assert not reply.success
        assert "parts grey_2 and grey_3 overlap by 16 mm" in reply.message
        assert call(loop, RemovePart, "remove_part", id="black_1").message == "black_1 was removed"
        assert "id is 'black_1'" in call(loop, RemovePart, "remove_part", id="black_1").message
        loop.answer = still
        assert loop.spin(lambda: len(loop.truths) >= 2)
        truth = msg_to_parts(loop.truths[-1])
        assert truth.ids == ("black_2", "grey_1", "grey_2", "grey_3")
        assert truth.position[[1, 3]] == pytest.approx(np.array([[0.28, -0.14], [0.28, 0.14]]))


def still(index, stamp):
    return motors_to_msg(RIG, PlateCycle.rest(0.1), stamp)


def open_hopper(loop, duration):
    return call(loop, OpenHopper, "open", of="hopper/", duration_s=duration)


def test_a_hopper_is_opened_and_a_robot_takes_parts():
    with Loop(lockstep=True, scenario="feed", noise=0.0, seed=3) as loop:
        assert loop.spin(lambda: len(loop.truths) == 1)
        reply = open_hopper(loop, 0.2)
        assert (reply.success, reply.message) == (True, "open for 0.2 s, 2 parts will drop")
        loop.answer = still
        assert loop.spin(lambda: len(loop.truths) >= 4)
        loop.answer = None
        truth = msg_to_parts(loop.truths[-1])
        assert len(truth.ids) == 12
        places, before = truth.position, image_to_array(loop.images[-1]).astype(int)
        x, y = places[0] + [0.003, 0.0]
        reply = call(loop, MoveRobot, "move_robot", to=MoveRobot.Request.GRIP, x=x, y=y)
        assert (reply.success, reply.id) == (True, "black_1")
        assert reply.error_m == pytest.approx(0.003)
        assert reply.error_rad == 0
        assert not set_parameters(loop, pick_failure=1.0)
        x, y = places[1]
        reply = call(loop, MoveRobot, "move_robot", to=MoveRobot.Request.GRIP, x=x, y=y)
        assert (reply.success, reply.id, reply.message) == (False, "black_2", "black_2 slipped")
        stamp, images = loop.images[-1].header.stamp, len(loop.images)
        loop.tables.publish(still(0, stamp))
        assert loop.spin(lambda: len(loop.images) > images)
        changed = np.abs(image_to_array(loop.images[-1]).astype(int) - before) > 20
        assert np.count_nonzero(changed) > 2000  # pixels of an arm
        assert call(loop, MoveRobot, "move_robot", to=MoveRobot.Request.AWAY).success
        assert msg_to_parts(loop.truths[-1]).ids == truth.ids[1:]


def test_impossible_calls_of_hopper_and_robot_return_the_reason():
    duration = float("nan")
    with Loop(lockstep=True, scenario="feed") as loop:
        reply = open_hopper(loop, duration)
        assert not reply.success
        assert "allowed: 0 (closes it) to 60 s" in reply.message
        reply = call(loop, MoveRobot, "move_robot", to=7)
        assert (reply.success, reply.message[:8]) == (False, "to is 7,")
        reply = call(loop, MoveRobot, "move_robot", to=MoveRobot.Request.GRIP, x=duration)
        assert (reply.success, reply.message[:11]) == (False, "gripper is ")


def test_a_scenario_without_a_hopper_is_reported():
    with Loop(lockstep=True, scenario="sort_4") as loop:
        assert "this scenario has no hopper" in open_hopper(loop, 1.0).message


@pytest.mark.parametrize("options", [{"image_rate": 40.0, "latency": 0.05}, {}])
def test_parts_drop_and_leave_in_real_time(options):
    with Loop(scenario="feed", seed=4, **options) as loop:
        assert loop.spin(lambda: len(loop.truths) >= 2)
        assert open_hopper(loop, 0.5).success
        assert loop.spin(lambda: len(loop.truths[-1].parts) == 15)
        x, y = msg_to_parts(loop.truths[-1]).position[-1]
        assert call(loop, MoveRobot, "move_robot", to=MoveRobot.Request.GRIP, x=x, y=y).success
        assert loop.spin(lambda: len(loop.truths[-1].parts) == 14)


def test_parts_drop_where_the_device_drives():
    with Loop(scenario="feed", driven_by="device", seed=2) as loop:
        motions = loop.ear.create_publisher(JointTrajectory, "motor_motion", DATA)
        ends = (motions, loop.simulator._truths)
        assert loop.spin(lambda: all(end.get_subscription_count() == 1 for end in ends))
        assert open_hopper(loop, 0.2).success
        start = loop.simulator._time_ns + 1_000_000_000
        for k in range(6):
            motions.publish(motors_to_msg(RIG, push(), to_time(start + k * 50_000_000)))
            assert loop.spin(lambda k=k: len(loop.truths) > k)
        assert [len(msg.parts) for msg in loop.truths] == [10, 11, 11, 12, 12, 12]


def test_a_seed_that_is_set_counts_at_the_next_reset():
    with Loop(lockstep=True, scenario="sort_4", seed=7) as loop:
        for seed, used in ((7, 7), (None, 8), (3, 3), (3, 3)):
            assert seed is None or not set_parameters(loop, seed=seed)
            answer = call(loop, Trigger, "reset")
            assert answer.message == f"parts are at new positions, seed {used}"


def test_the_world_changes_while_it_runs_where_it_can():
    with Loop(good, lockstep=True, scenario="sort_4", seed=1) as loop:
        assert not set_parameters(loop, friction_spread=0.4, mu_scale=1.2, shadows=0.5, tilt_x=0.01)
        assert loop.simulator._simulation.disturbances.shadows == 0.5
        assert np.ptp(loop.simulator._simulation.mu) > 0
        max_tilt = RANGES["tilt_x"][1]
        assert "tilt" in set_parameters(loop, tilt_x=max_tilt, tilt_y=max_tilt)
        assert (loop.simulator.options.tilt_x, loop.simulator.options.tilt_y) == (max_tilt, 0.0)
        assert not set_parameters(loop, noise=3.0)  # refused messages are forgotten
        assert "not active" in set_parameters(loop, latency=0.1)
        assert "rate is 2 in lockstep, allowed: 1" in set_parameters(loop, rate=2.0)


def test_time_goes_faster_and_slower_without_a_jump():
    with Loop(good, simulated_time=True, scenario="sort_4") as loop:
        clock = []
        loop.ear.create_subscription(ClockMsg, "/clock", clock.append, DATA)
        assert loop.spin(lambda: len(clock) > 20)
        assert not set_parameters(loop, rate=0.05)
        loop.executor.spin_for(1.0)
        times = np.array([nanoseconds(msg.clock) for msg in clock])
        assert np.all(np.diff(times) >= 0)
        slow = 1e-9 * times[-1]
        assert not set_parameters(loop, rate=20.0)
        assert loop.spin(lambda: 1e-9 * nanoseconds(clock[-1].clock) > slow + 5.0)
        assert np.all(np.diff([nanoseconds(msg.clock) for msg in clock]) >= 0)


def spoilt(index, stamp):
    """Answers of which none may be played."""
    msg = motors_to_msg(RIG, push(), stamp)
    if index % 4 == 0:
        msg.points[5].positions[0] = float("nan")
    elif index % 4 == 1:
        msg.joint_names[0] = "motor_9"
    elif index % 4 == 2:
        msg.points = msg.points[3:]  # does not start at rest, nor at 0
    else:
        msg = motors_to_msg(RIG, push().scaled(3.0), stamp)
    return msg


def test_bad_tables_are_refused_and_the_plate_carries_on():
    with Loop(spoilt, lockstep=True) as loop:
        assert loop.spin(lambda: len(loop.images) >= 9)
        loop.answer = None
        loop.reports.clear()
        assert loop.spin(lambda: bool(loop.reports))
        values = {item.key: item.value for item in loop.reports[-1].status[0].values}
        assert int(values["refused tables"]) >= 8
        assert set(np.diff(loop.stamps)) == {100_000_000}  # it only rested
        assert np.array_equal(
            msg_to_parts(loop.truths[0]).position, msg_to_parts(loop.truths[-1]).position
        )


def test_diagnostics_report_timeouts_and_refusals():
    def wait_for(loop, level, text):
        loop.reports.clear()

        def published():
            status = loop.reports[-1].status[0] if loop.reports else None
            return status and status.level == level and text in status.message

        assert loop.spin(published), loop.reports[-1:]

    with Loop(idle_period=0.05, input_timeout_s=0.3) as loop:
        wait_for(
            loop,
            DiagnosticStatus.STALE,
            "no motor table yet on motor_setpoints; check that the driver",
        )
        loop.answer = good
        assert loop.spin(lambda: 50_000_000 in np.diff(loop.stamps))
        assert loop.spin(lambda: loop.reports[-1].status[0].level != DiagnosticStatus.STALE)
        loop.answer = spoilt
        wait_for(loop, DiagnosticStatus.ERROR, "tables refused: ")
        loop.answer = None
        wait_for(loop, DiagnosticStatus.STALE, "no motor table for ")
        # A driver that is not ready sends no tables, so they are not missing.
        driver = loop.ear.create_publisher(DriverStatus, "driver_status", LATCHED)
        driver.publish(DriverStatus(state=DriverStatus.STOPPED, text="stopped: power cut"))
        wait_for(loop, DiagnosticStatus.OK, "the plate rests, driver: stopped: power cut")
        driver.publish(DriverStatus(state=DriverStatus.READY))
        wait_for(loop, DiagnosticStatus.STALE, "no motor table for ")


def test_real_time_continues_without_results():
    with Loop(idle_period=0.02) as loop:
        assert loop.spin(lambda: len(loop.images) >= 5)
        assert set(np.diff(loop.stamps)) == {20_000_000}
        assert abs(loop.stamps[-1] - loop.clock.ns) <= 20_000_000


def going(begin, end):
    """Table of 50 ms from one state of the plate to another, with a tail of 50 ms."""
    knots = np.stack([begin, end, end, np.zeros((3, 3))], axis=1)
    return PlateCycle.from_knots(np.array([0.0, 0.05, 0.05, 0.1]), *knots)


HOME, ON_ITS_WAY = np.zeros((3, 3)), np.array([[1e-3, 0, 0], [0.02, 0, 0], [0.0, 0, 0]])
LEAVES, GOES_ON = going(HOME, ON_ITS_WAY), going(ON_ITS_WAY, ON_ITS_WAY)


def hear_starts(loop):
    """The cycles that the plate has begun, from now on."""
    starts = []
    loop.ear.create_subscription(
        JointTrajectory, "cycle_started", lambda msg: starts.append(msg_to_cycle(msg)), DATA
    )
    assert loop.spin(loop.simulator._starts.get_subscription_count)
    return starts


def kinds(starts):
    """The kind of each of them."""
    known = {"leaves": LEAVES, "goes on": GOES_ON, "tail": LEAVES.tail, "push": push()}
    names = []
    for cycle in starts:
        same = [
            name for name, one in known.items()
            if one.knot_pose.shape == cycle.knot_pose.shape
            and np.allclose(one.knot_pose, cycle.knot_pose, atol=1e-12)
        ]  # fmt: skip
        names.append("rest" if not cycle.moves else "".join(same))
    return names


def test_a_table_in_motion_follows_the_one_that_ends_so_else_the_plate_comes_to_rest():
    tables = [LEAVES, GOES_ON, GOES_ON, push(), LEAVES, GOES_ON.tail, GOES_ON, push()]

    def answer(index, stamp):
        return motors_to_msg(RIG, tables[min(index, 7)], stamp)

    with Loop(lockstep=True) as loop:
        starts = hear_starts(loop)
        assert loop.spin(lambda: starts)  # with the first image, which comes again
        loop.answer = answer
        assert loop.spin(lambda: len(loop.images) >= 9 and "push" in kinds(starts))
        played = ["rest", "leaves", "goes on", "goes on", "tail", "leaves", "tail", "rest", "push"]
        names = kinds(starts)
        del names[1 : names.index("leaves")]  # the first one came several times
        assert names[: len(played)] == played
        ends = [100, 50, 50, 50, 50, 50, 50, 100]
        assert np.diff(loop.stamps[:9]).tolist() == [1_000_000 * each for each in ends]
        assert loop.simulator._count["refused tables"] == 1
        assert loop.simulator._count["held cycles"] == 0


def test_without_a_new_table_the_tail_is_played_and_the_plate_rests():
    with Loop(idle_period=0.05) as loop:
        starts = hear_starts(loop)
        assert loop.spin(loop.tables.get_subscription_count)
        loop.tables.publish(motors_to_msg(RIG, LEAVES, to_time(0)))
        assert loop.spin(lambda: "leaves" in kinds(starts))
        for table in (GOES_ON, push(), GOES_ON):  # the newest that follows, not the newest
            loop.tables.publish(motors_to_msg(RIG, table, to_time(0)))
        assert loop.spin(lambda: kinds(starts)[-2:] == ["tail", "rest"])
        assert kinds(starts)[-4:] == ["leaves", "goes on", "tail", "rest"]
        assert loop.simulator._count["held cycles"] == 1
        assert loop.simulator._count["late cycles"] == 0


def test_after_a_pause_the_plate_is_at_rest():
    with Loop(idle_period=0.05) as loop:
        starts = hear_starts(loop)
        assert loop.spin(loop.tables.get_subscription_count)
        loop.tables.publish(motors_to_msg(RIG, LEAVES, to_time(0)))
        assert loop.spin(lambda: "leaves" in kinds(starts))
        loop.simulator.trigger_deactivate()
        loop.simulator.trigger_activate()
        count = len(starts)
        assert loop.spin(lambda: len(starts) > count)
        loop.tables.publish(motors_to_msg(RIG, GOES_ON, to_time(0)))
        assert loop.spin(lambda: loop.simulator._count["refused tables"] == 1)
        assert loop.spin(lambda: len(starts) > count + 3)
        assert set(kinds(starts[count:])) == {"rest"}


def test_a_camera_that_runs_free_takes_images_at_any_time():
    options = {"image_rate": 40.0, "latency": 0.02, "stamp_jitter": 0.001, "seed": 5}
    with Loop(scenario="sort_4", **options) as loop:
        starts = []
        loop.ear.create_subscription(JointTrajectory, "cycle_started", starts.append, DATA)
        assert loop.spin(lambda: len(starts) >= 2)
        loop.images.clear()
        assert loop.spin(lambda: len(loop.images) >= 25)
        begins = [nanoseconds(msg.header.stamp) for msg in starts]
        assert set(np.diff(begins)) == {100_000_000}
        steps = np.diff(loop.stamps)
        assert np.all(steps > 0)
        assert abs(np.median(steps) * 1e-6 - 25) < 3
        phases = {(stamp - begins[0]) % 100_000_000 // 10_000_000 for stamp in loop.stamps}
        assert len(phases) >= 4  # all over the cycle
        assert not msg_to_cycle(starts[-1]).knot_pose.any()
        ends = (loop.tables, loop.simulator._starts)
        assert loop.spin(lambda: all(end.get_subscription_count() for end in ends))
        loop.tables.publish(motors_to_msg(RIG, push(), to_time(0)))
        assert loop.spin(lambda: msg_to_cycle(starts[-1]).knot_pose.any())
        assert np.allclose(msg_to_cycle(starts[-1]).knot_pose, push().knot_pose, atol=1e-12)


def test_driven_by_the_device_a_camera_may_run_free_too():
    options = {"driven_by": "device", "image_rate": 25.0, "seed": 2}
    with Loop(scenario="sort_4", **options) as loop:
        motions = loop.ear.create_publisher(JointTrajectory, "motor_motion", DATA)
        assert loop.spin(lambda: motions.get_subscription_count() == 1)
        assert loop.spin(lambda: loop.simulator._images.get_subscription_count() == 1)
        start = loop.simulator._time_ns + 1_000_000_000
        for k in range(4):  # of 50 ms, with an image each 40 ms
            motions.publish(motors_to_msg(RIG, push(), to_time(start + k * 50_000_000)))
            assert loop.spin(lambda k=k: len(loop.stamps) > k)
        assert np.all(np.abs(np.diff(loop.stamps) - 40_000_000) <= 1000)
        assert start <= loop.stamps[0] < start + 40_000_000


def test_driven_by_the_device_the_parts_follow_what_was_played():
    """Whole tables, a stretch of rest that is too short for an image, and refusals."""
    with Loop(scenario="sort_4", driven_by="device", noise=0.0, seed=2) as loop:
        motions = loop.ear.create_publisher(JointTrajectory, "motor_motion", DATA)
        ends = (motions, loop.simulator._truths, loop.simulator._images)
        assert loop.spin(lambda: all(end.get_subscription_count() == 1 for end in ends))
        start = loop.simulator._time_ns + 1_000_000_000
        table = motors_to_msg(RIG, push(), to_time(0))

        def play(msg: JointTrajectory, at: int) -> None:
            msg.header.stamp = to_time(at)
            motions.publish(msg)

        play(table, start)
        assert loop.spin(lambda: len(loop.truths) == 1)
        short = motors_to_msg(RIG, PlateCycle.rest(0.01), to_time(0))
        play(short, start + 50_000_000)
        bad = motors_to_msg(RIG, push(), to_time(0))
        bad.points[3].positions[0] = float("nan")
        play(bad, start + 60_000_000)
        play(table, start + 60_000_000)
        assert loop.spin(lambda: len(loop.truths) == 2 and len(loop.images) == 2)
        assert loop.stamps == [start + 50_000_000, start + 110_000_000]
        # The parts were carried along.
        first, second = (msg_to_parts(msg).position for msg in loop.truths)
        assert np.max(np.abs(second - first)) > 1e-5
        assert loop.simulator._count["refused tables"] == 1
        assert loop.simulator._count["cycles"] == 3


@pytest.fixture(name="triggered")
def _triggered(tmp_path):
    """A rig file with a trigger of the camera."""
    rig = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    rig["camera"]["trigger_phase"] = 0.4
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(rig, sort_keys=False), encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lockstep:=true", "image_rate:=30.0"], "image_rate is 30 in lockstep, allowed: 0"),
        (["driven_by:=device", "latency:=0.02", "rig_file:={}"], r"latency is 0\.02, allowed: 0"),
    ],
)
def test_images_at_times_that_cannot_be_are_refused(triggered, words, message):
    words = [part for word in words for part in ("-p", word.format(triggered))]
    rclpy.init(args=["--ros-args", *words])
    node = SimulatorNode()
    with pytest.raises(PlateError, match=message):
        start_nodes(node)
    node.destroy_node()
    rclpy.try_shutdown()


def test_driven_by_the_device_its_pulses_trigger_the_camera(triggered):
    with Loop(scenario="sort_4", driven_by="device", rig_file=triggered, seed=2) as loop:
        motions = loop.ear.create_publisher(JointTrajectory, "motor_motion", DATA)
        pulses = loop.ear.create_publisher(Header, "camera_trigger", DATA)
        ends = (motions, pulses, loop.simulator._truths, loop.simulator._images)
        assert loop.spin(lambda: all(end.get_subscription_count() == 1 for end in ends))
        start = loop.simulator._time_ns + 1_000_000_000
        end = start + 50_000_000

        def pulse(at: int) -> None:
            pulses.publish(Header(stamp=to_time(at)))

        motions.publish(motors_to_msg(RIG, push(), to_time(start)))
        assert loop.spin(lambda: loop.simulator._count["cycles"] == 1)
        pulse(end)
        assert loop.spin(lambda: len(loop.images) == 1)
        pulse(end + 50_000_000)  # before the motion up to it
        loop.spin(lambda: False, 0.2)
        motions.publish(motors_to_msg(RIG, push(), to_time(end)))
        assert loop.spin(lambda: len(loop.images) == 2)
        assert loop.stamps == [end, end + 50_000_000]
