"""Stops, enable, start and state from the command line, also where there is no `ros2`."""

from __future__ import annotations

import argparse
import sys
import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from .qos import LATCHED

SERVICES = {
    "emergency_stop": "brake, then current off (stop category 1)",
    "cut_power": "current off at once (stop category 0)",
    "enable": "clear the present stop: the motors get current, and the plate goes home",
    "disable": "brake, then current off, without an emergency",
    "home": "forget where home is: the next enable finds it",
    "start": "start the planner's task",
    "stop": "end the planner's task",
    "state": "print driver_state and task_state",
}
FOUND_S, ANSWER_S = 3.0, 15.0
"""Longest waits: for the service to be found, and for its answer [s]."""


def main() -> None:
    """Run the command line; exit code 0 if it was done, 1 if not."""
    lines = "\n".join(f"  {name:15}{what}" for name, what in SERVICES.items())
    parser = argparse.ArgumentParser(
        prog="plate", description=f"Call a service of the plate:\n{lines}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("service", choices=SERVICES, metavar="SERVICE")
    parser.add_argument("--namespace", default="", help="of the nodes")
    args = parser.parse_args()
    rclpy.init()
    node = Node("plate_command", namespace=args.namespace)
    try:
        done, text = _state(node) if args.service == "state" else _call(node, args.service)
    finally:
        node.destroy_node()
        rclpy.shutdown()
    print(text)
    sys.exit(0 if done else 1)


def _call(node: Node, name: str) -> tuple[bool, str]:
    switch = name in ("enable", "disable")
    service = "enable" if switch else name
    client = node.create_client(SetBool if switch else Trigger, service)
    if not client.wait_for_service(FOUND_S):
        return False, f"no service {service}: does the node run, in this ROS_DOMAIN_ID?"
    request = SetBool.Request(data=name == "enable") if switch else Trigger.Request()
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=ANSWER_S)
    answer = future.result() if future.done() else None
    if answer is None:
        return False, f"{service} does not answer: cut the power by hand"
    return bool(answer.success), str(answer.message)


def _state(node: Node) -> tuple[bool, str]:
    said: dict[str, str] = {}

    def hear(topic: str) -> None:
        def on_message(msg: String) -> None:
            said[topic] = msg.data

        node.create_subscription(String, topic, on_message, LATCHED)

    hear("driver_state")
    hear("task_state")
    end = time.monotonic() + FOUND_S
    while len(said) < 2 and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    lines = [f"{t}: {said.get(t, 'nothing heard')}" for t in ("driver_state", "task_state")]
    return "driver_state" in said, "\n".join(lines)
