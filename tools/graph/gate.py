"""A process between nodes: hands the main input of each node on to it, until a command cuts one.

What a cut cable, a wrong remapping or a filter that has died look like to the node behind it: its
process runs, those before it run, and nothing comes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import DATA, IMAGE, run_node
from plate_interfaces.msg import PartForces, Parts

NAME = "gate"

INPUTS: Mapping[str, tuple[Any, str, QoSProfile]] = {
    "simulator": (JointTrajectory, "motor_setpoints", DATA),
    "detector": (Image, "image_raw", IMAGE),
    "planner": (Parts, "parts", DATA),
    "solver": (PartForces, "part_forces", DATA),
    "driver": (JointTrajectory, "plate_cycle", DATA),
}
"""By node: type, topic and quality of service of its main input."""

DRIVEN = (JointTrajectory, "motor_motion", DATA)
"""The simulator's input where a device moves the plate."""


def inputs(transport: str) -> dict[str, tuple[Any, str, QoSProfile]]:
    """Return the main input of each node."""
    return {**INPUTS, "simulator": DRIVEN} if transport == "serial" else dict(INPUTS)


def behind(topic: str) -> str:
    """Return the name that a topic has behind the gate."""
    return f"{NAME}/{topic}"


def remaps(transport: str) -> dict[str, tuple[str, str]]:
    """Return what puts each node behind the gate."""
    return {node: (topic, behind(topic)) for node, (_, topic, _) in inputs(transport).items()}


def command(transport: str) -> list[str]:
    """Return the command line of the gate."""
    return [sys.executable, str(Path(__file__)), transport]


class Gate(Node):
    """Node `gate`: its parameter `cut` names the node that gets nothing; empty: all get theirs."""

    def __init__(self) -> None:
        super().__init__(NAME)
        self._cut = self.declare_parameter("cut", "").value
        for node, (kind, topic, qos) in inputs(sys.argv[1]).items():
            publisher = self.create_publisher(kind, behind(topic), qos)
            self.create_subscription(
                kind, topic, self._through(node, publisher.publish), qos, raw=True
            )
        self.add_on_set_parameters_callback(self._on_set)

    def _through(self, node: str, publish: Callable[[bytes], None]) -> Callable[[bytes], None]:
        def on_message(data: bytes) -> None:
            if self._cut != node:
                publish(data)

        return on_message

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        for item in parameters:
            if item.name == "cut":
                self._cut = item.value
        return SetParametersResult(successful=True)


if __name__ == "__main__":
    run_node(Gate)
