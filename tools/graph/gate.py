#!/usr/bin/env python3
"""The gate is a node that forwards the main input of each other node. Usage: python
tools/graph/gate.py TRANSPORT

The parameter `cut` of the gate is the name of a node whose input the gate does not forward. All
processes run, but no message arrives at this node. A cut cable, a wrong remapping or a crashed
filter has the same effect.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import DATA, IMAGE, run_node
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

GATE = "gate"


def main_inputs(transport: str) -> dict[str, tuple[str, Any]]:
    """Return the topic and the message type of each node's main input."""
    found = dict(zip((*NODES[1:], NODES[0]), CHAIN, strict=True))
    # with a serial device, the simulator's main input is the motion that the device publishes
    if transport == "serial":
        found["simulator"] = ("motor_motion", JointTrajectory)
    return found


def gate_remappings(transport: str) -> dict[str, tuple[str, str]]:
    """Return the remapping of each node's main input to the gate's output."""
    return {node: (topic, f"{GATE}/{topic}") for node, (topic, _) in main_inputs(transport).items()}


def gate_command(transport: str) -> list[str]:
    """Return the command line of the gate."""
    return [__file__, transport]


class Gate(Node):
    """Node `gate`. The parameter `cut` of this node is the name of the node whose input is blocked.
    If the parameter is empty, all inputs are forwarded."""

    def __init__(self, transport: str) -> None:
        super().__init__(GATE)
        self.declare_parameter("cut", "")
        for node, (topic, kind) in main_inputs(transport).items():
            qos = IMAGE if kind is Image else DATA
            publisher = self.create_publisher(kind, f"{GATE}/{topic}", qos)
            through = self._make_forwarder(node, publisher.publish)
            self.create_subscription(kind, topic, through, qos, raw=True)

    def _make_forwarder(
        self, node: str, publish: Callable[[bytes], None]
    ) -> Callable[[bytes], None]:
        def on_message(data: bytes) -> None:
            if self.get_parameter("cut").value != node:
                publish(data)

        return on_message


if __name__ == "__main__":
    run_node(partial(Gate, sys.argv[1]), args=["--ros-args", "--disable-external-lib-logs"])
