"""The sixth process: sees the nodes over DDS, starts the task, and keeps what was heard of it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, MultiDOFJointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_bringup import GraphError
from plate_core.ros import CAMERA, LATCHED, nanoseconds

MOST_IMAGES = 240
"""Images kept for drawing (300 kB each)."""

ALL = QoSProfile(depth=200)
"""We want to hear everything, also when we are slow."""

CALL_S = 10.0
"""Longest wait for a service [s]."""

POLL_S = 0.05

READY_S = 15.0
"""Longest wait until the driver is ready [s]: the device may have to find home first, for 5 s."""

ACCEPTED_S = 5.0
"""Longest wait until a task may be started [s]: the planner hears of the driver and of images when
we do, or a little later."""

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


@dataclass
class Record:
    """Messages of one run, undecoded where decoding would steal time from the nodes.

    Attributes
    ----------
    truth, tables : list of bytes
        All of ground_truth and motor_setpoints.
    answers : int
        Number of plate_cycle messages.
    images : Thinned
        Some of image_raw, as bytes.
    reports : dict of str to list of (stamp in ns, dict)
        Diagnostics by node: keys and values, and the message under "message".
    states : list of str
        Of task_state.
    driver_state : str
        What the driver said last.
    """

    truth: list[bytes] = field(default_factory=list)
    tables: list[bytes] = field(default_factory=list)
    answers: int = 0
    images: Thinned = field(default_factory=Thinned)
    reports: dict[str, list[tuple[int, dict[str, str]]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    states: list[str] = field(default_factory=list)
    driver_state: str = ""

    def last(self, node: str, key: str, default: str = "") -> str:
        """Return the newest value that a node has reported."""
        reports = self.reports.get(node)
        return reports[-1][1].get(key, default) if reports else default

    def numbers(self, node: str, key: str) -> list[float]:
        """Return all numbers that a node has reported under a key."""
        return [float(values[key]) for _, values in self.reports.get(node, []) if key in values]

    @property
    def ended(self) -> bool:
        """Whether the task is over."""
        return bool(self.states) and self.states[-1].split(":")[0] not in ("idle", "running")


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

    Attributes
    ----------
    record : Record
    node : Node
    pulses : list of callables
        Called about every `POLL_S` while waiting; each may raise to end the wait.
    """

    def __init__(
        self, domain: int, pulse: Callable[[], None] = lambda: None, pictures: bool = True
    ) -> None:
        self.record = Record()
        self.pulses = [pulse]
        self._pulsed_at = 0.0
        rclpy.init(
            domain_id=domain,
            args=["--ros-args", "--disable-external-lib-logs"],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("observer")
        self._executor = EventsExecutor()
        self._executor.add_node(self.node)
        record = self.record

        def listen(kind: Any, topic: str, on_message: Any, qos: QoSProfile, raw: bool) -> None:
            self.node.create_subscription(kind, topic, on_message, qos, raw=raw)

        listen(MultiDOFJointState, "ground_truth", record.truth.append, ALL, True)
        listen(JointTrajectory, "motor_setpoints", record.tables.append, ALL, True)
        listen(JointTrajectory, "plate_cycle", self._on_answer, ALL, True)
        if pictures:
            listen(Image, "image_raw", record.images.add, CAMERA, True)
        listen(DiagnosticArray, "diagnostics", self._on_report, ALL, False)
        listen(String, "task_state", lambda msg: record.states.append(msg.data), LATCHED, False)
        listen(String, "driver_state", self._on_driver, LATCHED, False)

    def __enter__(self) -> Observer:
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _on_answer(self, _: bytes) -> None:
        self.record.answers += 1

    def _on_driver(self, msg: String) -> None:
        self.record.driver_state = msg.data

    def _on_report(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            node = status.name.split(":")[0].rsplit("/", 1)[-1]
            values = {item.key: item.value for item in status.values}
            stamp = nanoseconds(msg.header.stamp)
            self.record.reports[node].append((stamp, {"message": status.message, **values}))

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
        if not self.until(lambda: self.seen(names) == names, timeout_s):
            missing = [name for name in names if name not in self.seen(names)]
            raise GraphError(
                f"not seen within {timeout_s:g} s: {', '.join(missing)} (of {', '.join(names)})"
            )
        return self.seen(names)

    def await_answers(self, timeout_s: float) -> None:
        """Wait until images are answered as far as the solver.

        Raises
        ------
        GraphError
            If that does not happen within the time [s].
        """
        if not self.until(lambda: self.record.answers > 0, timeout_s):
            raise GraphError(
                f"no plate_cycle within {timeout_s:g} s: images are not answered "
                f"({self.record.images.count} images seen)"
            )

    def activate_driver(self) -> None:
        """Let the driver pass on what the solver answers, as far as the motors may move.

        Raises
        ------
        GraphError
            If it refuses: its log tells why.
        """
        for step in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=step))
            if not self.call(ChangeState, "driver/change_state", request).success:
                raise GraphError("the driver could not be activated, see its log")

    def enable(self) -> None:
        """Set the motors free, as a person does who has looked at the rig; returns when they are.

        Raises
        ------
        GraphError
            If that is refused, or they are not ready in time.
        """
        self.until(lambda: not self.record.driver_state.startswith("braking"), READY_S)
        answer = self.call(SetBool, "enable", SetBool.Request(data=True))
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
        if not self.until(lambda: self.record.driver_state.startswith("ready"), READY_S):
            said = self.record.driver_state or "nothing"
            raise GraphError(f"the driver is not ready within {READY_S:g} s, it says: {said}")

    def start(self) -> None:
        """Start the task; for a moment it may still be refused.

        Raises
        ------
        GraphError
            If it is refused for longer: why.
        """
        self.await_ready()
        end = time.monotonic() + ACCEPTED_S
        while True:
            try:
                self.trigger("start")
                return
            except GraphError:
                if time.monotonic() > end:
                    raise
            self.until(lambda: False, POLL_S)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service and return its answer.

        Raises
        ------
        GraphError
            If there is none within `CALL_S`.
        """
        client = self.node.create_client(kind, service)
        try:
            answer = None
            if self.until(client.service_is_ready, CALL_S):
                future = client.call_async(request)
                if self.until(future.done, CALL_S):
                    answer = future.result()
            if answer is None:
                raise GraphError(f"service {service} did not answer within {CALL_S:g} s")
            return answer
        finally:
            self.node.destroy_client(client)

    def trigger(self, service: str) -> str:
        """Call `start` or `stop` and return what it says.

        Raises
        ------
        GraphError
            If it refuses.
        """
        answer = self.call(Trigger, service, Trigger.Request())
        if not answer.success:
            raise GraphError(f"{service} refused: {answer.message}")
        return str(answer.message)

    def begin_anew(self) -> None:
        """Put the parts down anew, forget where they were, and start the task again.

        The driver must be ready.

        Raises
        ------
        GraphError
            If that is refused.
        """
        self.record.states.clear()
        for service in ("stop", "simulator/reset", "detector/reset"):
            self.trigger(service)
        self.until(lambda: False, SETTLE_S)  # images of the old parts are on their way
        self.trigger("detector/reset")
        self.record.states.clear()
        self.start()

    def set_parameter(self, node: str, name: str, value: Any) -> tuple[bool, str]:
        """Set a parameter of a running node; returns whether it took it, and why not."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        return bool(result.successful), str(result.reason)
