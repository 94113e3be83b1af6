"""Client of the planner's actions. The client sends goals, follows their progress and waits for
their results.

with PlateClient.connect() as plate:
    status = plate.run(load_scenario("sort_4"))
    print(status.text)
"""

from __future__ import annotations

import atexit
import ctypes
import os
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from plate_core import PlateError, choose_network, node_namespace
from plate_core.ros import (
    ACTIONS,
    DATA,
    LATCHED,
    REFUSED,
    action_name,
    diagnostics_topics,
    msg_to_reports,
    msg_to_targets,
    new_goal_id,
    scenario_to_goal,
    targets_to_msg,
)
from plate_core.tasks import PartTarget, Scenario
from plate_interfaces.msg import Targets, TaskProgress, TaskStatus

from ..messages import spin_until

DISCOVERY_S = 5.0
"""Maximum time for the discovery of the planner [s]."""

TIMEOUT_S = 2.0
"""Maximum time without feedback on a running task [s]. After this time, the client assumes that the
planner has ended."""

CANCEL_S = 5.0
"""Maximum time in which a canceled task must end [s]."""

AGAIN_S = 0.2
"""Time between two attempts to send a goal while the graph is not ready for it [s]."""

ANSWER_S = 1.0
"""Time without a reply after which the goal is sent again [s]. DDS may lose the first reply of a
planner that was just discovered."""

TAKEN_S = 0.5
"""Maximum time in which the planner usually takes new targets [s]. Before this time, a refusal in
the diagnostics may be about earlier targets."""

REFUSED_S = 5.0
"""Maximum time until the planner takes or refuses new targets [s]. It publishes diagnostics once
per second."""

SPIN_S = 0.1
"""Maximum time for which the background thread of `PlateClient.connect` waits for a message [s]."""

CLOSED = "the client is closed; call its methods inside its `with` block"

_NUMBERS = count(1)
"""Numbers of the nodes of `PlateClient.connect`. Two nodes with one name would share their log."""

Callback = Callable[[Any], None]

Until = Callable[[Callable[[], bool], float], bool]
"""Function that processes messages until a condition is true or until a timeout [s]. The function
returns whether the condition is true."""


def _until_of_closed(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Raise the PlateError of a closed client. This function replaces `PlateClient._until`."""
    raise PlateError(CLOSED)


def _skip_destructors() -> None:
    """Skip the destructors of C++ libraries when this forked process exits. The destructors of DDS
    need threads that only the parent process has, so they would crash the process."""
    libc = ctypes.CDLL(None)
    libc.on_exit(libc._exit, None)  # glibc calls `_exit` with the exit code


class TaskError(PlateError):
    """Error: a task was refused, or ended without success. `status` contains the reason."""

    def __init__(self, status: TaskStatus) -> None:
        super().__init__(status.text)
        self.status = status


class Task:
    """A goal that was sent, with its progress and result.

    Parameters
    ----------
    name : str
    send : callable
        Function that sends the goal, with callbacks for feedback and reply. The function uses the
        same goal id each time. Therefore the planner executes a repeated goal only once.
    check : callable, optional
        Function that raises a PlateError if the client is closed. `send` and `cancel` call it.

    Attributes
    ----------
    name : str
        Name of the action.
    progress : TaskProgress
        Newest progress.
    status : TaskStatus or None
        Result. None while the task is running.
    """

    def __init__(
        self,
        name: str,
        send: Callable[[Callback, Callback], None],
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self._send = send
        self._check = check
        self._sent = 0
        self.progress = TaskProgress()
        self.feedbacks = 0  # number of feedback messages
        self.status: TaskStatus | None = None
        self._handle: Any = None
        self._cancel = False

    @property
    def ended(self) -> bool:
        """Whether the task has ended, with or without success."""
        return self.status is not None

    @property
    def done(self) -> bool:
        """Whether the task has ended and its goal is reached."""
        return self.status is not None and self.status.state == TaskStatus.DONE

    @property
    def accepted(self) -> bool:
        """Whether the planner has accepted the goal. `cancel` has no effect before the planner has
        accepted the goal."""
        return self._handle is not None

    def has_begun(self) -> bool:
        """Whether the planner executes the task or has ended it."""
        return self.ended or (self.accepted and self.progress.parts_total > 0)

    def send(self) -> None:
        """Send the goal, or send it again."""
        self._sent += 1
        self._sent_at = time.monotonic()
        self._check()
        self._send(self._on_feedback, self._on_answer)

    def send_again(self) -> None:
        """Send the goal again if the planner has not replied in time."""
        if not self.accepted and not self.ended and time.monotonic() - self._sent_at > ANSWER_S:
            self.send()

    def cancel(self) -> None:
        """Ask the planner to end the task. `PlateClient.wait` returns when the task has ended."""
        self._cancel = True
        if self._handle is not None and not self.ended:
            self._check()
            self._handle.cancel_goal_async()

    def _on_feedback(self, msg: Any) -> None:
        self.progress = msg.feedback.progress
        self.feedbacks += 1

    def _on_answer(self, future: Any) -> None:
        if self.accepted:
            return
        self._handle = handle = future.result()
        # rclpy rejects a goal that is sent again with the same id. Therefore a rejection means a
        # refusal by the planner only if the goal was sent once.
        if not handle.accepted and self._sent == 1:
            self.status = TaskStatus(state=TaskStatus.ABORTED, text="the planner refused the goal")
            return
        handle.get_result_async().add_done_callback(self._on_result)
        if self._cancel:
            handle.cancel_goal_async()

    def _on_result(self, future: Any) -> None:
        status = future.result().result.status
        # A result with one of these states contains only default values: the planner has no data
        # about the goal.
        if status.state in (TaskStatus.IDLE, TaskStatus.RUNNING):
            status.state, status.text = TaskStatus.ABORTED, "the planner no longer knows the goal"
        self.status = status


class _BackgroundNode:
    """Node whose messages a background thread processes, for `PlateClient.connect`.

    Attributes
    ----------
    node : Node
    """

    def __init__(self, namespace: str) -> None:
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        name = f"plate_client_{os.getpid()}_{next(_NUMBERS)}"
        self.node = Node(name, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._process = os.getpid()
        self._closing = threading.Event()
        self._ended = threading.Event()
        # exceptions that ended the processing of messages
        self._problems: list[Exception] = []

    def start(self, close_client: Callable[[], None]) -> None:
        """Start the thread. At its end, the thread calls `close_client`."""
        self._close_client = close_client
        threading.Thread(target=self._spin, daemon=True).start()

    def until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition is true or until a timeout [s]. Return whether it is true.

        Raises
        ------
        PlateError
            If the client is closed.
        """
        held = spin_until(
            time.sleep,
            lambda: bool(self._problems) or self._is_closed() or condition(),
            timeout_s,
        )
        if self._problems:
            raise self._problems[0]
        if self._is_closed():
            raise PlateError(CLOSED)
        return held

    def end(self) -> None:
        """End the thread, which destroys the node."""
        self._closing.set()
        # Wait for an event, because `Thread.join` of some Pythons has an error: if Ctrl-C
        # interrupts it, the next call returns although the thread is still running.
        if os.getpid() == self._process:
            self._ended.wait()
        else:
            _skip_destructors()

    def _is_closed(self) -> bool:
        # a forked process has no background thread
        return self._closing.is_set() or os.getpid() != self._process

    def _spin(self) -> None:
        while not (self._closing.is_set() or self._problems):
            try:
                self._executor.spin_once(SPIN_S)
            except ExternalShutdownException as problem:
                self._problems.append(problem)  # `until` raises it in the thread of the caller
            except Exception:  # a callback has failed; continue with the next one
                self.node.get_logger().error(traceback.format_exc())
                self._closing.wait(SPIN_S)  # limits the rate of the log
        self._closing.wait()
        # Ctrl-C interrupts only the main thread. Therefore this thread destroys the node.
        try:
            self._close_client()
            self._executor.shutdown()
            self.node.destroy_node()
            rclpy.shutdown(context=self._context)
        finally:
            self._ended.set()


class PlateClient:
    """Client of the planner's actions that uses an existing node.

    Parameters
    ----------
    node : Node
        Node that is in the namespace of the planner.
    until : callable
        Function of the type `Until` that processes the messages of the node. Default:
        `rclpy.spin_once`.
    """

    def __init__(self, node: Node, until: Until | None = None) -> None:
        self.node = node
        self._until = until or self._spin_until
        self._clients = {name: ActionClient(node, kind, name) for name, kind in ACTIONS.items()}
        self._targets = node.create_publisher(Targets, "targets", DATA)
        self._current: tuple[PartTarget, ...] = ()  # targets of the running task
        self._refusal, self._refused_at = "", float("-inf")
        self._listeners = (
            node.create_subscription(Targets, "part_targets", self._on_targets, LATCHED),
            *(
                node.create_subscription(DiagnosticArray, topic, self._on_report, DATA)
                for topic in diagnostics_topics(node)
            ),
        )

    @classmethod
    @contextmanager
    def connect(cls, namespace: str = "") -> Iterator[PlateClient]:
        """Create a client that has its own node. The node uses the ROS domain in the environment
        variable ROS_DOMAIN_ID.

        A background thread processes the node's messages, so `Task.progress` is always current. All
        methods may be called in any thread. If a callback raises an exception, this exception is
        logged, and the client continues. At the end of the context, the client is closed.
        Methods that are still waiting in other threads then raise a PlateError. In a process that
        was created by `os.fork`, the client is also closed.

        Raises
        ------
        PlateError
            If `namespace` is not a namespace.
        """
        namespace = node_namespace(namespace)
        choose_network(os.environ)
        background = _BackgroundNode(namespace)
        client = cls(background.node, background.until)
        background.start(client.close)
        # If the thread still waits for messages when the interpreter ends, the process aborts.
        atexit.register(background.end)
        try:
            yield client
        finally:
            background.end()
            atexit.unregister(background.end)

    def close(self) -> None:
        """Destroy the action clients, the publisher and the subscriptions. The client does not
        destroy the node. Further calls do nothing."""
        if self._until is _until_of_closed:
            return
        self._until = _until_of_closed
        for client in self._clients.values():
            client.destroy()
        self.node.destroy_publisher(self._targets)
        for listener in self._listeners:
            self.node.destroy_subscription(listener)

    def found(self, name: str) -> bool:
        """Whether an action server with this name exists.

        Raises
        ------
        PlateError
            If the client is closed. The other methods raise the same error.
        """
        self._check_open()
        return bool(self._clients[name].server_is_ready())

    def _check_open(self) -> None:
        self._until(lambda: True, 0.0)  # a closed client raises its PlateError here

    def send(self, task: Scenario | Any, waiting: Callable[[str], None] = lambda why: None) -> Task:
        """Send a scenario, or a goal of one of the actions, without waiting for its result. If the
        planner is not found, `waiting` is called with the reason.

        Raises
        ------
        PlateError
            If no planner is found.
        """
        if isinstance(task, Scenario):
            name, goal = scenario_to_goal(task)
        else:
            name, goal = action_name(task), task
        client = self._clients[name]
        end = time.monotonic() + DISCOVERY_S
        while not self._until(client.server_is_ready, AGAIN_S):
            if time.monotonic() > end:
                raise PlateError(f"there is no action {name} in this ROS domain; start the planner")
            waiting(f"waiting for the action {name}, which a configured planner offers")
        number = new_goal_id()

        def send_goal(feedback: Callback, answer: Callback) -> None:
            client.send_goal_async(goal, feedback, number).add_done_callback(answer)

        sent = Task(name, send_goal, self._check_open)
        sent.send()
        return sent

    def move_targets(self, targets: Sequence[PartTarget]) -> None:
        """Replace targets of parts in a running task of kind `move`, and wait until the planner has
        taken them. Other parts keep their targets.

        Raises
        ------
        PlateError
            If no planner is found, or if the planner refuses a target. The planner still takes all
            other targets. If a part is unknown, the message contains the names of all parts.
        """
        if not self._until(lambda: self._targets.get_subscription_count() > 0, DISCOVERY_S):
            raise PlateError("no node in this ROS domain subscribes to targets; start the planner")
        msg = targets_to_msg(targets, self.node.get_clock().now().to_msg())
        requested, sent_at = set(msg_to_targets(msg)), time.monotonic()
        self._targets.publish(msg)

        def taken() -> bool:
            return requested <= set(self._current)

        def refused() -> bool:
            return self._refused_at > sent_at

        if self._until(taken, TAKEN_S):
            return
        self._until(lambda: taken() or refused(), REFUSED_S)
        if not taken():
            no_reply = "the planner has neither taken nor refused the targets; it may hang"
            raise PlateError(self._refusal if refused() else no_reply)

    def _on_targets(self, msg: Targets) -> None:
        self._current = msg_to_targets(msg)

    def _on_report(self, msg: DiagnosticArray) -> None:
        for report in msg_to_reports(msg, self.node.get_namespace()):
            refusal = report.values.get("refusal", "")
            if report.own and report.node == "planner" and refusal.startswith("targets: "):
                self._refusal, self._refused_at = refusal, time.monotonic()

    def wait(
        self,
        task: Task,
        timeout_s: float = float("inf"),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> TaskStatus:
        """Return the last status of a task. `meanwhile` is called repeatedly until the task has
        ended.

        Raises
        ------
        PlateError
            If the task does not end in time, or if the planner stops sending feedback.
        """
        end, feedbacks, waited_s = time.monotonic() + timeout_s, task.feedbacks, 0.0
        while not self._until(lambda: task.ended, AGAIN_S):
            waited_s = waited_s + AGAIN_S if task.feedbacks == feedbacks else 0.0
            feedbacks = task.feedbacks
            if waited_s > TIMEOUT_S:
                raise PlateError(
                    f"the planner has sent no message for {TIMEOUT_S:g} s, so it hangs or has "
                    "ended; the result of the task is unknown"
                )
            if time.monotonic() > end:
                raise PlateError(f"the task {task.name} has not ended within {timeout_s:g} s")
            task.send_again()
            meanwhile()
        assert task.status is not None
        return task.status

    def start(
        self,
        scenario: Scenario | Any,
        ready_timeout_s: float = DISCOVERY_S,
        waiting: Callable[[str], None] = lambda why: None,
    ) -> Task:
        """Send a goal. If the graph is not ready, the goal is sent again for at most
        `ready_timeout_s` [s]. During this time `waiting` is called with the reason.

        Raises
        ------
        TaskError
            If the goal is refused.
        """
        end = time.monotonic() + ready_timeout_s
        while True:
            task = self.send(scenario, waiting)
            try:
                for _ in range(round(DISCOVERY_S / AGAIN_S)):
                    if self._until(task.has_begun, AGAIN_S):
                        break
                    task.send_again()
            # the caller cannot cancel the task, because it has no handle of the task yet
            except KeyboardInterrupt:
                raise TaskError(self.cancel(task)) from None
            if not task.accepted:
                task.cancel()  # cancel the goal in case it still arrives
                raise PlateError(
                    f"the planner has not answered the goal within {DISCOVERY_S:g} s; it may hang"
                )
            if task.status is None or task.status.reason not in REFUSED:
                return task
            if task.status.reason != TaskStatus.NOT_READY or time.monotonic() > end:
                raise TaskError(task.status)
            waiting(str(task.status.text))
            self._until(lambda: False, AGAIN_S)

    def run(self, scenario: Scenario | Any, timeout_s: float = float("inf")) -> TaskStatus:
        """Execute a task, and return its last status. If the wait for the task ends early, because
        of Ctrl-C or a PlateError, the task is canceled.

        Raises
        ------
        TaskError
            If the task is refused, or if it ends without reaching its goal.
        PlateError
            In the same cases as `wait`.
        """
        task = self.start(scenario)
        try:
            status = self.wait(task, timeout_s)
        # the caller cannot cancel the task, because it has no handle of the task
        except (KeyboardInterrupt, PlateError):
            with suppress(PlateError):
                self.cancel(task)
            raise
        if status.state != TaskStatus.DONE:
            raise TaskError(status)
        return status

    def cancel(self, task: Task) -> TaskStatus:
        """Cancel a task, and return its last status.

        Ctrl-C ends the wait, but only after the planner has received the request.
        """
        requested = False
        while True:
            try:
                task.cancel()
                requested = True
                return self.wait(task, CANCEL_S)
            except KeyboardInterrupt:
                if requested and task.accepted:
                    raise

    def _spin_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        return spin_until(
            lambda wait_s: rclpy.spin_once(self.node, timeout_sec=wait_s), condition, timeout_s
        )
