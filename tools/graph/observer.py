"""The sixth process: sees the nodes over DDS, starts the task, and keeps what was heard of it."""

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
from plate_interfaces.msg import DriverStatus, Parts, TaskStatus

MOST_IMAGES = 240
"""Images kept for drawing (300 kB each)."""

ALL = QoSProfile(depth=200)
"""We want to hear everything, also when we are slow."""

CALL_S, AGAIN_S = 10.0, 1.0
"""Longest wait for a service, and time after which one that may be called twice is [s]: DDS may
lose the first answer of a service that was just found."""

AFTER = {
    "configure": "inactive", "activate": "active", "deactivate": "inactive",
    "cleanup": "unconfigured",
}  # fmt: skip
"""States of a lifecycle after its transitions."""

POLL_S = 0.05

LOOK_S = 0.25
"""Between two looks why there is no answer yet [s]."""

ANSWERED_S = 15.0
"""Longest wait for the first answer once all nodes have told how they are [s]."""

FRESH_S = 2.5
"""What a node has said counts for so long [s]: it says something each second."""

CALL_AGAIN = ": call again"
"""What the driver ends with that has just stood still, as on a busy computer."""

READY_S = 15.0
"""Longest wait until the driver is ready [s]: the device may have to find home first, for 5 s."""

ACCEPTED_S = 5.0
"""Longest wait until a task may be started [s]: the planner hears of the driver and of images when
we do, or a little later."""

PERSONS = (
    DriverStatus.EMERGENCY_STOP, DriverStatus.POWER_CUT, DriverStatus.STOP_UNANSWERED,
)  # fmt: skip
"""Stops by somebody who saw a danger."""

SETTLE_S = 0.5
"""Time in which all images of parts that were put elsewhere are answered [s]."""


@dataclass
class Thinned:
    """A list that never grows beyond `most`: when full, every other item goes, and from then on
    only every second, fourth, ... new one is taken."""

    most: int = MOST_IMAGES
    items: list[Any] = field(default_factory=list)
    step: int = 1
    count: int = 0

    def add(self, item: Any) -> None:
        """Take the item, or not."""
        if self.count % self.step == 0:
            self.items.append(item)
            if len(self.items) >= self.most:
                del self.items[1::2]
                self.step *= 2
        self.count += 1


@dataclass(frozen=True)
class Said:
    """What a node said of itself, or of the driver or the task.

    Attributes
    ----------
    at : float
        When it came [s, monotonic].
    stamp : int
        What it was about [ns].
    text : str
    level : Level
        Of diagnostics.
    state : int
        Of a status.
    values : dict of str to str
        Of diagnostics.
    """

    at: float
    stamp: int
    text: str
    level: Level = Level.OK
    state: int = 0
    values: dict[str, str] = field(default_factory=dict)


@dataclass
class Record:
    """Messages of one run, undecoded where decoding would steal time from the nodes.

    Attributes
    ----------
    truth, tables : list of bytes
        All messages of ground_truth (without a simulator: of parts) and of motor_setpoints.
    simulated : bool
        Whether there is a simulator.
    answers : int
        Number of plate_cycle messages.
    images : Thinned
        Some of image_raw, as bytes.
    said : dict of str to list of Said
        Diagnostics by node.
    drivers, tasks : list of Said
        Statuses of the driver and, each text once, of the task.
    status : TaskStatus, optional
        The newest.
    driver : DriverStatus, optional
        The newest.
    """

    truth: list[bytes] = field(default_factory=list)
    tables: list[bytes] = field(default_factory=list)
    simulated: bool = True
    answers: int = 0
    images: Thinned = field(default_factory=Thinned)
    said: dict[str, list[Said]] = field(default_factory=dict)
    drivers: list[Said] = field(default_factory=list)
    tasks: list[Said] = field(default_factory=list)
    status: TaskStatus | None = None
    driver: DriverStatus | None = None

    def last(self, node: str, key: str, default: str = "") -> str:
        """Return the newest value that a node has reported."""
        reports = self.reports(node)
        return reports[-1].values.get(key, default) if reports else default

    def reports(self, node: str) -> list[Said]:
        """Return what a node has said with values."""
        return [said for said in self.said.get(node, []) if said.values]

    @property
    def states(self) -> list[str]:
        """What the planner said of the task, in words."""
        return [said.text for said in self.tasks]

    @property
    def ready(self) -> bool:
        """Whether cycles reach the motors."""
        return self.driver is not None and self.driver.state == DriverStatus.READY

    @property
    def done(self) -> bool:
        """Whether the task is over, and its goal reached."""
        return self.status is not None and self.status.state == TaskStatus.DONE

    @property
    def running(self) -> bool:
        """Whether a task runs."""
        return self.status is not None and self.status.state == TaskStatus.RUNNING

    @property
    def ended(self) -> bool:
        """Whether the task is over."""
        going = (TaskStatus.IDLE, TaskStatus.RUNNING)
        return self.status is not None and self.status.state not in going


class Observer:
    """A node of its own in this process; a context manager.

    Parameters
    ----------
    domain : int
        ROS domain.
    pulse : callable, optional
        The first of `pulses`.
    pictures : bool
        Whether to listen to images.
    waiting : callable, optional
        Called with what is waited for, while it is.
    simulated : bool
        Whether places of parts come from a simulator; otherwise from the detector.

    Attributes
    ----------
    record : Record
    domain : int
    node : Node
    pulses : list of callables
        Called about every `POLL_S` while waiting; each may raise to end the wait.
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
        if self.record.states[-1:] != [msg.text]:  # it is said with each image
            self.record.tasks.append(_said(msg))

    def _on_driver(self, msg: DriverStatus) -> None:
        self.record.driver = msg
        self.record.drivers.append(_said(msg))

    def _on_report(self, msg: DiagnosticArray) -> None:
        now, stamp = time.monotonic(), nanoseconds(msg.header.stamp)
        for report in msg_to_reports(msg):
            said = Said(now, stamp, report.message, report.level, values=report.values)
            self.record.said.setdefault(report.node, []).append(said)

    @cached_property
    def client(self) -> PlateClient:
        """The client of the planner's actions."""
        return PlateClient(self.node, self.until)

    def until(self, true: Callable[[], bool], timeout_s: float) -> bool:
        """Listen until the condition holds; False if it does not within the time [s]."""
        end = time.monotonic() + timeout_s
        while not true():
            now = time.monotonic()
            if now > end:
                return False
            if now - self._pulsed_at > POLL_S:
                self._pulsed_at = now
                for pulse in self.pulses:
                    pulse()
            self._executor.spin_once(timeout_sec=POLL_S)
        return True

    def seen(self, names: Iterable[str]) -> list[str]:
        """Return those of the names that are in the graph now."""
        there = self.node.get_node_names()
        return [name for name in names if name in there]

    def await_nodes(self, names: list[str], timeout_s: float) -> list[str]:
        """Wait until all nodes are in the graph, and return their names.

        Raises
        ------
        GraphError
            Names those that did not appear within the time [s].
        """

        def missing() -> list[str]:
            seen = self.seen(names)
            absent = [name for name in names if name not in seen]
            if absent:
                self._waiting(f"waiting for {', '.join(absent)}")
            return absent

        if not self.until(lambda: not missing(), timeout_s):
            raise GraphError(
                f"not seen within {timeout_s:g} s: {', '.join(missing())} (of {', '.join(names)})"
            )
        return self.seen(names)

    def await_camera(self, timeout_s: float) -> None:
        """Wait until somebody publishes images.

        Raises
        ------
        GraphError
            If nobody does within the time [s].
        """
        topics = ("image_raw", "image_raw/compressed")
        if not self.until(lambda: any(map(self.node.count_publishers, topics)), timeout_s):
            raise GraphError(
                f"no camera: nobody publishes /image_raw in ROS domain {self.domain}. Start it "
                f"there (export ROS_DOMAIN_ID={self.domain}), or say in which domain it is: "
                "--domain N"
            )

    def await_answers(self, timeout_s: float, names: Iterable[str] = ()) -> None:
        """Wait until images are answered as far as the solver.

        Parameters
        ----------
        timeout_s : float
            Longest wait [s].
        names : iterable of str
            Nodes: once all have told how they are, `ANSWERED_S` is long enough.

        Raises
        ------
        GraphError
            If that does not happen: what the nodes say.
        """
        names = list(names)
        began, allowed_s = time.monotonic(), timeout_s
        while not self.until(lambda: self.record.answers > 0, LOOK_S):
            waited_s = time.monotonic() - began
            self._waiting(f"waiting for the answer to the first image | {waited_s:.0f} s")
            if names and all(name in self.record.said for name in names):
                allowed_s = min(allowed_s, waited_s + ANSWERED_S)
            if waited_s > allowed_s:
                raise GraphError(
                    f"images are not answered within {allowed_s:.0f} s: {self.blame()} "
                    f"({self.node.count_publishers('plate_cycle')} publishers of plate_cycle seen, "
                    f"{len(self.record.tables)} motor tables)"
                )

    def blame(self) -> str:
        """Say why images are not answered: the first node on their way that says so, or all."""
        newest = {name: said[-1] for name, said in self.record.said.items()}
        for name in ("detector", "planner", "solver"):
            if name in newest and newest[name].level in (Level.ERROR, Level.STALE):
                return f"{name}: {newest[name].text}"
        told = [f"{name}: {said.text}" for name, said in newest.items()]
        return "; ".join(told) or "no node says how it is"

    def activate_driver(self) -> None:
        """Let the driver pass on what the solver answers, as far as the motors may move.

        Raises
        ------
        GraphError
            If it refuses: why.
        """
        for transition in ("configure", "activate"):
            self.change_state("driver", transition)

    def change_state(self, node: str, transition: str) -> None:
        """Have a node make a transition of its lifecycle. One that is made, but whose answer was
        lost, is refused when it is asked for again.

        Raises
        ------
        GraphError
            If it refuses: why.
        """
        request = ChangeState.Request(transition=Transition(label=transition))
        if self.call(ChangeState, f"{node}/change_state", request, AGAIN_S).success:
            return
        now = self.call(GetState, f"{node}/get_state", GetState.Request(), AGAIN_S)
        if now.current_state.label == AFTER.get(transition):
            return
        said, now = self.record.said, time.monotonic()
        self.until(lambda: any(each.at > now for each in said.get(node, ())), FRESH_S)
        told = said[node][-1].text if node in said else "nothing"
        raise GraphError(f"{transition} refused, {node} says: {told}")

    def check_not_stopped(self) -> None:
        """Refuse to begin where somebody has stopped motors or task: that is theirs to undo.

        Raises
        ------
        GraphError
            Says what was stopped.
        """
        driver, task = self.record.driver, self.record.status
        if driver is not None and driver.reason in PERSONS:
            raise GraphError(f"stopped before the task began, driver: {driver.text}")
        if task is not None and (task.state, task.reason) == (TaskStatus.IDLE, TaskStatus.STOPPED):
            raise GraphError("stopped before the task began: somebody called the service stop")

    def enable(self) -> None:
        """Set the motors free, as a person does who has looked at the rig; returns when they are.

        Raises
        ------
        GraphError
            If that is refused, or they are not ready in time.
        """
        record, starting = self.record, (DriverStatus.UNCONFIGURED, DriverStatus.INACTIVE)
        soon = *starting, DriverStatus.BRAKING  # images may be answered before the driver has begun
        self.until(lambda: record.driver is not None and record.driver.state not in soon, READY_S)
        answer = SetBool.Response()

        def enabled() -> bool:
            nonlocal answer
            answer = self.call(SetBool, "enable", SetBool.Request(data=True))
            return answer.success or not answer.message.endswith(CALL_AGAIN)

        self.until(enabled, READY_S)
        if not answer.success:
            raise GraphError(f"enable refused: {answer.message}")
        self.await_ready()

    def await_ready(self) -> None:
        """Wait until the driver says that it is ready.

        Raises
        ------
        GraphError
            If it does not in time: what it says instead.
        """
        end = time.monotonic() + READY_S
        while not self.until(lambda: self.record.ready, LOOK_S):
            said = "nothing" if self.record.driver is None else self.record.driver.text
            if time.monotonic() > end:
                raise GraphError(f"the driver is not ready within {READY_S:g} s, it says: {said}")
            self._waiting(f"waiting for the driver, it says: {said}")

    def start(self, scenario: Scenario, ready_timeout_s: float = ACCEPTED_S) -> Task:
        """Send the goal of a scenario; for a moment it may still be refused.

        Raises
        ------
        GraphError
            If it is refused for longer: why.
        """
        if ready_timeout_s:
            self.await_ready()
        self.record.status = None
        try:
            task = self.client.start(scenario, ready_timeout_s, self._waiting)
        except PlateError as refusal:
            raise GraphError(str(refusal)) from None
        # What was said of the task before may come after the new goal was sent.
        self.until(lambda: task.ended or self.record.running, ACCEPTED_S)
        return task

    def call(self, kind: Any, service: str, request: Any, again_s: float = CALL_S) -> Any:
        """Call a service and return its answer; again after so long without one [s].

        Raises
        ------
        GraphError
            If there is none within `CALL_S`.
        """
        client = self.node.create_client(kind, service)
        try:
            answers: list[Any] = []
            tries = range(round(CALL_S / again_s))
            for _ in tries if self.until(client.service_is_ready, CALL_S) else ():
                future = client.call_async(request)
                future.add_done_callback(lambda done: answers.append(done.result()))
                if self.until(lambda: bool(answers), again_s):
                    return answers[0]
            raise GraphError(f"service {service} did not answer within {CALL_S:g} s")
        finally:
            self.node.destroy_client(client)

    def trigger(self, service: str) -> str:
        """Call a service such as `stop` and return what it says.

        Raises
        ------
        GraphError
            If it refuses.
        """
        answer = self.call(Trigger, service, Trigger.Request(), AGAIN_S)
        if not answer.success:
            raise GraphError(f"{service} refused: {answer.message}")
        return str(answer.message)

    def begin_anew(self, scenario: Scenario) -> None:
        """Put the parts down anew, forget where they were, and start the task.

        The driver must be ready.

        Raises
        ------
        GraphError
            If that is refused.
        """
        for service in ("stop", "simulator/reset", "detector/reset"):
            self.trigger(service)
        self.until(lambda: False, SETTLE_S)  # images of the old parts are on their way
        self.trigger("detector/reset")
        self.record.tasks.clear()
        self.start(scenario)

    def set_parameter(self, node: str, name: str, value: Any) -> None:
        """Set a parameter of a running node.

        Raises
        ------
        GraphError
            If it refuses: why.
        """
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        if not result.successful:
            raise GraphError(str(result.reason))


def _said(msg: DriverStatus | TaskStatus) -> Said:
    return Said(time.monotonic(), nanoseconds(msg.header.stamp), msg.text, state=msg.state)
