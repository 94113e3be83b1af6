"""Executes commands of browsers with the public actions, services, topics and parameters of the ROS
nodes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from action_msgs.srv import CancelGoal
from geometry_msgs.msg import Point
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from plate_core import PlateError, Rig, ScenarioError, did_you_mean, part_class
from plate_core.ros import ACTIONS, REFUSED, goal_to_scenario, scenario_to_goal
from plate_core.tasks import (
    AssembleTask,
    FeedTask,
    FollowTask,
    PoseTask,
    Scenario,
    SortTask,
    Task,
    check_scenario,
    load_scenario,
    read_scenario,
    scenario_names,
)
from plate_core.yaml_fields import Fields
from plate_interfaces.action import FollowPaths, MoveParts
from plate_interfaces.msg import PartCount, Path, Target, Targets, TaskStatus
from plate_interfaces.srv import MeasureFriction, PlacePart, RemovePart, TakeLensPictures

from ..calls import SERVICES, call_text, goal_text
from ..commands import Command
from ..scene import task_scene
from ..server import PageServer, Socket
from .caller import ANSWER_S, Caller
from .listener import Listener
from .pending import PendingCommand

DISCOVERY_TIMEOUT_S = 2.0
"""Maximum time for the discovery of an action server [s]."""

MOVE_TOLERANCE_M = 0.001
"""Distance from its target at which a dragged part counts as arrived [m]."""

MOVE_TOLERANCE_RAD = 0.05
"""Angle error at which a dragged part counts as arrived [rad]."""

MAX_SQUARES = 255
"""Maximum number of squares along a side of a calibration board. The message TakeLensPictures
cannot contain a larger number. The maximum number that the detector allows is smaller."""

FOLLOW_ERROR_M = 0.02
"""Maximum distance of a part from its drawn path [m]. If the part is farther from the path, the
task ends."""

FOLLOW_LIMIT_S = 600.0
"""Maximum time for following a drawn path [s]. After this time, the task ends."""

SECRET = ("operator_token", "viewer_token")
"""Parameters that are not sent to browsers."""


@dataclass(eq=False)
class Goal:
    """An action goal that the page has sent. The attribute `handle` is set when the planner accepts
    the goal."""

    task: Task
    handle: Any = None
    ended: bool = False


@dataclass(eq=False)
class _GoalCall:
    """A goal that is being sent.

    Attributes
    ----------
    operator : Operator
    pending : PendingCommand
        Command of the browser. It receives one reply.
    name : str
        Name of the action.
    request : Goal message
    goal : Goal
        The sent goal.
    before : Goal or None
        Goal of the previous task. If the new goal is refused, this task is shown again.
    future : Future or None
        Call of the action server. None until the server is available.
    end : float
        Time at which the call fails, if the server is not available or does not reply [s].
    replied : bool
        Whether the browser has received its reply.
    """

    operator: Operator
    pending: PendingCommand
    name: str
    request: Any
    goal: Goal = field(init=False)
    before: Goal | None = None
    future: Any = None
    end: float = 0.0
    replied: bool = False

    def __post_init__(self) -> None:
        self.goal = Goal(goal_to_scenario(self.request).task)
        self.end = time.monotonic() + DISCOVERY_TIMEOUT_S

    def check(self) -> None:
        """Send the goal when the server is available. If a time limit has passed, reply with the
        reason. The operator calls this method repeatedly."""
        operator = self.operator
        client = operator._actions[self.name]
        if self.future is None and client.server_is_ready():
            # Set the goal before it is sent, because task_status reports the task before the
            # planner accepts the goal.
            self.before, operator._goal = operator._goal, self.goal
            self.future = client.send_goal_async(self.request, feedback_callback=self._on_feedback)
            self.future.add_done_callback(self._on_answer)
            self.end = time.monotonic() + ANSWER_S
        elif self.replied or time.monotonic() > self.end:
            operator._caller.pollers.discard(self.check)
            if self.replied:
                return
            why = "is not available" if self.future is None else "does not reply"
            self._refuse(f"the action {self.name} {why}; check that the planner is configured")

    def _reply(self, ok: bool, text: str) -> None:
        if not self.replied:
            self.replied = True
            self.pending.answer(ok, text)

    def _refuse(self, text: str) -> None:
        self.goal.ended = True
        # The new goal did not replace the previous task. Therefore show the previous task again,
        # unless it has ended.
        if self.operator._goal is self.goal:
            is_running = self.before is not None and not self.before.ended
            self.operator._goal = self.before if is_running else None
        self._reply(False, text)

    def _on_feedback(self, msg: Any) -> None:
        self._reply(True, "it runs")

    def _on_answer(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._refuse("the planner refused the goal")
        elif self.goal.ended:  # the goal was accepted after the time limit, so cancel it
            handle.cancel_goal_async()
        else:
            self.goal.handle = handle
            handle.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        status = future.result().result.status
        if status.reason in REFUSED:
            self._refuse(status.text)
            return
        self._reply(status.state == TaskStatus.DONE, status.text)
        self.goal.ended = True
        operator = self.operator
        if operator._goal is self.goal:
            operator._goal = operator._waiting = None
        waiting, operator._next = operator._next, None
        if waiting is not None:
            operator._send_goal(*waiting)


class Operator:
    """Executes the commands of browsers.

    Parameters
    ----------
    node : Node
    rig : Rig
    publish : callable
        Publisher on the topic `targets`.
    expected : Scenario or None
        Scenario that is assumed for a running task that this page has not started.
    """

    def __init__(
        self, node: Node, rig: Rig, publish: Callable[[Targets], None], expected: Scenario | None
    ) -> None:
        self._node = node
        self._rig = rig
        self._publish = publish
        self._expected = expected
        self._actions = {name: ActionClient(node, kind, name) for name, kind in ACTIONS.items()}
        self._caller = Caller(node)
        self._call = self._caller.call
        self._goal: Goal | None = None  # goal of the task that this page has started
        # Next goal, which is sent when the present task has ended.
        self._next: tuple[PendingCommand, str, Any] | None = None
        # Targets that are stored until the task runs.
        self._waiting: dict[str, dict[str, Any]] | None = None
        # Requests that wait for the parameters of a node.
        self._requests: dict[str, list[PendingCommand]] = {}

    def begin(self, server: PageServer, listener: Listener) -> None:
        """Start to execute the commands of the browsers of `server`."""
        self._server, self._listener = server, listener
        self._goal = self._next = self._waiting = None
        self._shown = ""
        self._requests.clear()
        self._caller.pollers.clear()
        listener.on_task = self._on_task

    def close(self) -> None:
        """Destroy all clients."""
        self._caller.close()
        for action in self._actions.values():
            action.destroy()

    def do(self, browser: Socket, command: Command) -> None:
        """Execute a command. The browser receives the reply, and all browsers show the equivalent
        call."""
        pending = PendingCommand(self._server, browser, command)
        try:
            DONE[command.name](self, pending)
        except PlateError as error:
            pending.refuse(str(error))

    # Services and parameters

    def _call_trigger_service(self, pending: PendingCommand) -> None:
        service = SERVICES[pending.command.name][0].removeprefix("/")
        self._call(pending, Trigger, service, Trigger.Request(), pending.done)

    def _enable(self, pending: PendingCommand) -> None:
        request = SetBool.Request(data=pending.values["on"])
        self._call(pending, SetBool, "enable", request, pending.done)

    def _reset(self, pending: PendingCommand) -> None:
        """Reset the parts of the simulator, then the detector. After that, the ids of parts restart
        at 1."""
        seed, request = pending.values["seed"], Trigger.Request()

        def reset_detector(answer: Any) -> None:
            if not answer.success:
                pending.done(answer)
                return
            self._call(pending, Trigger, "detector/reset", request, lambda _: pending.done(answer))

        def reset() -> None:
            self._call(pending, Trigger, "simulator/reset", request, reset_detector)

        if seed is None:
            reset()
        else:
            self._request_parameter_change(pending, "simulator", "seed", seed, reset)

    def _teach(self, pending: PendingCommand) -> None:
        name = pending.values["name"]
        self._request_parameter_change(
            pending, "detector", "teach_name", name, lambda: self._call_trigger_service(pending)
        )

    def _place(self, pending: PendingCommand) -> None:
        given = {key: "" if value is None else value for key, value in pending.values.items()}
        request = PlacePart.Request(**given)
        self._call(pending, PlacePart, "simulator/place_part", request, pending.done)

    def _remove(self, pending: PendingCommand) -> None:
        request = RemovePart.Request(id=pending.values["id"])
        self._call(pending, RemovePart, "simulator/remove_part", request, pending.done)

    def _take_lens_pictures(self, pending: PendingCommand) -> None:
        """Take pictures of a calibration board. Refuse numbers of squares that are too large for
        the ROS message."""
        given = {key: value for key, value in pending.values.items() if value is not None}
        for side in ("columns", "rows"):
            if given.get(side, 0) > MAX_SQUARES:
                raise PlateError(f"{side} is {given[side]}, allowed: 3 to 40")
        service = SERVICES[pending.command.name][0].removeprefix("/")
        self._call(
            pending, TakeLensPictures, service, TakeLensPictures.Request(**given), pending.done
        )

    def _measure_friction(self, pending: PendingCommand) -> None:
        request = MeasureFriction.Request(start=pending.values["start"])
        self._call(pending, MeasureFriction, "measure_friction", request, pending.done)

    def _set_parameter(self, pending: PendingCommand) -> None:
        values = pending.values
        node, name, value = values["node"], values["name"], values["value"]
        self._request_parameter_change(
            pending, node, name, value, lambda: pending.accept(f"{node} {name}: {value}")
        )

    def _request_parameter_change(
        self, pending: PendingCommand, node: str, name: str, value: Any, then: Callable[[], None]
    ) -> None:
        """Set a parameter. Then call `then`."""

        def on_reply(answer: Any) -> None:
            (result,) = answer.results
            if result.successful:
                then()
            else:
                request, refused = ListParameters.Request(), partial(refuse_change, result.reason)
                self._call(pending, ListParameters, f"{node}/list_parameters", request, refused)

        def refuse_change(reason: str, answer: Any) -> None:
            known = sorted(answer.result.names)
            if name in known:
                pending.refuse(f"{node} refuses: {reason}")
            else:
                hint = did_you_mean(name, known)
                pending.refuse(
                    f"{node} has no parameter {name!r}{hint}, it has: {', '.join(known)}"
                )

        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        self._call(
            pending, SetParameters, f"{self._find_node(node)}/set_parameters", request, on_reply
        )

    def _find_node(self, name: str) -> str:
        """Return the name of an existing node. The page creates no service clients for other
        names."""
        own_namespace = self._node.get_namespace()
        nodes = self._node.get_node_names_and_namespaces()
        node_names = sorted({node_name for node_name, space in nodes if space == own_namespace})
        if name not in node_names:
            raise PlateError(f"node is {name!r}, allowed: {', '.join(node_names)}")
        return name

    def _send_parameters(self, pending: PendingCommand) -> None:
        """Send the parameters of a node to a browser. Further requests wait until the present
        request is complete."""
        node = pending.values["node"]
        if node in self._requests:
            self._requests[node].append(pending)
        else:
            self._request_parameters(pending, self._find_node(node))

    def _request_parameters(
        self, pending: PendingCommand, node: str, others: Sequence[PendingCommand] = ()
    ) -> None:
        """Request the names of parameters, then their values, then their descriptions."""
        self._requests[node] = []

        def finish(ok: bool, text: str) -> None:
            for call in others:
                call.answer(ok, text)
            waiting = self._requests.pop(node, [])
            if waiting:
                self._request_parameters(waiting[0], node, waiting[1:])

        pending.answered = finish
        names: list[str] = []
        values: list[Any] = []

        def on_names(answer: Any) -> None:
            names.extend(sorted(answer.result.names))
            request = GetParameters.Request(names=names)
            self._call(pending, GetParameters, f"{node}/get_parameters", request, on_values)

        def on_values(answer: Any) -> None:
            values.extend(answer.values)
            request = DescribeParameters.Request(names=names)
            self._call(
                pending, DescribeParameters, f"{node}/describe_parameters", request, on_descriptions
            )

        def on_descriptions(answer: Any) -> None:
            rows = zip(names, values, answer.descriptors, strict=True)
            shown = [_parameter_for_page(*row) for row in rows if row[0] not in SECRET]
            scene = {"kind": "parameters", "node": node, "parameters": shown}
            self._server.publish(f"parameters {node}", scene)
            pending.accept("")

        request = ListParameters.Request()
        self._call(pending, ListParameters, f"{node}/list_parameters", request, on_names)

    # Tasks

    def _start_task(self, pending: PendingCommand) -> None:
        scenario, task = pending.values["scenario"], pending.values["task"]
        if (scenario is None) == (task is None):
            raise PlateError("start requires exactly one of scenario and task")
        if scenario is None:
            chosen = read_scenario(Fields(task, "task", ScenarioError), "task")
        elif scenario in scenario_names():
            chosen = load_scenario(scenario)
        elif self._expected is not None and scenario == self._expected.name:
            chosen = self._expected
        else:
            raise PlateError(f"scenario is {scenario!r}, allowed: {', '.join(scenario_names())}")
        name, goal = scenario_to_goal(chosen)
        if scenario not in scenario_names():
            pending.call = goal_text(name, ACTIONS[name].__name__, _changed_fields(goal))
        self._send_after_move(pending, name, goal)

    def _send_goal(self, pending: PendingCommand, name: str, goal: Any) -> None:
        """Send a goal. Reply when the goal is executed. If the goal is not executed, reply with the
        reason."""
        call = _GoalCall(self, pending, name, goal)
        self._caller.poll(call.check)
        call.check()

    def _cancel(self, pending: PendingCommand) -> None:
        """Cancel all running goals. A request with a zero id and a zero stamp cancels every goal
        (CancelGoal)."""
        left, found = list(ACTIONS), [0]

        def on_reply(answer: Any) -> None:
            found[0] += len(answer.goals_canceling)
            left.pop()
            if not left:
                pending.accept("canceled" if found[0] else "no task was running")

        self._waiting = None
        self._drop_next_goal("canceled")
        for name in ACTIONS:
            request, service = CancelGoal.Request(), f"{name}/_action/cancel_goal"
            self._call(pending, CancelGoal, service, request, on_reply)

    def _move(self, pending: PendingCommand) -> None:
        """Publish targets. If no task runs, start the task `move`."""
        targets = {target["id"]: target for target in pending.values["targets"]}
        task = self._listener.task
        running = task.state == TaskStatus.RUNNING
        if running and task.task == "move":
            self._publish_targets(targets)
            pending.accept("")
        elif running:
            raise PlateError(f"a task runs ({task.task}); cancel it first")
        elif self._waiting is not None:  # the task is about to start
            self._waiting |= targets
            pending.accept("")
        else:
            self._start_move_task(pending, targets)

    def _start_move_task(self, pending: PendingCommand, targets: dict[str, dict[str, Any]]) -> None:
        goal = MoveParts.Goal(
            parts=self._count_parts(), until_canceled=True, tolerance_m=MOVE_TOLERANCE_M,
            tolerance_rad=MOVE_TOLERANCE_RAD,
            marked=any(math.isfinite(target["angle"]) for target in targets.values()),
        )  # fmt: skip
        begun = goal_text("move_parts", "MoveParts", _changed_fields(goal))
        pending.call = f"{begun}; {call_text(pending.command)}"
        pending.answered = lambda ok, text: None if ok else self._drop_waiting_targets()
        self._waiting = dict(targets)
        self._send_goal(pending, "move_parts", goal)

    def _drop_next_goal(self, why: str) -> None:
        before, self._next = self._next, None
        if before is not None:
            before[0].refuse(why)

    def _drop_waiting_targets(self) -> None:
        self._waiting = None

    def _on_task(self) -> None:
        """Show the target places of a task that begins. Publish the targets that waited until this
        task runs."""
        status = self._listener.task
        running = status.task if status.state == TaskStatus.RUNNING else ""
        if running != self._shown:
            self._shown = running
            known = None if self._goal is None else self._goal.task
            if known is None and self._expected is not None:
                known = self._expected.task
            same_kind = running and known is not None and KINDS.get(type(known)) == running
            self._server.publish("paths", task_scene(self._rig, known if same_kind else None))
        if self._waiting is not None and running == "move":
            targets, self._waiting = self._waiting, None
            self._publish_targets(targets)

    def _publish_targets(self, targets: Mapping[str, Mapping[str, Any]]) -> None:
        stamp = self._node.get_clock().now().to_msg()
        msg = Targets(header=Header(stamp=stamp, frame_id="plate_home"))
        msg.targets = [Target(**target) for target in targets.values()]
        self._publish(msg)

    def _start_follow_task(self, pending: PendingCommand) -> None:
        """Start a task in which a part follows a drawn path."""
        part, closed, speed = (pending.values[key] for key in ("id", "closed", "speed"))
        if not any(detected.id == part for detected in self._listener.parts.parts):
            raise PlateError(f"follow: part {part!r} is not detected")
        path = Path(type=part_class(part), closed=closed, laps=float(closed), speed=speed)
        path.waypoints = [Point(x=x, y=y) for x, y in pending.values["points"]]
        goal = FollowPaths.Goal(
            parts=[PartCount(type=path.type, count=1)], paths=[path], max_error_m=FOLLOW_ERROR_M,
            time_limit_s=FOLLOW_LIMIT_S,
        )  # fmt: skip
        pending.call = goal_text("follow_paths", "FollowPaths", _changed_fields(goal))
        self._send_after_move(pending, "follow_paths", goal)

    def _send_after_move(self, pending: PendingCommand, name: str, goal: Any) -> None:
        """Send a goal. If the task `move` of this page runs, cancel this task first, because it
        does not end by itself.

        Raises
        ------
        ScenarioError
            If the rig cannot execute the goal. A running task then continues.
        """
        check_scenario(goal_to_scenario(goal), self._rig)
        running = self._goal
        if (
            running is not None
            and running.handle is not None
            and self._listener.task.task == "move"
        ):
            self._drop_next_goal("another task was requested")
            self._next = pending, name, goal
            running.handle.cancel_goal_async()
        else:
            self._send_goal(pending, name, goal)

    def _count_parts(self) -> list[PartCount]:
        """Return the number of parts of each type in the newest image."""
        types = [part_class(part.id) for part in self._listener.parts.parts]
        if not types:
            raise PlateError("no parts have been detected yet")
        return [PartCount(type=kind, count=types.count(kind)) for kind in sorted(set(types))]


KINDS = {
    SortTask: "sort", FollowTask: "follow", AssembleTask: "assemble", PoseTask: "pose",
    FeedTask: "feed",
}  # fmt: skip
"""Tasks whose target places are shown, and their names in the topic task_status."""

DONE: Mapping[str, Callable[[Operator, PendingCommand], None]] = {
    "learn_plate": Operator._call_trigger_service,
    "cancel": Operator._cancel,
    "enable": Operator._enable,
    "start": Operator._start_task,
    "move": Operator._move,
    "follow": Operator._start_follow_task,
    "set": Operator._set_parameter,
    "parameters": Operator._send_parameters,
    "place": Operator._place,
    "remove": Operator._remove,
    "reset": Operator._reset,
    "teach": Operator._teach,
    "find_home": Operator._call_trigger_service,
    "save_home": Operator._call_trigger_service,
    "take_lens_pictures": Operator._take_lens_pictures,
    "fit_lens": Operator._call_trigger_service,
    "save_lens": Operator._call_trigger_service,
    "measure_friction": Operator._measure_friction,
    "write_friction": Operator._call_trigger_service,
}
"""Function for each command. `Stops` executes the commands that stop the plate."""


def _changed_fields(msg: Any) -> Any:
    """Return the fields of a message that differ from their defaults, as mappings, lists and
    values."""
    if hasattr(msg, "get_fields_and_field_types"):
        values = {name: getattr(msg, name) for name in msg.get_fields_and_field_types()}
        new = type(msg)()
        return {name: _changed_fields(v) for name, v in values.items() if v != getattr(new, name)}
    if isinstance(msg, str | bool | int | float):
        return msg
    return [_changed_fields(item) for item in msg]


def _parameter_for_page(name: str, value: Any, about: Any) -> dict[str, Any]:
    """Return the name, the value and the description of a parameter for the page."""
    ranges = [*about.floating_point_range, *about.integer_range]
    text, plain = about.additional_constraints, parameter_value_to_python(value)
    return {
        "name": name,
        "value": plain if isinstance(plain, bool | int | float | str) else str(plain),
        "whole": value.type == ParameterType.PARAMETER_INTEGER,
        "description": about.description,
        "low": ranges[0].from_value if ranges else None,
        "high": ranges[0].to_value if ranges else None,
        "choices": text.removeprefix("one of ").split(", ") if text.startswith("one of") else None,
        "live": not about.read_only,
    }
