"""The program `plate`: tasks, stops, states and parameters of a running graph, without `ros2`."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
import yaml
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from plate_core import PlateError, config_path, did_you_mean
from plate_core.ros import ACTIONS, DATA, LATCHED, msg_to_reports
from plate_core.status import COMPILING
from plate_core.tasks import Scenario, load_scenario
from plate_interfaces.msg import TaskStatus

from .client import PlateClient, TaskError

SERVICES = {
    "stop": "end the task, also of another sender",
    "enable": "clear the present stop: the motors get current, and the plate goes home",
    "disable": "brake, then current off, without an emergency",
    "emergency_stop": "brake, then current off (stop category 1)",
    "cut_power": "current off at once (stop category 0)",
    "home": "forget where home is: the next enable finds it",
    "calibrate": "learn the plate's response",
}
OTHERS = {
    "goal": "SCENARIO: do the task of a scenario, by name or .yaml file; Ctrl-C cancels it",
    "cancel": "cancel all goals",
    "state": "print driver_state, task_state, and what each node says of itself",
    "params": "[NODE]: list parameters, their values and meanings",
    "get": "NODE NAME: print a parameter",
    "set": "NODE NAME VALUE: change a parameter of a running node",
}

NOBODY_S, FOUND_S, ANSWER_S = 1.0, 3.0, 15.0
"""Longest waits: for any node to be seen, for a service to be found, for its answer [s]."""

URGENT = ("emergency_stop", "cut_power", "disable")
"""These are tried for longer, also where nobody is seen."""

REPORT_S, LATE_S = 1.2, 2.0
"""What nodes say of themselves once a second is listened to for so long, and for so much longer
where some of those that are known have said nothing yet [s]."""

PROGRESS_S = 2.0
"""Between two lines on how a task gets on [s]."""

NAME = "plate_command"

LAST_DOMAIN = 232
"""The ports of the next one would be beyond 65535."""

DDS_PORT, PORTS_PER_DOMAIN, DOMAINS = 7400, 250, range(102)
"""UDP ports of a ROS domain (DDSI-RTPS 9.6.1.1), and the domains whose ports are nobody else's."""


def main() -> None:
    """Run the command line; exit code 0 if it was done, 1 if not."""
    args = _arguments()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` has it ignored
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_path("fastdds.xml")))
    try:
        domain()
        if not re.fullmatch(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?", args.namespace, re.ASCII):
            raise PlateError(
                f"namespace is {args.namespace!r}, allowed: words of letters, digits and _, with / "
                "between them"
            )
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        graph = Graph(args.namespace)
        try:
            print(graph.run(args))
        finally:
            graph.node.destroy_node()
    except PlateError as error:
        print(f"plate: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        rclpy.try_shutdown()


def _arguments() -> argparse.Namespace:
    lines = "\n".join(f"  {name:15}{what}" for name, what in (SERVICES | OTHERS).items())
    parser = argparse.ArgumentParser(
        prog="plate", usage="plate COMMAND [--namespace NAME]",
        description=f"Talk to the plate's running nodes, in the domain ROS_DOMAIN_ID:\n{lines}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True, help=argparse.SUPPRESS)
    for name, what in (SERVICES | OTHERS).items():
        one = commands.add_parser(name, description=what)
        if name in ("get", "set", "params"):
            one.add_argument("node", nargs="?" if name == "params" else None, metavar="NODE")
        if name in ("get", "set"):
            one.add_argument("name", metavar="NAME")
        if name == "goal":
            one.add_argument("scenario", metavar="SCENARIO")
        if name == "set":
            one.add_argument("value", metavar="VALUE")
        one.add_argument("--namespace", default="", help="of the nodes")
    words = sys.argv[1:]
    if words and words[0] not in (*SERVICES, *OTHERS, "-h", "--help"):
        known = (*SERVICES, *OTHERS)
        hint = did_you_mean(words[0], known)
        parser.exit(2, f"plate: command is {words[0]!r}{hint}, allowed: {', '.join(known)}\n")
    return parser.parse_args()


class Graph:
    """The running nodes, as seen by one of our own.

    Parameters
    ----------
    namespace : str
        Of the nodes.
    """

    def __init__(self, namespace: str) -> None:
        self.node = Node(NAME, namespace=namespace)
        self._said: dict[str, str] = {}  # by topic
        self._health: dict[str, str] = {}  # by node
        self.node.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, DATA)

    def run(self, args: argparse.Namespace) -> str:
        """Do what is asked, and return what there is to tell.

        Raises
        ------
        PlateError
            If it was not done.
        """
        match args.command:
            case "goal":
                return self._do(load_scenario(args.scenario))
            case "cancel":
                return self._cancel_all()
            case "state":
                return self._state()
            case "params":
                return "\n".join(self._list(name) for name in self._nodes(args.node))
            case "get":
                (node,) = self._nodes(args.node)
                return str(self._get(node, args.name))
            case "set":
                (node,) = self._nodes(args.node)
                return self._set(node, args.name, args.value)
            case "enable" | "disable":
                request = SetBool.Request(data=args.command == "enable")
                return self._asked(SetBool, "enable", request, args.command in URGENT)
            case _:
                trigger = Trigger.Request()
                return self._asked(Trigger, args.command, trigger, args.command in URGENT)

    # Tasks

    def _do(self, scenario: Scenario) -> str:
        """Do a task, and show how it gets on; returns the last status in words."""
        self._until(lambda: bool(self._seen()), NOBODY_S)
        if not self._seen():
            raise PlateError(nobody())
        plate = PlateClient(self.node, self._until)
        task = plate.start(scenario)
        try:
            while not self._until(lambda: task.ended, PROGRESS_S):
                at = task.progress
                line = f"{at.time_s:.0f} s: {at.parts_sorted} of {at.parts_total} parts"
                print(f"  {line}, {1e3 * at.to_go_m:.0f} mm to go", flush=True)
            status = plate.wait(task, 0.0)
        except KeyboardInterrupt:
            status = plate.cancel(task)
        if status.state != TaskStatus.DONE:
            raise TaskError(status)
        return str(status.text)

    def _cancel_all(self) -> str:
        """Cancel what runs; the zero id and stamp stand for every goal (action_msgs/CancelGoal)."""
        count = sum(
            len(self._call(CancelGoal, f"{name}/_action/cancel_goal", CancelGoal.Request(), True)
                .goals_canceling)
            for name in ACTIONS
        )  # fmt: skip
        return f"{count} goals canceled"

    # Services

    def _asked(self, kind: Any, service: str, request: Any, urgent: bool) -> str:
        answer = self._call(kind, service, request, urgent)
        if not answer.success:
            raise PlateError(str(answer.message))
        return str(answer.message)

    def _call(self, kind: Any, service: str, request: Any, urgent: bool = False) -> Any:
        client = self.node.create_client(kind, service)

        def there() -> bool:  # a service may be known before the name of its node is
            return urgent or client.service_is_ready() or bool(self._seen())

        if not (self._until(there, NOBODY_S) and self._until(client.service_is_ready, FOUND_S)):
            cut = ": cut the power by hand" if urgent else ""
            raise PlateError(self._missing(service) + cut)
        future = client.call_async(request)
        if not self._until(future.done, ANSWER_S):
            cut = ": cut the power by hand" if urgent else ""
            raise PlateError(f"{service} does not answer{cut}")
        self.node.destroy_client(client)
        return future.result()

    def _missing(self, service: str) -> str:
        """Say why there is no such service."""
        here = self._seen()
        if not here:
            return f"no service {service}: {nobody()}"
        busy = [f"{name} is {text}" for name, text in self._health.items() if COMPILING in text]
        return f"no service {service}: {'; '.join(busy) or 'nodes here: ' + ', '.join(here)}"

    # State

    def _state(self) -> str:
        topics = {"driver_state": String, "task_status": TaskStatus}
        for topic, kind in topics.items():
            self.node.create_subscription(kind, topic, self._on_text(topic), LATCHED)
        self._until(lambda: bool(self._seen()), NOBODY_S)
        if self._seen():
            self._until(lambda: False, REPORT_S)
            said, speakers = self._health, self.node.count_publishers
            self._until(lambda: len(said) >= speakers("diagnostics"), LATE_S)
        if not self._seen() and not self._said:
            raise PlateError(nobody())
        lines = [f"{topic}: {self._said.get(topic, 'nothing heard')}" for topic in topics]
        return "\n".join([*lines, *(f"  {name}: {text}" for name, text in self._health.items())])

    def _on_text(self, topic: str) -> Callable[[Any], None]:
        def on_message(msg: Any) -> None:
            self._said[topic] = msg.data if isinstance(msg, String) else msg.text

        return on_message

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in msg_to_reports(msg):
            self._health[report.node] = f"{report.level.name}, {report.message}"

    # Parameters

    def _nodes(self, name: str | None) -> list[str]:
        """Return the node of a name, or all."""
        self._until(lambda: bool(self._seen()), NOBODY_S)
        if self._seen():
            self._until(lambda: name in self._seen(), NOBODY_S)
        here = self._seen()
        if not here:
            raise PlateError(nobody())
        if name is None:
            return here
        if name not in here:
            raise PlateError(f"node is {name!r}{did_you_mean(name, here)}, here: {', '.join(here)}")
        return [name]

    def _names(self, node: str) -> list[str]:
        answer = self._call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        return sorted(answer.result.names)

    def _get(self, node: str, name: str) -> Any:
        request = GetParameters.Request(names=[name])
        values = self._call(GetParameters, f"{node}/get_parameters", request).values
        value = parameter_value_to_python(values[0]) if values else None
        if value is None:
            known = self._names(node)
            hint = did_you_mean(name, known)
            raise PlateError(f"{node} has no parameter {name!r}{hint}, it has: {', '.join(known)}")
        return value

    def _list(self, node: str) -> str:
        names = self._names(node)
        request = GetParameters.Request(names=names)
        values = self._call(GetParameters, f"{node}/get_parameters", request).values
        asked = DescribeParameters.Request(names=names)
        told = self._call(DescribeParameters, f"{node}/describe_parameters", asked).descriptors
        lines = [node]
        for name, value, about in zip(names, values, told, strict=True):
            shown = repr(parameter_value_to_python(value))
            allowed = f" ({about.additional_constraints})" if about.additional_constraints else ""
            fixed = "" if not about.read_only else " [fixed]"
            lines.append(f"  {name:20} {shown:14} {about.description}{allowed}{fixed}")
        return "\n".join(lines)

    def _set(self, node: str, name: str, text: str) -> str:
        before = self._get(node, name)
        scalar = isinstance(before, bool | int | float | str)
        kind = type(before) if scalar else list
        try:
            value = text if isinstance(before, str) else yaml.safe_load(text)
            if isinstance(before, float) and type(value) is int:
                value = float(value)
            allowed = type(value) is kind
        except (yaml.YAMLError, ValueError):  # the latter: a date that is none
            allowed = False
        if not allowed:
            raise PlateError(f"{node} {name} is {text!r}, allowed: a {kind.__name__}")
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self._call(SetParameters, f"{node}/set_parameters", request).results[0]
        if not result.successful:
            raise PlateError(f"{node} refuses: {result.reason}")
        return f"{node} {name}: {before} -> {value}"

    # Waiting

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
        end = time.monotonic() + timeout_s
        while not true():
            if time.monotonic() > end:
                return False
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return True


def nobody() -> str:
    """Say that no graph is there, and in which domains of this machine there may be one."""
    others = sorted(domains_in_use() - {domain()})
    text = f"no graph runs in ROS domain {domain()}"
    if others:
        listed = ", ".join(map(str, others))
        text += f"; ROS runs on this machine in {listed}: export ROS_DOMAIN_ID={others[0]}"
    return text


def domain() -> int:
    """Return the ROS domain of this process.

    Raises
    ------
    PlateError
        If the environment names none.
    """
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        raise PlateError(
            f"ROS_DOMAIN_ID is {text!r}, allowed: a whole number from 0 to {LAST_DOMAIN}"
        )
    return int(text)


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
