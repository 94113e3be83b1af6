"""Calls of the safety node while the motors' controller withholds its answers: all are answered."""

import os
import time

import pytest

rclpy = pytest.importorskip("rclpy")
from driven import TICK_S, Driven, answered_once  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from plate_core.driver_status import DriverReason, DriverState  # noqa: E402
from plate_core.ros import CALLS, start_nodes  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402
from plate_driver.safety.node import ENABLING, LATE, NO_REPLY  # noqa: E402
from plate_driver.setpoints import MAX_KNOTS  # noqa: E402
from plate_driver.status import UNANSWERED, UNCERTAIN  # noqa: E402
from plate_driver.transports import Condition, Measured, Order, Report  # noqa: E402

FOREVER_S = 3600.0
"""Maximum wait for orders of this transport without another bound."""

IN_TIME_S = 0.5
"""Maximum time until a call gets its reply."""


class Withheld:
    """Motors whose controller answers nothing until the test has it settle an order.

    Parameters
    ----------
    clock : callable
        [s].
    order : callable
        Makes an order of the longest time to wait for it [s].
    """

    motors = True
    calibrates = False
    max_knots = MAX_KNOTS
    hold_s = 2.0

    def __init__(self, clock=time.monotonic, order=Order) -> None:
        self._clock, self._order = clock, order
        self.reported, self.telemetry = Report(Condition.OFF), True
        self.stops = []
        self.cuts = []
        self.enables = []
        self.closed = 0

    def open(self) -> None:
        self.stops = []

    def poll(self) -> list[Measured]:
        now = self._clock()
        return [Measured(now, now, 0, (0.0,) * 4, (0.0,) * 4)] if self.telemetry else []

    def report(self) -> Report:
        return self.reported

    def send(self, table, repeats) -> None:
        raise AssertionError("nobody sends anything here")

    def stop(self, cut=False) -> Order:
        self.cuts.append(cut)
        self.stops.append(self._order(FOREVER_S))
        return self.stops[-1]

    def enable(self) -> Order:
        self.enables.append(self._order(FOREVER_S))
        return self.enables[-1]

    def home(self) -> Order:
        return self._order(FOREVER_S)

    def troubles(self) -> list[str]:
        return []

    def values(self) -> dict[str, str]:
        return {}

    def close(self) -> None:
        self.closed += 1


class Desk(Driven):
    """A driver with such motors, in the test's time: while it waits for an order, time passes."""

    def __init__(self, monkeypatch) -> None:
        class TimedOrder(Order):
            def wait(order, max_s=None):
                self.pass_time(max(TICK_S, order.max_s if max_s is None else max_s))
                return order.done

        self.motors = Withheld(lambda: self.clock.now, TimedOrder)
        monkeypatch.setattr("plate_driver.node.make_transport", lambda name, context: self.motors)
        monkeypatch.setattr("plate_driver.transports.thread.Order", TimedOrder)
        super().__init__(monkeypatch, start=False)

    def call(self, name, request=None):
        began = self.clock.now
        answer = super().call(name, request)
        assert self.clock.now - began < IN_TIME_S
        return answer

    def go_silent(self) -> None:
        self.motors.reported, self.motors.telemetry = Report(Condition.GONE, text="no word"), False

    def close(self) -> None:
        self.motors.reported = Report(Condition.OFF)
        super().close()


@pytest.fixture(name="desk")
def _desk(monkeypatch):
    desk = Desk(monkeypatch)
    yield desk
    desk.close()


def test_an_unacknowledged_stop_gets_a_reply_and_is_repeated(desk):
    start_nodes(desk.node)
    desk.go_silent()
    answer = desk.call("emergency_stop")
    assert (answer.success, answer.message) == (False, UNANSWERED)
    status = desk.node.status
    assert (status.text, status.reason) == (UNCERTAIN, DriverReason.STOP_UNANSWERED)
    desk.motors.stops[-1].complete()  # the status then has the result
    assert desk.node.status.text == "error: no word"
    # Telemetry shows it: an acknowledgement is not needed.
    desk.motors.reported, desk.motors.telemetry = Report(Condition.OFF), True
    answer = desk.call("emergency_stop")
    assert answer.success, answer.message
    assert answer.message.startswith("stopped: emergency stop")
    assert not desk.motors.stops[-1].completed


def test_an_enable_is_answered_before_the_motors_are_ready(desk):
    start_nodes(desk.node)
    answer = desk.call("home")
    assert (answer.success, answer.message) == (False, NO_REPLY)
    answer = desk.enable()
    assert (answer.success, answer.message) == (True, ENABLING)
    desk.motors.reported = Report(Condition.ENABLING)
    desk.pass_time(0.1)
    assert desk.node.status.state is DriverState.ENABLING
    for order in desk.motors.enables:
        order.complete()
    desk.motors.reported = Report(Condition.READY)
    desk.pass_time(0.1)
    assert desk.node.status.state is DriverState.READY
    answer = desk.call("home")  # with current
    assert (answer.success, answer.message[:28]) == (False, "the driver is ready, allowed")


def test_requests_during_a_stall_of_the_driver_are_refused_except_stops(desk):
    start_nodes(desk.node)
    for ask in (desk.enable, lambda: desk.call("home")):
        desk.clock.now += 5.0
        answer = ask()
        assert (answer.success, answer.message) == (False, LATE)
    assert not desk.motors.enables
    desk.clock.now += 5.0
    desk.enable(False)
    assert desk.motors.stops
    desk.pass_time(1.0)
    assert desk.enable().success


def test_each_stop_reaches_the_motors_and_the_gravest_reason_is_reported(desk):
    start_nodes(desk.node)
    stop, cut, off = DriverReason.EMERGENCY_STOP, DriverReason.POWER_CUT, DriverReason.SWITCHED_OFF
    for ask, cuts, reason in (
        (lambda: desk.enable(False), False, off),
        (lambda: desk.call("emergency_stop"), False, stop),
        (lambda: desk.enable(False), False, stop),
        (lambda: desk.call("cut_power"), True, cut),
        (lambda: desk.call("emergency_stop"), False, cut),
    ):
        before = len(desk.motors.cuts)
        assert ask().success
        assert desk.motors.cuts[before:] == [cuts]
        assert desk.node.latch.reason is reason


def test_a_stop_during_the_end_of_the_driver_leaves_no_transport_open(desk):
    safety = desk.node._safety
    close = safety.close

    def stop_and_close():
        safety.close = close
        desk.call("emergency_stop")
        close()

    safety.close = stop_and_close
    desk.go_silent()
    desk.node.close()
    assert (len(desk.motors.stops), desk.motors.closed) == (2, 1)  # closing also stops


def test_a_stop_of_an_unconfigured_driver_is_tried_until_it_is_acknowledged(desk):
    desk.go_silent()
    for _ in range(2):  # by the same transport
        answer = desk.call("emergency_stop")
        assert (answer.success, answer.message) == (False, UNANSWERED)
    motors = desk.motors
    assert (len(motors.stops), motors.closed) == (2, 0)
    assert desk.node.status.reason is DriverReason.STOP_UNANSWERED
    for order in motors.stops:
        order.complete()
    end = time.monotonic() + 60.0
    while not motors.closed and time.monotonic() < end:
        time.sleep(0.01)
    assert motors.closed == 1
    assert desk.node.status.reason is DriverReason.EMERGENCY_STOP
    # One that is still tried when the driver is configured makes room for it.
    desk.call("emergency_stop")
    assert motors.closed == 1
    start_nodes(desk.node)
    assert motors.closed == 2
    assert desk.node.status.state is not DriverState.READY


# In true time, with the threads of the node


def test_a_stop_is_answered_behind_50_enables_and_each_of_50_stops_too(monkeypatch):
    motors = Withheld()
    monkeypatch.setattr("plate_driver.node.make_transport", lambda name, context: motors)
    rclpy.init(args=["--ros-args", "-r", f"__ns:=/safety_test_{os.getpid()}"])
    driver, node, executor = DriverNode(), rclpy.create_node("caller"), SingleThreadedExecutor()
    executor.add_node(node)
    start_nodes(driver)
    motors.reported, motors.telemetry = Report(Condition.GONE, text="no word"), False
    calls = [
        (node.create_client(kind, name, qos_profile=CALLS), request)
        for kind, name, request in (
            (SetBool, "enable", SetBool.Request(data=True)),
            (Trigger, "emergency_stop", Trigger.Request()),
        )
        for _ in range(50)
    ]

    def seen(condition, seconds=60.0):
        end = time.monotonic() + seconds
        while not (holds := condition()) and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)
        return holds

    try:
        assert all(client.wait_for_service(60) for client, _ in calls)
        assert answered_once(calls, seen)
        before = len(motors.stops)
        requested = [client.call_async(request) for client, request in calls]
        assert seen(lambda: all(future.done() for future in requested))
        assert {future.result().message for future in requested[50:]} == {UNANSWERED}
        assert len(motors.stops) >= before + 50
    finally:
        motors.reported = Report(Condition.OFF)
        driver.destroy_node()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
