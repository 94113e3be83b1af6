"""Lifecycle nodes: they start themselves, rest before they end, and leave nothing behind."""

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
from ..status import Finding, Level
from ..turns import Turns
from .diagnostics import Diagnostics
from .frames import add_prefix
from .params import Spec, declare, follow, parameter, set_parameters
from .qos import CALLS
from .rclpy_workarounds import RclpyLifecycleNode, logged

UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"
"""What ROS calls a node of which it knows no more yet than a topic."""

WARN_S = 2.0
"""Minimum time between two warnings of the same kind [s]."""


@dataclass(frozen=True)
class NodeOptions:
    """Parameters that all nodes of the loop have."""

    rig_file: str = parameter("", "Rig file (YAML); empty: the default rig.")
    frame_prefix: str = parameter(
        "", "Prefix of frame names, such as left/: two plates in one tf tree."
    )
    autostart: bool = parameter(
        True, "Configure and activate at start; false: others do this.", fixed=True
    )
    end_with_parent: bool = parameter(
        True, "End with the process that started it; false: keep running.", fixed=True
    )


Options = TypeVar("Options", bound=NodeOptions)


class SafeLifecycleNode(RclpyLifecycleNode, Generic[Options]):
    """A lifecycle node that rests before it stops being active, however it ends.

    A subclass makes things in `configure`, by the methods `managed_...` or handed to `keep`, and
    says what `begin`, `rest`, `release` and `retune` do. What is managed works only while the node
    is active, and is gone after clean-up. `start_nodes`, which `run_node` calls unless the
    parameter `autostart` is false, configures and activates it.

    Parameters
    ----------
    name : str
    kind : type
        Dataclass of its parameters, of which `options` are those in force: read when it is
        configured, live ones at any time.

    Attributes
    ----------
    options : Options
    active : bool
    configuring : bool
        Whether it is being configured, which may take long.
    """

    def __init__(self, name: str, kind: type[Options]) -> None:
        super().__init__(name)
        self.configuring = self.configured = self.active = False
        self._closed = False
        self._turns: dict[str, Turns] = {}
        self._kept: list[tuple[Callable[[Any], Any], Any]] = []
        self.options = self._given = declare(self, kind)
        self._follow = follow(self, self._given, self._on_options, self._fixed_now)
        self.add_on_set_parameters_callback(self._keep_clock)  # called first: the last one added is

    # What a subclass says

    def configure(self) -> None:
        """Make everything that the node needs, from `options`."""

    def begin(self) -> None:
        """Make ready for work: `active` is set next."""

    def rest(self) -> None:
        """Leave nothing moving."""

    def release(self) -> None:
        """Let go of what ROS does not know of."""

    def retune(self) -> None:
        """Take over `options` of which a live one has changed; called once configured. What does
        not fit together is refused by a `PlateError`: then the options before stay."""

    # What a subclass makes

    def keep(self, destroy: Callable[[Any], Any], *things: Any) -> None:
        """Have things destroyed at clean-up."""
        self._kept += [(destroy, thing) for thing in things]

    def managed_publisher(self, kind: type, topic: str, qos: QoSProfile) -> Any:
        """Return a publisher that is silent unless the node is active; to the names of our frames
        it adds the prefix."""
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
        heard: Callable[[Any], None],
        qos: QoSProfile,
        in_turn: bool = False,
    ) -> None:
        """Have `heard` called with what comes while the node is active; `in_turn`: but for single
        messages of strangers, as `Turns.came` tells them."""
        turns = self._turns[topic] = Turns()

        def callback(msg: Any, info: dict[str, Any]) -> None:
            follows = turns.came(info["publication_sequence_number"], time.monotonic())
            if self.active and (follows or not in_turn):
                heard(msg)

        subscription = self.create_subscription(kind, topic, callback, qos)  # type: ignore[arg-type]
        self.keep(self.destroy_subscription, subscription)

    def managed_service(self, kind: type, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Answer by `answer` while the node is active, and refuse while it is not."""

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
        """Have `tick` called every so often while the node is active, by the steady clock if no
        other one is given."""

        def callback() -> None:
            if self.active:
                tick()

        clock = clock or Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(period_s, callback, clock=clock)
        self.keep(self.destroy_timer, timer)
        return timer

    def rivals(self, topic: str) -> str:
        """Say that several nodes publish what only one may; "" if they do not."""
        full = self.resolve_topic_name(topic)
        if self.count_publishers(full) < 2:
            return ""
        found, own = self.get_publishers_info_by_topic(full), f"{self.get_namespace()}/"
        # By name: of a node that was killed and started again there are two for a while, and the
        # new one has no name yet.
        names = {
            f"{each.node_namespace}/{each.node_name}".removeprefix(own)
            for each in found
            if each.node_name != UNKNOWN_NAME
        }
        told = ", ".join(sorted(names)) or "without a name"
        if len(names) > 1:
            return f"{len(names)} nodes publish {topic} ({told}), allowed: one"
        if topic in self._turns and self._turns[topic].several(time.monotonic()):
            return f"two nodes of one name publish {topic} ({told}), allowed: one"
        return ""

    def report(
        self,
        find: Callable[[float], Finding],
        values: Callable[[], Mapping[str, Any]],
        hardware_id: str = "",
        reported: Callable[[], None] = lambda: None,
        stamp: Callable[[], Time] | None = None,
    ) -> Diagnostics:
        """Publish diagnostics, also while the node is not active: that, and why it is not.

        Call it in the constructor. The parameters are those of `Diagnostics`, except `hardware_id`:
        a name, by default the rig's.
        """

        def idle() -> Finding:
            state = "inactive" if self.configured else "unconfigured"
            if self.failure is not None:
                return Finding(Level.ERROR, f"{state}: {self.failure}")
            return Finding(Level.WARN, state)

        def now_or_seen() -> Time:
            return stamp() if stamp and self.active else self.get_clock().now().to_msg()

        return Diagnostics(
            self,
            lambda now: find(now) if self.active else idle(),
            lambda: values() if self.active else {},
            lambda: hardware_id or Path(self.options.rig_file).stem or "default",
            lambda: reported() if self.active else None,
            now_or_seen,
        )

    # Parameters

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters for the services and `ros2 param`; see `set_parameters` in params."""
        return set_parameters(self, parameter_list, super().set_parameters_atomically)

    def _fixed_now(self, name: str, spec: Spec) -> str:
        if spec.live or not self.active:
            return ""
        return (
            f"parameter {name} is read when {self.get_name()} is configured, "
            "allowed: while it is not active"
        )

    def _keep_clock(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse another clock in mid-task; rclpy's own callback changes it at once."""
        if not self.active or all(item.name != USE_SIM_TIME_NAME for item in parameters):
            return SetParametersResult(successful=True)
        reason = (
            f"parameter {USE_SIM_TIME_NAME} changes the clock of {self.get_name()}, "
            "allowed: while it is not active"
        )
        return SetParametersResult(successful=False, reason=reason)

    def _on_options(self, given: Options) -> None:
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

    @logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make everything, or nothing if that fails."""
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

    @logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen and to publish."""
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

    @logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest, then fall silent."""
        self._stop()
        return super().on_deactivate(state)

    @logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that on_configure made."""
        self._release()
        return super().on_cleanup(state)

    @logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest and release everything."""
        self._stop()
        self._release()
        return super().on_shutdown(state)

    @logged
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest if that still works, and begin anew from unconfigured."""
        try:
            self._stop()
        finally:
            self._release()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Rest, and release everything, also when the process has to stop."""
        try:
            self.close()
        finally:  # whatever that has raised
            super().destroy_node()

    def close(self) -> None:
        """Do so once, but leave the node itself to `destroy_node`."""
        if self._closed:
            return
        self._closed = True
        try:
            if self.context.ok():
                self._stop()  # not by a transition: the signal may have come within one
        finally:
            self.active = False
            self._release()

    def _stop(self) -> None:
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
    """Configure nodes, then activate them, in this order; but not those whose parameter `autostart`
    is false.

    Raises
    ------
    Exception
        What a transition has raised: a `PlateError` for wrong input.
    """
    own = [node for node in nodes if node.options.autostart]
    for trigger in ("trigger_configure", "trigger_activate"):
        for node in own:
            node.starting = True
            try:
                done = getattr(node, trigger)() == TransitionCallbackReturn.SUCCESS
            finally:
                node.starting = False
            if not done and node.failure is not None:
                raise node.failure
