"""Calls of the safety node while the motors' controller withholds its answers: all are answered."""

import os
import time

import pytest

rclpy = pytest.importorskip("rclpy")
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_srvs.srv import SetBool, Trigger  # noqa: E402

from plate_core.driver_status import DriverReason, DriverState  # noqa: E402
from plate_core.ros import CALLS, start_nodes  # noqa: E402
from plate_driver import node as driver_module  # noqa: E402
from plate_driver.node import DriverNode  # noqa: E402
from plate_driver.safety.node import ENABLING, LATE, SILENT  # noqa: E402
from plate_driver.setpoints import MAX_KNOTS  # noqa: E402
from plate_driver.status import UNANSWERED, UNCERTAIN  # noqa: E402
from plate_driver.transports import Condition, Measured, Order, Report  # noqa: E402

FOREVER_S = 3600.0
"""Orders of this transport are waited for so long, if nobody bounds that."""


class Withheld:
    """Motors whose controller answers nothing until the test has it settle an order."""

    motors, calibrates, max_knots, hold_s = True, False, MAX_KNOTS, 2.0

    def __init__(self) -> None:
        self.told, self.telemetry = Report(Condition.OFF), True
        self.stops, self.enables, self.closed = [], [], 0

    def open(self) -> None:
        self.stops = []

    def poll(self) -> list[Measured]:
        now = time.monotonic()
        return [Measured(now, now, 0, (0.0,) * 4, (0.0,) * 4)] if self.telemetry else []

    def report(self) -> Report:
        return self.told

    def send(self, table, repeats) -> None:
        raise AssertionError("nobody sends anything here")

    def stop(self, cut=False) -> Order:
        self.stops.append(Order(FOREVER_S))
        return self.stops[-1]

    def enable(self) -> Order:
        self.enables.append(Order(FOREVER_S))
        return self.enables[-1]

    def home(self) -> Order:
        return Order(FOREVER_S)

    def troubles(self) -> list[str]:
        return []

    def values(self) -> dict[str, str]:
        return {}

    def close(self) -> None:
        self.closed += 1


class Desk:
    """A driver with such motors in this process, and a node that calls its services."""

    def __init__(self, monkeypatch) -> None:
        self.motors = Withheld()
        monkeypatch.setattr(driver_module, "make_transport", lambda name, context: self.motors)
        namespace = f"/safety_test_{os.getpid()}"
        rclpy.init(args=["--ros-args", "-r", f"__ns:={namespace}"])
        self.driver = DriverNode()
        self.node = rclpy.create_node("caller")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def clients(self, kind, name: str, count: int):
        """Clients that the driver knows: each of them has been answered once."""
        made = [self.node.create_client(kind, name, qos_profile=CALLS) for _ in range(count)]
        assert all(client.wait_for_service(20) for client in made)
        return made

    def until(self, condition, seconds: float = 60.0) -> bool:
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
        return condition()

    def call(self, client, request):
        """Call, again where the answer was lost since the driver did not know this client yet."""
        for _ in range(5):
            future = client.call_async(request)
            if self.until(future.done, 10.0):
                return future.result()
        pytest.fail(f"no answer of {client.service_name}")

    def close(self) -> None:
        self.motors.told = Report(Condition.OFF)
        self.driver.destroy_node()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


@pytest.fixture(name="desk")
def _desk(monkeypatch):
    desk = Desk(monkeypatch)
    yield desk
    desk.close()


def test_a_stop_that_is_not_acknowledged_is_answered_and_goes_on_being_tried(desk):
    motors, driver = desk.motors, desk.driver
    start_nodes(driver)
    motors.told, motors.telemetry = Report(Condition.GONE, text="no word"), False
    [stop] = desk.clients(Trigger, "emergency_stop", 1)
    answer = desk.call(stop, Trigger.Request())
    assert (answer.success, answer.message) == (False, UNANSWERED)
    assert (driver.status.text, driver.status.reason) == (UNCERTAIN, DriverReason.STOP_UNANSWERED)
    motors.stops[-1].settle()  # what becomes of it is told
    assert driver.status.text == "error: no word"
    # Telemetry shows it: an acknowledgement is not needed.
    motors.told, motors.telemetry = Report(Condition.OFF), True
    answer = desk.call(stop, Trigger.Request())
    assert answer.success, answer.message
    assert answer.message.startswith("stopped: emergency stop")
    assert not motors.stops[-1].settled


def test_an_enable_is_answered_before_the_motors_are_ready(desk):
    motors, driver = desk.motors, desk.driver
    start_nodes(driver)
    [enable], [home] = desk.clients(SetBool, "enable", 1), desk.clients(Trigger, "home", 1)
    answer = desk.call(home, Trigger.Request())
    assert (answer.success, answer.message) == (False, SILENT)
    answer = desk.call(enable, SetBool.Request(data=True))
    assert (answer.success, answer.message) == (True, ENABLING)
    motors.told = Report(Condition.ENABLING)
    assert desk.until(lambda: driver.status.state is DriverState.ENABLING)
    for order in motors.enables:
        order.settle()
    motors.told = Report(Condition.READY)
    assert desk.until(lambda: driver.status.state is DriverState.READY)


def test_what_was_asked_while_the_driver_stood_still_is_refused_but_for_stops(desk):
    motors, driver = desk.motors, desk.driver
    start_nodes(driver)
    [enable, disable] = desk.clients(SetBool, "enable", 2)
    [home] = desk.clients(Trigger, "home", 1)
    for client, request in (
        (enable, SetBool.Request(data=True)), (home, Trigger.Request()),
    ):  # fmt: skip
        driver._safety._standstill._looked -= 5.0
        answer = desk.call(client, request)
        assert (answer.success, answer.message) == (False, LATE)
    assert not motors.enables
    driver._safety._standstill._looked -= 5.0
    desk.call(disable, SetBool.Request(data=False))
    assert motors.stops
    assert desk.until(lambda: not driver._safety._standstill.is_late(time.monotonic()))
    assert desk.call(enable, SetBool.Request(data=True)).success


def test_a_stop_is_answered_behind_50_enables_and_each_of_50_stops_too(desk):
    motors, driver = desk.motors, desk.driver
    start_nodes(driver)
    motors.told, motors.telemetry = Report(Condition.GONE, text="no word"), False
    enables = desk.clients(SetBool, "enable", 50)
    stops = desk.clients(Trigger, "emergency_stop", 50)
    for client, request in (
        (enables[0], SetBool.Request(data=True)),
        (stops[0], Trigger.Request()),
    ):
        desk.call(client, request)
    desk.until(lambda: False, 1.0)  # the driver gets to know the others
    asked = [client.call_async(SetBool.Request(data=True)) for client in enables]
    asked += [client.call_async(Trigger.Request()) for client in stops]
    assert desk.until(lambda: all(future.done() for future in asked))
    assert {future.result().message for future in asked[50:]} == {UNANSWERED}
    assert len(motors.stops) >= 51


def test_a_stop_of_an_unconfigured_driver_is_tried_until_it_is_acknowledged(desk):
    motors, driver = desk.motors, desk.driver
    motors.told, motors.telemetry = Report(Condition.GONE, text="no word"), False
    [stop] = desk.clients(Trigger, "emergency_stop", 1)
    for _ in range(2):  # by the same transport
        answer = desk.call(stop, Trigger.Request())
        assert (answer.success, answer.message) == (False, UNANSWERED)
    assert (len(motors.stops), motors.closed) == (2, 0)
    assert driver.status.reason is DriverReason.STOP_UNANSWERED
    for order in motors.stops:
        order.settle()
    assert desk.until(lambda: motors.closed == 1)
    assert driver.status.reason is DriverReason.EMERGENCY_STOP
    # One that is still tried when the driver is configured makes room for it.
    desk.call(stop, Trigger.Request())
    assert motors.closed == 1
    start_nodes(driver)
    assert motors.closed == 2
    assert driver.status.state is not DriverState.READY
