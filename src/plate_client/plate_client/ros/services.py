"""Calls of the running nodes' services, with no more imports than a stop needs."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from plate_core import PlateError, choose_network, ros_domain

from ..messages import spin_until

NOBODY_S, FOUND_S, ANSWER_S, READY_S = 1.0, 3.0, 15.0, 15.0
"""Longest waits: for any node to be seen, for a service to be found, for its answer, and for motors
that are being enabled [s]."""

URGENT = ("emergency_stop", "cut_power", "disable")
"""These are tried for longer, also where nobody is seen."""

ONCE, AGAIN_S = ("home", "calibrate", "call"), 0.5
"""Commands of which each call counts, as of enable; all others are called again after so long
without an answer [s]: DDS may lose the first one of a service that was just found."""

SERVICE = re.compile(r"/?([A-Za-z_]\w*/)*[A-Za-z_]\w*", re.ASCII)
"""Names of services."""

CALLS = QoSProfile(depth=1000)
"""As in plate_core.ros, which takes too long to import."""

NAME = "plate_command"

DDS_PORT, PORTS_PER_DOMAIN, DOMAINS = 7400, 250, range(102)
"""UDP ports of a ROS domain (DDSI-RTPS 9.6.1.1), and the domains whose ports are nobody else's."""


def start_ros(namespace: str) -> None:
    """Start ROS, for nodes of a namespace.

    Raises
    ------
    PlateError
        If the environment names no ROS domain, or the namespace is none.
    """
    choose_network(os.environ)
    ros_domain(os.environ)
    if not re.fullmatch(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?", namespace, re.ASCII):
        raise PlateError(
            f"namespace is {namespace!r}, allowed: words of letters, digits and _, with / "
            "between them"
        )
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)


def end_ros(services: Services | None) -> None:
    """End ROS, and the node that was made for it, if it was."""
    if services is not None:
        services.node.destroy_node()
    rclpy.try_shutdown()


class Services:
    """The services of the running nodes, as seen by a node of our own.

    Parameters
    ----------
    namespace : str
        Of the nodes.
    """

    def __init__(self, namespace: str) -> None:
        self.node = Node(
            NAME, namespace=namespace, start_parameter_services=False, enable_rosout=False
        )

    def run(self, args: argparse.Namespace) -> str:
        """Do what is asked, and return what there is to tell.

        Raises
        ------
        PlateError
            If it was not done.
        """
        service, urgent = args.command, args.command in URGENT
        if service == "call":
            service = args.service
            if not SERVICE.fullmatch(service):
                raise PlateError(
                    f"service is {service!r}, allowed: words of letters, digits and _, with / "
                    "between them"
                )
        if service == "enable":
            return self._enable()
        if service == "disable":
            answer = self._call(SetBool, "enable", SetBool.Request(data=False), urgent)
        else:
            once = args.command in ONCE
            answer = self._call(Trigger, service, Trigger.Request(), urgent, once)
        if not answer.success:
            raise PlateError(str(answer.message))
        return str(answer.message)

    def _enable(self) -> str:
        """Enable the motors, and wait until they are ready: that may take longer than the answer.

        Raises
        ------
        PlateError
            If they are not: why.
        """
        from plate_core.ros import LATCHED
        from plate_interfaces.msg import DriverStatus

        said: list[DriverStatus] = []
        enabling, ready = DriverStatus.ENABLING, DriverStatus.READY

        def over() -> bool:
            states = [msg.state for msg in said]
            return bool(states) and (
                states[-1] == ready or (enabling in states and states[-1] != enabling)
            )

        heard = self.node.create_subscription(DriverStatus, "driver_status", said.append, LATCHED)
        try:
            answer = self._call(SetBool, "enable", SetBool.Request(data=True), once=True)
            if not answer.success:
                raise PlateError(str(answer.message))
            if not answer.message.startswith("enabling"):
                return str(answer.message)
            self._until(over, READY_S)
        finally:
            self.node.destroy_subscription(heard)
        if not said or said[-1].state != ready:
            raise PlateError(f"not enabled, driver_status: {said[-1].text if said else 'nothing'}")
        return str(said[-1].text)

    def _call(
        self, kind: Any, service: str, request: Any, urgent: bool = False, once: bool = False
    ) -> Any:
        client = self.node.create_client(kind, service, qos_profile=CALLS)

        def there() -> bool:  # a service may be known before the name of its node is
            return urgent or client.service_is_ready() or bool(self._seen())

        cut = ": cut the power by hand" if urgent else ""
        if not (self._until(there, NOBODY_S) and self._until(client.service_is_ready, FOUND_S)):
            raise PlateError(self._missing(service) + cut)
        again_s = ANSWER_S if once else AGAIN_S
        answers: list[Any] = []
        for _ in range(round(ANSWER_S / again_s)):
            client.call_async(request).add_done_callback(lambda done: answers.append(done.result()))
            if self._until(lambda: bool(answers), again_s):
                self.node.destroy_client(client)
                return answers[0]
        raise PlateError(f"{service} does not answer{cut}")

    def _missing(self, service: str) -> str:
        """Say why there is no such service."""
        here = self._seen()
        return f"no service {service}: {'nodes here: ' + ', '.join(here) if here else nobody()}"

    def _find_nodes(self) -> None:
        """Wait until a node of our namespace is seen.

        Raises
        ------
        PlateError
            If none is.
        """
        if not self._until(lambda: bool(self._seen()), NOBODY_S):
            raise PlateError(nobody())

    def _seen(self) -> list[str]:
        """Return the names of the nodes of our namespace."""
        ours = self.node.get_namespace()
        found = self.node.get_node_names_and_namespaces()
        return sorted(  # names with _ are hidden: tools, such as the daemon of the ros2 command
            name
            for name, where in found
            if name != NAME and where == ours and not name.startswith("_")
        )

    def _until(self, true: Callable[[], bool], timeout_s: float) -> bool:
        return spin_until(
            lambda wait_s: rclpy.spin_once(self.node, timeout_sec=wait_s), true, timeout_s
        )


def nobody() -> str:
    """Say that no graph is there, and in which domains of this machine there may be one."""
    ours = ros_domain(os.environ)
    others = sorted(domains_in_use() - {ours})
    text = f"no graph runs in ROS domain {ours}"
    if others:
        listed = ", ".join(map(str, others))
        text += f"; ROS runs on this machine in {listed}: export ROS_DOMAIN_ID="
        text += listed if len(others) == 1 else "that of yours"  # one may be another's plate
    return text


def domains_in_use() -> set[int]:
    """Return the ROS domains of this machine's processes, as their UDP ports tell."""
    found = set()
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        path = Path(table)
        for line in path.read_text("ascii").splitlines()[1:] if path.exists() else ():
            port = int(line.split()[1].rsplit(":", 1)[1], 16)
            domain, offset = divmod(port - DDS_PORT, PORTS_PER_DOMAIN)
            if domain in DOMAINS and offset >= 10:  # below: multicast
                found.add(domain)
    return found
