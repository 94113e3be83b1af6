#!/usr/bin/env python3
"""Nodes that only forward messages: the gate, and a graph that computes nothing.

python tools/graph/relays.py gate TRANSPORT
    Forwards the main input of each node, except of the node that its parameter `cut` names. For
    this node the effect is that of a cut cable, a wrong remapping or a crashed filter: all
    processes run, but no message arrives.

python tools/graph/relays.py NODE FOLDER
    One node of a graph with the same topics, types, message sizes and qualities of service as the
    real one, in the namespace `beside`. This graph shows the time that the middleware and Python
    take. Its camera publishes an image half a cycle after the real one, so that the two graphs
    alternate. The serialised messages are files in FOLDER.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import CAMERA, DATA, IMAGE, nanoseconds, run_node
from plate_interfaces.msg import PartForces, Parts

CHAIN: tuple[tuple[str, Any], ...] = (
    ("image_raw", Image),
    ("parts", Parts),
    ("part_forces", PartForces),
    ("plate_cycle", JointTrajectory),
    ("motor_setpoints", JointTrajectory),
)
"""Topics from the image to the motor setpoints, with their types."""

NODES = ("simulator", "detector", "planner", "solver", "driver")
"""Nodes that publish the topics of `CHAIN`, in the same order."""

GATE, NAMESPACE = "gate", "beside"

MIN_NS, MAX_NS = 10_000_000, 500_000_000
"""Bounds of half a cycle [ns]."""


def inputs(transport: str) -> dict[str, tuple[str, Any]]:
    """Return topic and type of the main input of each node."""
    found = dict(zip((*NODES[1:], NODES[0]), CHAIN, strict=True))
    if transport == "serial":  # the device moves the plate, and publishes its motion
        found["simulator"] = ("motor_motion", JointTrajectory)
    return found


def remaps(transport: str) -> dict[str, tuple[str, str]]:
    """Return the remapping of each node's main input to the gate's output."""
    return {node: (topic, f"{GATE}/{topic}") for node, (topic, _) in inputs(transport).items()}


def command(*words: str) -> list[str]:
    """Return the command line of the gate, or of a node that forwards."""
    return [__file__, *words]


class Gate(Node):
    """Node `gate`. Its parameter `cut` names the node whose input is blocked. If the parameter is
    empty, all inputs are forwarded."""

    def __init__(self, transport: str) -> None:
        super().__init__(GATE)
        self.declare_parameter("cut", "")
        for node, (topic, kind) in inputs(transport).items():
            qos = IMAGE if kind is Image else DATA
            publisher = self.create_publisher(kind, f"{GATE}/{topic}", qos)
            through = self._through(node, publisher.publish)
            self.create_subscription(kind, topic, through, qos, raw=True)

    def _through(self, node: str, publish: Callable[[bytes], None]) -> Callable[[bytes], None]:
        def on_message(data: bytes) -> None:
            if self.get_parameter("cut").value != node:
                publish(data)

        return on_message


class Forwarder(Node):
    """Publishes the same message whenever a message of the preceding topic arrives. The first one
    follows the real camera."""

    def __init__(self, number: int, folder: Path) -> None:
        super().__init__(NODES[number], namespace=NAMESPACE)
        topic, kind = CHAIN[number]
        self._message = deserialize_message((folder / topic).read_bytes(), kind)
        self._out = self.create_publisher(kind, topic, DATA if number else IMAGE)
        if number == 0:
            self._last_ns = 0
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self.create_timer(1.0, self._shoot, clock=steady)
            self._timer.cancel()
            self.create_subscription(CameraInfo, "/camera_info", self._on_real, CAMERA)
        else:
            topic, kind = CHAIN[number - 1]
            self.create_subscription(kind, topic, self._on_message, DATA if number > 1 else CAMERA)
        if NODES[number] == "planner":  # the real planner also subscribes to plate_cycle
            self.create_subscription(JointTrajectory, "plate_cycle", lambda _: None, DATA)

    def _on_real(self, msg: CameraInfo) -> None:
        stamp_ns = nanoseconds(msg.header.stamp)
        half_ns = (stamp_ns - self._last_ns) // 2
        self._last_ns = stamp_ns
        self._timer.timer_period_ns = min(max(half_ns, MIN_NS), MAX_NS)
        self._timer.reset()

    def _shoot(self) -> None:
        self._timer.cancel()
        self._message.header.stamp = self.get_clock().now().to_msg()
        self._out.publish(self._message)

    def _on_message(self, msg: Any) -> None:
        self._message.header.stamp = msg.header.stamp
        self._out.publish(self._message)


if __name__ == "__main__":
    name, given = sys.argv[1:]
    make: Callable[[], Node] = partial(Gate, given)
    if name != GATE:
        make = partial(Forwarder, NODES.index(name), Path(given))
    run_node(make, args=["--ros-args", "--disable-external-lib-logs"])
