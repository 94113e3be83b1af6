"""The latch, and a transport in its thread: what was made before a stop is not sent after it."""

import threading

import pytest

from plate_core import CycleError, load_rig
from plate_core.status import Finding, Level
from plate_driver.raw_cycle import HEAD_BYTES, POINT_BYTES, check_length
from plate_driver.setpoints import Statistics
from plate_driver.setpoints.motor_table import MotorTable
from plate_driver.state import (
    CUT,
    DISABLED,
    EMERGENCY,
    LOOK,
    OFF,
    UNCERTAIN,
    driver_state,
    health,
)
from plate_driver.transports import Condition, Order, Report, SimTransport
from plate_driver.transports.thread import Latch, TransportThread

RIG = load_rig()
TABLE = MotorTable.rest(RIG, 0.1, 1)


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
    with pytest.raises(CycleError, match="was stopped meanwhile"):
        thread.send(TABLE, 1, latch.number)
    assert latch.open(latch.number)
    with pytest.raises(CycleError, match="was stopped meanwhile"):
        thread.send(TABLE, 1, number)  # of before
    thread.send(TABLE, 1, latch.number)
    assert len(sent) == 2


def test_an_enable_opens_only_the_stop_it_was_given_for():
    _, latch, _ = kept()
    latch.close(EMERGENCY)
    number = latch.number
    latch.close(EMERGENCY)
    assert not latch.open(number)
    assert latch.reason == EMERGENCY
    assert latch.open(latch.number)
    assert latch.reason == ""


def test_a_weaker_reason_does_not_replace_a_stronger_one():
    _, latch, _ = kept()
    latch.close(DISABLED)
    latch.close(EMERGENCY, over=("", DISABLED))
    latch.close(DISABLED)
    assert latch.reason == EMERGENCY
    latch.close(CUT, over=())
    latch.close(EMERGENCY, over=("", DISABLED))
    assert latch.reason == CUT
    assert latch.number == 5


def test_a_stop_does_not_wait_behind_an_enable():
    """The enable of a transport that never becomes ready is waited for without a lock."""
    thread, _, _ = kept()
    never = Order(longest_s=60.0)
    thread._transport.enable = lambda: never
    waiting = threading.Thread(target=lambda: thread.enable(0).wait(), daemon=True)
    waiting.start()
    assert thread.stop().done
    assert waiting.is_alive()
    never.settle("stopped")
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
    asked = []
    thread._transport.enable = lambda: asked.append(1) or Order().settle()
    assert "another stop has come since" in thread.enable(number).failure
    assert not asked
    assert thread.enable(latch.number).done
    assert asked


@pytest.mark.parametrize("broken", ["stop", "enable", "home", "report", "poll", "send", "values"])
def test_a_defect_of_a_transport_stops_the_motors_and_ends_nothing(broken):
    """Whatever it raises: the answer is no, no cycle goes on, and the motors are stopped."""
    told: list[Exception] = []
    sent: list = []
    latch = Latch()
    thread = TransportThread(SimTransport(RIG, sent.append), latch, told.append)
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
        assert answer.settled
        assert not answer.done
    assert [str(error) for error in told] == ["a defect"]
    assert thread.report.condition is Condition.GONE
    assert "defect" in thread.report.reason
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
    order = thread.stop()
    assert order.failure == "the transport is busy"
    go_on.set()
    thread.close()


def test_a_defect_of_a_transport_is_told_and_the_thread_goes_on():
    told: list[Exception] = []
    again = threading.Event()
    thread = TransportThread(SimTransport(RIG, lambda table: None), Latch(), told.append)

    def poll():
        if len(told) >= 2:
            again.set()
            return []
        raise RuntimeError("a defect")

    thread._transport.poll = poll
    thread.start()
    assert again.wait(10)
    thread.close()
    assert [str(error) for error in told] == ["a defect"] * 2


@pytest.mark.parametrize(
    ("lifecycle", "latch", "condition", "reason", "calibrating", "told"),
    [
        ("unconfigured", "", None, "", False, "unconfigured"),
        ("unconfigured", EMERGENCY, None, "", False,
         "unconfigured: emergency stop; look at the rig, then call enable"),
        ("inactive", DISABLED, Condition.OFF, "", False, "inactive"),
        ("active", "", Condition.GONE, "", False, "error: the device does not answer"),
        ("active", EMERGENCY, Condition.GONE, "port is gone", False, "error: port is gone"),
        ("active", "", Condition.OFF, "", False, OFF),
        ("active", DISABLED, Condition.OFF, "stopped", False, OFF),
        ("active", DISABLED, Condition.BRAKING, "stopped", False, "braking: disabled"),
        ("inactive", DISABLED, Condition.BRAKING, "stopped", False, "inactive: braking"),
        ("active", DISABLED, Condition.OFF, "supply", False,
         "stopped: supply; look at the rig, then call enable"),
        ("active", EMERGENCY, Condition.OFF, "supply", False, f"stopped: emergency stop; {LOOK}"),
        ("active", "", Condition.OFF, "following", False,
         "stopped: following; look at the rig, then call enable"),
        ("active", "", Condition.OFF, "stopped", False,
         "stopped: before this driver began; look at the rig, then call enable"),
        ("active", "", Condition.ENABLING, "", False, "enabling: the plate goes home"),
        ("active", EMERGENCY, Condition.BRAKING, "stopped", False,
         "braking: emergency stop"),
        ("active", "", Condition.BRAKING, "heat", False, "braking: heat"),
        ("active", "", Condition.READY, "", False, "ready"),
        ("active", "", Condition.READY, "", True, "calibrating"),
        ("active", EMERGENCY, Condition.READY, "", False, "braking: emergency stop"),
    ],
)  # fmt: skip
def test_driver_state_is_what_the_motors_report(
    lifecycle, latch, condition, reason, calibrating, told
):
    report = None if condition is None else Report(condition, reason)
    assert driver_state(lifecycle, latch, report, calibrating) == told


@pytest.mark.parametrize("lifecycle", ["unconfigured", "inactive", "active"])
def test_a_stop_that_nobody_acknowledged_is_told_until_the_device_is_heard(lifecycle):
    gone, off = Report(Condition.GONE, "port is gone"), Report(Condition.OFF, "stopped")
    assert driver_state(lifecycle, CUT, gone, False, True) == UNCERTAIN
    assert driver_state(lifecycle, CUT, None, False, True) == UNCERTAIN
    assert "power cut" in driver_state(lifecycle, CUT, off, False, True)


@pytest.mark.parametrize(
    ("state", "troubles", "retries", "quiet_s", "level", "message"),
    [
        ("ready", (), 0, None, Level.OK, "all cycles as asked"),
        ("calibrating", (), 50, None, Level.OK, "all cycles as asked"),
        ("ready", ("a cycle was refused",), 0, None, Level.WARN, "a cycle was refused"),
        ("ready", (), 51, None, Level.WARN, "51 messages were repeated: the line is bad"),
        ("ready", (), 0, 1.2, Level.STALE, "no plate_cycle for 1.2 s, the plate rests"),
        (OFF, (), 0, 5.0, Level.WARN, OFF),
        ("inactive", (), 0, None, Level.WARN, "inactive"),
        ("error: x", (), 0, 5.0, Level.ERROR, "error: x"),
        (f"stopped: {CUT}; {LOOK}", (), 0, None, Level.ERROR, f"stopped: {CUT}; {LOOK}"),
    ],
)
def test_levels(state, troubles, retries, quiet_s, level, message):
    assert health(state, Statistics(problems=troubles), retries, quiet_s) == Finding(level, message)


def test_long_messages_are_refused_by_their_beginning():
    names = b"".join(
        len(n).to_bytes(4, "little") + n + b"\0" * (-len(n) % 4) for n in (b"x\0", b"y\0")
    )
    head = b"\0\1\0\0" + bytes(8) + (2).to_bytes(4, "little") + b"a\0" + bytes(2)
    head += (2).to_bytes(4, "little") + names
    check_length(head + (50).to_bytes(4, "little"), 5000, 50)
    with pytest.raises(CycleError, match="51 points, allowed: at most 50"):
        check_length(head + (51).to_bytes(4, "little"), 5000, 50)
    most = HEAD_BYTES + 50 * POINT_BYTES
    with pytest.raises(CycleError, match=f"{most + 1} bytes, allowed: at most {most}"):
        check_length(head + (50).to_bytes(4, "little"), most + 1, 50)
    for data in (b"", b"\0\1\0\0", b"\xff" * 40, head, b"\0\1\0\0" + b"\xff" * 100):
        check_length(data, len(data), 50)  # whether it is a cycle shows when it is unpacked
