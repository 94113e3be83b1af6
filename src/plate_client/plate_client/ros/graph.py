"""Tasks, states and parameters of the running nodes."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import yaml
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import Trigger

from plate_core import PlateError, did_you_mean
from plate_core.ros import ACTIONS, DATA, LATCHED, Report, diagnostics_topics, msg_to_reports
from plate_core.tasks import Scenario, load_scenario
from plate_interfaces.msg import DriverStatus, Friction, TaskStatus
from plate_interfaces.srv import MeasureFriction

from .client import AGAIN_S, TIMEOUT_S, PlateClient, Task, TaskError
from .services import DISCOVERY_S, Services, no_graph_text

PROGRESS_S = 2.0
"""Time between two lines that state the progress of a task [s]."""

WAITING_S = 5.0
"""Time between two lines that state the reason why a task waits [s]."""

REPORT_S = 2.0
"""Time for which diagnostics are collected [s]. Nodes publish diagnostics once per second."""

LATE_S = 2.0
"""Additional time if some nodes have not published diagnostics yet [s]."""

AT_FIRST_S = 0.5
"""Minimum time for which a task must wait before the reason is printed [s]."""


class NoReportError(PlateError):
    """Error: the driver no longer reports that it measures."""


class Graph(Services):
    """Access to the running nodes and their services through a temporary node.

    Parameters
    ----------
    namespace : str
        Namespace of the nodes.
    """

    def __init__(self, namespace: str) -> None:
        super().__init__(namespace)
        self._texts: dict[str, str] = {}  # last displayed text of each topic

    def run(self, args: argparse.Namespace) -> str:
        """Execute a command, and return its output.

        Raises
        ------
        PlateError
            If the command failed.
        """
        match args.command:
            case "goal":
                return self._do(load_scenario(args.scenario))
            case "cancel":
                return self._cancel_all()
            case "friction":
                return self._friction(args.write)
            case "state":
                return self._state()
            case "params":
                return "\n".join(self._list(name) for name in self._nodes(args.node))
            case "get":
                node = self._node(args, "node", "name")
                return str(self._get(node, args.name))
            case "set":
                node = self._node(args, "node", "name", "value")
                return self._set(node, args.name, args.value)
            case _:
                return super().run(args)

    # Tasks

    def _do(self, scenario: Scenario) -> str:
        """Execute a task, and show its progress. Return the text of the last status."""
        self._find_nodes()
        plate = PlateClient(self.node, self._until)
        task = self._start(plate, scenario)
        next_s = time.monotonic() + PROGRESS_S

        def show() -> None:
            nonlocal next_s
            if time.monotonic() < next_s:
                return
            next_s, progress = time.monotonic() + PROGRESS_S, task.progress
            line = (
                f"{progress.time_s:.0f} s: {progress.parts_sorted} of {progress.parts_total} parts"
            )
            print(f"  {line}, {1e3 * progress.to_go_m:.0f} mm to go", flush=True)

        try:
            status = plate.wait(task, meanwhile=show)
        except KeyboardInterrupt:
            status = plate.cancel(task)
        if status.state != TaskStatus.DONE:
            raise TaskError(status)
        return str(status.text)

    def _start(self, plate: PlateClient, scenario: Scenario) -> Task:
        """Send the goal of a task. While the graph is not ready, print the reason."""
        began, next_s = time.monotonic(), AT_FIRST_S

        def waiting(why: str) -> None:
            nonlocal next_s
            waited_s = time.monotonic() - began
            if waited_s >= next_s:
                next_s = waited_s + WAITING_S
                print(f"  {waited_s:.0f} s: {why}", flush=True)

        return plate.start(scenario, waiting=waiting)

    def _cancel_all(self) -> str:
        """Cancel all goals. A request with a zero id and a zero stamp cancels every goal
        (action_msgs/CancelGoal)."""
        self._find_nodes()
        count = sum(
            len(self._call(CancelGoal, f"{name}/_action/cancel_goal", CancelGoal.Request())
                .goals_canceling)
            for name in ACTIONS
        )  # fmt: skip
        return "no goal was running" if not count else "canceled"

    # Friction

    def _friction(self, write: bool) -> str:
        """Measure friction and show the progress. If the user confirms it, write the result into
        the rig file. Return the outcome as text.

        Raises
        ------
        PlateError
            If the measurement fails, or if the result cannot be written.
        """
        received: list[Friction] = []
        drivers: list[DriverStatus] = []
        self.node.create_subscription(Friction, "friction", received.append, LATCHED)
        self.node.create_subscription(DriverStatus, "driver_status", drivers.append, LATCHED)
        start, end = (MeasureFriction.Request(start=on) for on in (True, False))
        try:
            answer = self._call(MeasureFriction, "measure_friction", start, once=True)
            if answer.success:
                self._await_friction(received, drivers, answer.started)
        except (KeyboardInterrupt, OSError, NoReportError):
            # An OSError is raised if the output was closed.
            self._call(MeasureFriction, "measure_friction", end)
            raise
        if not answer.success:
            raise PlateError(str(answer.message))
        result = received[-1]
        if result.state != Friction.DONE:
            raise PlateError(result.text)
        rows = [f"  {'part':14}  {'x [mm]':>8}  {'y [mm]':>8}  mu"]
        rows += [
            f"  {part.id:14}  {1e3 * part.x:8.1f}  {1e3 * part.y:8.1f}  {part.mu:.4f} +- "
            f"{part.mu_error:.4f}"
            for part in result.parts
        ]
        print("\n".join([*rows, result.text]), flush=True)
        question = f"Write mu {result.mu:.3g} into the driver's rig file? Type yes, or Enter: "
        if not write and not (sys.stdin.isatty() and input(question).strip() == "yes"):
            return "mu was not written; use --write to write it"
        answer = self._call(Trigger, "write_friction", Trigger.Request())
        if not answer.success:
            raise PlateError(str(answer.message))
        return str(answer.message)

    def _await_friction(
        self, received: list[Friction], drivers: list[DriverStatus], started: Time
    ) -> None:
        """Show the progress of a measurement until it ends. The start time identifies the
        measurement.

        Raises
        ------
        NoReportError
            If the driver no longer reports that it measures.
        """
        text, reports, waited_s = "", 0, 0.0

        def over() -> bool:
            nonlocal text
            messages = [msg for msg in received if msg.header.stamp == started]
            if messages and messages[-1].text != text:
                text = messages[-1].text
                if messages[-1].state == Friction.RUNNING:
                    print(f"  {100 * messages[-1].fraction:3.0f} %  {text}", flush=True)
            return bool(messages) and messages[-1].state != Friction.RUNNING

        while not self._until(over, AGAIN_S):
            measuring = sum(msg.state == DriverStatus.CALIBRATING for msg in drivers)
            waited_s = waited_s + AGAIN_S if len(received) + measuring == reports else 0.0
            reports = len(received) + measuring
            if waited_s > TIMEOUT_S:
                why = (
                    f"the driver has reported no measurement for {TIMEOUT_S:g} s, so it hangs, has "
                    "ended or was restarted"
                )
                print(f"  {why}; canceling the measurement", flush=True)
                raise NoReportError(f"{why}. Check whether the plate is at rest")

    # State

    def _state(self) -> str:
        topics = {"driver_status": DriverStatus, "task_status": TaskStatus}
        for topic, kind in topics.items():
            self.node.create_subscription(kind, topic, self._on_text(topic), LATCHED)
        reports: dict[str, Report] = {}

        def on_report(msg: DiagnosticArray) -> None:
            found = msg_to_reports(msg, self.node.get_namespace())
            reports.update((report.node, report) for report in found)

        for topic in diagnostics_topics(self.node):
            self.node.create_subscription(DiagnosticArray, topic, on_report, DATA)
        if self._until(lambda: bool(self._seen()), DISCOVERY_S):
            self._until(lambda: False, REPORT_S)
            self._until(lambda: not self._without_reports(reports), LATE_S)
        missing = self._without_reports(reports)
        if not self._seen() and not self._texts:
            raise PlateError(no_graph_text(self.node))
        lines = [f"{topic}: {self._texts.get(topic, 'no message')}" for topic in topics]
        nodes = {name: f"{status.level.name}, {status.message}" for name, status in reports.items()}
        nodes |= dict.fromkeys(missing, "no message yet: the node is starting, or it hangs")
        if missing:
            lines.append("some nodes have sent no message; other nodes may wait for them")
        return "\n".join([*lines, *(f"  {name}: {text}" for name, text in sorted(nodes.items()))])

    def _without_reports(self, reports: dict[str, Report]) -> list[str]:
        """Return the nodes that have a publisher of diagnostics but have not published yet. A node
        without diagnostics is starting or does not respond."""
        publishers = {
            publisher.node_name
            for topic in diagnostics_topics(self.node)
            for publisher in self.node.get_publishers_info_by_topic(topic)
            if publisher.node_namespace == self.node.get_namespace()
        }
        return sorted(publishers & set(self._seen()) - reports.keys())

    def _on_text(self, topic: str) -> Callable[[Any], None]:
        def on_message(msg: Any) -> None:
            self._texts[topic] = msg.text

        return on_message

    # Parameters

    def _nodes(self, name: str | None) -> list[str]:
        """Return the node with a name. Without a name, return all nodes.

        Raises
        ------
        PlateError
            If the node does not run. The message lists the running nodes.
        """
        self._find_nodes()
        self._until(lambda: name in self._seen(), DISCOVERY_S)
        running = self._seen()
        if name is None:
            return running
        if name not in running:
            hint, listed = did_you_mean(name, running), ", ".join(running)
            raise PlateError(f"no node {name!r} runs{hint}; running nodes: {listed}")
        return [name]

    def _node(self, args: argparse.Namespace, *names: str) -> str:
        """Return the name of the node in `args`. Raise PlateError if the node does not run or if an
        argument in `names` is missing."""
        if any(getattr(args, word) is None for word in names):
            usage, listed = " ".join(names).upper(), ", ".join(self._nodes(None))
            raise PlateError(f"{args.command} requires {usage}; running nodes: {listed}")
        (node,) = self._nodes(args.node)
        return node

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
        query = DescribeParameters.Request(names=names)
        answer = self._call(DescribeParameters, f"{node}/describe_parameters", query)
        lines = [node]
        for name, value, about in zip(names, values, answer.descriptors, strict=True):
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
        # The last three errors are caused by an invalid date, an escape sequence beyond the range
        # of Unicode, and deep nesting.
        except (yaml.YAMLError, ValueError, OverflowError, RecursionError):
            allowed = False
        if not allowed:
            raise PlateError(f"parameter {name} of {node} is {text!r}, allowed: a {kind.__name__}")
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        result = self._call(SetParameters, f"{node}/set_parameters", request).results[0]
        if not result.successful:
            raise PlateError(f"{node} refuses: {result.reason}")
        return f"{node} {name}: {before} -> {value}"
