"""The latch, and a transport in its thread: tables computed before a stop are not sent after it."""

import threading
import time
from dataclasses import replace

import pytest

from plate_core import CycleError, load_rig
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.status import Finding, Level
from plate_driver.raw_cycle import HEAD_BYTES, POINT_BYTES, check_length
from plate_driver.setpoints import Statistics
from plate_driver.setpoints.motor_table import MotorTable
from plate_driver.status import CHECK_RIG, OFF, UNCERTAIN, driver_status, health
from plate_driver.transports import STOPPED_SINCE, Condition, Measured, Order, Report, SimTransport
from plate_driver.transports.thread import BUSY, Latch, TransportThread

RIG = load_rig()
TABLE = MotorTable.rest(RIG, 0.1, 1)
NONE, EMERGENCY, CUT, OFF_SWITCH = (
    DriverReason.NONE, DriverReason.EMERGENCY_STOP, DriverReason.POWER_CUT,
    DriverReason.SWITCHED_OFF,
)  # fmt: skip


def kept() -> tuple[TransportThread, Latch, list[MotorTable]]:
    sent: list[MotorTable] = []
    latch = Latch()
    thread = TransportThread(
        SimTransport(RIG, sent.append), latch, lambda error: pytest.fail(repr(error))
    )
    return thread, latch, sent


def test_a_table_made_before_a_stop_is_not_sent_after_it():
    thread, latch, sent = kept()
    thread.send(TABLE, 1, latch.number)
    number = latch.number
    latch.close(EMERGENCY)
    with pytest.raises(CycleError, match="was stopped in the meantime"):
        thread.send(TABLE, 1, latch.number)
    assert latch.open(latch.number)
    with pytest.raises(CycleError, match="was stopped in the meantime"):
        thread.send(TABLE, 1, number)  # of before
    thread.send(TABLE, 1, latch.number)
    assert len(sent) == 2


def test_a_table_that_is_too_old_is_not_sent():
    thread, latch, sent = kept()
    with pytest.raises(CycleError, match="too late"):
        thread.send(replace(TABLE, until=time.monotonic() - 0.01), 1, latch.number)
    assert not sent


def test_an_enable_opens_only_the_stop_it_was_given_for():
    _, latch, _ = kept()
    latch.close(EMERGENCY)
    number = latch.number
    latch.close(EMERGENCY)
    assert not latch.open(number)
    assert latch.reason == EMERGENCY
    assert latch.open(latch.number)
    assert latch.reason is NONE


def test_a_weaker_reason_does_not_replace_a_stronger_one():
    _, latch, _ = kept()
    latch.close(OFF_SWITCH)
    latch.close(EMERGENCY, over=(NONE, OFF_SWITCH))
    latch.close(OFF_SWITCH)
    assert latch.reason == EMERGENCY
    latch.close(CUT, over=())
    latch.close(EMERGENCY, over=(NONE, OFF_SWITCH))
    assert latch.reason == CUT
    assert latch.number == 5


class Motors(SimTransport):
    """Motors that neither act nor report by themselves: the test is their controller."""

    motors = True

    def __init__(self) -> None:
        super().__init__(RIG, lambda table: None)
        self.enabled, self.stops, self.reported = Order(60.0), [], Condition.OFF
        self.measured_at: list[float] = []

    def stop(self, cut=False):
        self.stops.append(cut)
        self.last = Order(60.0)
        return self.last

    def enable(self):
        return self.enabled

    def report(self):
        return Report(self.reported)

    def poll(self):
        times, self.measured_at = self.measured_at, []
        return [Measured(t, t, 0, (0.0,) * 4, (0.0,) * 4) for t in times]


def driven() -> tuple[TransportThread, Motors, Latch]:
    motors, latch = Motors(), Latch()
    return TransportThread(motors, latch, lambda error: pytest.fail(repr(error))), motors, latch


def test_an_enable_opens_the_latch_when_the_motors_are_ready_with_or_without_a_caller():
    thread, motors, latch = driven()
    latch.close(EMERGENCY)
    order = thread.enable(latch.number)
    thread.poll()
    assert (order.completed, latch.enabling, latch.reason) == (False, True, EMERGENCY)
    motors.enabled.complete()
    thread.poll()
    assert (order.done, latch.enabling, latch.reason) == (True, False, NONE)
    assert not motors.stops


def test_an_enable_that_fails_or_comes_too_late_leaves_the_latch_closed():
    thread, motors, latch = driven()
    latch.close(EMERGENCY)
    order = thread.enable(latch.number)
    motors.enabled.complete("wrong stop")
    thread.poll()
    assert (order.failure, latch.enabling, latch.reason) == ("wrong stop", False, EMERGENCY)
    assert not motors.stops
    motors.enabled = Order(0.0)
    order = thread.enable(latch.number)
    assert order.failure == "the motors are not ready after 0 s"
    assert (motors.stops, latch.enabling, latch.reason) == ([False], False, EMERGENCY)


def test_a_stop_wins_over_an_enable_that_is_under_way():
    thread, motors, latch = driven()
    latch.close(EMERGENCY)
    order = thread.enable(latch.number)
    latch.close(CUT, over=())
    motors.enabled.complete()  # the device has accepted it before it received the stop
    thread.poll()
    assert order.failure == STOPPED_SINCE
    assert (motors.stops, latch.reason, latch.enabling) == ([False], CUT, False)


def test_a_stop_that_is_not_acknowledged_is_done_if_what_is_measured_shows_it():
    thread, motors, _ = driven()

    def shown(condition: Condition, cut: bool, measured_at: float, end: float) -> bool:
        order = thread.stop(cut)
        motors.reported, motors.measured_at = condition, [measured_at]
        thread.poll()
        return thread.stopped(order, cut, end)

    now = time.monotonic()
    assert shown(Condition.OFF, False, now - 0.05, now)
    assert shown(Condition.OFF, True, now - 0.05, now)
    assert shown(Condition.BRAKING, False, now - 0.05, now)
    assert not shown(Condition.BRAKING, True, now - 0.05, now)
    assert not shown(Condition.READY, False, now - 0.05, now)
    assert not shown(Condition.GONE, False, now - 0.05, now)
    assert not shown(Condition.OFF, False, now - 0.2, now)  # before the stop had come, it may be
    order = thread.stop(True)
    motors.reported, motors.measured_at = Condition.OFF, [now]
    thread.poll()
    order.complete("it cannot be cut from here")
    assert not thread.stopped(order, True, now)  # the transport's report counts


def test_a_late_stop_is_forgotten_once_it_is_acknowledged_or_the_motors_are_off():
    thread, motors, latch = driven()
    latch.late = thread.stop()
    assert (latch.unanswered, thread.stopping) == (True, True)
    motors.last.complete()
    assert (latch.unanswered, thread.stopping) == (False, False)
    latch.late = thread.stop()
    thread.poll()
    assert latch.unanswered  # the motors were off before it: nothing is measured since
    motors.measured_at = [0.0]
    thread.poll()
    assert not latch.unanswered


def test_a_stop_does_not_wait_behind_an_enable():
    """The enable of motors that never become ready is waited for without a lock."""
    thread, motors, latch = driven()
    order = thread.enable(latch.number)
    waiting = threading.Thread(target=order.wait, daemon=True)
    waiting.start()
    thread.stop()
    assert motors.stops == [False]
    assert waiting.is_alive()
    motors.enabled.complete("stopped")
    thread.poll()
    waiting.join(10)
    assert not waiting.is_alive()


def refused(thread: TransportThread, number: int) -> None:
    with pytest.raises(CycleError, match="defect"):
        thread.send(TABLE, 1, number)


def test_an_enable_that_was_called_before_a_stop_does_not_reach_the_transport():
    thread, latch, _ = kept()
    number = latch.number
    latch.close(EMERGENCY)
    assert thread.stop().done
    requested = []
    thread._transport.enable = lambda: requested.append(1) or Order().complete()
    assert "another stop has arrived" in thread.enable(number).failure
    assert not requested
    assert thread.enable(latch.number).done
    assert requested


@pytest.mark.parametrize("broken", ["stop", "enable", "home", "report", "poll", "send", "values"])
def test_a_defect_of_a_transport_stops_the_motors_and_ends_nothing(broken):
    """Whatever it raises: the answer is no, no cycle goes on, and the motors are stopped."""
    reported: list[Exception] = []
    sent: list = []
    latch = Latch()
    thread = TransportThread(SimTransport(RIG, sent.append), latch, reported.append)
    thread.send(TABLE, 1, latch.number)
    stops = []
    stop = thread._transport.stop
    thread._transport.stop = lambda cut=False: stops.append(cut) or stop(cut)

    def defect(*_):
        raise RuntimeError("a defect")

    setattr(thread._transport, broken, defect)
    calls = {
        "stop": thread.stop, "enable": lambda: thread.enable(0), "home": thread.home,
        "report": thread.poll, "poll": thread.poll, "values": thread.values,
        "send": lambda: refused(thread, latch.number),
    }  # fmt: skip
    answer = calls[broken]()
    if isinstance(answer, Order):
        assert answer.completed
        assert not answer.done
    assert [str(error) for error in reported] == ["a defect"]
    assert thread.report.condition is Condition.GONE
    assert thread.report.reason is DriverReason.DEFECT
    assert "defect" in thread.report.text
    assert bool(stops) == (broken != "stop")


def test_a_transport_that_hangs_does_not_hold_up_an_answer():
    thread, _, _ = kept()
    hangs, go_on = threading.Event(), threading.Event()

    def poll():
        hangs.set()
        go_on.wait(30)
        return []

    thread._transport.poll = poll
    thread.start()
    assert hangs.wait(10)
    stops = []
    thread._transport.stop = lambda cut=False: stops.append(cut) or Order().complete()
    order = thread.stop(cut=True)
    assert (order.failure, stops, thread.stopping) == (BUSY, [], True)
    go_on.set()
    thread.close()
    assert True in stops  # as soon as it could


def test_a_defect_of_a_transport_is_reported_and_the_thread_continues():
    reported: list[Exception] = []
    again = threading.Event()
    thread = TransportThread(SimTransport(RIG, lambda table: None), Latch(), reported.append)

    def poll():
        if len(reported) >= 2:
            again.set()
            return []
        raise RuntimeError("a defect")

    thread._transport.poll = poll
    thread.start()
    assert again.wait(10)
    thread.close()
    assert [str(error) for error in reported] == ["a defect"] * 2


def closed(reason: DriverReason, unanswered: bool = False) -> Latch:
    """A latch that was closed, unless the reason is NONE."""
    latch = Latch()
    if reason:
        latch.close(reason)
    latch.late = Order() if unanswered else None
    return latch


SUPPLY, FOLLOWING, EARLIER = (
    Report(Condition.OFF, reason, reason.text)
    for reason in (DriverReason.SUPPLY, DriverReason.FOLLOWING, DriverReason.EARLIER_STOP)
)
SILENT = Report(Condition.GONE, DriverReason.NO_ANSWER, "the device does not answer")


@pytest.mark.parametrize(
    ("active", "latch", "report", "state", "reason", "text"),
    [
        (False, NONE, None, DriverState.UNCONFIGURED, NONE, "unconfigured"),
        (False, EMERGENCY, None, DriverState.UNCONFIGURED, EMERGENCY,
         f"unconfigured: emergency stop; {CHECK_RIG}"),
        (False, OFF_SWITCH, Report(Condition.OFF), DriverState.INACTIVE, NONE, "inactive"),
        (True, NONE, SILENT, DriverState.ERROR, DriverReason.NO_ANSWER,
         "error: the device does not answer"),
        (True, EMERGENCY, SILENT, DriverState.ERROR, DriverReason.NO_ANSWER,
         "error: the device does not answer"),
        (True, NONE, Report(Condition.OFF), DriverState.DISABLED, NONE, OFF),
        (True, OFF_SWITCH, EARLIER, DriverState.DISABLED, OFF_SWITCH, OFF),
        (True, OFF_SWITCH, SUPPLY, DriverState.STOPPED, DriverReason.SUPPLY,
         f"stopped: supply; {CHECK_RIG}"),
        (True, EMERGENCY, SUPPLY, DriverState.STOPPED, EMERGENCY,
         f"stopped: emergency stop; {CHECK_RIG}"),
        (True, NONE, FOLLOWING, DriverState.STOPPED, DriverReason.FOLLOWING,
         f"stopped: following; {CHECK_RIG}"),
        (True, NONE, EARLIER, DriverState.STOPPED, DriverReason.EARLIER_STOP,
         f"stopped while this driver was not connected; {CHECK_RIG}"),
        (True, NONE, Report(Condition.ENABLING), DriverState.ENABLING, NONE,
         "enabling: the plate moves to home"),
        (True, OFF_SWITCH, Report(Condition.BRAKING, DriverReason.EARLIER_STOP, "stopped"),
         DriverState.BRAKING, OFF_SWITCH, "braking: switched off"),
        (False, OFF_SWITCH, Report(Condition.BRAKING), DriverState.BRAKING, OFF_SWITCH,
         "braking: switched off"),
        (True, NONE, Report(Condition.BRAKING, DriverReason.HEAT, "heat"), DriverState.BRAKING,
         DriverReason.HEAT, "braking: heat"),
        (True, NONE, Report(Condition.READY), DriverState.READY, NONE, "ready"),
        (True, EMERGENCY, Report(Condition.READY), DriverState.BRAKING, EMERGENCY,
         "braking: emergency stop"),
    ],
)  # fmt: skip
def test_the_status_is_what_the_motors_report(active, latch, report, state, reason, text):
    reported = driver_status(active, closed(latch), report, calibrating=False)
    assert reported == DriverStatus(state, reason, text)


def test_calibrating_is_a_state():
    reported = driver_status(True, Latch(), Report(Condition.READY), calibrating=True)
    assert reported == DriverStatus(DriverState.CALIBRATING, text="calibrating")


def test_motors_that_are_ready_before_the_latch_is_open_do_not_brake():
    """The device reports before the call of enable returns; only a stop since then brakes."""
    latch = closed(CUT)
    number = latch.number

    def state() -> DriverState:
        return driver_status(True, latch, Report(Condition.READY), calibrating=False).state

    latch.enable_started(number)
    assert state() is DriverState.ENABLING
    latch.enable_started(number)  # by somebody else, who is refused
    latch.enable_ended(number)
    assert state() is DriverState.ENABLING
    assert latch.open(number)
    latch.enable_ended(number)
    assert state() is DriverState.READY
    latch.close(CUT)
    latch.enable_started(latch.number)
    latch.close(EMERGENCY, over=())
    assert state() is DriverState.BRAKING


def test_each_enable_has_another_time():
    latch = Latch()
    assert latch.open(0)
    first = latch.enabled_ns
    latch.close(CUT)
    assert latch.open(1)
    assert latch.enabled_ns > first


def test_a_device_has_been_met_after_its_first_message():
    motors = Motors()
    motors.reported = Condition.GONE
    thread = TransportThread(motors, Latch(), pytest.fail)
    thread.poll()
    assert not thread.met
    motors.reported = Condition.OFF
    thread.poll()
    motors.reported = Condition.GONE
    thread.poll()
    assert thread.met


@pytest.mark.parametrize("active", [False, True])
def test_an_unacknowledged_stop_is_reported_until_the_device_replies(active):
    latch = closed(CUT, unanswered=True)
    expected = DriverStatus(DriverState.ERROR, DriverReason.STOP_UNANSWERED, UNCERTAIN)
    assert driver_status(active, latch, SILENT, False) == expected
    assert driver_status(active, latch, None, False) == expected
    assert driver_status(active, latch, EARLIER, False).reason is CUT


@pytest.mark.parametrize(
    ("state", "text", "troubles", "retries", "idle_s", "task", "level", "message"),
    [
        (DriverState.READY, "", (), 0, None, True, Level.OK, "all cycles as requested"),
        (DriverState.CALIBRATING, "", (), 50, None, True, Level.OK, "all cycles as requested"),
        (DriverState.READY, "", ("a cycle was refused",), 0, None, True, Level.WARN,
         "a cycle was refused"),
        (DriverState.READY, "", (), 51, None, True, Level.WARN,
         "51 messages were repeated, so the serial line is bad"),
        (DriverState.READY, "", (), 0, 1.2, True, Level.STALE,
         "no plate_cycle for 1.2 s, the plate rests"),
        (DriverState.READY, "", (), 0, 1.2, False, Level.OK, "the plate rests: no task runs"),
        (DriverState.READY, "", ("a cycle was refused",), 0, 1.2, False, Level.WARN,
         "a cycle was refused"),
        (DriverState.DISABLED, OFF, (), 0, 5.0, True, Level.WARN, OFF),
        (DriverState.INACTIVE, "inactive", (), 0, None, True, Level.WARN, "inactive"),
        (DriverState.ERROR, "error: x", (), 0, 5.0, True, Level.ERROR, "error: x"),
        (DriverState.STOPPED, "stopped: y", (), 0, None, True, Level.ERROR, "stopped: y"),
    ],
)  # fmt: skip
def test_the_diagnostics_level_follows_from_the_state(
    state, text, troubles, retries, idle_s, task, level, message
):
    status, statistics = DriverStatus(state, text=text), Statistics(problems=troubles)
    found = health(status, statistics, retries, idle_s, task)
    assert found == Finding(level, message)


def test_long_messages_are_refused_by_their_beginning():
    names = b"".join(
        len(n).to_bytes(4, "little") + n + b"\0" * (-len(n) % 4) for n in (b"x\0", b"y\0")
    )
    head = b"\0\1\0\0" + bytes(8) + (2).to_bytes(4, "little") + b"a\0" + bytes(2)
    head += (2).to_bytes(4, "little") + names
    check_length(head + (50).to_bytes(4, "little"), 5000, 50)
    with pytest.raises(CycleError, match="51 points, allowed: at most 50"):
        check_length(head + (51).to_bytes(4, "little"), 5000, 50)
    max_bytes = HEAD_BYTES + 50 * POINT_BYTES
    with pytest.raises(CycleError, match=f"{max_bytes + 1} bytes, allowed: at most {max_bytes}"):
        check_length(head + (50).to_bytes(4, "little"), max_bytes + 1, 50)
    for data in (b"", b"\0\1\0\0", b"\xff" * 40, head, b"\0\1\0\0" + b"\xff" * 100):
        check_length(data, len(data), 50)  # whether it is a cycle shows when it is unpacked
