"""Subscriber that passes ROS messages to the browsers. The subscriptions exist only while a browser
is connected."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateError, Rig
from plate_core.ros import (
    CAMERA,
    DATA,
    LATCHED,
    WARN_S,
    image_to_array,
    msg_to_cycle,
    msg_to_parts,
    msg_to_reports,
    msg_to_request,
    nanoseconds,
    seconds,
)
from plate_interfaces.msg import Aim, DriverStatus, Friction, PartForces, Parts, Targets, TaskStatus

from ..scene import (
    Scene,
    camera_scene,
    cycle_scene,
    motors_scene,
    nodes_scene,
    parts_scene,
    request_scene,
)
from ..server import PageServer
from ..top_view import TopView
from .aim import aim_scene
from .values import finite_or_none, state_names

SAME_CLOCK_S = 10.0
"""Maximum difference between a stamp and the clock of this node [s]. If a difference exceeds this
maximum, the stamp is from another clock."""

LATENCIES = 200
"""Number of setpoint messages from which the latency is computed."""

CAMERA_S = 0.1
"""Minimum time between two pictures in the view for aiming the camera [s]."""


TASK_STATES = state_names(TaskStatus, "IDLE", "RUNNING", "DONE", "STUCK", "LOST", "ABORTED")
DRIVER_STATES = state_names(
    DriverStatus, "UNCONFIGURED", "INACTIVE", "DISABLED", "ENABLING", "READY", "CALIBRATING",
    "BRAKING", "STOPPED", "ERROR",
)  # fmt: skip
FRICTION_STATES = state_names(Friction, "NONE", "RUNNING", "DONE", "FAILED")
SEVERITIES = {20: "info", 30: "warn", 40: "error", 50: "error"}
"""Names of the severities of rcl_interfaces/Log. Messages with other severities are not shown."""

ROSOUT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Listener:
    """Subscribes to topics while a browser is connected, and passes the messages to all browsers.

    Parameters
    ----------
    node : Node
    rig : Rig
    view : TopView
    server : PageServer
    namespace : str
        Namespace of the plate, as `Node.get_namespace` returns it.

    Attributes
    ----------
    task : TaskStatus
        Newest task status.
    parts : Parts
        Parts in the newest image.
    on_task : callable
        Function that is called after each task status.
    """

    def __init__(
        self, node: Node, rig: Rig, view: TopView, server: PageServer, namespace: str
    ) -> None:
        self._namespace = namespace
        self._node = node
        self._rig = rig
        self._view = view
        self._server = server
        self.task, self.parts = TaskStatus(), Parts()
        self.on_task: Callable[[], None] = lambda: None
        self._listening: dict[str, Any] = {}
        self._newest: dict[str, Any] = {}
        self._reports: dict[str, tuple[float, Any]] = {}
        self._latencies: list[float] = []
        self._setpoints, self._counted = 0, time.monotonic()
        self._camera_at = -math.inf

    def adapt(self) -> None:
        """Subscribe to the topics that browsers need. Without browsers, there are no
        subscriptions."""
        some = bool(self._server.browsers)
        for name, topic in TOPICS.items():
            needed = some and (
                not topic.watched or any(map(self._server.is_displayed, topic.watched))
            )
            if needed and name not in self._listening:
                self._listening[name] = self._node.create_subscription(
                    topic.kind, name, partial(self.receive, name), topic.qos
                )
            elif not needed:
                self._unsubscribe(name)

    def close(self) -> None:
        """Destroy all subscriptions."""
        for topic in TOPICS:
            self._unsubscribe(topic)

    def _unsubscribe(self, topic: str) -> None:
        if topic in self._listening:
            self._node.destroy_subscription(self._listening.pop(topic))
            self._newest.pop(topic, None)

    def receive(self, topic: str, msg: Any) -> None:
        """Process a message of one of `TOPICS`."""
        if TOPICS[topic].at_once:
            TOPICS[topic].take(self, msg)
        else:
            self._newest[topic] = msg

    # Messages that are sent to the browsers immediately

    def _on_setpoints(self, msg: JointTrajectory) -> None:
        self._setpoints += 1
        took = 1e-9 * (self._node.get_clock().now().nanoseconds - nanoseconds(msg.header.stamp))
        if abs(took) < SAME_CLOCK_S:
            self._latencies = [*self._latencies[1 - LATENCIES :], took]

    def _on_task(self, msg: TaskStatus) -> None:
        self.task = msg
        progress = msg.progress
        self._publish(
            {
                "kind": "task", "task": msg.task, "state": TASK_STATES.get(msg.state, "idle"),
                "reason": int(msg.reason), "text": msg.text,
                "progress": {
                    name: finite_or_none(getattr(progress, name))
                    for name in progress.get_fields_and_field_types()
                },
            }
        )  # fmt: skip
        self.on_task()

    def _on_driver(self, msg: DriverStatus) -> None:
        self._publish(
            {
                "kind": "driver", "state": DRIVER_STATES.get(msg.state, "error"),
                "reason": int(msg.reason), "text": msg.text,
            }
        )  # fmt: skip

    def _on_friction(self, msg: Friction) -> None:
        self._publish(
            {
                "kind": "friction", "state": FRICTION_STATES.get(msg.state, "failed"),
                "text": msg.text, "fraction": finite_or_none(msg.fraction),
                "mu": finite_or_none(msg.mu),
                "parts": [
                    {
                        "id": part.id, "mu": finite_or_none(part.mu),
                        "error": finite_or_none(part.mu_error),
                    }
                    for part in msg.parts
                ],
            }
        )  # fmt: skip

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in msg_to_reports(msg, self._namespace):
            self._reports[report.node] = time.monotonic(), report

    def _on_log(self, msg: Log) -> None:
        if msg.level in SEVERITIES:
            line = {
                "time": seconds(msg.stamp), "level": SEVERITIES[msg.level], "from": msg.name,
                "text": msg.msg,
            }  # fmt: skip
            self._publish({"kind": "log", "lines": [line]}, keep=False)

    # Messages that are sent at the rate at which browsers can draw

    def tick(self) -> None:
        """Send the browsers all messages that have arrived since the last call."""
        newest, self._newest = self._newest, {}
        for topic, msg in newest.items():
            try:
                TOPICS[topic].take(self, msg)
            # a ValueError is raised if a value is NaN, because JSON has no NaN
            except (PlateError, ValueError) as error:
                warn = self._node.get_logger().warning
                warn(f"{topic}: {error}", throttle_duration_sec=WARN_S)

    def _show_parts(self, msg: Parts) -> None:
        self.parts = msg
        spread = np.array([part.covariance[[0, 4, 8]] for part in msg.parts]).reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            spread = np.sqrt(np.where(spread[:, :1] < 0, np.nan, spread))
        seen = [part.source != part.PROPAGATED for part in msg.parts]
        stamp = seconds(msg.header.stamp)
        self._publish(parts_scene(self._rig, stamp, msg_to_parts(msg), spread, seen))

    def _show_truth(self, msg: Parts) -> None:
        parts = [
            {"id": part.id, "type": part.type, "x": part.x, "y": part.y, "angle": part.angle}
            for part in msg.parts
        ]
        self._publish({"kind": "truth", "parts": parts})

    def _show_request(self, msg: PartForces) -> None:
        self._publish(request_scene(self._rig, seconds(msg.header.stamp), msg_to_request(msg)))

    def _show_targets(self, msg: Targets) -> None:
        targets = [
            {
                "id": target.id,
                "x": finite_or_none(target.x),
                "y": finite_or_none(target.y),
                "angle": finite_or_none(target.angle),
            }
            for target in msg.targets
        ]
        self._publish({"kind": "targets", "targets": targets})

    def _show_cycle(self, msg: JointTrajectory) -> None:
        cycle, field = msg_to_cycle(msg), self._server.is_displayed("field")
        self._publish(cycle_scene(self._rig, seconds(msg.header.stamp), cycle, field))
        self._publish(motors_scene(self._rig, cycle))

    def _show_image(self, msg: Image) -> None:
        if not any(map(self._server.is_displayed, TOPICS["image_raw"].watched)):
            return  # ignore images that no browser shows; a replay also delivers such images
        image, stamp = image_to_array(msg), seconds(msg.header.stamp)
        image = image[..., ::-1] if msg.encoding == "rgb8" else image
        now = time.monotonic()
        if self._server.is_displayed("camera") and now - self._camera_at >= CAMERA_S:
            self._camera_at = now
            self._publish(camera_scene(stamp, image), keep=False)
        if self._server.is_displayed("image"):
            picture = np.float64(stamp).tobytes() + self._view.jpeg(image)
            self._server.publish("image", picture, keep=False)

    def _show_aim(self, msg: Aim) -> None:
        self._publish(aim_scene(msg), keep=False)

    def tick_slowly(self) -> None:
        """Send the states of the nodes, the latency of the setpoints, the rate of cycles and the
        number of browsers to the browsers."""
        if not self._server.browsers:
            return
        now = time.monotonic()
        self._publish(
            nodes_scene(
                {
                    name: (now - arrival, report.level.name, report.message, report.values)
                    for name, (arrival, report) in self._reports.items()
                }
            )
        )
        latency_ms = 1e3 * np.array(self._latencies or [np.nan])
        elapsed, self._counted = now - self._counted, now
        rate, self._setpoints = self._setpoints / max(elapsed, 1e-3), 0
        self._publish(
            {
                "kind": "timing",
                "latency_ms": {
                    "median": finite_or_none(float(np.median(latency_ms))),
                    "p99": finite_or_none(float(np.percentile(latency_ms, 99))),
                },
                "cycle_rate": round(rate, 1),
                "browsers": len(self._server.browsers),
            }
        )

    def _publish(self, scene: Scene, keep: bool = True) -> None:
        self._server.publish(scene["kind"], scene, keep)


class Topic(NamedTuple):
    """A topic, and the function that handles its messages.

    If `at_once`, each message is handled on arrival. Otherwise only the newest message is handled,
    at the rate at which browsers can draw. If `watched` is not empty, it contains kinds of data.
    The page then subscribes to the topic only while a browser displays one of these kinds.
    """

    kind: type
    qos: QoSProfile
    take: Callable[[Listener, Any], None]
    at_once: bool = False
    watched: tuple[str, ...] = ()


TOPICS: Mapping[str, Topic] = {
    "parts": Topic(Parts, DATA, Listener._show_parts),
    "ground_truth": Topic(Parts, DATA, Listener._show_truth),
    "part_forces": Topic(PartForces, DATA, Listener._show_request),
    "part_targets": Topic(Targets, LATCHED, Listener._show_targets),
    "cycle_started": Topic(JointTrajectory, DATA, Listener._show_cycle),
    "motor_setpoints": Topic(JointTrajectory, DATA, Listener._on_setpoints, at_once=True),
    "task_status": Topic(TaskStatus, LATCHED, Listener._on_task, at_once=True),
    "driver_status": Topic(DriverStatus, LATCHED, Listener._on_driver, at_once=True),
    "friction": Topic(Friction, LATCHED, Listener._on_friction, at_once=True),
    "diagnostics": Topic(DiagnosticArray, DATA, Listener._on_diagnostics, at_once=True),
    "/rosout": Topic(Log, ROSOUT, Listener._on_log, at_once=True),
    "image_raw": Topic(Image, CAMERA, Listener._show_image, watched=("image", "camera")),
    "aim": Topic(Aim, DATA, Listener._show_aim, watched=("camera",)),
}
"""Topics by name."""
