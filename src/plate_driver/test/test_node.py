"""The driver as a process of its own, spoken to over ROS."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.motion import motor_state

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import (  # noqa: E402
    CALLS,
    DATA,
    LATCHED,
    cycle_to_msg,
    msg_to_motors,
    nanoseconds,
    start_nodes,
    to_time,
)
from plate_driver.freshness import STANDSTILL_S  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402
from plate_driver.status import LOOK, OFF  # noqa: E402
from plate_interfaces.msg import DriverStatus, TaskStatus  # noqa: E402

DRIVER = [sys.executable, "-c", "from plate_driver.node import main; main()"]
NAMESPACE = f"/driver_test_{os.getpid()}"
PERIOD = 0.1
MS = 1_000_000
SIMULATED = 90_000 * MS
"""A stamp of a simulated clock."""


def shaking(amplitude: float) -> PlateCycle:
    """Cycle of two harmonics that starts at rest; amplitudes [m]."""
    t = np.arange(48) * PERIOD / 48
    wave = np.sin(np.pi * t / PERIOD) ** 4
    phase = 4 * np.pi * t / PERIOD
    pose = np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    cycle = PlateCycle.from_samples(PERIOD, amplitude * pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0  # the spline's derivatives are only almost zero
    return PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)


EMERGENCY, CUT = (f"stopped: {what}; {LOOK}" for what in ("emergency stop", "power cut"))


class Peer:
    """A driver process and a node that listens to it."""

    def __init__(self, *parameters: str) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("peer", context=self.context, namespace=NAMESPACE)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.setpoints: list[JointTrajectory] = []
        self.states: list[JointState] = []
        self.reports: list[DiagnosticArray] = []
        for kind, topic, received in (
            (JointTrajectory, "motor_setpoints", self.setpoints),
            (JointState, "motor_states", self.states),
            (DiagnosticArray, "diagnostics", self.reports),
        ):
            self.node.create_subscription(kind, topic, received.append, DATA)
        self.told: list[str] = []  # without what is said again
        self.statuses: list[DriverStatus] = []
        self.node.create_subscription(DriverStatus, "driver_status", self._on_status, LATCHED)
        self.cycles = self.node.create_publisher(JointTrajectory, "plate_cycle", DATA)
        self.tasks = self.node.create_publisher(TaskStatus, "task_status", LATCHED)
        self.changes = self.node.create_client(ChangeState, "driver/change_state")
        self.asks = self.node.create_client(GetState, "driver/get_state")
        env = os.environ | {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }
        arguments = [word for p in parameters for word in ("-p", p)]
        command = [*DRIVER, "--ros-args", "-r", f"__ns:={NAMESPACE}", *arguments]
        self.process = subprocess.Popen(
            command, env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )

    def _on_status(self, msg: DriverStatus) -> None:
        self.statuses.append(msg)
        if not self.told or self.told[-1] != msg.text:
            self.told.append(msg.text)

    def until(self, condition, seconds: float = 60.0) -> bool:
        """Spin until the condition holds; False when it takes too long.

        A datagram that gets lost on a busy machine is sent again only with the writer's next
        heartbeat, 3 s later, so some seconds are no failure.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
            if condition():
                return True
        return False

    def connect(self, ready: bool = True) -> None:
        assert self.until(
            lambda: (
                self.cycles.get_subscription_count() > 0
                and self.node.count_publishers("motor_setpoints") > 0
                and (not ready or self.told[-1:] == ["ready"])
            )
        ), self.end()
        # The driver may get to know us a little later than we it; until then its words are lost.
        self.until(lambda: False, 0.5)

    def send(self, cycle: PlateCycle, stamp_ns: int | None = None) -> int:
        """Send a cycle that answers an image, if not said otherwise of now; returns its stamp."""
        stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
        self.cycles.publish(cycle_to_msg(cycle, to_time(stamp_ns)))
        return stamp_ns

    def answer(self, stamp_ns: int, count: int = 1) -> JointTrajectory:
        """Wait for the setpoints with a stamp; `count` of them."""

        def found() -> list[JointTrajectory]:
            return [m for m in self.setpoints if nanoseconds(m.header.stamp) == stamp_ns]

        if not self.until(lambda: len(found()) >= count):
            pytest.fail(f"{len(found())} of {count} answers to stamp {stamp_ns}; {self.end()}")
        return found()[-1]

    def moved(self, cycle: PlateCycle | None = None) -> int:
        """Have the plate move, by a cycle for each new image as a solver does; returns the stamp
        that was answered. A driver that has only just become ready has to notice that first, and
        one that has stood still on a busy machine refuses what was asked before."""
        cycle = shaking(0.0005) if cycle is None else cycle
        sent, count = [], len(self.setpoints)
        for _ in range(50):
            sent.append(self.send(cycle))
            if self.until(lambda: len(self.setpoints) > count, 0.5):
                last = self.setpoints[-1]
                assert nanoseconds(last.header.stamp) in sent
                assert not at_rest(last)
                return nanoseconds(last.header.stamp)
        pytest.fail(f"nothing moves; {self.end()}")

    def call(self, client, request, tries: int = 1):
        assert client.wait_for_service(timeout_sec=20.0)
        for _ in range(tries):
            future = client.call_async(request)
            if self.until(future.done, 20.0 / tries):
                return future.result()
        pytest.fail(f"no answer of {client.service_name}; {self.end()}")

    def change(self, transition: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = transition
        return self.call(self.changes, request).success

    def state(self) -> str:
        # A service may answer before it knows of the client's ear, and the answer is lost. To ask
        # for the state once more does no harm; changes are asked for when both know each other.
        return self.call(self.asks, GetState.Request(), tries=10).current_state.label

    def level(self) -> bytes:
        return self.reports[-1].status[0].level if self.reports else b""

    def value(self, key: str) -> str:
        return {v.key: v.value for v in self.reports[-1].status[0].values}[key]

    def end(self, number: int = signal.SIGINT) -> tuple[int, str]:
        """Signal the driver; return its exit code and all it printed."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        output, _ = self.process.communicate(timeout=10)
        return self.process.returncode, output

    def close(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.end()
        self.process.kill()
        self.process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(name="rig", scope="module")
def _rig():
    return load_rig()


@pytest.fixture(name="peer")
def _peer(request):
    peer = Peer(*getattr(request, "param", ()))
    yield peer
    peer.close()


def at_rest(msg: JointTrajectory) -> bool:
    return not any(
        value for p in msg.points for value in (*p.positions, *p.velocities, *p.accelerations)
    )


# Tests of the driver's life come in few, long pieces: to start one takes most of a second.


def test_good_and_bad_cycles(peer, rig):
    peer.connect()
    # A cycle within the limits is passed on as it is.
    gentle = shaking(0.0005)
    stamp = peer.moved(gentle)
    motors = peer.answer(stamp)
    q, qd, qdd = motor_state(rig, gentle.knot_pose, gentle.knot_twist, gentle.knot_accel)
    assert motors.joint_names == ["motor_1", "motor_2", "motor_3", "motor_4"]
    np.testing.assert_allclose([p.positions for p in motors.points], q, atol=1e-12)
    np.testing.assert_allclose([p.velocities for p in motors.points], qd, atol=1e-12)
    np.testing.assert_allclose([p.accelerations for p in motors.points], qdd, atol=1e-12)
    # The same stamp again is answered again: the first answer may have been missed.
    peer.send(gentle, stamp)
    peer.answer(stamp, count=2)

    # A wild one comes back scaled down, the same motion.
    wild = shaking(0.1)
    stamp = peer.moved(wild)
    applied = msg_to_motors(rig, peer.answer(stamp))
    factor = applied.knot_pose[24, 2] / wild.knot_pose[24, 2]
    assert 0 < factor < 0.2
    np.testing.assert_allclose(applied.knot_pose, factor * wild.knot_pose, atol=1e-9)

    # Bad ones are not answered, and the driver goes on.
    bad = [cycle_to_msg(gentle, to_time(0)) for _ in range(4)]
    bad[0].joint_names = ["x", "y", "z"]
    bad[1].points[3].velocities[1] = float("nan")
    bad[2].points[-1].positions[0] = 0.004
    bad[3].points[5].time_from_start.nanosec = 1
    stale, empty = (cycle_to_msg(gentle, to_time(stamp - 50 * MS)), JointTrajectory())
    before, good = len(peer.setpoints), []
    for three in ((*bad[:3],), (bad[3], stale, empty)):
        for each in three:  # the queue holds five
            if each in bad:
                each.header.stamp = to_time(time.time_ns())
            peer.cycles.publish(each)
        good.append(peer.moved(gentle))
    assert [nanoseconds(m.header.stamp) for m in peer.setpoints[before:]] == good

    # What happened is in the diagnostics.
    def totals():
        return [{v.key: v.value for v in r.status[0].values} for r in peer.reports]

    assert peer.until(lambda: any(r["refused"] == "6" and r["cycles"] == "5" for r in totals()))
    assert totals()[-1]["scaled"] == "1"
    assert any(float(r["worst_limit_fraction"]) > 5 for r in totals())
    assert peer.until(lambda: len(peer.states) > 0)
    assert peer.states[-1].name == motors.joint_names

    # It rests before it ends.
    stamp = peer.moved(gentle)
    code, output = peer.end(signal.SIGINT)
    assert code == 0, output
    assert at_rest(peer.answer(stamp, count=2))
    assert "Traceback" not in output
    assert "cycle refused: " in output
    assert "cycle scaled by" in output


@pytest.mark.parametrize("peer", [["hold_cycles:=2"]], indirect=True)
def test_foreign_cycle_and_silence(peer, rig):
    peer.connect()
    t = np.arange(24) * PERIOD / 24
    pose = 0.001 * np.column_stack([np.cos(2 * np.pi * t / PERIOD)] * 3)
    stamp = peer.moved(PlateCycle.from_samples(PERIOD, pose))
    applied = msg_to_motors(rig, peer.answer(stamp))
    assert applied.starts_at_rest
    assert applied.period == pytest.approx(3 * PERIOD)
    # No more cycles: the plate rests by itself, and the driver says so; nothing is sent for it.
    assert peer.until(lambda: peer.level() == DiagnosticStatus.STALE)
    assert peer.reports[-1].status[0].message.startswith("no plate_cycle for ")
    assert len(peer.setpoints) == 1
    # What came while the driver stood still moves nothing, however young it is.
    peer.process.send_signal(signal.SIGSTOP)
    peer.until(lambda: False, STANDSTILL_S + 0.1)
    peer.send(shaking(0.0005))
    peer.process.send_signal(signal.SIGCONT)
    refused = "cycle refused: plate_cycle answers an image from before the driver itself stood"
    assert peer.until(lambda: peer.reports and peer.value("refused") == "1")
    # What is too old moves nothing, nor what a task asked for that has ended, nor what a second
    # node sends; a plate at rest may be asked for at any time.
    peer.send(shaking(0.0005), time.time_ns() - 700 * MS)
    assert peer.until(lambda: peer.value("refused") == "2")
    asked = time.time_ns()
    peer.tasks.publish(TaskStatus(header=Header(stamp=to_time(asked)), state=TaskStatus.ABORTED))
    peer.until(lambda: False, 0.1)
    peer.send(shaking(0.0005), asked)
    assert peer.until(lambda: peer.value("refused") == "3")
    rogue = rclpy.create_node("rogue", context=peer.context, namespace=NAMESPACE)
    cycles = rogue.create_publisher(JointTrajectory, "plate_cycle", DATA)
    assert peer.until(lambda: cycles.get_subscription_count() > 0)
    cycles.publish(cycle_to_msg(shaking(0.0005), to_time(time.time_ns())))
    assert peer.until(lambda: peer.value("refused") == "4")
    peer.answer(peer.send(PlateCycle.rest(PERIOD)))
    rogue.destroy_node()
    assert peer.until(lambda: peer.node.count_publishers("plate_cycle") == 1)
    assert all(map(at_rest, peer.setpoints[1:]))
    # A signal while the plate moves: it rests before the driver ends.
    stamp = peer.moved()
    code, output = peer.end(signal.SIGTERM)
    assert code == 0, output
    assert "Traceback" not in output
    assert "no plate_cycle for 0.6 s: the plate rests" in output
    assert refused in output
    assert at_rest(peer.answer(stamp, count=2))


@pytest.mark.parametrize("peer", [["hold_cycles:=2", "use_sim_time:=true"]], indirect=True)
def test_in_simulated_time_silence_is_simulated_too(peer):
    peer.connect()
    clock = peer.node.create_publisher(Clock, "/clock", DATA)
    assert peer.until(lambda: clock.get_subscription_count() > 0)
    peer.send(shaking(0.0005), SIMULATED)
    peer.answer(SIMULATED)
    count = len(peer.reports)
    assert peer.until(lambda: len(peer.reports) > count + 1)
    assert peer.value("rests") == "0"  # the plate waits: nothing has come for a second and more
    clock.publish(Clock(clock=to_time(SIMULATED + 250 * MS)))
    assert peer.until(lambda: peer.value("rests") == "1")
    # The simulator starts again: its clock is put back, and the cycle sent before counts no more.
    peer.send(shaking(0.0005), SIMULATED + 300 * MS)
    peer.answer(SIMULATED + 300 * MS)
    clock.publish(Clock(clock=to_time(300 * MS)))
    assert peer.until(lambda: peer.value("rests") == "2")


@pytest.mark.parametrize("peer", [["autostart:=false"]], indirect=True)
def test_lifecycle(peer):
    assert peer.state() == "unconfigured"
    assert peer.until(lambda: peer.told == ["unconfigured"])
    assert peer.until(lambda: peer.level() == DiagnosticStatus.WARN)
    assert peer.change("configure")
    assert peer.state() == "inactive"
    assert peer.until(lambda: peer.told[-1] == "inactive")
    peer.connect(ready=False)
    peer.send(shaking(0.0005))
    assert not peer.until(lambda: peer.setpoints, seconds=0.3), "an inactive driver sends nothing"
    assert peer.change("activate")
    assert peer.until(lambda: peer.told[-1] == "ready")
    stamp = peer.moved()
    assert peer.change("deactivate")
    assert at_rest(peer.answer(stamp, count=2))
    assert peer.change("cleanup")
    assert peer.state() == "unconfigured"
    # A second life.
    assert peer.change("configure")
    assert peer.change("activate")
    peer.connect()
    stamp = peer.moved()
    assert peer.change("shutdown")
    assert at_rest(peer.answer(stamp, count=2))
    code, output = peer.end()
    assert code == 0, output
    assert "Traceback" not in output


def test_wrong_parameter_ends_the_process():
    result = subprocess.run(
        [*DRIVER, "--ros-args", "-p", "transport:=can"],
        capture_output=True,
        text=True,
        timeout=15,
    )
    assert result.returncode == 2
    assert result.stderr.endswith("error: transport is 'can', allowed: serial, sim\n")
    assert "Traceback" not in result.stderr


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


def test_services_stop_disable_and_enable(peer):
    peer.connect()
    stop, cut, home, calibrate = (
        peer.node.create_client(Trigger, name)
        for name in ("emergency_stop", "cut_power", "home", "calibrate")
    )
    enable = peer.node.create_client(SetBool, "enable")
    assert peer.until(lambda: peer.told[-1:] == ["ready"])
    off = SetBool.Request(data=False)
    for call, state, reason in (
        (lambda: peer.call(stop, Trigger.Request()), EMERGENCY, DriverStatus.EMERGENCY_STOP),
        (lambda: peer.call(cut, Trigger.Request()), CUT, DriverStatus.POWER_CUT),
        (lambda: peer.call(enable, off), OFF, DriverStatus.SWITCHED_OFF),
    ):
        stamp = peer.moved()
        assert call().success
        assert at_rest(peer.answer(stamp, count=2))
        assert peer.until(lambda s=state: peer.told[-1] == s)
        assert peer.statuses[-1].reason == reason
        count = len(peer.setpoints)
        peer.send(shaking(0.0005))
        assert not peer.until(lambda n=count: len(peer.setpoints) > n, seconds=0.5)
        assert call().success  # once more does no harm
        assert peer.told[-1] == state
        assert peer.call(home, Trigger.Request()).success
        assert peer.call(enable, SetBool.Request(data=True)).success
        assert peer.until(lambda: peer.told[-1] == "ready")
    answer = peer.call(calibrate, Trigger.Request())
    assert (answer.success, answer.message[:19]) == (False, "calibration_file is")
    peer.moved()
    code, output = peer.end()
    assert code == 0, output
    assert "cycle refused: the driver is stopped: emergency stop; look at the rig" in output


@pytest.mark.parametrize("peer", [["autostart:=false"]], indirect=True)
def test_a_transition_that_does_not_fit_is_refused_and_ends_nothing(peer):
    assert peer.change("configure")
    assert peer.change("activate")
    assert not peer.change("activate")
    assert not peer.change("configure")
    assert peer.state() == "active"
    stop = peer.node.create_client(Trigger, "emergency_stop")
    assert peer.call(stop, Trigger.Request()).success


def test_the_command_line_stops_and_tells(peer):
    peer.connect()

    def plate(*words: str) -> tuple[int, str]:
        code = "from plate_client.command import main; main()"
        done = subprocess.run(
            [sys.executable, "-c", code, *words, "--namespace", NAMESPACE],
            capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        # On a busy machine Fast DDS may report on stderr that it tries the next port.
        return done.returncode, done.stdout or done.stderr

    assert plate("emergency_stop") == (0, EMERGENCY + "\n")
    code, text = plate("state")
    assert "\n  driver: " in text
    assert (code, EMERGENCY in text) == (0, True)
    assert plate("enable") == (0, "ready\n")
    code, text = plate("stop")
    assert (code, "no service stop: nodes here: driver, driver_safety" in text) == (1, True)


def test_each_of_100_stops_at_once_is_answered(peer):
    peer.connect()
    stops = [
        peer.node.create_client(Trigger, "emergency_stop", qos_profile=CALLS) for _ in range(100)
    ]
    assert all(peer.until(stop.service_is_ready) for stop in stops)
    peer.until(lambda: False, 1.0)  # the driver gets to know them
    answers = [stop.call_async(Trigger.Request()) for stop in stops]
    assert peer.until(lambda: all(answer.done() for answer in answers))
    assert {answer.result().message for answer in answers} == {EMERGENCY}


def test_a_stop_latches_in_every_state(peer):
    """Without motors there is only the driver's own latch: nothing but enable opens it."""
    peer.connect()
    stop = peer.node.create_client(Trigger, "emergency_stop")
    enable = peer.node.create_client(SetBool, "enable")
    assert peer.call(stop, Trigger.Request()).success
    assert peer.until(lambda: peer.told[-1] == EMERGENCY)
    for change, word in (
        ("deactivate", "inactive"), ("cleanup", "unconfigured"), ("configure", "inactive"),
    ):  # fmt: skip
        assert peer.change(change)
        told = f"{word}: emergency stop; look at the rig, then call enable"
        assert peer.until(lambda told=told: peer.told[-1] == told)
    assert peer.change("activate")
    assert peer.until(lambda: peer.told[-1] == EMERGENCY)
    assert "ready" not in peer.told[peer.told.index(EMERGENCY) :]
    peer.send(shaking(0.0005))
    assert not peer.until(lambda: peer.setpoints, seconds=0.5)
    assert peer.level() == DiagnosticStatus.ERROR
    # A stop of an inactive and of an unconfigured driver, and what enable says there.
    assert peer.call(enable, SetBool.Request(data=True)).success
    for change, word in (("deactivate", "inactive"), ("cleanup", "unconfigured")):
        assert peer.change(change)
        answer = peer.call(enable, SetBool.Request(data=True))
        assert (answer.success, answer.message[: 14 + len(word)]) == (
            False, f"the driver is {word}",
        )  # fmt: skip
        assert peer.call(stop, Trigger.Request()).success
    assert peer.change("configure")
    assert peer.change("activate")
    assert peer.until(lambda: peer.told[-1] == EMERGENCY)
    assert peer.call(enable, SetBool.Request(data=True)).success
    assert peer.until(lambda: peer.told[-1] == "ready")
    # A sign of life, twice a second.
    count = len(peer.statuses)
    assert peer.until(lambda: len(peer.statuses) >= count + 3)


def test_an_enable_without_a_stop_changes_nothing(peer):
    """Another time of it would end a running task: it stands for a stop that was cleared."""
    peer.connect()
    assert peer.until(lambda: peer.told[-1:] == ["ready"])
    first, before = len(peer.statuses) - 1, peer.statuses[-1].enabled_at
    assert abs(nanoseconds(before) * 1e-9 - time.time()) < 600
    enable = peer.node.create_client(SetBool, "enable")
    answer = peer.call(enable, SetBool.Request(data=True))
    assert (answer.success, answer.message) == (True, "ready")
    count = len(peer.statuses)
    assert peer.until(lambda: len(peer.statuses) >= count + 2)
    assert all(status.enabled_at == before for status in peer.statuses[first:])
    stop = peer.node.create_client(Trigger, "emergency_stop")
    assert peer.call(stop, Trigger.Request()).success
    assert peer.call(enable, SetBool.Request(data=True)).success
    ready = DriverStatus.READY
    assert peer.until(
        lambda: peer.statuses[-1].state == ready and peer.statuses[-1].enabled_at != before
    )
    stopped = next(s for s in peer.statuses if s.state == DriverStatus.STOPPED)
    assert (stopped.reason, stopped.text) == (DriverStatus.EMERGENCY_STOP, EMERGENCY)
    assert stopped.enabled_at == before


def test_bytes_that_are_no_message_end_nothing(peer):
    """As of a computer with other interfaces; one of the latched topic comes again and again."""
    peer.connect()
    status, cycle = TaskStatus(text="idle"), cycle_to_msg(shaking(0.0005), to_time(time.time_ns()))
    for publisher, msg in ((peer.tasks, status), (peer.cycles, cycle)):
        data = serialize_message(msg)
        publisher.publish(data[: len(data) // 2])
    assert peer.until(lambda: peer.reports and peer.value("refused") == "1")
    peer.moved()
    stop = peer.node.create_client(Trigger, "emergency_stop")
    assert peer.call(stop, Trigger.Request()).success
    _, output = peer.end()
    assert "cycle refused: JointTrajectory: " in output
    assert "task_status: TaskStatus: " in output


def test_cycles_that_are_too_long_are_refused_unread(peer):
    peer.connect()
    msg = cycle_to_msg(shaking(0.0005), to_time(time.time_ns()))
    msg.points = msg.points * 500
    peer.cycles.publish(msg)
    assert peer.until(lambda: peer.reports and peer.value("refused") == "1")
    assert not peer.setpoints
    peer.moved()
    _, output = peer.end()
    assert "cycle refused: plate_cycle: 24500 points, allowed: at most 2000" in output
