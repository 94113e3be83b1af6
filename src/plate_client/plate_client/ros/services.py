"""Functions that call the services of running nodes. This file imports only the modules that a stop
needs."""

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

from plate_core import PlateError, choose_network, node_namespace, ros_domain

from ..messages import spin_until

DISCOVERY_S = 1.0
"""Maximum time for the discovery of any node [s]."""

SERVICE_TIMEOUT_S = 3.0
"""Maximum time for the discovery of a service [s]."""

ANSWER_S = 15.0
"""Maximum time for the reply of a service [s]."""

READY_S = 15.0
"""Maximum time until enabled motors are ready [s]."""

URGENT = ("emergency_stop", "cut_power", "disable")
"""Commands that wait for the service even if no node has been discovered yet."""

ONCE = ("home", "calibrate", "call")
"""Commands that must not be repeated. The command `enable` must not be repeated either."""

AGAIN_S = 0.5
"""Time without a reply after which a command is repeated [s], if it is allowed to be repeated (see
`ONCE`). DDS may lose the first reply of a service that was just discovered."""

SERVICE = re.compile(r"/?([A-Za-z_]\w*/)*[A-Za-z_]\w*", re.ASCII)
"""Valid names of services."""

CALLS = QoSProfile(depth=1000)
"""QoS profile of service calls, equal to `CALLS` in plate_core.ros. The profile is repeated here
because the import of plate_core.ros takes too long."""

NAME = "plate_command"

DDS_PORT = 7400
"""First UDP port of ROS domain 0 (DDSI-RTPS 9.6.1.1)."""

PORTS_PER_DOMAIN = 250
"""Number of UDP ports of a ROS domain."""

DOMAINS = range(102)
"""ROS domains whose UDP ports are below the range of ephemeral ports."""


def start_ros(namespace: str) -> None:
    """Initialise ROS for nodes of a namespace.

    Raises
    ------
    PlateError
        If ROS_DOMAIN_ID or the namespace is not valid.
    """
    choose_network(os.environ)
    ros_domain(os.environ)
    node_namespace(namespace)
    # A stop must also be sent if no log file can be written, for example on a full disk.
    args = ["--ros-args", "--disable-external-lib-logs"]
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def end_ros(services: Services | None) -> None:
    """Shut down ROS. Destroy the node if there is one."""
    if services is not None:
        services.node.destroy_node()
    rclpy.try_shutdown()


class Services:
    """Access to the services of the running nodes through a separate node.

    Parameters
    ----------
    namespace : str
        Namespace of the nodes.
    """

    def __init__(self, namespace: str) -> None:
        own_namespace = node_namespace(namespace)
        self.node = Node(
            NAME, namespace=own_namespace, start_parameter_services=False, enable_rosout=False
        )

    def run(self, args: argparse.Namespace) -> str:
        """Execute a command, and return its output.

        Raises
        ------
        PlateError
            If the command failed.
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
        """Enable the motors, and wait until they are ready. The motors may become ready only after
        the service has replied.

        Raises
        ------
        PlateError
            If the motors do not become ready. The message contains the reason.
        """
        from plate_core.ros import LATCHED
        from plate_interfaces.msg import DriverStatus

        statuses: list[DriverStatus] = []
        enabling, ready = DriverStatus.ENABLING, DriverStatus.READY

        def over() -> bool:
            states = [msg.state for msg in statuses]
            return bool(states) and (
                states[-1] == ready or (enabling in states and states[-1] != enabling)
            )

        subscription = self.node.create_subscription(
            DriverStatus, "driver_status", statuses.append, LATCHED
        )
        try:
            answer = self._call(SetBool, "enable", SetBool.Request(data=True), once=True)
            if not answer.success:
                raise PlateError(str(answer.message))
            if not answer.message.startswith("enabling"):
                return str(answer.message)
            self._until(over, READY_S)
        finally:
            self.node.destroy_subscription(subscription)
        if not statuses or statuses[-1].state != ready:
            raise PlateError(
                "the motors are not enabled; driver_status: "
                f"{statuses[-1].text if statuses else 'no message'}"
            )
        return str(statuses[-1].text)

    def _call(
        self, kind: Any, service: str, request: Any, urgent: bool = False, once: bool = False
    ) -> Any:
        client = self.node.create_client(kind, service, qos_profile=CALLS)
        try:
            return self._answer(client, service, request, urgent, once)
        finally:
            self.node.destroy_client(client)

    def _answer(self, client: Any, service: str, request: Any, urgent: bool, once: bool) -> Any:
        def there() -> bool:  # a service may be discovered before the name of its node
            return urgent or client.service_is_ready() or bool(self._seen())

        cut = "; cut the power by hand" if urgent else ""
        if not (
            self._until(there, DISCOVERY_S)
            and self._until(client.service_is_ready, SERVICE_TIMEOUT_S)
        ):
            raise PlateError(self._missing(service) + cut)
        again_s = ANSWER_S if once else AGAIN_S
        answers: list[Any] = []
        for _ in range(round(ANSWER_S / again_s)):
            client.call_async(request).add_done_callback(lambda done: answers.append(done.result()))
            if self._until(lambda: bool(answers), again_s):
                return answers[0]
        raise PlateError(f"the service {service} does not answer{cut}")

    def _missing(self, service: str) -> str:
        """Return the reason why the service is missing."""
        running = self._seen()
        why = f"running nodes: {', '.join(running)}" if running else no_graph_text(self.node)
        return f"no service {service}; {why}"

    def _find_nodes(self) -> None:
        """Wait until a node of this namespace is discovered.

        Raises
        ------
        PlateError
            If no node is discovered.
        """
        if not self._until(lambda: bool(self._seen()), DISCOVERY_S):
            raise PlateError(no_graph_text(self.node))

    def _seen(self) -> list[str]:
        """Return the names of the nodes in this namespace."""
        own_namespace = self.node.get_namespace()
        found = self.node.get_node_names_and_namespaces()
        return sorted(  # names that begin with _ belong to hidden nodes, such as the ros2 daemon
            name
            for name, where in found
            if name != NAME and where == own_namespace and not name.startswith("_")
        )

    def _until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        return spin_until(
            lambda wait_s: rclpy.spin_once(self.node, timeout_sec=wait_s), condition, timeout_s
        )


def no_graph_text(node: Node) -> str:
    """Return the error text for the case that no graph runs in the namespace of `node`. The text
    lists the other namespaces or, if there are none, the ROS domains in use on this machine."""
    own_namespace = node.get_namespace()
    found = node.get_node_names_and_namespaces()
    namespaces = {where for name, where in found if name != NAME and not name.startswith("_")}
    if namespaces := namespaces - {own_namespace}:
        return (
            f"no graph runs in namespace {own_namespace}; namespaces with nodes: "
            f"{', '.join(sorted(namespaces))}; to choose one, add --namespace"
        )
    own_domain = ros_domain(os.environ)
    others = sorted(domains_in_use() - {own_domain})
    text = f"no graph runs in ROS domain {own_domain}"
    if others:
        listed = ", ".join(map(str, others))
        text += (
            f"; ROS domains in use on this machine: {listed}; to choose one, export ROS_DOMAIN_ID="
        )
        # If several ROS domains are in use, some of them may belong to other users.
        text += listed if len(others) == 1 else "(the domain of your graph)"
    return text


def domains_in_use() -> set[int]:
    """Return the ROS domains of the processes on this machine. The domains are derived from the UDP
    ports of the processes."""
    found = set()
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        path = Path(table)
        for line in path.read_text("ascii").splitlines()[1:] if path.exists() else ():
            port = int(line.split()[1].rsplit(":", 1)[1], 16)
            domain, offset = divmod(port - DDS_PORT, PORTS_PER_DOMAIN)
            # ports with an offset below 10 are for multicast and do not show that a domain is in
            # use
            if domain in DOMAINS and offset >= 10:
                found.add(domain)
    return found
