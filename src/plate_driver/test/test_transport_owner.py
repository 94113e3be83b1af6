"""Owner of the transport: a stop reaches the motors whether or not a transport is open."""

import threading

import pytest

from plate_core import PlateError, load_rig
from plate_core.driver_status import DriverReason
from plate_driver.status import UNANSWERED
from plate_driver.transport_owner import TransportOwner
from plate_driver.transport_problems import UNPLAYED_S, TransportProblems
from plate_driver.transports import Condition, Latch, Order, Report, SimTransport, TransportThread

RIG = load_rig()
WAIT_S = 60.0
"""Maximum wait for a thread. It does not decide a passing test."""


class Motors(SimTransport):
    """Motors that acknowledge a stop only if `settles`."""

    def __init__(self, settles=True):
        super().__init__(RIG, lambda table: None)
        self.settles, self.orders, self.closed = settles, [], threading.Event()

    def stop(self, cut=False):
        self._stopped = self.settles
        order = Order(WAIT_S)
        self.orders.append((cut, order))
        return order.complete() if self.settles else order

    def close(self):
        self.closed.set()


def owner(*motors):
    made = list(motors)
    return TransportOwner(
        Latch(), lambda: RIG, lambda rig: made.pop(0), lambda error: pytest.fail(repr(error))
    )


def test_a_stop_without_a_transport_opens_one_and_closes_it_when_it_is_settled():
    motors = Motors()
    owned = owner(motors)
    assert owned.stop(cut=True)
    assert motors.orders[0][0]
    assert motors.closed.wait(WAIT_S)
    assert owned.current is None


def test_an_unacknowledged_stop_keeps_its_transport_until_another_one_is_opened():
    silent, motors = Motors(settles=False), Motors()
    owned = owner(silent, motors)
    assert not owned.stop(cut=False)
    assert owned.latch.unanswered
    temporary = owned.temporary
    assert temporary is not None
    assert not owned.stop(cut=False)
    assert owned.temporary is temporary
    silent.orders[0][1].complete()
    assert not silent.closed.is_set()  # the second stop is not settled
    owned.open(RIG)
    assert silent.closed.is_set()
    assert owned.temporary is None
    assert owned.stop(cut=False)
    assert len(motors.orders) == 1
    owned.close()
    assert motors.closed.is_set()
    assert owned.current is None


def test_a_stop_is_refused_while_a_transport_cannot_be_made():
    def fail(rig):
        raise PlateError("port is '', allowed: a port")

    owned = TransportOwner(Latch(), lambda: RIG, fail, lambda error: None)
    assert not owned.stop(cut=False)
    assert owned.latch.late.failure == "port is '', allowed: a port"


def test_rest_waits_for_motors_without_current(monkeypatch):
    monkeypatch.setattr(TransportThread, "start", lambda _: None)
    motors = Motors()
    owned = owner(motors)
    owned.open(RIG)
    assert owned.rest() == ""
    motors.settles = False
    assert owned.rest() == UNANSWERED
    assert owned.latch.unanswered
    owned.latch.close(DriverReason.EMERGENCY_STOP)
    motors.settles, motors.report = True, lambda: Report(Condition.BRAKING)
    monkeypatch.setattr("plate_driver.transport_owner.REST_S", 0.05)
    assert owned.rest() == "the plate still moves after 0.05 s"
    assert not owned.latch.unanswered


def test_each_problem_is_logged_once_until_it_has_been_absent():
    problems = TransportProblems(2.0)
    assert problems.new(["a", "b", "a"], motors_rest=False, now=0.0) == ["a", "b"]
    assert problems.new(["a"], motors_rest=False, now=1.9) == []
    assert problems.new(["a"], motors_rest=False, now=2.0) == ["a"]


def test_sent_cycles_that_the_motors_do_not_play_are_a_problem():
    problems = TransportProblems(2.0)
    problems.new(["bad line"], motors_rest=False, now=0.0)
    assert problems.unplayed(10.0) == ""
    problems.new(["device refuses Commit"], motors_rest=True, now=10.0)
    problems.new(["bad line"], motors_rest=True, now=10.1)
    assert problems.unplayed(10.0 + UNPLAYED_S) == ""
    expected = "no plate_cycle has been played for 0.6 s: device refuses Commit"
    assert problems.unplayed(10.6) == expected
    problems.clear_unplayed()
    assert problems.unplayed(10.6) == ""
