"""The host's link: order, window, retries, pace, giving up, the device's clock. The rest: test/."""

import itertools
from dataclasses import replace

import pytest

from plate_core.driver_status import DriverReason
from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
)
from plate_driver.transports import Condition, Report
from plate_driver.transports.line import ANSWER_S, frame_bytes
from plate_driver.transports.link import (
    GREETING_S,
    GREETING_TRIES,
    LATER_GREETING_S,
    QUEUE_S,
    SESSION_STEP,
    TIMEOUT_S,
    Link,
)  # fmt: skip

REST = (0.0,) * 4
WRONG_DEVICE, DEVICE_RESET, NO_ANSWER = (
    DriverReason.WRONG_DEVICE, DriverReason.DEVICE_RESET, DriverReason.NO_ANSWER,
)  # fmt: skip
KNOTS = [Knot(i, REST, REST, REST) for i in range(49)]


def gone_report(reason: DriverReason, text: str) -> Report:
    return Report(Condition.GONE, reason, text)


def telemetry(state: State, faults: Fault = Fault.NONE, waiting: int = 0, stop: int = 77) -> Packet:
    return Packet(0, Telemetry(0, state, faults, stop, 0, 0, waiting, 0, REST, REST, 0.0, 0.0, 0.0))


def capabilities(**changes) -> Packet:
    values = {
        "version": VERSION, "session": 5, "boot": 1, "motors": 4, "max_knots": 512, "window": 8,
        "watchdog_ms": 250, "stroke_m": 0.01, "speed": 1.0, "accel": 100.0, "force": 200.0,
        "continuous_force": 60.0, "following_m": 0.003, "hold_ms": 10_000,
    }  # fmt: skip
    return Packet(0, Capabilities(**(values | changes)))


def connected(state: State = State.READY, baud: float = float("inf")) -> Link:
    """A link of a line without delay, that has had its first pulse."""
    link, _ = Link.connecting(5, 0.0, baud).due(0.0)
    link = link.received(capabilities(), 0.0).received(telemetry(state), 0.0)
    return link.received(Packet(0, Pulse(0, 0)), 0.0)


def messages_in(packets: list[Packet]) -> list[Message]:
    return [p.message for p in packets if not isinstance(p.message, Heartbeat)]


def done(link: Link, packets: list[Packet], now: float, status=Status.DONE) -> Link:
    for p in packets:
        if not isinstance(p.message, Heartbeat):
            link = link.received(Packet(0, Acknowledgement(p.sequence, status)), now)
    return link


def test_hello_is_repeated_and_given_up():
    link, now, sent = Link.connecting(5, 0.0), 0.0, []
    while not link.failed and now < 2 * GREETING_S:
        link, packets = link.due(now)
        sent += [(now, p) for p in packets]
        now += 0.001
    assert {p.message for _, p in sent} == {Hello(VERSION, 5)}
    waits = [b - a for (a, _), (b, _) in itertools.pairwise(sent)]
    assert waits[: GREETING_TRIES - 1] == pytest.approx([ANSWER_S] * (GREETING_TRIES - 1), abs=2e-3)
    assert waits[GREETING_TRIES:] == pytest.approx(
        [LATER_GREETING_S] * len(waits[GREETING_TRIES:]), abs=2e-3
    )
    assert link.failed == gone_report(NO_ANSWER, "device does not answer Hello")
    assert now == pytest.approx(GREETING_S, abs=0.2)
    assert link.due(now)[1] == []


def test_order_of_an_upload():
    link, first = connected().uploading(3, KNOTS, 5).due(0.01)
    assert [type(m) for m in messages_in(first)] == [Begin]
    link, packets = link.due(0.015)
    assert messages_in(packets) == []  # not before it is answered
    link = done(link, first, 0.02)
    link, some = link.due(0.02)
    assert len(messages_in(some)) == 8  # the device's window
    link, rest = link.due(0.025)
    knots = some + rest
    assert [k for m in messages_in(knots) for k in m.knots] == KNOTS
    link, last = done(link, knots, 0.03).due(0.03)
    assert messages_in(last) == [Commit(3, 5)]
    link = done(link, last, 0.035)
    # The next one does not wait until this one plays, unless it goes on from there in motion.
    assert [m.table for m in messages_in(link.uploading(4, KNOTS, 5).due(0.035)[1])] == [4]
    link = link.uploading(4, KNOTS, 5, follows=3)
    assert messages_in(link.due(0.035)[1]) == []
    link = link.received(telemetry(State.PLAYING, waiting=3), 0.04)
    assert messages_in(link.due(0.04)[1]) == []
    link, packets = link.received(telemetry(State.PLAYING), 0.05).due(0.05)
    assert [m.table for m in messages_in(packets)] == [4]


def test_messages_in_flight_fit_into_the_buffer_of_the_device():
    """With a round trip of 0.2 s it takes 0.1 s until the first of them is there."""
    slow = connected().received(Packet(0, Pulse(0, 0)), 0.2)
    slow = replace(slow, line=replace(slow.line, trip_s=0.2, deviation_s=0.0, beats=()))
    link, first = slow.uploading(3, KNOTS, 5).due(0.2)
    link, some = done(link, first, 0.4).due(0.4)
    assert len(messages_in(some)) == 8  # the window
    link, none = link.due(0.49)
    assert messages_in(none) == []
    link, rest = link.due(0.51)
    assert len(messages_in(rest)) == 5
    assert link.retries == 0


def test_messages_are_sent_at_the_speed_of_the_line():
    """Never more on the line than some milliseconds, and a frame; all of it goes out in time."""
    baud = 115_200.0
    link, first = connected(baud=baud).uploading(3, KNOTS, 5).due(0.0)
    link = done(link, first, 0.01)
    now, sent, free_at = 0.01, 0, 0.0
    while any(isinstance(p.message, Knots) for p in link.queue) and now < 2:
        link, packets = link.due(now)
        for p in packets:
            free_at = max(now, free_at) + 10 * frame_bytes(p.message) / baud
            sent += frame_bytes(p.message)
        assert free_at - now <= QUEUE_S + 10 * (225 + 17) / baud
        link = done(link, packets, now)
        for p in packets:
            if isinstance(p.message, Heartbeat):
                link = link.received(Packet(0, Pulse(p.message.host_ns, 0)), now)
        now += 0.005
    assert link.retries == 0
    assert now - 0.01 == pytest.approx(10 * sent / baud, rel=0.15)


def test_on_a_slow_line_queued_messages_are_not_repeated():
    link = connected(baud=9600.0).uploading(3, KNOTS[:2], 5)
    link, first = replace(link, heartbeat_at=1.0).due(0.02)  # after Hello
    assert messages_in(first) == [Begin(3, 2, 3201564194)]
    link, some = done(link, first, 0.1).due(0.1)
    assert messages_in(some) == [Knots(3, 0, (KNOTS[0],))]  # one knot, because it takes 68 ms
    for now in (0.11, 0.13, 0.15):
        link, more = link.due(now)
        assert messages_in(more) == []
    link, more = link.due(0.165)
    assert messages_in(more) == [Knots(3, 1, (KNOTS[1],))]
    assert link.retries == 0


def test_lost_knots_are_sent_one_by_one():
    link, first = connected().uploading(3, KNOTS[:8], 5).due(0.01)
    link, some = done(link, first, 0.01).due(0.01)
    assert len(messages_in(some)) == 2
    link = done(link, said_packets(some)[1:], 0.02)  # the second one arrived
    link, again = link.due(0.05)
    assert messages_in(again) == [Knots(3, i, (KNOTS[i],)) for i in range(4)]
    assert link.retries == 4


@pytest.mark.parametrize("start", [40, 2**16 - 30])
def test_commands_have_consecutive_numbers_of_65536(start):
    """Also those of lost knots, which are sent one by one: else an answer would fit several."""
    link, first = replace(connected(), sequence=start).uploading(3, KNOTS, 5).due(0.01)
    link, some = done(link, first, 0.01).due(0.01)
    assert [p.sequence for p in said_packets(first + some)] == [
        (start + i) % 2**16 for i in range(9)
    ]
    link, _ = link.due(0.05)
    parted = [p.sequence for p in link.queue if len(getattr(p.message, "knots", ())) == 1]
    # After Begin, 13 messages of knots, of which the last has one, and Commit.
    assert parted == [(start + i) % 2**16 for i in (*range(15, 47), 13)]
    stop = link.stopping().queue[0]
    assert stop.sequence == (start + 47) % 2**16


def test_sessions_begin_with_numbers_far_apart():
    numbers = [Link.connecting(session, 0.0).queue[0].sequence for session in range(1, 9)]
    assert numbers[0] == SESSION_STEP
    gaps = [abs(a - b) for a, b in itertools.combinations(numbers, 2)]
    assert min(*gaps, *(2**16 - gap for gap in gaps)) > 1000


def test_setpoints_of_a_stream_are_numbered_by_65536():
    link, packets = connected().adding(3, 2**16 - 6, KNOTS[:12]).due(0.01)
    assert [m.first for m in messages_in(packets)] == [2**16 - 6, 2**16 - 2, 2]
    assert [k for m in messages_in(packets) for k in m.knots] == KNOTS[:12]
    again = messages_in(link.due(0.05)[1])
    assert [m.first for m in again] == [(2**16 - 6 + i) % 2**16 for i in range(12)]
    assert [k for m in again for k in m.knots] == KNOTS[:12]


def said_packets(packets: list[Packet]) -> list[Packet]:
    return [p for p in packets if not isinstance(p.message, Heartbeat)]


def test_on_a_line_that_loses_much_all_is_sent_more_often():
    link = connected()
    bad = replace(link, line=replace(link.line, answered=0.26))  # 3 % of the bytes
    packets = bad.uploading(3, KNOTS, 5).due(0.01)[1]
    assert len(messages_in(packets)) >= 2
    assert len({p.sequence for p in said_packets(packets)}) == 1  # the same command, done once
    begun = done(bad.uploading(3, KNOTS, 5).due(0.01)[0], packets[:1], 0.02)
    knots = messages_in(begun.due(0.02)[1])
    assert all(len(m.knots) == 1 for m in knots)
    assert len(bad.stopping().due(0.01)[1]) >= 2
    beats = [n for n in range(100) if (r := bad.due(0.001 * n))[1] and (bad := r[0])]
    assert len(beats) == pytest.approx(10, abs=1)  # each 10 ms, not 25


@pytest.mark.parametrize(
    ("status", "refusal"),
    [(Status.LIMIT, "device refuses Begin: limit"), (Status.OLD, "device refuses Begin: old")],
)
def test_refused_tables_are_dropped_and_reported(status, refusal):
    link, first = connected().uploading(3, KNOTS, 5).due(0.01)
    link = done(link, first, 0.02, status)
    assert link.refusal == refusal
    assert link.queue == ()
    assert not link.failed


@pytest.mark.parametrize("state", [State.OFF, State.HOMING, State.BRAKING])
def test_a_device_that_is_not_ready_gets_no_table_and_no_enable(state):
    link = connected(state).uploading(3, KNOTS, 5)
    for now in (0.01, 1.0, 2.0):
        link = link.received(telemetry(state, Fault.HOST_SILENT | Fault.NO_HOME), now)
        link, packets = link.due(now)
        assert messages_in(packets) == []
    assert not link.busy
    # Nor does a table go on to a device that has stopped while it was on its way.
    link, first = connected().uploading(3, KNOTS, 5).due(0.01)
    link = done(link, first, 0.02).received(telemetry(state), 0.02)
    assert messages_in(link.due(0.02)[1]) == []


def test_an_enable_is_requested_once_and_discarded_by_a_stop():
    link, packets = connected(State.OFF).enabling(77).due(0.01)
    assert messages_in(packets) == [Enable(77)]
    answered = done(link, packets, 0.02, Status.WRONG_STOP)
    assert answered.answer.status is Status.WRONG_STOP
    answered = answered.received(telemetry(State.OFF, stop=78), 0.03)
    assert messages_in(answered.due(1.0)[1]) == []
    # Not answered it is repeated with its number, until there is a stop.
    assert messages_in(link.due(0.1)[1]) == [Enable(77)]
    stopped, packets = link.stopping().due(0.02)
    assert messages_in(packets) == [Stop(0)]
    assert messages_in(done(stopped, packets, 0.03).due(0.5)[1]) == []


def test_stop_overtakes_everything():
    link, _ = connected(baud=9600.0).uploading(3, KNOTS, 5).due(0.01)
    link, packets = link.uploading(4, KNOTS, 5).stopping().due(0.011)
    assert messages_in(packets) == [Stop(0)]
    # Even a greeting, which goes on after it.
    link, packets = Link.connecting(5, 0.0).stopping(True).due(0.0)
    assert messages_in(packets) == [Stop(1), Hello(VERSION, 5)]


def test_the_trigger_follows_the_greeting_and_no_stop_forgets_it():
    trigger = Trigger(100, 2)
    link, first = Link.connecting(5, 0.0, trigger=trigger).due(0.0)
    assert messages_in(first) == [Hello(VERSION, 5)]
    link = link.received(capabilities(), 0.0).received(telemetry(State.PLAYING), 0.0)
    link, packets = link.uploading(1, KNOTS[:4], 1).stopping().due(0.01)
    assert messages_in(packets) == [Stop(0), trigger]
    link, later = done(link, packets, 0.02).due(0.5)
    assert messages_in(later) == []
    assert link.refusal == ""


def test_of_two_stop_requests_the_stronger_remains():
    link, first = connected(State.PLAYING).stopping().due(0.01)
    link, again = link.stopping().due(0.011)
    assert said_packets(again)[0] == said_packets(first)[0]  # at once, and no new stop
    link, cut = link.stopping(True).due(0.012)
    assert messages_in(cut) == [Stop(1)]
    link, still = link.stopping(False).due(0.013)
    assert messages_in(still) == [Stop(1)]


def test_home_is_a_command():
    link, packets = connected(State.OFF).homing().due(0.01)
    assert messages_in(packets) == [Home()]
    assert done(link, packets, 0.02).answer.status is Status.DONE


@pytest.mark.parametrize(
    ("packet", "failed"),
    [
        (
            capabilities(version=2),
            gone_report(
                WRONG_DEVICE,
                "device has protocol version 2 and 4 motors, allowed: version 5 and 4 motors",
            ),
        ),
        (capabilities(boot=2), gone_report(DEVICE_RESET, "device was reset")),
        (
            Packet(0, Acknowledgement(9, Status.NO_SESSION)),
            gone_report(DEVICE_RESET, "device was reset"),
        ),
        (capabilities(session=4), None),
        (Packet(0, Acknowledgement(9, Status.DONE)), None),
    ],
)
def test_packets_that_end_a_link(packet, failed):
    assert connected().received(packet, 0.01).failed == failed


def test_the_timeout_of_a_link_increases_with_its_round_trip_time():
    link = connected()
    assert not link.due(TIMEOUT_S - 1e-3)[0].failed
    silent = gone_report(NO_ANSWER, "device has been silent for 1 s")
    assert link.due(TIMEOUT_S + 1e-3)[0].failed == silent
    far = replace(link, line=replace(link.line, trip_s=0.2, deviation_s=0.05))
    assert not far.due(TIMEOUT_S + 0.399)[0].failed
    assert far.due(TIMEOUT_S + 0.401)[0].failed
