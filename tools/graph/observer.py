"""ROS node of the test tools. The node watches the nodes of a graph, starts tasks, and records
messages.

`Observer` waits for nodes, images and states with a time limit. If the awaited event does not
occur, `Observer` raises `GraphError` with the messages of the nodes. `Record` stores the messages
of one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_bringup import GraphError
from plate_client import PlateClient, Task
from plate_core import PlateError
from plate_core.ros import CAMERA, LATCHED, NodeExecutor, msg_to_reports, nanoseconds
from plate_core.status import Level
from plate_core.tasks import Scenario
from plate_driver.transports import CALL_AGAIN, UNCONNECTED
from plate_interfaces.msg import DriverStatus, Parts, TaskStatus

from .processes import signals_wait

MAX_IMAGES = 240
"""Maximum number of images that are stored for drawing. Each image has 300 kB."""

ALL = QoSProfile(depth=200)
"""Quality of service with a long queue, so that no message is lost while this process is slow."""

CALL_S, AGAIN_S = 10.0, 1.0
"""`CALL_S`: maximum wait for a service's reply [s]. `AGAIN_S`: time after which a service that can
be called twice is called again [s]. DDS can lose the first reply of a service that was just
discovered."""

SLOW_REPLY_S = 0.5
"""Time without a reply of a service after which the wait is reported [s]."""

AFTER = {
    "configure": "inactive", "activate": "active", "deactivate": "inactive",
    "cleanup": "unconfigured",
}  # fmt: skip
"""State of a lifecycle node after each transition."""

POLL_S = 0.05

REPORT_S = 0.25
"""Interval at which a waiting function reports its progress [s]."""

ANSWERED_S = 15.0
"""Maximum wait for the first plate_cycle after all nodes have published diagnostics [s]."""

FRESH_S = 2.5
"""Maximum wait for new diagnostics of a node [s]. Each node publishes diagnostics once per
second."""

READY_S = 15.0
"""Maximum wait until the driver is ready [s]. Homing of the device can take 5 s."""

STOPPED_S = 3.0
"""Time in the state STOPPED after which the driver does not become ready without a call [s]. After
a call, the state can arrive later than the reply."""

ACCEPTED_S = 5.0
"""Maximum wait until the planner accepts a task [s]. The planner can receive the driver's status
and the images a little later than this process."""

PERSONS = (
    DriverStatus.EMERGENCY_STOP, DriverStatus.POWER_CUT, DriverStatus.STOP_UNANSWERED,
)  # fmt: skip
"""Reasons of stops that a person must clear."""

STARTING = (DriverStatus.UNCONFIGURED, DriverStatus.INACTIVE, DriverStatus.BRAKING)
"""States of the driver that end without a command. When the first image is answered, the driver may
still be in one of these states."""

SETTLE_S = 0.5
"""Time to wait after a stop and a reset of the parts [s]. During this time, the plate comes to rest
and all earlier images are processed."""


@dataclass
class Thinned:
    """A list of limited length. When the list has `max_count` items, every second item is removed.
    Of the following items, only every second (later every fourth, ...) is kept."""

    max_count: int = MAX_IMAGES
    items: list[Any] = field(default_factory=list)
    step: int = 1
    count: int = 0

    def add(self, item: Any) -> None:
        """Append the item, or skip it if only every second (fourth, ...) item is kept."""
        if self.count % self.step == 0:
            self.items.append(item)
            if len(self.items) >= self.max_count:
                del self.items[1::2]
                self.step *= 2
        self.count += 1


@dataclass(frozen=True)
class Received:
    """One received message of diagnostics, driver_status or task_status.

    Attributes
    ----------
    at : float
        Arrival time [s, monotonic].
    stamp : int
        Stamp of the message [ns].
    text : str
        Text of the message.
    level : Level
        Severity, for diagnostics.
    state : int
        State, for a status.
    values : dict of str to str
        Values, for diagnostics.
    """

    at: float
    stamp: int
    text: str
    level: Level = Level.OK
    state: int = 0
    values: dict[str, str] = field(default_factory=dict)


@dataclass
class Record:
    """Messages of one run. Frequent messages are stored in serialised form, because their
    deserialisation would slow down the nodes.

    Attributes
    ----------
    truth, tables : list of bytes
        All messages of ground_truth and of motor_setpoints. Without a simulator, `truth` has the
        messages of parts.
    starts : list of bytes
        All messages of cycle_started.
    simulated : bool
        Whether there is a simulator.
    answers : int
        Number of plate_cycle messages.
    images : Thinned
        A selection of image_raw, serialised.
    diagnostics : dict of str to list of Received
        Diagnostics by node.
    drivers, tasks : list of Received
        All driver_status messages, and the task_status messages with a new text.
    status : TaskStatus, optional
        Newest task_status.
    driver : DriverStatus, optional
        Newest driver_status.
    """

    truth: list[bytes] = field(default_factory=list)
    tables: list[bytes] = field(default_factory=list)
    starts: list[bytes] = field(default_factory=list)
    simulated: bool = True
    answers: int = 0
    images: Thinned = field(default_factory=Thinned)
    diagnostics: dict[str, list[Received]] = field(default_factory=dict)
    drivers: list[Received] = field(default_factory=list)
    tasks: list[Received] = field(default_factory=list)
    status: TaskStatus | None = None
    driver: DriverStatus | None = None

    def last(self, node: str, key: str, default: str = "") -> str:
        """Return a value from the newest diagnostics of a node that contain values."""
        reports = self.reports(node)
        return reports[-1].values.get(key, default) if reports else default

    def reports(self, node: str) -> list[Received]:
        """Return those diagnostics of a node that contain values."""
        return [message for message in self.diagnostics.get(node, []) if message.values]

    @property
    def states(self) -> list[str]:
        """Texts of the task_status messages that were received so far."""
        return [message.text for message in self.tasks]

    @property
    def answered(self) -> bool:
        """Whether the solver has answered an image: a plate_cycle arrived, or the solver's
        diagnostics count an answer.

        In lockstep, the solver publishes a single plate_cycle before the first goal. If this
        process discovers the solver later, this process does not receive that message.
        """
        return self.answers > 0 or self.last("solver", "answers", "0") != "0"

    @property
    def ready(self) -> bool:
        """Whether the driver is ready to play cycles."""
        return self.driver is not None and self.driver.state == DriverStatus.READY

    @property
    def done(self) -> bool:
        """Whether the task has reached its goal."""
        return self.status is not None and self.status.state == TaskStatus.DONE

    @property
    def running(self) -> bool:
        """Whether a task runs."""
        return self.status is not None and self.status.state == TaskStatus.RUNNING

    @property
    def ended(self) -> bool:
        """Whether the task has ended."""
        going = (TaskStatus.IDLE, TaskStatus.RUNNING)
        return self.status is not None and self.status.state not in going


class Observer:
    """ROS node in this process that records messages and calls services. Use this class as a
    context manager.

    Parameters
    ----------
    domain : int
        ROS domain.
    pulse : callable, optional
        First item of the attribute `pulses`.
    pictures : bool
        Whether to record images.
    waiting : callable, optional
        Function that is called during a wait, with a text about the missing event.
    simulated : bool
        Whether to record the parts' true positions from the simulator. If False, the positions from
        the detector are recorded.

    Attributes
    ----------
    record : Record
    domain : int
    node : Node
    pulses : list of callables
        Functions that are called about every `POLL_S` during a wait. A function can raise an
        exception to end the wait.
    """

    def __init__(
        self,
        domain: int,
        pulse: Callable[[], None] = lambda: None,
        pictures: bool = True,
        waiting: Callable[[str], None] = lambda _: None,
        simulated: bool = True,
    ) -> None:
        self.record, self.domain, self._waiting = Record(simulated=simulated), domain, waiting
        self.pulses = [pulse]
        self._pulsed_at = 0.0
        rclpy.init(
            domain_id=domain,
            args=["--ros-args", "--disable-external-lib-logs"],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("observer")
        self._executor = NodeExecutor()
        self._executor.add_node(self.node)
        record = self.record

        def listen(kind: Any, topic: str, on_message: Any, qos: QoSProfile, raw: bool) -> None:
            self.node.create_subscription(kind, topic, on_message, qos, raw=raw)

        listen(Parts, "ground_truth" if simulated else "parts", record.truth.append, ALL, True)
        listen(JointTrajectory, "motor_setpoints", record.tables.append, ALL, True)
        listen(JointTrajectory, "cycle_started", record.starts.append, ALL, True)
        listen(JointTrajectory, "plate_cycle", self._on_answer, ALL, True)
        if pictures:
            listen(Image, "image_raw", record.images.add, CAMERA, True)
        listen(DiagnosticArray, "diagnostics", self._on_report, ALL, False)
        listen(TaskStatus, "task_status", self._on_task, LATCHED, False)
        listen(DriverStatus, "driver_status", self._on_driver, LATCHED, False)

    def __enter__(self) -> Observer:
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _on_answer(self, _: bytes) -> None:
        self.record.answers += 1

    def _on_task(self, msg: TaskStatus) -> None:
        self.record.status = msg
        # record each text once, although it is published with each image
        if self.record.states[-1:] != [msg.text]:
            self.record.tasks.append(_to_received(msg))

    def _on_driver(self, msg: DriverStatus) -> None:
        self.record.driver = msg
        self.record.drivers.append(_to_received(msg))

    def _on_report(self, msg: DiagnosticArray) -> None:
        now, stamp = time.monotonic(), nanoseconds(msg.header.stamp)
        for report in msg_to_reports(msg, self.node.get_namespace()):
            message = Received(now, stamp, report.message, report.level, values=report.values)
            self.record.diagnostics.setdefault(report.node, []).append(message)

    @cached_property
    def client(self) -> PlateClient:
        """Client of the planner's actions."""
        return PlateClient(self.node, self.until)

    def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Receive messages until the condition is true. Return False if the condition is not true
        within `timeout_s` [s].

        A signal takes effect only between two messages. If a signal handler raised an exception
        while rclpy converts a message, rclpy would raise a RuntimeError instead.
        """
        end = time.monotonic() + timeout_s
        while not condition():
            now = time.monotonic()
            if now > end:
                return False
            if now - self._pulsed_at > POLL_S:
                self._pulsed_at = now
                for pulse in self.pulses:
                    pulse()
            with signals_wait():
                self._executor.spin_once(timeout_sec=POLL_S)
        return True

    def seen(self, names: Iterable[str]) -> list[str]:
        """Return the names of the nodes that are now visible in the ROS graph."""
        visible = self.node.get_node_names()
        return [name for name in names if name in visible]

    def await_nodes(self, names: list[str], timeout_s: float) -> list[str]:
        """Wait until all nodes are visible in the ROS graph, and return their names.

        Raises
        ------
        GraphError
            If some nodes do not appear within `timeout_s` [s]. The message contains the names of
            these nodes.
        """

        def missing() -> list[str]:
            seen = self.seen(names)
            absent = [name for name in names if name not in seen]
            if absent:
                self._waiting(f"waiting for {', '.join(absent)}")
            return absent

        if not self.until(lambda: not missing(), timeout_s):
            raise GraphError(
                f"missing after {timeout_s:g} s: {', '.join(missing())} (of {', '.join(names)})"
            )
        return self.seen(names)

    def await_camera(self, timeout_s: float) -> None:
        """Wait until images have a publisher.

        Raises
        ------
        GraphError
            If there is no publisher within `timeout_s` [s].
        """
        topics = ("image_raw", "image_raw/compressed")
        if not self.until(lambda: any(map(self.node.count_publishers, topics)), timeout_s):
            raise GraphError(
                f"no camera: no node publishes /image_raw in ROS domain {self.domain}. Start it "
                f"there (export ROS_DOMAIN_ID={self.domain}), or name its domain: "
                "--domain N"
            )

    def await_answers(self, timeout_s: float, names: Iterable[str] = ()) -> None:
        """Wait until the solver has answered an image (`Record.answered`).

        Parameters
        ----------
        timeout_s : float
            Maximum wait [s].
        names : iterable of str
            Nodes. After all of them have published diagnostics, the wait ends within `ANSWERED_S`.

        Raises
        ------
        GraphError
            If no image is answered. The message contains the messages of the nodes.
        """
        names = list(names)
        began, allowed_s = time.monotonic(), timeout_s
        while not self.until(lambda: self.record.answered, REPORT_S):
            waited_s = time.monotonic() - began
            self._waiting(f"waiting for the answer to the first image | {waited_s:.0f} s")
            if names and all(name in self.record.diagnostics for name in names):
                allowed_s = min(allowed_s, waited_s + ANSWERED_S)
            if waited_s > allowed_s:
                raise GraphError(
                    f"no result for an image within {allowed_s:.0f} s: {self.blame()} "
                    f"({self.node.count_publishers('plate_cycle')} publishers of plate_cycle seen, "
                    f"{len(self.record.tables)} motor tables)"
                )

    def blame(self) -> str:
        """Return the reason why no cycle arrives: the message of the first node in the chain with
        an error, or the messages of all nodes if no node has an error."""
        newest = {name: message[-1] for name, message in self.record.diagnostics.items()}
        for name in ("detector", "planner", "solver"):
            if name in newest and newest[name].level in (Level.ERROR, Level.STALE):
                return f"{name}: {newest[name].text}"
        texts = [f"{name}: {message.text}" for name, message in newest.items()]
        return "; ".join(texts) or "no node publishes diagnostics"

    def activate_driver(self) -> None:
        """Configure and activate the driver, so that it forwards the solver's cycles.

        Raises
        ------
        GraphError
            If the driver refuses. The message contains the reason.
        """
        for transition in ("configure", "activate"):
            self.change_state("driver", transition)

    def change_state(self, node: str, transition: str) -> None:
        """Request a lifecycle transition of a node.

        If DDS loses the reply, the second call is refused because the transition is already done.
        Therefore a refusal counts as success if the node is already in the state that follows the
        transition.

        Raises
        ------
        GraphError
            If the node refuses. The message contains the reason.
        """
        request = ChangeState.Request(transition=Transition(label=transition))
        if self.call(ChangeState, f"{node}/change_state", request, AGAIN_S).success:
            return
        now = self.call(GetState, f"{node}/get_state", GetState.Request(), AGAIN_S)
        if now.current_state.label == AFTER.get(transition):
            return
        reports, now = self.record.diagnostics, time.monotonic()
        self.until(lambda: any(report.at > now for report in reports.get(node, ())), FRESH_S)
        reported = reports[node][-1].text if node in reports else "nothing"
        raise GraphError(f"{transition} refused, {node} reports: {reported}")

    def check_not_stopped(self) -> None:
        """Check that nobody has stopped the motors or the task. Only a person is allowed to clear
        such a stop.

        Raises
        ------
        GraphError
            If the motors or the task were stopped. The message contains the reason of the stop.
        """
        driver, task = self.record.driver, self.record.status
        if driver is not None and driver.reason in PERSONS:
            raise GraphError(f"stopped before the task began, driver: {driver.text}")
        if task is not None and (task.state, task.reason) == (TaskStatus.IDLE, TaskStatus.STOPPED):
            raise GraphError("stopped before the task began by the service stop")

    def enable(self, check: Callable[[], None] = lambda: None) -> None:
        """Wait until the driver is connected to the device, enable the motors as an operator does
        after a look at the rig, and wait until the driver is ready. `check` is called before each
        call of the service, and can raise an exception.

        Raises
        ------
        GraphError
            If the driver refuses, or is not ready in time.
        """
        answer = SetBool.Response()

        def connected() -> bool:
            driver = self.record.driver
            waits = driver is None or driver.state in STARTING
            if driver is not None and driver.state == DriverStatus.ERROR:
                waits = driver.reason in UNCONNECTED
            if waits:
                self._show_driver_wait()
            return not waits

        def enabled() -> bool:
            nonlocal answer
            self.until(connected, READY_S)
            check()
            answer = self.call(SetBool, "enable", SetBool.Request(data=True))
            return answer.success or not answer.message.endswith(CALL_AGAIN)

        self.until(enabled, READY_S)
        if not answer.success:
            raise GraphError(f"enable refused: {answer.message}")
        self.await_ready()

    def _show_driver_wait(self) -> str:
        """Show that the program waits for the driver, and return the driver's last report."""
        reported = "nothing" if self.record.driver is None else str(self.record.driver.text)
        self._waiting(f"waiting for the driver, it reports: {reported}")
        return reported

    def await_ready(self) -> None:
        """Wait until the driver is ready.

        Raises
        ------
        GraphError
            If the driver is not ready in time, or if it has stopped the motors: then it waits for
            a new call of enable. The message contains its status.
        """
        end, stopped_s = time.monotonic() + READY_S, 0.0
        while not self.until(lambda: self.record.ready, REPORT_S):
            reported = self._show_driver_wait()
            driver = self.record.driver
            is_stopped = driver is not None and driver.state == DriverStatus.STOPPED
            stopped_s = stopped_s + REPORT_S if is_stopped else 0.0
            if stopped_s > STOPPED_S:
                raise GraphError(f"the driver has stopped the motors before the task: {reported}")
            if time.monotonic() > end:
                raise GraphError(
                    f"the driver was not ready after {READY_S:g} s, its last report: {reported}"
                )

    def start(self, scenario: Scenario, ready_timeout_s: float = ACCEPTED_S) -> Task:
        """Send the goal of a scenario, and wait until its task runs or has ended. If the planner
        refuses the goal, the goal is sent again for up to `ready_timeout_s` [s].

        Raises
        ------
        GraphError
            If the planner still refuses the goal after this time. The message contains the reason.
        """
        if ready_timeout_s:
            self.await_ready()
        self.record.status = None
        try:
            task = self.client.start(scenario, ready_timeout_s, self._waiting)
        except PlateError as refusal:
            raise GraphError(str(refusal)) from None
        # Wait for the status of the new task. The status of an earlier task can arrive after the
        # new goal was sent.
        self.until(lambda: task.ended or self.record.running, ACCEPTED_S)
        return task

    def call(self, kind: Any, service: str, request: Any, again_s: float = CALL_S) -> Any:
        """Call a service, and return its reply. If there is no reply for `again_s` [s], repeat the
        call.

        Raises
        ------
        GraphError
            If there is no reply within `CALL_S`.
        """
        client = self.node.create_client(kind, service)
        began = time.monotonic()

        def received(condition: Callable[[], bool], timeout_s: float) -> bool:
            end = time.monotonic() + timeout_s
            while not self.until(condition, min(REPORT_S, max(0.0, end - time.monotonic()))):
                now = time.monotonic()
                if now - began > SLOW_REPLY_S:
                    last = "" if self.record.driver is None else str(self.record.driver.text)
                    driver = f"; the driver reports: {last}" if last else ""
                    self._waiting(f"waiting {now - began:.0f} s for the service {service}{driver}")
                if now >= end:
                    return False
            return True

        try:
            answers: list[Any] = []
            tries = range(round(CALL_S / again_s))
            for _ in tries if received(client.service_is_ready, CALL_S) else ():
                future = client.call_async(request)
                future.add_done_callback(lambda done: answers.append(done.result()))
                if received(lambda: bool(answers), again_s):
                    return answers[0]
            raise GraphError(f"service {service} did not answer within {CALL_S:g} s")
        finally:
            self.node.destroy_client(client)

    def trigger(self, service: str) -> str:
        """Call a service such as `stop`, and return the message of its reply.

        Raises
        ------
        GraphError
            If the node refuses.
        """
        answer = self.call(Trigger, service, Trigger.Request(), AGAIN_S)
        if not answer.success:
            raise GraphError(f"{service} refused: {answer.message}")
        return str(answer.message)

    def restart(self, scenario: Scenario) -> None:
        """Place the parts again, reset the detector's tracking, and start the task.

        The driver must be ready.

        Raises
        ------
        GraphError
            If a call or the goal is refused.
        """
        for service in ("stop", "simulator/reset", "detector/reset"):
            self.trigger(service)
        # wait, because images from before the reset may still be in the queues
        self.until(lambda: False, SETTLE_S)
        self.trigger("detector/reset")
        self.record.tasks.clear()
        self.start(scenario)

    def set_parameter(self, node: str, name: str, value: Any) -> None:
        """Set a parameter of a running node.

        Raises
        ------
        GraphError
            If the node refuses. The message contains the reason.
        """
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        if not result.successful:
            raise GraphError(str(result.reason))


def _to_received(msg: DriverStatus | TaskStatus) -> Received:
    return Received(time.monotonic(), nanoseconds(msg.header.stamp), msg.text, state=msg.state)
