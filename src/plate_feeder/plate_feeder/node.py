"""The node `feeder`. The node gives parts to robots. Robots send their commands over ROS or over
TCP."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.action import ActionServer, CancelResponse
from std_srvs.srv import Trigger

from plate_core import PlateError, load_rig
from plate_core.ros import (
    CALLS,
    DATA,
    LATCHED,
    RESULT_S,
    NodeOptions,
    SafeLifecycleNode,
    add_prefix,
    msg_to_pick,
    order_to_msg,
    parameter,
    run_node,
    scenario_to_goal,
    seconds,
    to_time,
)
from plate_core.status import Finding, Level, combined
from plate_core.tasks import FeedMode, FeedOrder, FeedTask, Pick, check_scenario, load_scenario
from plate_interfaces.action import GetPart, PurgePlate
from plate_interfaces.msg import DriverStatus, FeedPick, FeedStatus, Part, PartCount, TaskStatus
from plate_interfaces.msg import FeedOrder as FeedOrderMsg
from plate_interfaces.srv import OpenHopper, PartQuantity, PartTaken, PreparePart

from . import feeder as core
from .codes import Code
from .feeder import Feeder
from .hand_eye import HandEye, load_hand_eye
from .interface import ReadyPart, Reply
from .lines import Command, part_text, quantity_text
from .ros import FeedGoal
from .server import Answer, RobotServer

STEP_S = 0.05
"""Interval between two calls of `Feeder.step`, which evaluates the feeder's rules [s]."""

ORDER_S = 0.5
"""Interval at which an unchanged order to the planner is published again [s]. The repetition is
necessary because an earlier message may have been lost."""

HOPPER_S = 1.0
"""Maximum time from the planned closing of the hopper to the reply of the service hopper/open
[s]."""

FEEDBACK_S = 0.5
"""Interval between two feedback messages of the node's actions [s]."""

WARN_PERIOD_S = 10.0
"""Minimum time between two warnings with the same text [s]."""

ROS = 0
"""Client number of all ROS clients, which count as one client. TCP clients have the numbers 1 and
above."""

ONE_MACHINE = ("127.0.0.1", "::1", "localhost")
"""Addresses of the TCP server that other machines cannot reach."""

STOPPED = "the feeder was deactivated"

NEED_A_PERSON = (
    TaskStatus.STOPPED, TaskStatus.CANCELED, TaskStatus.PREEMPTED, TaskStatus.DRIVER_STOPPED,
)  # fmt: skip
"""Values of `TaskStatus.reason`. If the planner's task ends with one of these reasons, a person
must call resume_feeding. With such a reason, either another client has ended the task, or a person
must also enable the motors."""

BY_PERSON = (
    DriverStatus.SWITCHED_OFF, DriverStatus.EMERGENCY_STOP, DriverStatus.POWER_CUT,
    DriverStatus.STOP_UNANSWERED,
)  # fmt: skip
"""Values of `DriverStatus.reason` after which a person must call resume_feeding. With these values,
the motors were switched off or stopped on request, the driver was deactivated, or the motor
controller did not acknowledge a stop."""

Replied = Callable[[Reply], None]


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the feeder."""

    recipe: str = parameter(
        "feed",
        "Recipe: a scenario of kind feed. Name in config/scenarios, or path of a .yaml file.",
    )
    host: str = parameter(
        "127.0.0.1", "Address of the TCP server for robots. The server requires no password. "
        "0.0.0.0 means all networks.",
    )  # fmt: skip
    port: int = parameter(7171, "TCP port. 0 means any free port, which is logged.", 0, 65535)
    hand_eye: str = parameter(
        "", "File of points (YAML) that define the plate's pose in the robot's frame. If it is "
        "empty, the robot receives positions in plate_home.",
    )  # fmt: skip


class FeederNode(SafeLifecycleNode[Options]):
    """Node `feeder`. The node gives parts to robots one by one, while the planner moves the next
    parts to places where a robot can pick them.

    Actions: get_part and purge_plate. Services: part_taken, prepare_part, part_quantity, and
    resume_feeding, which a person calls after a stop. A TCP server serves robots that do not use
    ROS. The node subscribes to feed_status, task_status and driver_status. The node publishes
    feed_orders and diagnostics. When a robot's command requires it, the node sends the action goal
    feed_parts to the planner. The node opens the hopper with the service hopper/open.
    """

    def __init__(self) -> None:
        super().__init__("feeder", Options)
        self._server: RobotServer | None = None
        # calls that the server's thread has requested
        self._inbox: deque[Callable[[], None]] = deque()
        # Results that no client has fetched yet. The keys are the ids of the goals.
        self._results: dict[bytes, tuple[Reply, Part | None]] = {}
        self._enabled_at: Any = None  # last known time at which the motors were enabled
        self._stopped = ""  # reason of the stop that was active when the node was deactivated
        self.report(self._diagnose, self._diagnostic_values)

    def configure(self) -> None:
        """Read the recipe and the hand-eye file, and create actions and services."""
        options = self.options
        scenario = load_scenario(options.recipe)
        self._rig = load_rig(options.rig_file or scenario.rig)
        if not isinstance(scenario.task, FeedTask):
            raise PlateError(f"recipe is {options.recipe}, allowed: a scenario of kind feed")
        check_scenario(scenario, self._rig)
        self._recipe = scenario.task
        self._hand_eye = load_hand_eye(options.hand_eye) if options.hand_eye else HandEye()
        self._orders = self.managed_publisher(FeedOrderMsg, "feed_orders", DATA)
        self.managed_subscription(FeedStatus, "feed_status", self._on_status, DATA)
        self.managed_subscription(TaskStatus, "task_status", self._on_task, LATCHED)
        self.managed_subscription(DriverStatus, "driver_status", self._on_driver, LATCHED)
        self.managed_service(PartTaken, "part_taken", self._on_taken)
        self.managed_service(PreparePart, "prepare_part", self._on_prepare)
        self.managed_service(Trigger, "resume_feeding", self._on_resume)
        quantity = self.create_service(
            PartQuantity, "part_quantity", self._on_quantity, qos_profile=CALLS
        )
        self.keep(self.destroy_service, quantity)
        self._hopper: Any = None
        if self._recipe.hopper is not None:
            self._hopper = self.create_client(OpenHopper, "hopper/open", qos_profile=CALLS)
            self.keep(self.destroy_client, self._hopper)
        for action, name, accepted in (
            (GetPart, "get_part", self._on_get_part),
            (PurgePlate, "purge_plate", self._on_purge),
        ):
            server = ActionServer(
                self, action, name, self._make_result, handle_accepted_callback=accepted,
                cancel_callback=self._on_cancel, result_timeout=RESULT_S,
            )  # fmt: skip
            self.keep(ActionServer.destroy, server)
        _, goal = scenario_to_goal(scenario)
        self._task = FeedGoal(self, goal, self._on_end)
        self.keep(FeedGoal.close, self._task)
        self.managed_timer(STEP_S, self._step_rules)
        self.managed_timer(FEEDBACK_S, self._publish_feedback)

    def begin(self) -> None:
        """Reset all state except a stop that waits for resume_feeding. Then start the TCP server
        for robots."""
        options = self.options
        self._feeder = Feeder(self._recipe, self._rig)
        if self._stopped:
            self._feeder.stop(self._stopped)
        self._driver: DriverStatus | None = None
        # State and reason in the last task_status.
        self._last_task = TaskStatus.IDLE, TaskStatus.NONE
        # ready parts in the newest status; the keys are the ids of the parts
        self._parts: dict[str, Part] = {}
        # for each waiting client: the function that sends its reply
        self._waiting: dict[int, Replied] = {}
        self._goal: Any = None  # action goal of a ROS client that waits for its result
        self._order, self._ordered = FeedOrder(), -math.inf
        self._hopper_problem = ""
        # pending reply of the hopper, and its deadline
        self._opening: tuple[Any, float] | None = None
        self._inbox.clear()
        self._server = RobotServer(
            options.host, options.port, self._on_command, self._on_disconnect
        )
        self.get_logger().info(
            f"the server for robots listens at {options.host}:{self._server.port}"
        )
        if options.host not in ONE_MACHINE:
            self.get_logger().warning(
                f"any machine that can reach {options.host} can command the feeder"
            )

    def rest(self) -> None:
        """Reply to waiting commands, end the planner's task, and stop the TCP server."""
        self._stopped = self._feeder.stopped.removeprefix(core.WAITS)
        self._feeder.task_ended(STOPPED)
        self._step_rules()
        server, self._server = self._server, None
        if server is not None:
            server.close()

    # The rules

    def _step_rules(self) -> None:
        """Evaluate the rules with `Feeder.step`, and execute the actions that it returns."""
        now = time.monotonic()
        output = self._feeder.step(now)
        self._task.request(output.run)
        if self._task.runs:
            self._publish_order(output.order, now)
        if self._opening is not None and now >= self._opening[1]:
            self._hopper.remove_pending_request(self._opening[0])
            self._opening = None
            self._warn_of_hopper("the service hopper/open does not reply; check the hopper's node")
        if output.open_s is not None:
            self._open_hopper(output.open_s, now)
        for client, reply in output.replies:
            if reply.code is Code.HOPPER_EMPTY and self._hopper_problem:
                reply = replace(reply, text=f"{reply.text}; {self._hopper_problem}")
            waiting = self._waiting.pop(client, None)  # type: ignore[call-overload]
            if waiting is not None:
                waiting(reply)

    def _publish_order(self, order: FeedOrder, now: float) -> None:
        if order != self._order or now > self._ordered + ORDER_S:
            self._order, self._ordered = order, now
            stamp = self.get_clock().now().to_msg()
            self._orders.publish(order_to_msg(order, stamp))

    def _open_hopper(self, open_s: float, now: float) -> None:
        if not self._hopper.service_is_ready():
            self._warn_of_hopper("there is no service hopper/open; start the hopper's node")
            return

        def on_answer(future: Any) -> None:
            response = future.result()
            self._opening, self._hopper_problem = None, ""
            if response is not None and not response.success:
                self._warn_of_hopper(f"hopper/open: {response.message or 'refused'}")

        request = OpenHopper.Request(duration_s=float(open_s))
        future = self._hopper.call_async(request)
        self._opening = future, now + open_s + HOPPER_S
        future.add_done_callback(on_answer)

    def _warn_of_hopper(self, text: str) -> None:
        self._hopper_problem = text
        self.get_logger().warning(text, throttle_duration_sec=WARN_PERIOD_S)

    def _reply_or_wait(self, client: int, reply: Reply | None, replied: Replied) -> None:
        """Send the reply to a command. If `reply` is None, a later `Feeder.step` returns the reply,
        which is then sent."""
        if reply is None:
            self._waiting[client] = replied
        else:
            replied(reply)
        self._step_rules()

    # From the planner

    def _on_status(self, msg: FeedStatus) -> None:
        if not self._task.runs or msg.mode not in tuple(FeedMode):
            return
        self._parts = {part.id: part for part in msg.ready}
        status = core.FeedStatus(
            stamp=seconds(msg.header.stamp),
            mode=FeedMode(msg.mode),
            at_rest=msg.at_rest,
            ready=tuple(
                ReadyPart(part.id, part.x, part.y, part.angle, tuple(part.covariance.tolist()))
                for part in msg.ready
            ),
            seen={seen_class.type: seen_class.count for seen_class in msg.seen},
            discharged=msg.discharged,
            lost=msg.lost,
        )
        self._feeder.receive_status(status, time.monotonic())
        self._step_rules()

    def _on_task(self, msg: TaskStatus) -> None:
        before, self._last_task = self._last_task, (msg.state, msg.reason)
        # task_status reports the end of a task repeatedly, but the stop of an idle planner only
        # once.
        is_repeated = msg.state != TaskStatus.IDLE and self._last_task == before
        if msg.reason in (TaskStatus.STOPPED, TaskStatus.DRIVER_STOPPED) and not is_repeated:
            self._stop_until_resumed(f"the planner was stopped: {msg.text}")
        self._task.on_task_status(msg)

    def _on_driver(self, msg: DriverStatus) -> None:
        self._driver = msg
        if msg.reason in BY_PERSON:
            self._stop_until_resumed(f"driver: {msg.text}")
        if msg.state == DriverStatus.READY:
            before, self._enabled_at = self._enabled_at, msg.enabled_at
            if before not in (None, msg.enabled_at) and not self._feeder.stopped:
                self._stop_until_resumed("the motors were enabled again after a stop")

    def _on_end(self, status: TaskStatus) -> None:
        self.get_logger().info(f"no longer feeding: {status.text}")
        if status.reason in NEED_A_PERSON:
            self._feeder.stop(status.text)
        else:
            self._feeder.task_ended(status.text)
        if self.active:
            self._step_rules()

    def _stop_until_resumed(self, why: str) -> None:
        """End the task, and refuse commands that move the plate until a person calls
        resume_feeding."""
        if not self._feeder.stopped:
            self.get_logger().info(f"no longer feeding: {why}")
        self._feeder.stop(why)
        self._step_rules()

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        driver = self._driver
        response.success = driver is None or driver.state == DriverStatus.READY
        if driver is not None and not response.success:
            response.message = f"driver: {driver.text}, allowed: ready"
            return response
        was = self._feeder.stopped
        self._feeder.resume()
        response.message = f"the next command starts feeding; state before: {was or 'not stopped'}"
        self.get_logger().info(response.message)
        return response

    # Over ROS

    def _on_get_part(self, goal: Any) -> None:
        request = goal.request
        if not self.active:
            self._finish_goal(goal, Reply(Code.STOPPED, STOPPED))
            return
        reply = self._feeder.get_part(
            ROS, request.type, _read_pick(request.pick), request.timeout_s, now=time.monotonic()
        )
        self._accept_goal(goal, reply)

    def _on_purge(self, goal: Any) -> None:
        if not self.active:
            self._finish_goal(goal, Reply(Code.STOPPED, STOPPED))
            return
        reply = self._feeder.purge(ROS, goal.request.timeout_s, now=time.monotonic())
        self._accept_goal(goal, reply)

    def _accept_goal(self, goal: Any, reply: Reply | None) -> None:
        if reply is None:
            self._goal = goal
        self._reply_or_wait(ROS, reply, lambda reply: self._finish_goal(goal, reply))

    def _on_cancel(self, goal: Any) -> CancelResponse:
        if goal is not self._goal:
            return CancelResponse.REJECT
        self._feeder.cancel(ROS)
        self._waiting.pop(ROS, None)
        self._finish_goal(goal, Reply(Code.CANCELED, "canceled"))
        self._step_rules()
        return CancelResponse.ACCEPT

    def _finish_goal(self, goal: Any, reply: Reply) -> None:
        """Complete a goal. `_make_result` returns its result."""
        if goal is self._goal:
            self._goal = None
        part = None if reply.part is None else self._parts[reply.part.id]
        self._results[bytes(goal.goal_id.uuid)] = reply, part
        goal.execute()

    def _make_result(self, goal: Any) -> Any:
        reply, part = self._results.pop(bytes(goal.goal_id.uuid))
        if reply.code.done:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        if isinstance(goal.request, PurgePlate.Goal):
            return PurgePlate.Result(success=reply.code.done, message=reply.text, left=reply.left)
        result = GetPart.Result(success=reply.code.done, message=reply.text)
        if reply.part is not None:
            now = self.get_clock().now()
            left = reply.valid_until - time.monotonic()
            result.part = part
            result.pose = pose_to_msg(self._hand_eye.part(reply.part))
            result.pose.header.frame_id = self._hand_eye.frame
            add_prefix(result.pose, self.options.frame_prefix)
            result.pose.header.stamp = now.to_msg()
            result.valid_until = to_time(now.nanoseconds + round(1e9 * left))
        return result

    def _publish_feedback(self) -> None:
        if self._goal is None:
            return
        if isinstance(self._goal.request, PurgePlate.Goal):
            left = sum(self._feeder.quantity().seen.values())
            self._goal.publish_feedback(PurgePlate.Feedback(left=left))
        else:
            self._goal.publish_feedback(
                GetPart.Feedback(doing=self._activity_text(time.monotonic()))
            )

    def _on_taken(
        self, request: PartTaken.Request, response: PartTaken.Response
    ) -> PartTaken.Response:
        return self._fill_response(
            self._feeder.part_taken(ROS, request.id, request.taken), response
        )

    def _on_prepare(
        self, request: PreparePart.Request, response: PreparePart.Response
    ) -> PreparePart.Response:
        pick, now = _read_pick(request.pick), time.monotonic()
        return self._fill_response(
            self._feeder.prepare_part(ROS, request.type, pick, now=now), response
        )

    def _fill_response(self, reply: Reply, response: Any) -> Any:
        response.success, response.message = reply.code.done, reply.text
        self._step_rules()
        return response

    def _on_quantity(
        self, request: PartQuantity.Request, response: PartQuantity.Response
    ) -> PartQuantity.Response:
        if self.active:
            quantity = self._feeder.quantity()
            response.seen = [PartCount(type=k, count=n) for k, n in quantity.seen.items()]
            response.ready, response.taken = quantity.ready, quantity.taken
            response.discharged, response.lost = quantity.discharged, quantity.lost
        return response

    # The functions for TCP are called on the server's thread. These functions pass the commands to
    # the thread of the ROS node.

    def _on_command(self, client: int, command: Command, answer: Answer) -> None:
        self._schedule(lambda: self._execute_command(client, command, answer))

    def _on_disconnect(self, client: int) -> None:
        self._schedule(lambda: self._remove_client(client))

    def _schedule(self, work: Callable[[], None]) -> None:
        executor = self.executor
        if executor is not None:
            self._inbox.append(work)
            executor.create_task(self._run_scheduled)

    def _run_scheduled(self) -> None:
        if self._inbox and self.active:
            self._inbox.popleft()()

    def _remove_client(self, client: int) -> None:
        self._feeder.remove_client(client)
        self._waiting.pop(client, None)
        self._step_rules()

    def _execute_command(self, client: int, command: Command, answer: Answer) -> None:
        """Execute a command that a robot has sent over TCP."""
        feeder, now = self._feeder, time.monotonic()

        def send_reply(reply: Reply) -> None:
            text = reply.text
            if reply.part is not None:
                part = self._hand_eye.part(reply.part)
                text = part_text(part, reply.valid_until - time.monotonic())
            elif command.name == "purge" and reply.code.done:
                text = f"left={reply.left}"
            answer(reply.code, text)

        if command.name == "get_part":
            reply = feeder.get_part(client, command.label, None, command.timeout_s, now=now)
        elif command.name == "purge":
            reply = feeder.purge(client, command.timeout_s, now=now)
        elif command.name == "prepare_part":
            reply = feeder.prepare_part(client, command.label, now=now)
        elif command.name == "part_taken":
            reply = feeder.part_taken(client, command.part, command.taken)
        elif command.name == "part_quantity":
            reply = Reply(Code.DONE, quantity_text(feeder.quantity()))
        else:
            reply = Reply(Code.DONE, self._state_text(client, now))
        self._reply_or_wait(client, reply, send_reply)

    def _state_text(self, client: int, now: float) -> str:
        feeder, kept = self._feeder, self._feeder.reserved
        hopper = "none" if self._recipe.hopper is None else "ok"
        if feeder.hopper_empty:
            hopper = "empty"
        text = f"state={feeder.state(now).value} ready={feeder.quantity().ready} hopper={hopper}"
        if kept is not None:
            text += f" id={kept.part.id}" if kept.client == client else ""
            text += f" valid_s={max(kept.until - now, 0.0):.1f}"
        return text + (" call=resume_feeding" if feeder.stopped else "")

    # Diagnostics

    def _activity_text(self, now: float) -> str:
        quantity = self._feeder.quantity()
        return (
            f"{self._feeder.state(now).value}: {quantity.ready} of "
            f"{sum(quantity.seen.values())} parts on the plate are ready"
        )

    def _diagnose(self, now: float) -> Finding:
        """Return the most severe problem of the feeder, see `plate_core.status`."""
        feeder, quantity = self._feeder, self._feeder.quantity()
        found: list[Finding] = []
        if text := feeder.no_status_text(now):
            found.append(Finding(Level.STALE, text))
        if feeder.stopped:
            found.append(Finding(Level.WARN, feeder.stopped))
        if feeder.hopper_empty:
            found.append(Finding(Level.WARN, "the hopper is empty"))
        if self._hopper_problem:
            found.append(Finding(Level.WARN, self._hopper_problem))
        if quantity.lost:
            found.append(Finding(Level.WARN, f"{quantity.lost} parts left the plate over an edge"))
        return combined(found, self._activity_text(now))

    def _diagnostic_values(self) -> Mapping[str, Any]:
        quantity, server = self._feeder.quantity(), self._server
        return {
            "state": self._feeder.state(time.monotonic()).value,
            "on_plate": sum(quantity.seen.values()),
            "ready": quantity.ready,
            "taken": quantity.taken,
            "discharged": quantity.discharged,
            "lost": quantity.lost,
            "robots": 0 if server is None else server.clients,
            "port": 0 if server is None else server.port,
            "hand_eye_residual_mm": f"{1e3 * self._hand_eye.residual_m:.3f}",
        }


def _read_pick(msgs: list[FeedPick]) -> Pick | None:
    """Return the pick of a request, or None if the request has no pick. If the pick contains no
    number of ready parts, the number 1 is used."""
    if not msgs:
        return None
    pick = msg_to_pick(msgs[0])
    return replace(pick, ready=pick.ready or 1)


def pose_to_msg(part: ReadyPart) -> PoseWithCovarianceStamped:
    """Convert the pose of a part to a message. The stamp and the frame of the message stay
    empty."""
    msg = PoseWithCovarianceStamped()
    pose = msg.pose.pose
    pose.position.x, pose.position.y = float(part.x), float(part.y)
    pose.orientation.z, pose.orientation.w = math.sin(part.angle / 2), math.cos(part.angle / 2)
    covariance = np.zeros((6, 6))
    rows = [0, 1, 5]  # x, y, and the angle about z
    covariance[np.ix_(rows, rows)] = np.reshape(part.covariance, (3, 3))
    msg.pose.covariance = covariance.ravel()
    return msg


def main() -> None:
    """Run the node."""
    run_node(FeederNode, Options)
