"""The driver as a process of its own, spoken to over ROS: signals, and messages on their way."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from driven import CALM, EMERGENCY, answered_once, at_rest, transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

from plate_core.ros import (  # noqa: E402
    CALLS,
    DATA,
    LATCHED,
    cycle_to_msg,
    nanoseconds,
    to_time,
)
from plate_driver.freshness import STALL_S  # noqa: E402
from plate_interfaces.msg import DriverStatus, TaskStatus  # noqa: E402

DRIVER = [sys.executable, "-c", "from plate_driver.node import main; main()"]
NAMESPACE = f"/driver_test_{os.getpid()}"
PLATE = """
import sys
from unittest.mock import patch
from plate_client.command import main
from plate_client.ros import graph, services
for module, name in ((graph, "DISCOVERY_S"), (services, "DISCOVERY_S"), (graph, "LATE_S")):
    patch.object(module, name, 60.0).start()  # an unknown name is an error
_, namespace, *commands = sys.argv
for command in commands:
    services.SERVICE_TIMEOUT_S = 1.0 if command == "stop" else 60.0
    sys.argv = ["plate", command, "--namespace", namespace]
    try:
        main()
    except SystemExit as end:
        print("code", end.code, flush=True)
"""
"""The program `plate`, which gets one command after the other, and time to discover the nodes."""


class Peer:
    """A driver process and a node that listens to it."""

    def __init__(self, file: Path, *parameters: str) -> None:
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
        self.texts: list[str] = []  # without repeated messages
        self.node.create_subscription(DriverStatus, "driver_status", self._on_status, LATCHED)
        self.cycles = self.node.create_publisher(JointTrajectory, "plate_cycle", DATA)
        self.tasks = self.node.create_publisher(TaskStatus, "task_status", LATCHED)
        env = os.environ | {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }
        arguments = [word for p in parameters for word in ("-p", p)]
        command = [*DRIVER, "--ros-args", "-r", f"__ns:={NAMESPACE}", *arguments]
        self._file = file
        with file.open("w") as printed:
            self.process = subprocess.Popen(command, env=env, stdout=printed, stderr=printed)

    def _on_status(self, msg: DriverStatus) -> None:
        if not self.texts or self.texts[-1] != msg.text:
            self.texts.append(msg.text)

    @property
    def output(self) -> str:
        """All that the driver has printed."""
        return self._file.read_text()

    def seen(self, condition, seconds: float = 60.0) -> bool:
        """Spin until the condition holds. Return False if it does not hold within the time [s]."""
        end = time.monotonic() + seconds
        while not (holds := condition()) and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
        return holds

    def until(self, condition) -> None:
        assert self.seen(condition), self.output

    def send(self) -> int:
        """Send a cycle that answers an image of now; returns its stamp."""
        stamp_ns = time.time_ns()
        self.cycles.publish(cycle_to_msg(CALM, to_time(stamp_ns)))
        return stamp_ns

    def moved(self) -> None:
        """Move the plate by a cycle for each new image, as a solver does. The driver refuses late
        cycles and cycles that arrive before it is ready, and receives none before it has discovered
        this publisher."""
        sent, before = [], len(self.setpoints)

        def answered() -> bool:
            sent.append(self.send())
            return self.seen(lambda: len(self.setpoints) > before, 1.0)

        self.until(answered)
        assert nanoseconds(self.setpoints[-1].header.stamp) in sent
        assert not at_rest(self.setpoints[-1])

    def rests(self) -> None:
        """Wait until the plate does, which has moved: the cycle of this stamp is over."""
        self.until(lambda: at_rest(self.setpoints[-1]))
        moved, rests = self.setpoints[-2:]
        assert not at_rest(moved)
        assert moved.header.stamp == rests.header.stamp

    def clients(self, kind, name: str, known, count: int = 1):
        """Clients that the driver has answered the request `known`, which does no harm."""
        made = [self.node.create_client(kind, name, qos_profile=CALLS) for _ in range(count)]
        self.until(lambda: all(client.service_is_ready() for client in made))
        assert answered_once([(client, known) for client in made], self.seen), self.output
        return made

    def changes(self, unfit: str):
        """Return a function that makes the driver do a transition. `unfit` is a transition that is
        not possible now."""
        [client] = self.clients(ChangeState, "driver/change_state", transition(unfit))
        return lambda label: self.call(client, transition(label)).success

    def call(self, client, request):
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    @property
    def level(self) -> bytes:
        return self.reports[-1].status[0].level if self.reports else b""

    def end(self, number: int) -> None:
        """Signal the driver, which ends with code 0."""
        self.process.send_signal(number)
        assert self.process.wait(60) == 0, self.output
        assert "Traceback" not in self.output

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(name="peer")
def _peer(request, tmp_path):
    peer = Peer(tmp_path / "output", *getattr(request, "param", ()))
    yield peer
    peer.close()


# To start one takes a second, and ten on a busy computer: they come in few, long pieces.


def test_a_process_answers_over_ros_and_rests_at_an_interrupt(peer):
    # Bytes that are no message, as of a computer with other interfaces, end nothing: one of the
    # latched topic comes again and again.
    data = serialize_message(TaskStatus(text="idle"))
    peer.tasks.publish(data[: len(data) // 2])
    peer.moved()
    data = serialize_message(cycle_to_msg(CALM, to_time(time.time_ns())))

    def refused() -> bool:
        peer.cycles.publish(data[: len(data) // 2])
        return peer.seen(lambda: "cycle refused: JointTrajectory: " in peer.output, 1.0)

    peer.until(refused)  # which is not reported twice within two seconds
    peer.until(lambda: "task_status: TaskStatus: " in peer.output)
    peer.tasks.publish(TaskStatus(text="idle"))
    peer.until(lambda: peer.states)
    # Each of 100 stops at once is answered.
    ask = Trigger.Request()
    stops = peer.clients(Trigger, "emergency_stop", ask, 100)
    answers = [stop.call_async(ask) for stop in stops]
    peer.until(lambda: all(answer.done() for answer in answers))
    assert {answer.result().message for answer in answers} == {EMERGENCY}
    peer.until(lambda: peer.texts[-1] == EMERGENCY)
    [enable] = peer.clients(SetBool, "enable", SetBool.Request(data=False))
    assert peer.call(enable, SetBool.Request(data=True)).message == "ready"
    peer.until(lambda: peer.texts[-1] == "ready")
    # So does the command line.
    done = subprocess.run(
        [sys.executable, "-c", PLATE, NAMESPACE, "emergency_stop", "state", "enable", "stop"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    stop, state, enabled, unknown = re.findall(r"(.*?)code (\d)\n", done.stdout, re.DOTALL)
    assert stop == (f"{EMERGENCY}\n", "0")
    assert (state[1], EMERGENCY in state[0], "\n  driver: " in state[0]) == ("0", True, True)
    assert (enabled, unknown) == (("ready\n", "0"), ("", "1"))
    [names] = re.findall(r"plate: no service stop; running nodes: (.*)", done.stderr)
    assert set(names.split(", ")) <= {"driver", "driver_safety", "peer"}
    peer.until(lambda: {"driver", "driver_safety"} <= set(peer.node.get_node_names()))
    peer.moved()
    peer.end(signal.SIGINT)
    peer.rests()


@pytest.mark.parametrize("peer", [["autostart:=false"]], indirect=True)
def test_a_process_is_managed_frozen_and_terminated(peer):
    [get] = peer.clients(GetState, "driver/get_state", GetState.Request())
    change = peer.changes("deactivate")

    def state() -> str:
        return peer.call(get, GetState.Request()).current_state.label

    assert state() == "unconfigured"
    peer.until(lambda: peer.texts == ["unconfigured"])
    peer.until(lambda: peer.level == DiagnosticStatus.WARN)
    assert change("configure")
    assert state() == "inactive"
    peer.until(lambda: peer.texts[-1] == "inactive")
    assert change("activate")
    peer.until(lambda: peer.texts[-1] == "ready")
    assert not change("activate")
    assert not change("configure")
    assert state() == "active"
    peer.moved()
    # No cycle arrives any more, although a task runs: the plate rests, and the driver reports it.
    peer.tasks.publish(TaskStatus(state=TaskStatus.RUNNING))
    peer.until(lambda: peer.level == DiagnosticStatus.STALE)
    assert "no plate_cycle for 0.3 s: the plate rests" in peer.output
    assert change("deactivate")
    peer.rests()
    assert change("cleanup")
    assert state() == "unconfigured"
    # After a restart: messages that arrived during the stall of the driver move nothing, even if
    # they are new.
    assert change("configure")
    assert change("activate")
    peer.moved()
    stood = (
        "cycle refused: plate_cycle is for an image that was taken before the driver was stalled"
    )
    sent = []

    def refused() -> bool:
        peer.process.send_signal(signal.SIGSTOP)
        time.sleep(STALL_S + 0.1)
        sent.append(peer.send())
        peer.process.send_signal(signal.SIGCONT)
        return peer.seen(lambda: stood in peer.output, 1.0)

    peer.until(refused)
    peer.moved()
    assert not {nanoseconds(msg.header.stamp) for msg in peer.setpoints} & set(sent)
    peer.end(signal.SIGTERM)
    peer.rests()


def test_a_process_that_was_shut_down_rests_and_ends_well(peer):
    peer.moved()
    assert peer.changes("configure")("shutdown")
    peer.rests()
    peer.end(signal.SIGINT)


def test_wrong_parameter_ends_the_process():
    result = subprocess.run(
        [*DRIVER, "--ros-args", "-p", "transport:=can"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 2
    assert "error: transport is 'can', allowed: serial, sim" in result.stderr
    assert "Traceback" not in result.stderr


def test_a_device_that_was_never_met_has_no_current_to_cut(tmp_path):
    port = tmp_path / "nowhere"
    words = ["--ros-args", "-p", "transport:=serial", "-p", f"port:={port}"]
    with subprocess.Popen([*DRIVER, *words], stderr=subprocess.PIPE, text=True) as driver:
        lines = iter(driver.stderr.readline, "")
        assert any(f"serial port {port} is not there" in line for line in lines)
        driver.send_signal(signal.SIGINT)
        _, errors = driver.communicate(timeout=60)
    assert driver.returncode == 0
    assert "ERROR" not in errors
