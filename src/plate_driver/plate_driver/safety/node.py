"""Services for stops, enable and home, and the topic driver_status. The node has a separate DDS
participant and separate threads, so that cycle traffic cannot delay a stop."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.ros import (
    CALLS,
    LATCHED,
    SafeLifecycleNode,
    driver_status_to_msg,
    end_executor,
)
from plate_core.standstill import Standstill
from plate_interfaces.msg import DriverStatus as DriverStatusMsg

from ..status import UNANSWERED
from ..transport_owner import TransportOwner
from ..transports import ANSWER_S, CALL_AGAIN, Condition, Latch

STATE_PERIOD_S = 0.05
"""Time between checks whether driver_status has changed [s]."""

LIFE_PERIOD_S = 0.5
"""Time after which an unchanged driver_status is published again [s]."""

ACKNOWLEDGED_S = 0.5
"""Maximum time to wait for the acknowledgement of the last messages [s]."""

END_S = 10.0
"""Maximum time to wait for the end of the spinning thread and the service threads [s]. This time is
long, because on a busy machine a thread may not run for half a second. A thread that still runs
when the interpreter ends would crash the process."""

STILL_S = 1.0
"""Maximum stall of the driver [s]. After a longer stall, the driver refuses calls of enable and
home that may have waited."""

THREADS = 128
"""Maximum number of threads. Each thread processes one call at a time. Further calls wait. A thread
is created only when a call needs it."""


ENABLING = "enabling: driver_status reports when the motors are ready"
NO_REPLY = "the device has not answered yet"
"""Replies to a call of enable or home whose execution takes longer than the reply can wait."""

LATE = f"the driver was stalled, so this call may be old{CALL_AGAIN}"
"""Reply to a call of enable or home that may have waited while the driver was stalled."""


class SafetyNode:
    """Services for stops, enable and home, and the topic driver_status, separate from cycle
    traffic.

    The node's DDS participant receives no other messages. The calls run in separate threads, and
    the node uses the steady clock. Each call returns within 0.5 s, and the reply contains the state
    at that time. The topic driver_status reports later changes.

    Parameters
    ----------
    driver : SafeLifecycleNode
        Node whose names, domain and clock are used.
    transports : TransportOwner
    latch : Latch
    status : callable
        Function that returns the state of the motors.
    """

    def __init__(
        self,
        driver: SafeLifecycleNode[Any],
        transports: TransportOwner,
        latch: Latch,
        status: Callable[[], DriverStatus],
    ) -> None:
        self._driver, self._transports = driver, transports
        self._latch, self._driver_status = latch, status
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
            call = self._catch_exceptions(answer)
            node.create_service(kind, full, call, qos_profile=CALLS, callback_group=group)
        topic = driver.resolve_topic_name("driver_status")
        self._statuses = node.create_publisher(DriverStatusMsg, topic, LATCHED)
        self._standstill = Standstill(STILL_S, time.monotonic())
        self._status: DriverStatus | None = None
        self._status_at = float("-inf")
        self._publishing = threading.Lock()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer_group = MutuallyExclusiveCallbackGroup()
        node.create_timer(
            STATE_PERIOD_S, self.publish_status, clock=steady, callback_group=timer_group
        )
        self._ended = False
        self._executor = MultiThreadedExecutor(THREADS, context=self._context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name="safety", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self._context.ok() and not self._ended:
                try:
                    # The call returns at the latest when the timer fires. After each return, the
                    # loop condition is checked again.
                    self._executor.spin_once()
                except ExternalShutdownException:
                    raise
                except Exception as error:
                    self.node.get_logger().error(f"safety: {error!r}")

    def _catch_exceptions(self, answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Return a callback that catches exceptions and replies with them, so that the thread does
        not end."""

        def callback(request: Any, response: Any) -> Any:
            try:
                return answer(request, response)
            except Exception as error:
                self.node.get_logger().error(f"{type(request).__name__}: {error!r}")
                response.success, response.message = False, UNANSWERED
                return response

        return callback

    def publish_status(self) -> None:
        """Publish driver_status if it has changed or `LIFE_PERIOD_S` has passed."""
        with self._publishing:
            status, now = self._driver_status(), time.monotonic()
            self._standstill.is_late(now)
            if status == self._status and now - self._status_at < LIFE_PERIOD_S:
                return
            self._status, self._status_at = status, now
            stamp = self._driver.get_clock().now().to_msg()
            self._statuses.publish(driver_status_to_msg(status, stamp))

    def close(self) -> None:
        """Publish the last state and stop the threads. Further calls do nothing."""
        if self._ended:
            return
        self.publish_status()
        self._statuses.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S))
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

    def _stop_motors(
        self, response: Any, reason: DriverReason,
        over: tuple[DriverReason, ...] = (DriverReason.NONE,),
    ) -> Any:  # fmt: skip
        """Close the latch, stop the motors, and set the response to the result."""
        self._latch.close(reason, over)
        response.success = self._transports.stop(cut=reason is DriverReason.POWER_CUT)
        response.message = self._driver_status().text if response.success else UNANSWERED
        self.publish_status()
        return response

    def _stop_and_log(
        self, response: Any, reason: DriverReason, over: tuple[DriverReason, ...]
    ) -> Any:
        self._stop_motors(response, reason, over)
        if response.success:
            self.node.get_logger().warning(reason.text)
        else:
            self.node.get_logger().error(f"{reason.text}: {UNANSWERED}")
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if not request.data:
            return self._stop_motors(response, DriverReason.SWITCHED_OFF)
        if self._standstill.is_late(time.monotonic()):
            response.success, response.message = False, LATE
            return response
        transport, number = self._transports.current, self._latch.number
        if transport is None or not self._driver.active:
            response.success = False
            response.message = f"the driver is {self._driver_status().text}, allowed: active"
            return response
        status = self._driver_status()
        # The motors are already enabled. Nothing is sent to the device, because a task may be
        # running.
        if status.state is DriverState.READY:
            response.success, response.message = True, status.text
            return response
        end = time.monotonic() + ANSWER_S
        order = transport.enable(number)
        self.publish_status()
        order.wait(end - time.monotonic())
        self.publish_status()
        response.success = not order.failure
        done = self._driver_status().text if order.completed else ENABLING
        response.message = order.failure or done
        return response

    def _on_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        transport = self._transports.current
        response.success = False
        if self._standstill.is_late(time.monotonic()):
            response.message = LATE
        elif transport is None or transport.report.condition is not Condition.OFF:
            state = self._driver_status().text
            response.message = f"the driver is {state}, allowed: motors off; call enable with false"
        else:
            end = time.monotonic() + ANSWER_S
            order = transport.home()
            response.success = order.wait(end - time.monotonic())
            response.message = "the next enable searches for home"
            if not response.success:
                response.message = order.failure or NO_REPLY
        return response
