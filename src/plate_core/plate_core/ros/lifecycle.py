"""Base class and start function of this project's lifecycle nodes.

A `SafeLifecycleNode` brings its hardware to rest before it leaves the active state for any reason,
and destroys all objects that it has created. `start_nodes` configures and activates nodes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.time_source import USE_SIM_TIME_NAME
from rclpy.timer import Timer

from ..errors import PlateError
from ..publisher_monitor import PublisherMonitor
from ..status import Finding, Level
from .diagnostics import Diagnostics
from .frames import add_prefix
from .params import Spec, declare, follow, parameter, set_parameters
from .qos import CALLS
from .rclpy_workarounds import RclpyLifecycleNode, log_exceptions

UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"
"""Name that ROS gives to a node if it has discovered only one of its topics so far."""

CLOCK = "/clock"
"""Topic of simulated time. Two publishers would make the time of all nodes jump."""

WARN_S = 2.0
"""Minimum time between two warnings of the same kind [s]."""


@dataclass(frozen=True)
class NodeOptions:
    """Parameters of all nodes of the control loop."""

    rig_file: str = parameter("", "Rig file (YAML). If it is empty, the default rig is used.")
    frame_prefix: str = parameter(
        "",
        "Prefix of tf frames, such as left/, that separates two plates.",
    )
    autostart: bool = parameter(
        True,
        "Whether the node configures and activates itself at start.",
        fixed=True,
    )
    end_with_parent: bool = parameter(
        True, "Whether the node ends when the process that started it ends.", fixed=True
    )


Options = TypeVar("Options", bound=NodeOptions)


class SafeLifecycleNode(RclpyLifecycleNode, Generic[Options]):
    """A lifecycle node that always calls `rest` before it stops being active.

    A subclass creates its objects in `configure`, by the methods `managed_...` or by `keep`. A
    subclass implements `begin`, `before_end`, `rest`, `release` and `retune` if necessary. Managed
    objects work only while the node is active and are destroyed at clean-up. `run_node` calls
    `start_nodes`, which configures and activates the node unless its parameter `autostart` is
    false.

    Parameters
    ----------
    name : str
    kind : type
        Dataclass of the parameters. The parameters are read when the node is configured. Live
        parameters are also read when they change.

    Attributes
    ----------
    options : Options
        Values of the parameters that the node uses.
    active : bool
    configuring : bool
        Whether the node is being configured. This may take long.
    """

    def __init__(self, name: str, kind: type[Options]) -> None:
        super().__init__(name)
        self.configuring = self.configured = self.active = False
        self._closed = False
        self._publisher_monitors: dict[str, PublisherMonitor] = {}
        self._kept: list[tuple[Callable[[Any], Any], Any]] = []
        self.options = self._given = declare(self, kind)
        self._follow = follow(self, self._given, self._apply_options, self._active_refusal)
        # `_refuse_clock_change` is added last, because rclpy calls the callbacks in reverse order.
        self.add_on_set_parameters_callback(self._refuse_clock_change)

    # Methods that a subclass implements

    def configure(self) -> None:
        """Create all objects that the node needs, according to `options`."""

    def begin(self) -> None:
        """Prepare for work. `active` becomes True immediately afterwards."""

    def before_end(self) -> None:
        """Complete the work that must be done before the process ends. This method is called only
        while the node is active."""

    def rest(self) -> None:
        """Stop all motion."""

    def release(self) -> None:
        """Release resources that do not belong to ROS."""

    def retune(self) -> None:
        """Apply `options` after a live parameter has changed. This method is called only while the
        node is configured.

        Raise a `PlateError` if the options are inconsistent. After this error, the previous options
        remain in use.
        """

    # Methods that a subclass calls to create objects

    def keep(self, destroy: Callable[[Any], Any], *things: Any) -> None:
        """Register objects. When the node is cleaned up, it calls `destroy` with each object."""
        self._kept += [(destroy, thing) for thing in things]

    def managed_publisher(self, kind: type, topic: str, qos: QoSProfile) -> Any:
        """Return a publisher that publishes only while the node is active. The publisher puts the
        value of the parameter `frame_prefix` before the names of this project's frames."""
        publisher = self.create_lifecycle_publisher(kind, topic, qos)
        prefix, publish = self.options.frame_prefix, publisher.publish

        def publish_prefixed(msg: Any) -> None:
            add_prefix(msg, prefix)
            publish(msg)

        if prefix:
            publisher.publish = publish_prefixed
        self.keep(self.destroy_lifecycle_publisher, publisher)
        return publisher

    def managed_subscription(
        self,
        kind: type,
        topic: str,
        on_message: Callable[[Any], None],
        qos: QoSProfile,
        one_publisher: bool = False,
    ) -> None:
        """Call `on_message` with each message that arrives while the node is active.

        If `one_publisher` is True, messages of a second publisher are ignored.
        `PublisherMonitor.accepts` detects these messages.
        """
        monitor = self._publisher_monitors[topic] = PublisherMonitor()

        def callback(msg: Any, info: dict[str, Any]) -> None:
            follows = monitor.accepts(info["publication_sequence_number"], time.monotonic())
            if self.active and (follows or not one_publisher):
                on_message(msg)

        subscription = self.create_subscription(kind, topic, callback, qos)  # type: ignore[arg-type]
        self.keep(self.destroy_subscription, subscription)

    def managed_service(self, kind: type, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Offer a service. While the node is active, `answer` computes the replies. Otherwise calls
        are refused."""

        def callback(request: Any, response: Any) -> Any:
            if self.active:
                return answer(request, response)
            response.success = False
            response.message = f"{self.get_name()} is inactive, allowed: active"
            return response

        service = self.create_service(kind, name, callback, qos_profile=CALLS)
        self.keep(self.destroy_service, service)

    def managed_timer(
        self, period_s: float, tick: Callable[[], Any], clock: Clock | None = None
    ) -> Timer:
        """Call `tick` every `period_s` [s] while the node is active. The default clock is the
        steady clock."""

        def callback() -> None:
            if self.active:
                tick()

        clock = clock or Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(period_s, callback, clock=clock)
        self.keep(self.destroy_timer, timer)
        return timer

    def second_publisher(self, topic: str) -> str:
        """Return an error message if several nodes publish a topic that only one node is allowed to
        publish. Otherwise return an empty text."""
        full = self.resolve_topic_name(topic)
        if self.count_publishers(full) < 2:
            return ""
        found, prefix = self.get_publishers_info_by_topic(full), f"{self.get_namespace()}/"
        # Count the names of nodes instead of publishers. A killed node stays listed for a while,
        # together with its restarted instance. Ignore unknown names, because the name of a new node
        # is unknown at first.
        names = {
            f"{publisher.node_namespace}/{publisher.node_name}".removeprefix(prefix)
            for publisher in found
            if publisher.node_name != UNKNOWN_NAME
        }
        listed = ", ".join(sorted(names)) or "names unknown"
        if len(names) > 1:
            return f"{len(names)} nodes publish {topic} ({listed}), allowed: one"
        if topic in self._publisher_monitors and self._publisher_monitors[topic].has_two(
            time.monotonic()
        ):
            return f"two nodes with the same name publish {topic} ({listed}), allowed: one"
        return ""

    def second_clock(self) -> str:
        """Return an error message if this node uses simulated time that several nodes publish.
        Otherwise return an empty text."""
        simulated = self.get_parameter(USE_SIM_TIME_NAME).value
        return self.second_publisher(CLOCK) if simulated else ""

    def clock_problem(self) -> str:
        """Return the reason why this node has no valid simulated time. If there is none, or if the
        node uses no simulated time, return an empty text."""
        simulated = self.get_parameter(USE_SIM_TIME_NAME).value
        if simulated and not self.count_publishers(self.resolve_topic_name(CLOCK)):
            return f"use_sim_time is true, but no node publishes {CLOCK}"
        return self.second_clock()

    def report(
        self,
        find: Callable[[float], Finding],
        values: Callable[[], Mapping[str, Any]],
        hardware_id: str = "",
        reported: Callable[[], None] = lambda: None,
        stamp: Callable[[], Time] | None = None,
    ) -> Diagnostics:
        """Publish diagnostics. While the node is not active, the diagnostics contain the state of
        the node and, after an error, the reason.

        Call this method in the constructor. The parameters are the same as in `Diagnostics`, except
        `hardware_id`. This argument is a text, not a function. Default: the name of the rig.
        """

        def inactive_finding() -> Finding:
            state = "inactive" if self.configured else "unconfigured"
            if self.failure is not None:
                return Finding(Level.ERROR, f"{state}: {self.failure}")
            return Finding(Level.WARN, state)

        def finding(now: float) -> Finding:
            found, problem = find(now), self.clock_problem()
            if not problem or problem in found.message:
                return found
            level = max(found.level, Level.WARN, key=lambda each: each.rank)
            return Finding(level, f"{found.message}; {problem}")

        def report_stamp() -> Time:
            return stamp() if stamp and self.active else self.get_clock().now().to_msg()

        return Diagnostics(
            self,
            lambda now: finding(now) if self.active else inactive_finding(),
            lambda: values() if self.active else {},
            lambda: hardware_id or Path(self.options.rig_file).stem or "default",
            lambda: reported() if self.active else None,
            report_stamp,
        )

    # Parameters

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as `set_parameters` in params describes. The parameter services call this
        method, for example for `ros2 param`."""
        return set_parameters(self, parameter_list, super().set_parameters_atomically)

    def _active_refusal(self, name: str, spec: Spec) -> str:
        if spec.live or not self.active:
            return ""
        return (
            f"parameter {name} is only read when {self.get_name()} is configured, "
            "allowed: changes while the node is not active"
        )

    def _refuse_clock_change(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a change of the clock while the node is active, because rclpy's callback would
        apply the change immediately."""
        if not self.active or all(item.name != USE_SIM_TIME_NAME for item in parameters):
            return SetParametersResult(successful=True)
        reason = (
            f"parameter {USE_SIM_TIME_NAME} changes the clock of {self.get_name()}, "
            "allowed: changes while the node is not active"
        )
        return SetParametersResult(successful=False, reason=reason)

    def _apply_options(self, given: Options) -> None:
        if not self.configured:
            self.options = self._given = given
            return
        live = [item.name for item in fields(given) if item.metadata["spec"].live]
        before = self.options
        self.options = replace(before, **{name: getattr(given, name) for name in live})
        if self.options != before:
            try:
                self.retune()
            except PlateError:
                self.options = before
                raise
        self._given = given

    # Transitions

    @log_exceptions
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `configure`. If this fails, release everything that this method has created."""
        self.failure, self.options = None, self._given
        self.configuring = True
        try:
            self.configure()
            result = super().on_configure(state)
            self.configured = True
        finally:
            self.configuring = False
            if not self.configured:
                self._release()
        return result

    @log_exceptions
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `begin`, then start to process and to publish messages."""
        self.failure = None
        result = super().on_activate(state)
        try:
            self.begin()
            self.active = True
        finally:
            if not self.active:
                super().on_deactivate(state)
        self.get_logger().info("ready")
        return result

    @log_exceptions
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `rest`, then stop publishing."""
        self._deactivate()
        return super().on_deactivate(state)

    @log_exceptions
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that `on_configure` has created."""
        self._release()
        return super().on_cleanup(state)

    @log_exceptions
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `rest` and release everything."""
        self._deactivate()
        self._release()
        return super().on_shutdown(state)

    @log_exceptions
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Call `rest` if possible, release everything, and return to the state unconfigured."""
        try:
            self._deactivate()
        finally:
            self._release()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Call `rest`, release everything, and destroy the node. This method is also called when
        the process stops."""
        try:
            self.close()
        finally:
            super().destroy_node()

    def close(self) -> None:
        """Call `rest` and release everything, at most once. The node itself is not destroyed."""
        if self._closed:
            return
        self._closed = True
        try:
            if self.context.ok():
                # Call `_deactivate` without a lifecycle transition, because the signal may have
                # arrived during a transition.
                self._deactivate()
        finally:
            self.active = False
            self._release()

    def _deactivate(self) -> None:
        if self.active:
            self.active = False
            self.rest()

    def _release(self) -> None:
        self.configured = False
        kept, self._kept = self._kept, []
        for destroy, thing in kept:
            destroy(thing)
        self.release()


def start_nodes(*nodes: SafeLifecycleNode[Any]) -> None:
    """Configure all nodes, then activate all nodes, in the order of the arguments. Nodes whose
    parameter `autostart` is false are skipped.

    Raises
    ------
    Exception
        The exception of the transition that failed. For wrong input, the exception is a
        `PlateError`.
    """
    autostarted = [node for node in nodes if node.options.autostart]
    for trigger in ("trigger_configure", "trigger_activate"):
        for node in autostarted:
            node.starting = True
            try:
                done = getattr(node, trigger)() == TransitionCallbackReturn.SUCCESS
            finally:
                node.starting = False
            if not done and node.failure is not None:
                raise node.failure
