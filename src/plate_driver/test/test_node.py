"""Decisions of the driver's node: a node in this process, in the test's time."""

import contextlib
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.motion import motor_state

rclpy = pytest.importorskip("rclpy")
from cuts import cut  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from driven import CALM, CUT, EMERGENCY, Driven, at_rest, transition  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from shaking import PERIOD, shaking  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import (  # noqa: E402
    DATA,
    cycle_to_msg,
    msg_to_cycle,
    msg_to_motors,
    nanoseconds,
    start_nodes,
    to_time,
)
from plate_driver.freshness import STALL_S  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402
from plate_driver.status import OFF  # noqa: E402
from plate_driver.transports import Condition, Measured, Order, Report  # noqa: E402
from plate_interfaces.msg import DriverStatus, TaskStatus  # noqa: E402

MS = 1_000_000
SIMULATED = 90_000 * MS
"""A stamp of a simulated clock."""


@pytest.fixture(name="rig", scope="module")
def _rig():
    return load_rig()


GENTLE = shaking(0.0005)


FIRST, SECOND = cut(CALM, 0, 16), cut(CALM, 16, 32)
"""Cycles of 0.1 s, with tails of 0.05 s: one from rest, and one that follows."""


@pytest.fixture(name="make")
def _make(monkeypatch):
    with contextlib.ExitStack() as stack:

        def make(*parameters: str, **options) -> Driven:
            driven = Driven(monkeypatch, *parameters, **options)
            stack.callback(driven.close)
            return driven

        yield make


@pytest.fixture(name="driven")
def _driven(make):
    return make()


def refused(
    driven: Driven,
    stamp_ns: int | None = None,
    source: bytes = b"solver",
    cycle: PlateCycle = GENTLE,
) -> str:
    why = driven.send(cycle, stamp_ns, source)
    assert isinstance(why, str), "it was answered"
    return why


def tell_task(driven: Driven, state: int) -> None:
    data = serialize_message(TaskStatus(state=state))
    driven.node.take_task(data, len(data), b"")


def test_good_and_bad_cycles(driven, rig):
    # A cycle within the limits is passed on as it is.
    stamp = driven.send(GENTLE)
    [motors] = driven.setpoints
    assert driven.stamps() == [stamp]
    q, qd, qdd = motor_state(rig, GENTLE.knot_pose, GENTLE.knot_twist, GENTLE.knot_accel)
    assert motors.joint_names == ["motor_1", "motor_2", "motor_3", "motor_4"]
    np.testing.assert_allclose([p.positions for p in motors.points], q, atol=1e-12)
    np.testing.assert_allclose([p.velocities for p in motors.points], qd, atol=1e-12)
    np.testing.assert_allclose([p.accelerations for p in motors.points], qdd, atol=1e-12)
    # The same stamp again is answered again: the first answer may have been missed.
    assert driven.send(GENTLE, stamp) == stamp
    assert driven.stamps() == [stamp, stamp]
    assert not at_rest(driven.setpoints[-1])

    # A wild one comes back scaled down, the same motion.
    driven.pass_time(PERIOD)
    wild = shaking(0.1)
    stamp = driven.send(wild)
    applied = msg_to_motors(rig, driven.setpoints[-1])
    factor = applied.knot_pose[24, 2] / wild.knot_pose[24, 2]
    assert 0 < factor < 0.2
    np.testing.assert_allclose(applied.knot_pose, factor * wild.knot_pose, atol=1e-9)
    assert driven.log.lines[-1].startswith("the cycle is scaled by 0.0")

    # Bad ones are not answered, and the driver goes on.
    driven.pass_time(PERIOD)
    now = to_time(driven.clock.time_ns())
    bad = [cycle_to_msg(GENTLE, now) for _ in range(4)]
    bad[0].joint_names = ["x", "y", "z"]
    bad[1].points[3].velocities[1] = float("nan")
    bad[2].points[-1].positions[0] = 0.004
    bad[3].points[5].time_from_start.nanosec = 1
    bad += [cycle_to_msg(GENTLE, to_time(stamp - 50 * MS)), JointTrajectory()]
    for msg, why in zip(
        bad,
        ("joints are ['x', 'y', 'z']", "not finite", "not closed", "times must be finite",
         "is older than the last", "joints are []"),
        strict=True,
    ):  # fmt: skip
        assert why in driven.send_bytes(serialize_message(msg))
    good = driven.send(GENTLE)
    driven.pass_time(PERIOD)
    assert driven.stamps()[2:] == [stamp, good]
    assert driven.send(GENTLE) == driven.stamps()[-1]

    # Diagnostics have the event, and motor_states the commanded state.
    driven.pass_time(1.0)
    totals = driven.values()
    assert [totals[-1][key] for key in ("cycles", "refused", "scaled")] == ["5", "6", "1"]
    assert any(float(report["worst_limit_fraction"]) > 5 for report in totals)
    assert driven.published["motor_states"][-1].name == motors.joint_names


def test_a_cycle_in_motion_is_taken_where_the_last_one_ends(driven, rig):
    assert refused(driven, cycle=SECOND).startswith("plate_cycle: begins in motion, ")
    driven.send(FIRST)
    driven.pass_time(0.08)
    driven.send(SECOND)
    first, second = (msg_to_motors(rig, msg) for msg in driven.setpoints)
    assert second.follows(first)
    assert first.period == second.period == pytest.approx(0.1)
    assert first.tail.period == second.tail.period == pytest.approx(0.05)
    assert driven.setpoints[0].points[16] == driven.setpoints[0].points[17]
    # Without another cycle the plate comes to rest by the tail.
    assert "from the final state of the last cycle" in refused(driven, cycle=cut(CALM, 8, 24))
    tell_task(driven, TaskStatus.RUNNING)
    driven.pass_time(0.29)
    silence = "no plate_cycle for 0.3 s: the plate rests"
    assert silence not in driven.log.lines
    driven.pass_time(0.03)
    assert driven.log.lines.count(silence) == 1
    assert "from rest" in refused(driven, cycle=SECOND)
    assert isinstance(driven.send(FIRST), int)


class Player:
    """A transport that plays tables as a device does, from the moment at which they come."""

    motors = calibrates = True
    max_knots, hold_s = 2000, 10.0

    def __init__(self, clock) -> None:
        self.clock = clock
        self.condition = Condition.OFF
        self.plan = []
        self.count = 0

    def send(self, table, repeats) -> None:
        self.count, now = self.count + 1, self.clock()
        last = self.plan[-1] if self.plan else None
        if last is not None and table.cycle.follows(last[1].cycle):
            now = last[2] + last[1].cycle.period
        self.plan.append((self.count, table, now))

    def poll(self):
        now, rest = self.clock() - 0.002, (0.0,) * 4
        for number, table, began in reversed(self.plan):
            if began + table.cycle.period <= now < began + table.length:
                began, table = began + table.cycle.period, table.tail
            if began <= now < began + table.cycle.period:
                return [Measured(now, now, number, rest, rest, table, began)]
        return [Measured(now, now, 0, rest, rest)]

    def report(self) -> Report:
        return Report(self.condition)

    def enable(self) -> Order:
        self.condition = Condition.READY
        return Order().complete()

    def stop(self, cut=False) -> Order:
        self.condition = Condition.OFF
        return Order().complete()

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def troubles(self):
        return []

    def values(self):
        return {}


def test_starts_of_cycles_and_of_tails_are_reported(make, monkeypatch):
    monkeypatch.setattr(
        "plate_driver.node.make_transport", lambda _, context: Player(context.clock)
    )
    driven = make("use_sim_time:=false")
    driven.node._starts.get_subscription_count = lambda: 1
    assert driven.enable().success
    driven.pass_time(0.2)
    driven.published["cycle_started"].clear()
    begin = driven.send(FIRST)
    driven.pass_time(0.06)
    driven.send(SECOND)
    driven.pass_time(0.5)
    starts = driven.published["cycle_started"]
    after = [(nanoseconds(msg.header.stamp) - begin) / 1e9 for msg in starts]
    cycles = [msg_to_cycle(msg) for msg in starts]
    moving = [k for k, cycle in enumerate(cycles) if cycle.moves]
    np.testing.assert_allclose([after[k] for k in moving], [0.0, 0.1, 0.2], atol=1e-6)
    for k, cycle in zip(moving, (FIRST, SECOND, SECOND.tail), strict=True):
        np.testing.assert_array_equal(cycles[k].knot_pose, cycle.knot_pose)
        assert (cycles[k].tail is None) == (cycle.tail is None)
    # Then it reports rest, from the end of the tail on.
    assert after[moving[-1] + 1] == pytest.approx(0.25, abs=2e-3)


class Refusing(Player):
    """Motors whose controller reports that it plays no table, which is true or not."""

    takes = False

    def send(self, table, repeats):
        if self.takes:
            super().send(table, repeats)

    def troubles(self):
        return ["device refuses Commit: limit"]


def test_motors_that_take_no_table_are_reported_within_two_seconds(make, monkeypatch):
    monkeypatch.setattr(
        "plate_driver.node.make_transport", lambda _, context: Refusing(context.clock)
    )
    driven = make("use_sim_time:=false")
    assert driven.enable().success

    def play() -> None:
        for _ in range(18):
            driven.send(GENTLE)
            driven.pass_time(0.1)

    play()
    assert driven.report.level == DiagnosticStatus.STALE
    reported = r"no plate_cycle has been played for \d\.\d s: device refuses Commit: limit"
    assert re.fullmatch(reported, driven.report.message)
    driven.node.transports.current._transport.takes = True
    play()
    assert driven.report.level == DiagnosticStatus.WARN


def test_a_plate_rests_before_the_driver_ends(driven):
    stamp = driven.send(GENTLE)
    driven.close()
    assert driven.stamps() == [stamp, stamp]
    assert at_rest(driven.setpoints[-1])


def test_a_periodic_cycle_gets_fades_and_the_plate_rests_without_new_cycles(make, rig):
    driven = make("hold_cycles:=2")
    t = np.arange(24) * PERIOD / 24
    pose = 0.001 * np.column_stack([np.cos(2 * np.pi * t / PERIOD)] * 3)
    driven.send(PlateCycle.from_samples(PERIOD, pose))
    applied = msg_to_motors(rig, driven.setpoints[-1])
    assert applied.starts_at_rest
    assert applied.period == pytest.approx(3 * PERIOD)
    # No more cycles: the plate rests without a command, and the driver reports it.
    tell_task(driven, TaskStatus.RUNNING)
    silence = "no plate_cycle for 0.6 s: the plate rests"
    driven.pass_time(0.59)
    assert silence not in driven.log.lines
    driven.pass_time(0.03)
    assert driven.log.lines.count(silence) == 1
    driven.pass_time(2.0)
    assert driven.report.level == DiagnosticStatus.STALE
    assert driven.report.message.startswith("no plate_cycle for ")
    assert driven.values()[-1]["rests"] == "1"
    assert len(driven.setpoints) == 1
    why = refused(driven, cycle=SECOND)
    driven.pass_time(1.0)
    assert driven.report.message.endswith(f"the plate rests; the last cycle was refused: {why}")


@pytest.mark.parametrize("state", [None, TaskStatus.DONE])
def test_without_a_task_rest_is_normal(driven, state):
    if state is not None:
        tell_task(driven, TaskStatus.RUNNING)
        tell_task(driven, state)
    driven.pass_time(0.2)
    driven.send(GENTLE)
    driven.pass_time(3.0)
    assert driven.values()[-1]["rests"] == "1"
    assert not [line for line in driven.log.lines if "rests" in line]
    assert driven.report.level == DiagnosticStatus.OK
    assert driven.report.message == "the plate rests: no task runs"
    refused(driven, cycle=SECOND)
    driven.pass_time(1.0)
    assert driven.report.level == DiagnosticStatus.WARN


def test_cycles_that_arrived_while_the_driver_was_stalled_are_refused(driven):
    driven.pass_time(0.1)
    driven.clock.now += STALL_S
    assert driven.send(GENTLE, driven.clock.time_ns() - 10 * MS) == driven.stamps()[-1]
    driven.clock.now += STALL_S + 0.1  # stopped, or without a processor
    why = refused(driven, driven.clock.time_ns() - 1)
    assert (
        why == "plate_cycle is for an image that was taken before the driver was stalled for 0.4 s"
    )
    driven.pass_time(0.3)
    assert isinstance(driven.send(GENTLE), int)


def test_a_table_that_has_become_too_old_on_its_way_is_not_sent(driven):
    """Where the process is held up: for the transport, and within it."""
    driven.pass_time(0.5)
    thread = driven.node.transports.current
    for held_up in (thread, thread._transport):
        send = held_up.send

        def late(*args, send=send):
            driven.clock.now += 0.5
            send(*args)

        held_up.send = late
        assert refused(driven).startswith("the motor table was ready 0.12 s too late")
        held_up.send = send
        driven.pass_time(0.5)
        assert isinstance(driven.send(GENTLE), int)


def test_an_old_cycle_or_a_cycle_of_an_ended_task_is_refused(driven):
    driven.pass_time(0.5)
    old = driven.clock.time_ns() - 700 * MS
    assert refused(driven, old).startswith("plate_cycle is for an image 0.70 s old")
    # The end of the task arrives after the cycle that the task had requested, but was published
    # before it.
    requested = driven.clock.time_ns()
    data = serialize_message(
        TaskStatus(header=Header(stamp=to_time(requested)), state=TaskStatus.ABORTED)
    )
    waiting = [(data, len(data), b"")]
    inputs = driven.node._inputs
    subscription = SimpleNamespace(
        take=lambda: waiting.pop() if waiting else None, destroy=inputs.tasks.subscription.destroy
    )
    inputs.tasks = inputs.tasks._replace(subscription=subscription)
    assert refused(driven, requested) == "plate_cycle is for a task that has ended"
    # Rest can be requested at any time.
    assert driven.send(PlateCycle.rest(PERIOD), requested) == requested
    assert at_rest(driven.setpoints[-1])
    driven.pass_time(PERIOD)
    assert isinstance(driven.send(GENTLE), int)


def test_cycles_of_two_nodes_are_refused(driven):
    """A second publisher is a second name, or without names a second recent sender."""

    def wait_for(second_publisher: str) -> None:
        end = time.monotonic() + 60.0
        while driven.node.second_publisher("plate_cycle") != second_publisher:
            assert time.monotonic() < end
            time.sleep(0.01)

    others = [rclpy.create_node(name, namespace="/driven") for name in ("peer", "rogue")]
    for other in others:
        other.create_publisher(JointTrajectory, "plate_cycle", DATA)
    two = "2 nodes publish plate_cycle (peer, rogue), allowed: one"
    wait_for(two)
    assert refused(driven) == two
    assert isinstance(driven.send(PlateCycle.rest(PERIOD)), int)
    assert at_rest(driven.setpoints[-1])
    for other in others:
        other.destroy_node()
    wait_for("")
    driven.pass_time(PERIOD)
    assert isinstance(driven.send(GENTLE), int)
    driven.pass_time(PERIOD)
    assert refused(driven, source=b"another") == "2 nodes publish plate_cycle, allowed: one"
    assert refused(driven) == "2 nodes publish plate_cycle, allowed: one"


def test_timeouts_use_the_simulated_time(make):
    driven = make("hold_cycles:=2", "use_sim_time:=true")
    [received] = [
        each.callback for each in driven.node.subscriptions if each.topic_name == "/clock"
    ]

    def rests() -> str:
        driven.pass_time(1.0)
        return driven.values()[-1]["rests"]

    assert driven.send(GENTLE, SIMULATED) == SIMULATED
    driven.pass_time(1.0)
    assert rests() == "0"  # the plate waits: nothing has come for two seconds
    received(Clock(clock=to_time(SIMULATED + 190 * MS)))
    assert rests() == "0"
    received(Clock(clock=to_time(SIMULATED + 250 * MS)))
    assert rests() == "1"
    # The simulator starts again: its clock is put back, and the cycle sent before counts no more.
    assert driven.send(GENTLE, SIMULATED + 300 * MS) == SIMULATED + 300 * MS
    received(Clock(clock=to_time(300 * MS)))
    assert rests() == "2"


def change(driven: Driven, label: str) -> bool:
    return driven.call("change_state", transition(label)).success


def test_the_driver_follows_the_lifecycle(make):
    driven = make("autostart:=false", start=False)
    driven.pass_time(1.0)
    assert driven.texts == ["unconfigured"]
    assert driven.report.level == DiagnosticStatus.WARN
    assert not driven.node.raw_inputs
    data = serialize_message(cycle_to_msg(GENTLE, to_time(driven.clock.time_ns())))
    for _ in range(2):  # and a second life
        assert change(driven, "configure")
        assert driven.texts[-1] == "inactive"
        driven.node.take_cycle(data, len(data))
        assert not driven.setpoints, "an inactive driver sends nothing"
        assert change(driven, "activate")
        assert driven.texts[-1] == "ready"
        driven.pass_time(PERIOD)
        stamp = driven.send(GENTLE)
        assert change(driven, "deactivate")
        assert driven.stamps() == [stamp, stamp]
        assert at_rest(driven.setpoints.pop())
        assert not at_rest(driven.setpoints.pop())
        assert change(driven, "cleanup")
        assert driven.texts[-1] == "unconfigured"
    assert change(driven, "configure")
    assert change(driven, "activate")
    stamp = driven.send(GENTLE)
    assert change(driven, "shutdown")
    assert driven.stamps() == [stamp, stamp]
    assert at_rest(driven.setpoints[-1])


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("hold_cycles:=0", "parameter hold_cycles is 0, allowed: 1 to 20"),
        ("hold_cycles:=2.5", "parameter hold_cycles is 2.5, allowed: a value of type int"),
        ("repeats:=101", "parameter repeats is 101, allowed: 1 to 100"),
        ("state_rate:=-1.0", "parameter state_rate is -1.0, allowed: 0.0 to 200.0"),
        ("autostart:=1", "parameter autostart is 1, allowed: a value of type bool"),
        ("rig_file:=nowhere.yaml", "nowhere.yaml: no such file"),
    ],
)
def test_wrong_parameters_are_refused_at_start(parameter, message):
    def start():
        driver = DriverNode()
        try:
            start_nodes(driver)
        finally:
            driver.destroy_node()

    rclpy.init(args=["--ros-args", "-p", parameter])
    try:
        with pytest.raises(PlateError, match=re.escape(message)):
            start()
    finally:
        rclpy.shutdown()


def test_services_stop_disable_and_enable(driven):
    assert driven.texts[-1] == "ready"
    for call, state, reason in (
        (lambda: driven.call("emergency_stop"), EMERGENCY, DriverStatus.EMERGENCY_STOP),
        (lambda: driven.call("cut_power"), CUT, DriverStatus.POWER_CUT),
        (lambda: driven.enable(False), OFF, DriverStatus.SWITCHED_OFF),
    ):
        stamp = driven.send(GENTLE)
        assert call().success
        assert driven.stamps()[-2:] == [stamp, stamp]
        assert at_rest(driven.setpoints[-1])
        assert driven.texts[-1] == state
        assert driven.published["driver_status"][-1].reason == reason
        driven.pass_time(PERIOD)
        assert refused(driven) == f"the driver is {state}"
        assert call().success  # once more does no harm
        assert driven.texts[-1] == state
        assert driven.call("home").success
        assert driven.enable().success
        assert driven.texts[-1] == "ready"
        driven.pass_time(1.1)
        assert driven.values()[-1]["rests"] == "0"  # it was a stop, not silence
    answer = driven.call("calibrate")
    assert (answer.success, answer.message[:19]) == (False, "calibration_file is")
    assert isinstance(driven.send(GENTLE), int)


def test_a_stop_latches_in_every_state(driven):
    """Without motors there is only the driver's own latch: nothing but enable opens it."""
    assert driven.call("emergency_stop").success
    assert driven.texts[-1] == EMERGENCY
    for label, word in (
        ("deactivate", "inactive"), ("cleanup", "unconfigured"), ("configure", "inactive"),
    ):  # fmt: skip
        assert change(driven, label)
        driven.pass_time(0.1)
        assert driven.texts[-1] == f"{word}: emergency stop; look at the rig, then call enable"
    assert change(driven, "activate")
    driven.pass_time(1.0)
    assert driven.texts[-1] == EMERGENCY
    assert "ready" not in driven.texts[driven.texts.index(EMERGENCY) :]
    assert refused(driven) == f"the driver is {EMERGENCY}"
    assert driven.report.level == DiagnosticStatus.ERROR
    # A stop of an inactive and of an unconfigured driver, and the reply of enable there.
    assert driven.enable().success
    for label, word in (("deactivate", "inactive"), ("cleanup", "unconfigured")):
        assert change(driven, label)
        answer = driven.enable()
        assert not answer.success
        assert answer.message.startswith(f"the driver is {word}")
        assert driven.call("emergency_stop").success
    assert change(driven, "configure")
    assert change(driven, "activate")
    driven.pass_time(0.1)
    assert driven.texts[-1] == EMERGENCY
    assert driven.enable().success
    assert driven.texts[-1] == "ready"


def test_the_driver_status_is_published_twice_a_second(driven):
    driven.pass_time(3.0)
    times = [nanoseconds(msg.header.stamp) for msg in driven.published["driver_status"]]
    assert driven.clock.time_ns() - 600 * MS < times[-1]
    assert max(np.diff(times[1:])) < 600 * MS


def test_an_enable_without_a_stop_changes_nothing(driven):
    """Another time of it would end a running task: it stands for a stop that was cleared."""
    driven.pass_time(1.0)
    statuses = driven.published["driver_status"]
    first, before = len(statuses) - 1, statuses[-1].enabled_at
    assert abs(nanoseconds(before) - driven.clock.time_ns()) < 2000 * MS
    answer = driven.enable()
    assert (answer.success, answer.message) == (True, "ready")
    driven.pass_time(1.0)
    assert len(statuses) >= first + 3
    assert all(status.enabled_at == before for status in statuses[first:])
    assert driven.call("emergency_stop").success
    assert driven.enable().success
    assert statuses[-1].state == DriverStatus.READY
    assert nanoseconds(statuses[-1].enabled_at) > nanoseconds(before)
    stopped = next(s for s in statuses if s.state == DriverStatus.STOPPED)
    assert (stopped.reason, stopped.text) == (DriverStatus.EMERGENCY_STOP, EMERGENCY)
    assert stopped.enabled_at == before


def test_truncated_messages_do_not_end_the_driver(driven):
    """As of a computer with other interfaces."""
    data = serialize_message(cycle_to_msg(GENTLE, to_time(driven.clock.time_ns())))
    assert driven.send_bytes(data[: len(data) // 2]).startswith("JointTrajectory: ")
    data = serialize_message(TaskStatus(text="idle"))
    driven.node.take_task(data[: len(data) // 2], len(data) // 2, b"")
    assert driven.log.lines[-1].startswith("task_status: TaskStatus: ")
    assert isinstance(driven.send(GENTLE), int)
    assert driven.call("emergency_stop").success


def test_cycles_that_are_too_long_are_refused_unread(driven):
    msg = cycle_to_msg(GENTLE, to_time(driven.clock.time_ns()))
    msg.points = msg.points * 500
    why = driven.send_bytes(serialize_message(msg))
    assert why == "plate_cycle: 24500 points, allowed: at most 2000"
    assert isinstance(driven.send(GENTLE), int)
