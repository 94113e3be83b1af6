"""The host's link: order, window, retries, giving up, the device's clock. The rest: test/."""

import itertools

import pytest

from plate_core.serial_protocol import (
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    State,
    Status,
    Stop,
    Telemetry,
)  # fmt: skip
from plate_driver.link import RETRY_S, SILENCE_S, DeviceClock, Link

REST = (0.0,) * 4
KNOTS = [Knot(i, REST, REST, REST) for i in range(49)]


def told(state: State, faults: Fault = Fault.NONE, waiting: int = 0) -> Packet:
    return Packet(0, Telemetry(0, state, faults, 0, waiting, 0, REST, REST, 0.0))


def capabilities(**changes) -> Packet:
    values = {
        "version": 1, "session": 5, "boot": 1, "motors": 4, "max_knots": 512, "window": 8,
        "watchdog_ms": 250, "stroke_m": 0.01, "speed": 1.0,
        "accel": 100.0, "force": 200.0, "lasting": 60.0,
    }  # fmt: skip
    return Packet(0, Capabilities(**(values | changes)))


def met(state: State = State.READY) -> Link:
    link, _ = Link.begun(5, 0.0).due(0.0)
    return link.heard(capabilities(), 0.0).heard(told(state), 0.0)


def said(packets: list[Packet]) -> list[Message]:
    return [p.message for p in packets if not isinstance(p.message, Heartbeat)]


def done(link: Link, packets: list[Packet], now: float, status=Status.DONE) -> Link:
    for p in packets:
        link = link.heard(Packet(0, Acknowledgement(p.sequence, status)), now)
    return link


def test_hello_is_repeated_with_growing_waits_and_given_up():
    link, now, sent = Link.begun(5, 0.0), 0.0, []
    while not link.failed and now < 3:
        link, packets = link.due(now)
        sent += [(now, p) for p in packets]
        now += 0.001
    assert {p for _, p in sent} == {Packet(0, Hello(1, 5))}
    waits = [b - a for (a, _), (b, _) in itertools.pairwise(sent)]
    assert waits == pytest.approx(RETRY_S[:-1], abs=2e-3)
    assert link.failed == "device does not answer Hello"
    assert link.due(now)[1] == []


def test_order_of_an_upload():
    link, first = met().uploading(3, KNOTS).due(0.01)
    assert [type(m) for m in said(first)] == [Begin]
    link, packets = link.due(0.015)
    assert said(packets) == []  # not before it is answered
    link = done(link, first, 0.02)
    link, some = link.due(0.02)
    assert len(said(some)) == 8  # the device's window
    link, rest = done(link, some, 0.025).due(0.025)
    knots = [m for m in said(some + rest) if isinstance(m, Knots)]
    assert [k for m in knots for k in m.knots] == KNOTS
    link, last = done(link, rest, 0.03).due(0.03)
    assert said(last) == [Commit(3, 0)]
    # The next one is held back while this one waits for the boundary.
    link = done(link, last, 0.035).uploading(4, KNOTS)
    assert said(link.due(0.035)[1]) == []
    link = link.heard(told(State.PLAYING, waiting=3), 0.04)
    assert said(link.due(0.04)[1]) == []
    link, packets = link.heard(told(State.PLAYING), 0.05).due(0.05)
    assert [m.table for m in said(packets)] == [4]


def test_lost_knots_are_sent_one_by_one():
    link, first = met().uploading(3, KNOTS[:8]).due(0.01)
    link, some = done(link, first, 0.01).due(0.01)
    assert len(said(some)) == 2
    link = done(link, some[1:2], 0.02)  # the second one arrived
    link, again = link.due(0.05)
    assert said(again) == [Knots(3, i, (KNOTS[i],)) for i in range(4)]
    assert link.retries == 4


@pytest.mark.parametrize(
    ("status", "refusal"),
    [(Status.LIMIT, "device refuses Begin: limit"), (Status.OLD, "device refuses Begin: old")],
)
def test_refused_tables_are_dropped_and_told(status, refusal):
    link, first = met().uploading(3, KNOTS).due(0.01)
    link = done(link, first, 0.02, status)
    assert link.refusal == refusal
    assert link.queue == ()
    assert not link.failed


def test_motors_are_enabled_unless_hardware_failed():
    link, packets = met(State.OFF).uploading(3, KNOTS).due(0.01)
    assert said(packets) == [Enable()]
    link = met().heard(told(State.OFF, Fault.HOST_SILENT | Fault.SUPPLY), 0.0)
    assert said(link.uploading(3, KNOTS).due(0.01)[1]) == []


def test_stop_overtakes_everything():
    link, _ = met().uploading(3, KNOTS).due(0.01)
    link, packets = link.uploading(4, KNOTS).stopping().due(0.011)
    assert said(packets) == [Stop(0)]


@pytest.mark.parametrize(
    ("packet", "failed"),
    [
        (capabilities(version=2), "device speaks version 2 for 4 motors, allowed: version 1 for 4"),
        (capabilities(boot=2), "device was reset"),
        (Packet(0, Acknowledgement(9, Status.NO_SESSION)), "device was reset"),
        (capabilities(session=4), ""),
        (Packet(0, Acknowledgement(9, Status.DONE)), ""),
    ],
)
def test_what_ends_a_link(packet, failed):
    assert met().heard(packet, 0.01).failed == failed


def test_silence_ends_a_link():
    link = met()
    assert not link.due(SILENCE_S - 1e-3)[0].failed
    assert link.due(SILENCE_S + 1e-3)[0].failed == "device has been silent for 0.25 s"


def test_clock_is_right_to_half_the_round_trip():
    clock, offset = DeviceClock(), 123.0  # host minus device
    trips = [(1.0, 0.010, 0.002), (2.0, 0.001, 0.003), (3.0, 0.050, 0.0)]
    for sent, there, back in trips:
        device_us = round((sent + there - offset + 200) * 1e6)
        clock = clock.heard(Pulse(round(sent * 1e9), device_us), sent + there + back)
    assert clock.trip_s == pytest.approx(0.004)  # the shortest
    assert clock.host_time(0) == pytest.approx(offset - 200, abs=0.002)
    # After five seconds a longer one is better than an old one.
    clock = clock.heard(Pulse(8_000_000_000, 0), 8.02)
    assert clock.trip_s == pytest.approx(0.02)
    # A pulse from the future is nobody's.
    assert clock.heard(Pulse(9_000_000_000, 0), 8.5) == clock
