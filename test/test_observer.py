"""`Observer.enable` with a driver whose device is connected late, falls silent, or was stopped."""

import os
from typing import ClassVar

import pytest

rclpy = pytest.importorskip("rclpy")

from graph.domains import own_domain  # noqa: E402
from graph.observer import Observer  # noqa: E402
from graph.processes import ros_environment  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402

from plate_bringup import GraphError  # noqa: E402
from plate_core.ros import LATCHED  # noqa: E402
from plate_driver.transports import CALL_AGAIN  # noqa: E402
from plate_interfaces.msg import DriverStatus  # noqa: E402

INACTIVE = DriverStatus(state=DriverStatus.INACTIVE)
SILENT = DriverStatus(state=DriverStatus.ERROR, reason=DriverStatus.NO_ANSWER, text="silent")
NO_PORT = DriverStatus(state=DriverStatus.ERROR, reason=DriverStatus.PORT, text="no port")
OFF = DriverStatus(state=DriverStatus.DISABLED)
READY = DriverStatus(state=DriverStatus.READY)
STOPPED = DriverStatus(state=DriverStatus.STOPPED, reason=DriverStatus.EMERGENCY_STOP, text="red")


class Driver:
    """A driver that goes through states, one at each pulse of the observer. At a call of enable it
    must be at `OFF`, else it refuses."""

    begun: ClassVar[list["Driver"]] = []

    def __init__(self, observer: Observer, *statuses: DriverStatus) -> None:
        self.left, self.status, self.calls = list(statuses), statuses[0], 0
        self.at_first_call: list[DriverStatus] = []
        self.node = rclpy.create_node("driver")
        self.publisher = self.node.create_publisher(DriverStatus, "driver_status", LATCHED)
        self.node.create_service(SetBool, "enable", self.enable)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        observer.pulses.append(self.step)
        self.begun.append(self)

    def step(self) -> None:
        if self.left:
            self.status = self.left.pop(0)
            self.publisher.publish(self.status)
        self.executor.spin_once(timeout_sec=0)

    def enable(self, _: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.calls += 1
        if self.at_first_call:
            self.status, *self.left = self.at_first_call
            self.at_first_call = []
        response.success = self.status is OFF
        response.message = "" if response.success else f"{self.status.text}{CALL_AGAIN}"
        if response.success:
            self.left = [READY]
        return response


@pytest.fixture(name="observer")
def _observer(monkeypatch):
    with own_domain(None) as domain:
        for name, value in ros_environment(domain).items():
            monkeypatch.setitem(os.environ, name, value)
        with Observer(domain, pictures=False) as observer:
            yield observer
            # A driver that remained would send its last status to the observer of the next test.
            for driver in Driver.begun:
                driver.node.destroy_node()
            Driver.begun.clear()


@pytest.mark.parametrize("waits", [[SILENT], [NO_PORT], [INACTIVE, SILENT]])
def test_the_motors_are_enabled_once_when_the_device_is_connected(observer, waits):
    driver = Driver(observer, *waits, *[waits[-1]] * 10, OFF)
    observer.enable()
    assert (driver.calls, observer.record.ready) == (1, True)


def test_a_device_that_falls_silent_before_the_call_is_waited_for(observer):
    driver = Driver(observer, OFF)
    driver.at_first_call = [SILENT, SILENT, SILENT, OFF]
    observer.enable()
    assert (driver.calls > 1, observer.record.ready) == (True, True)


def test_a_stop_during_the_wait_is_not_cleared(observer):
    driver = Driver(observer, *[SILENT] * 5, STOPPED)
    with pytest.raises(GraphError, match="stopped before the task began, driver: red"):
        observer.enable(observer.check_not_stopped)
    assert driver.calls == 0


def test_the_reason_of_a_wait_for_a_service_is_shown(observer, monkeypatch):
    """An enable without a reply, while the driver reports that the device is silent."""
    monkeypatch.setattr("graph.observer.CALL_S", 1.0)
    monkeypatch.setattr("graph.observer.SLOW_REPLY_S", 0.2)
    shown: list[str] = []
    monkeypatch.setattr(observer, "_waiting", shown.append)
    observer.record.driver = SILENT
    with pytest.raises(GraphError, match="service enable did not answer"):
        observer.call(SetBool, "enable", SetBool.Request())
    assert shown
    assert shown[0].endswith("for the service enable; the driver reports: silent")


def test_a_driver_that_has_stopped_is_not_waited_for(observer, monkeypatch):
    """It becomes ready only after another call of enable."""
    monkeypatch.setattr("graph.observer.READY_S", 600.0)
    monkeypatch.setattr("graph.observer.STOPPED_S", 0.5)
    Driver(observer, STOPPED)
    with pytest.raises(GraphError, match="has stopped the motors before the task: red"):
        observer.await_ready()
