"""One node of a graph that only forwards: python -m graph.forward NODE FOLDER

The same topics, types, sizes and qualities of service as the real graph's, in a namespace of its
own, without anything being computed: what the middleware and Python alone take. The camera sends
its image half a cycle after the real one, so that the two graphs take turns.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import CAMERA, DATA, IMAGE, nanoseconds, run_node

from .hops import CHAIN

NAMESPACE = "beside"
NODES = ("simulator", "detector", "planner", "solver", "driver")
"""In the order of `CHAIN`: each publishes the topic of its number."""

SHORTEST_NS, LONGEST_NS = 10_000_000, 500_000_000
"""Bounds of half a cycle [ns]."""


class Forwarder(Node):
    """Publishes the same message whenever one of the topic before comes."""

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
        if NODES[number] == "planner":  # it hears what is sent to the plate, too
            self.create_subscription(JointTrajectory, "plate_cycle", lambda _: None, DATA)

    def _on_real(self, msg: CameraInfo) -> None:
        stamp_ns = nanoseconds(msg.header.stamp)
        half_ns = (stamp_ns - self._last_ns) // 2
        self._last_ns = stamp_ns
        self._timer.timer_period_ns = min(max(half_ns, SHORTEST_NS), LONGEST_NS)
        self._timer.reset()

    def _shoot(self) -> None:
        self._timer.cancel()
        self._message.header.stamp = self.get_clock().now().to_msg()
        self._out.publish(self._message)

    def _on_message(self, msg: Any) -> None:
        self._message.header.stamp = msg.header.stamp
        self._out.publish(self._message)


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the command line of each forwarder, name first."""
    start = [sys.executable, "-m", "graph.forward"]
    return {f"{NAMESPACE}_{name}": [*start, name, str(folder)] for name in NODES}


def environment() -> dict[str, str]:
    """Return the variables that a forwarder needs."""
    tools = str(Path(__file__).resolve().parents[1])
    return {"PYTHONPATH": os.pathsep.join([tools, os.environ.get("PYTHONPATH", "")])}


def main() -> None:
    """Run the forwarder that is named."""
    number, folder = NODES.index(sys.argv[1]), Path(sys.argv[2])
    make: Callable[[], Node] = lambda: Forwarder(number, folder)  # noqa: E731
    run_node(make, args=["--ros-args", "--disable-external-lib-logs"])


if __name__ == "__main__":
    main()
