"""Stops, enable, home and driver_status: a node with a participant and threads of its own."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.ros import CALLS, LATCHED, driver_status_to_msg, end_executor
from plate_core.standstill import Standstill
from plate_interfaces.msg import DriverStatus as DriverStatusMsg

from ..status import UNANSWERED
from ..transports import ANSWER_S, Condition

if TYPE_CHECKING:
    from ..node import DriverNode

STATE_PERIOD_S = 0.05
"""Time between checks whether driver_status has changed [s]."""

LIFE_PERIOD_S = 0.5
"""Time after which an unchanged driver_status is repeated [s]."""

FAREWELL_S = 0.5
"""How long to wait until the last messages have arrived [s]."""

END_S = 10.0
"""Longest wait for the thread that spins, and for those that answer [s]: one that outlives the
interpreter crashes the process, and on a busy machine half a second may pass before it runs
again."""

STILL_S = 1.0
"""A driver that stood still for longer [s] carries out no enable that was asked for meanwhile."""

THREADS = 128
"""So many calls may wait for an answer before the next one is late; made when they are needed."""


ENABLING = "enabling: driver_status tells when the motors are ready"
SILENT = "the device has not answered yet"
"""What an enable and a home say that are not settled when their caller gets an answer."""

LATE = "the driver itself stood still: call again"
"""What they say that may have waited for its end."""


class SafetyNode:
    """Stops, enable, home and driver_status, apart from all that cycles do: a participant of its
    own receives nothing else, threads of its own answer, and the clock is the steady one. Each call
    is answered within 0.5 s with what is known then; driver_status tells the rest.

    Parameters
    ----------
    driver : DriverNode
    """

    def __init__(self, driver: DriverNode) -> None:
        self._driver, self._latch = driver, driver.latch
        self._context = rclpy.Context()
        rclpy.init(
            args=[], context=self._context, domain_id=driver.context.get_domain_id(),
            signal_handler_options=SignalHandlerOptions.NO,
        )  # fmt: skip
        self.node = node = Node(
            f"{driver.get_name()}_safety", context=self._context,
            namespace=driver.get_namespace(), use_global_arguments=False,
            start_parameter_services=False,
        )  # fmt: skip
        group = ReentrantCallbackGroup()
        for kind, name, answer in (
            (Trigger, "emergency_stop", self._on_emergency_stop),
            (Trigger, "cut_power", self._on_cut_power),
            (SetBool, "enable", self._on_enable),
            (Trigger, "home", self._on_home),
        ):
            full = driver.resolve_service_name(name)
            call = self._guarded(answer)
            node.create_service(kind, full, call, qos_profile=CALLS, callback_group=group)
        topic = driver.resolve_topic_name("driver_status")
        self._statuses = node.create_publisher(DriverStatusMsg, topic, LATCHED)
        self._standstill = Standstill(STILL_S, time.monotonic())
        self._status: DriverStatus | None = None
        self._status_at = float("-inf")
        self._publishing = threading.Lock()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        own = MutuallyExclusiveCallbackGroup()
        node.create_timer(STATE_PERIOD_S, self.publish_status, clock=steady, callback_group=own)
        self._ended = False
        self._executor = MultiThreadedExecutor(THREADS, context=self._context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name="safety", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self._context.ok() and not self._ended:
                try:
                    self._executor.spin_once()  # at most until the timer ticks
                except ExternalShutdownException:
                    raise
                except Exception as error:
                    self.node.get_logger().error(f"safety: {error!r}")

    def _guarded(self, answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback that answers whatever goes wrong: these threads must not end."""

        def callback(request: Any, response: Any) -> Any:
            try:
                return answer(request, response)
            except Exception as error:
                self.node.get_logger().error(f"{type(request).__name__}: {error!r}")
                response.success, response.message = False, UNANSWERED
                return response

        return callback

    def publish_status(self) -> None:
        """Publish driver_status if it has changed, or was not published for a while."""
        with self._publishing:
            status, now = self._driver.status, time.monotonic()
            self._standstill.is_late(now)
            if status == self._status and now - self._status_at < LIFE_PERIOD_S:
                return
            self._status, self._status_at = status, now
            stamp = self._driver.get_clock().now().to_msg()
            self._statuses.publish(driver_status_to_msg(status, stamp))

    def close(self) -> None:
        """Publish the last state, and answer no more; once."""
        if self._ended:
            return
        self.publish_status()
        self._statuses.wait_for_all_acked(Duration(seconds=FAREWELL_S))
        self._ended = True
        self._thread.join(END_S)
        end_executor(self._executor, END_S)

    def destroy(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _on_emergency_stop(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        return self._stop_and_log(
            response, DriverReason.EMERGENCY_STOP,
            over=(DriverReason.NONE, DriverReason.SWITCHED_OFF),
        )  # fmt: skip

    def _on_cut_power(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._stop_and_log(response, DriverReason.POWER_CUT, over=())

    def _stop(
        self, response: Any, reason: DriverReason,
        over: tuple[DriverReason, ...] = (DriverReason.NONE,),
    ) -> Any:  # fmt: skip
        """Close the latch, have the motors stop, and answer whether they do."""
        self._latch.close(reason, over)
        response.success = self._driver.stop_motors(cut=reason is DriverReason.POWER_CUT)
        response.message = self._driver.status.text if response.success else UNANSWERED
        self.publish_status()
        return response

    def _stop_and_log(
        self, response: Any, reason: DriverReason, over: tuple[DriverReason, ...]
    ) -> Any:
        self._stop(response, reason, over)
        if response.success:
            self.node.get_logger().warning(reason.words)
        else:
            self.node.get_logger().error(f"{reason.words}: {UNANSWERED}")
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            return self._stop(response, DriverReason.SWITCHED_OFF)
        if self._standstill.is_late(time.monotonic()):
            response.success, response.message = False, LATE
            return response
        transport, number = self._driver.transport, self._latch.number
        if transport is None or not self._driver.active:
            response.success = False
            response.message = f"the driver is {self._driver.status.text}, allowed: active"
            return response
        status = self._driver.status
        if status.state is DriverState.READY:  # there is no stop to clear, and a task may run
            response.success, response.message = True, status.text
            return response
        end = time.monotonic() + ANSWER_S
        order = transport.enable(number)
        self.publish_status()
        order.wait(end - time.monotonic())
        self.publish_status()
        response.success = not order.failure
        done = self._driver.status.text if order.settled else ENABLING
        response.message = order.failure or done
        return response

    def _on_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        transport = self._driver.transport
        response.success = False
        if self._standstill.is_late(time.monotonic()):
            response.message = LATE
        elif transport is None or transport.report.condition is not Condition.OFF:
            state = self._driver.status.text
            response.message = f"the driver is {state}, allowed: motors off; call enable, false"
        else:
            end = time.monotonic() + ANSWER_S
            order = transport.home()
            response.success = order.wait(end - time.monotonic())
            response.message = "the next enable finds home"
            if not response.success:
                response.message = order.failure or SILENT
        return response
