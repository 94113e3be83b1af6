"""The driver's serial transport against the C firmware, byte by byte, in simulated time."""

import numpy as np
import pytest
from scipy.interpolate import BPoly
from simulated_firmware import (
    PERIOD,
    REPEATS,
    RIG,
    TICK_S,
    SimulatedFirmware,
    enabled,
    link,
    long_table,
    pass_time,
    play,
    settled,
    shaking,
)

from plate_core import CycleError, PlateCycle
from plate_core.driver_status import DriverReason
from plate_core.serial_protocol import (
    Commit,
    Enable,
    Hello,
    State,
    Stop,
)  # fmt: skip
from plate_driver.cycle_starts import CycleStarts
from plate_driver.setpoints import prepare
from plate_driver.transports import (
    Condition,
    Latch,
    Report,
    SerialTransport,
    TransportThread,
)  # fmt: skip


def test_tables_arrive_and_are_played_as_often_as_requested(firmware):
    transport = enabled(firmware)
    first, second = shaking(0.0005), shaking(0.0008, turns=3)
    transport.send(first, 20)
    pass_time(firmware, transport, 1.0)
    assert firmware.states[-1] is State.PLAYING
    transport.send(second, 8)
    measured = pass_time(firmware, transport, 0.5)
    assert transport.troubles() == []
    assert (transport.retries, transport.refused) == (0, 0)
    firmware.check_limits()
    firmware.check_smooth()
    # The last cycle is the second table, as scipy draws it.
    rows = np.array(firmware.setpoints)
    knots = np.stack([second.q, second.qd, second.qdd], axis=1)
    spline = BPoly.from_derivatives(second.cycle.times.copy(), knots)
    began = next(row[0] for row in firmware.setpoints if any(row[1:5])) - TICK_S
    last = rows[-100:]
    t = (last[:, 0] - began + 1e-9) % PERIOD
    np.testing.assert_allclose(last[:, 1:5], spline(t), atol=2e-8)
    # Telemetry is on the host's clock to a tick or so: the line has no delay here.
    assert 45 <= len(measured) <= 55
    for sample in measured:
        # Measured when the tick began: where the tick before has led the motors.
        row = rows[np.argmin(np.abs(rows[:, 0] - (sample.device_s - TICK_S)))]
        np.testing.assert_allclose(sample.position, row[1:5], rtol=1e-6, atol=1e-12)
        assert abs(sample.time - sample.device_s) < 3e-3
    starts, reported = CycleStarts(firmware.now - 0.5), []
    for sample in measured:
        starts, start, problem = starts.updated(sample, PERIOD, firmware.now)
        assert problem == ""
        reported += [] if start is None else [start]
    np.testing.assert_allclose(np.diff(reported), PERIOD, atol=4e-3)
    assert len(reported) in (round(0.5 / PERIOD), round(0.5 / PERIOD) + 1)
    # Eight times, then it rests, with current; the host has sent nothing for that.
    pass_time(firmware, transport, 1.0)
    assert firmware.states[-1] is State.READY
    moving = [row[0] for row in firmware.setpoints if row[0] > began and any(row[1:5])]
    plays = (moving[-1] - began) / PERIOD
    commits = [m for m in firmware.messages() if isinstance(m, Commit)]
    assert [m.repeats for m in commits] == [20, 8]
    assert abs(plays - round(plays)) < 0.02
    transport.send(first, 3)
    before = firmware.now
    pass_time(firmware, transport, 1.0)
    moving = [row[0] for row in firmware.setpoints if row[0] > before and any(row[1:5])]
    assert moving[-1] - moving[0] == pytest.approx(3 * PERIOD, abs=0.01)
    transport.close()
    pass_time(firmware, transport, 0.02)


def test_a_table_is_not_played_longer_than_the_device_allows(firmware):
    transport = enabled(firmware)
    transport.send(shaking(0.0005), 1000)
    pass_time(firmware, transport, 0.3)
    assert [m.repeats for m in firmware.messages() if isinstance(m, Commit)] == [100]  # 10 s
    assert transport.troubles() == []
    assert firmware.states[-1] is State.PLAYING


def test_upload_takes_a_fraction_of_a_cycle(firmware):
    transport = enabled(firmware)
    transport.send(shaking(0.0005), 50)
    pass_time(firmware, transport, 1.0)
    transport.send(shaking(0.0008), 50)
    # 13 messages of knots, 3 kB: 32 ms of a line of 921,600 baud.
    for _ in range(60):
        firmware.tick()
        transport.poll()
        if not transport.busy:
            return
    pytest.fail("the second table was not there after 60 ms")


@pytest.mark.parametrize(
    ("damage", "loss", "delay", "min_tables"),
    [
        (0.01, 0.0, 0.0, 5),
        (0.0, 0.01, 0.0, 5),
        (0.0, 0.0, 0.02, 10),
        (0.003, 0.003, 0.02, 5),
        (0.0, 0.03, 0.0, 2),
        (0.0, 0.0, 0.1, 3),
    ],
)
def test_bad_lines(firmware, damage, loss, delay, min_tables):
    firmware.damage, firmware.loss, firmware.delay = damage, loss, delay
    transport = enabled(firmware)
    tables = play(firmware, transport, 4.0)
    firmware.check_limits()
    firmware.check_smooth()
    assert len(tables) >= min_tables, (tables, transport.troubles())
    assert transport.troubles() == []
    assert firmware.current
    assert [type(m) for m in firmware.messages()].count(Hello) < 20
    if damage or loss:
        assert transport.retries > 0
        assert transport.refused > 0
    # And a stop comes through.
    order = settled(firmware, transport, transport.stop())
    assert order.done
    pass_time(firmware, transport, 1.2)
    assert not firmware.current


def test_no_table_is_sent_to_motors_that_are_off(firmware):
    transport = link(firmware)
    pass_time(firmware, transport, 0.5)
    with pytest.raises(CycleError, match="the device is off, allowed: ready"):
        transport.send(shaking(0.002), REPEATS)
    pass_time(firmware, transport, 1.0)
    kinds = {type(m).__name__ for m in firmware.messages()}
    assert kinds == {"Hello", "Heartbeat"}
    assert not firmware.current
    assert firmware.setpoints == []


# Each way to undo a stop. The judge is the line, and the current.


def quiet_since(firmware: SimulatedFirmware, since: float) -> None:
    """No Enable on the line since then, and no current now."""
    assert not [m for m in firmware.messages(since) if isinstance(m, Enable)]
    assert not firmware.current
    assert firmware.states[-1] is State.OFF
    firmware.check_limits()


def goes_on(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    """A person enables, once: one Enable with the present stop, then tables play."""
    since, stop = firmware.now, firmware.stop
    order = settled(firmware, transport, transport.enable())
    assert order.done, order.failure
    assert {m for m in firmware.messages(since) if isinstance(m, Enable)} == {Enable(stop)}
    assert play(firmware, transport, 0.5)


def again(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    transport.stop()
    pass_time(firmware, transport, 0.3)
    transport.stop(cut=True)


def reset(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    firmware.reset()
    firmware.current = False  # a new process


def cable(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    firmware.cut = True
    pass_time(firmware, transport, 2.0)
    firmware.cut = False


def supply(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    firmware.order("fault 8")
    pass_time(firmware, transport, 0.1)
    firmware.order("fault 0")


def tables(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    for _ in range(5):
        with pytest.raises(CycleError, match="allowed: ready"):
            transport.send(shaking(0.002), REPEATS)
        pass_time(firmware, transport, 0.1)


def homing(firmware: SimulatedFirmware, transport: SerialTransport) -> None:
    assert settled(firmware, transport, transport.home()).done


WAYS = [again, reset, cable, supply, tables, homing]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("cut", [False, True])
def test_a_stop_latches_with_any_input(firmware, way, cut):
    transport = enabled(firmware)
    play(firmware, transport, 1.0)
    assert firmware.states[-1] is State.PLAYING
    since = firmware.now
    order = settled(firmware, transport, transport.stop(cut))
    assert order.done
    assert firmware.current != cut  # it brakes first, or not
    pass_time(firmware, transport, 1.2)
    quiet_since(firmware, since)
    way(firmware, transport)
    pass_time(firmware, transport, 2.0)
    quiet_since(firmware, since)
    goes_on(firmware, transport)


@pytest.mark.parametrize("way", [reset, cable, supply])
def test_after_a_loss_of_current_the_motors_stay_off(firmware, way):
    transport = enabled(firmware)
    play(firmware, transport, 1.0)
    assert firmware.states[-1] is State.PLAYING
    since = firmware.now
    way(firmware, transport)
    pass_time(firmware, transport, 3.0)
    quiet_since(firmware, since)
    assert transport.report().condition is Condition.OFF
    assert transport.troubles()
    goes_on(firmware, transport)


def test_a_cable_that_is_pulled_lets_the_plate_brake(firmware):
    transport = enabled(firmware)
    play(firmware, transport, 1.0)
    assert firmware.states[-1] is State.PLAYING
    firmware.cut = True
    pulled = len(firmware.states)
    for _ in range(20):
        transport.poll()
        pass_time(firmware, transport, 0.1)
    # It brakes 0.25 s after the last received frame, or rests because its table has ended before.
    later = firmware.states[pulled:]
    assert State.BRAKING in later
    assert 0.2 <= later.index(State.BRAKING) * TICK_S <= 0.28
    assert firmware.states[-1] is State.OFF
    assert any("port is" in t for t in transport.troubles())
    assert transport.report().condition is Condition.GONE
    firmware.check_limits()
    firmware.check_smooth()


@pytest.mark.parametrize("cut", [False, True])
def test_telemetry_shows_a_stop_whose_acknowledgement_is_withheld(firmware, cut):
    transport = enabled(firmware)
    play(firmware, transport, 0.5)
    assert firmware.states[-1] is State.PLAYING
    thread = TransportThread(transport, Latch(), lambda error: pytest.fail(repr(error)))
    firmware.withholds = True
    order = thread.stop(cut)
    assert not thread.stopped(order, cut, firmware.now)  # nothing shows yet
    for tick in range(400):
        firmware.tick()
        if tick % 5 == 0:
            thread.poll()
    assert thread.stopped(order, cut, firmware.now)
    assert not order.completed
    assert thread.stopping  # it goes on being tried
    firmware.withholds = False
    for tick in range(500):
        firmware.tick()
        if tick % 5 == 0:
            thread.poll()
    assert order.done


def test_a_session_of_another_host_stops_the_plate(firmware):
    first = enabled(firmware)
    play(firmware, first, 1.0)
    since = firmware.now
    second = link(firmware, seed=1000)  # as after kill -9, without a last message
    pass_time(firmware, second, 1.5)
    quiet_since(firmware, since)
    assert second.report().reason is DriverReason.EARLIER_STOP
    goes_on(firmware, second)


def test_an_enable_is_dropped_by_a_stop(firmware):
    transport = link(firmware)
    pass_time(firmware, transport, 0.5)
    firmware.loss = 1.0  # it never arrives
    wish = transport.enable()
    pass_time(firmware, transport, 0.1)
    stop = transport.stop()
    assert (wish.completed, wish.failure[:24]) == (True, "another stop has arrived")
    firmware.loss = 0.0
    since = firmware.now
    assert settled(firmware, transport, stop).done
    pass_time(firmware, transport, 1.0)
    quiet_since(firmware, since)
    goes_on(firmware, transport)


def test_an_enable_that_does_not_arrive_is_not_kept_for_later(firmware):
    transport = link(firmware)
    pass_time(firmware, transport, 0.5)
    firmware.loss = 1.0
    wish = transport.enable()
    pass_time(firmware, transport, 3.0)  # the link fails
    assert wish.completed
    assert not wish.done
    firmware.loss = 0.0
    since = firmware.now
    pass_time(firmware, transport, 3.0)
    quiet_since(firmware, since)
    goes_on(firmware, transport)


def test_an_enable_does_not_clear_a_fault_that_came_later(firmware):
    """It was given for one stop; a dip of the supply since then is another one."""
    transport = enabled(firmware)
    settled(firmware, transport, transport.stop(cut=True))
    pass_time(firmware, transport, 0.5)
    firmware.delay = 0.05
    wish = transport.enable()  # is on the line while the supply dips
    firmware.order("fault 8")
    firmware.tick()
    firmware.order("fault 0")
    settled(firmware, transport, wish)
    assert wish.failure.startswith("wrong stop"), wish.failure
    pass_time(firmware, transport, 1.0)
    assert not firmware.current
    assert "supply" in transport.report().text
    firmware.delay = 0.0
    pass_time(firmware, transport, 0.5)
    goes_on(firmware, transport)


def test_while_the_board_reports_a_fault_an_enable_is_refused(firmware):
    transport = link(firmware)
    pass_time(firmware, transport, 0.5)
    firmware.order("fault 8")
    pass_time(firmware, transport, 0.2)
    wish = settled(firmware, transport, transport.enable())
    assert wish.failure.startswith("wrong state"), wish.failure
    assert not firmware.current


def test_an_unacknowledged_stop_is_not_reported_as_done_and_arrives_later(firmware):
    transport = enabled(firmware)
    play(firmware, transport, 1.0)
    firmware.loss = 1.0
    order = settled(firmware, transport, transport.stop(cut=True))
    assert not order.completed
    firmware.loss = 0.0
    pass_time(firmware, transport, 2.0)
    assert order.done
    assert Stop(1) in firmware.messages()
    assert not firmware.current


def test_a_stop_goes_before_all_that_waits(firmware):
    transport = enabled(firmware)
    transport.send(shaking(0.002), 50)
    pass_time(firmware, transport, 0.5)
    transport.send(shaking(0.001), 50)
    firmware.tick()
    transport.poll()
    assert transport.busy
    firmware.tick()
    since = firmware.now
    transport.stop()
    assert isinstance(firmware.messages(since)[0], Stop)
    pass_time(firmware, transport, 1.5)
    assert not [m for m in firmware.messages(since) if isinstance(m, Commit)]


def test_close_stops_the_plate(firmware):
    transport = enabled(firmware)
    play(firmware, transport, 1.0)
    since = len(firmware.states)
    transport.close()
    for _ in range(900):
        firmware.tick()
    assert firmware.states[-1] is State.OFF
    # At once, not by the watchdog.
    assert State.BRAKING in firmware.states[since : since + 10]


def test_a_jam_is_reported(firmware):
    transport = enabled(firmware)
    transport.send(shaking(0.008), 50)
    pass_time(firmware, transport, 0.5)
    firmware.order("jam 1")
    pass_time(firmware, transport, 0.5)
    assert not firmware.current
    assert transport.report().reason is DriverReason.FOLLOWING
    [reported] = transport.troubles()
    assert reported.startswith("device has stopped: following (a motor was 3.")
    assert reported.endswith("mm from its setpoint, allowed: 3)")
    assert float(transport.values()["following_error_mm"]) > 3


def test_a_device_whose_clock_is_fast_is_stopped(firmware):
    transport = enabled(firmware)
    assert play(firmware, transport, 1.0)
    assert transport.troubles() == []
    firmware.fast, since = 0.2, firmware.now
    measured = []
    while firmware.states[-1] not in (State.BRAKING, State.OFF) and firmware.now < since + 2:
        measured += pass_time(firmware, transport, 0.005)
    assert firmware.now - since < 0.5
    assert transport.troubles()[0].startswith("the device's clock ran ")
    assert measured[-1].clock_problem
    pass_time(firmware, transport, 1.5)
    assert not firmware.current
    assert transport.report().reason is DriverReason.DEVICE_CLOCK
    # Enabled only when it is right again.
    assert transport.enable().failure.startswith("the device's clock ran ")
    firmware.fast = 0.0
    pass_time(firmware, transport, 3.0)
    assert settled(firmware, transport, transport.enable()).done
    assert transport.report() == Report(Condition.READY)
    assert play(firmware, transport, 0.5)


def test_a_slow_clock_is_reported_and_stops_nothing(firmware):
    """The plate is slow too, and so keeps all limits."""
    transport = enabled(firmware)
    play(firmware, transport, 0.5)
    firmware.fast = -0.2
    play(firmware, transport, 2.0)
    assert transport.troubles()[0].startswith("the device's clock ran ")
    assert pass_time(firmware, transport, 0.1)[-1].clock_problem == ""
    assert firmware.current


def test_a_clock_that_is_set_once_is_reported_and_stops_nothing(firmware):
    transport = enabled(firmware)
    play(firmware, transport, 0.5)
    firmware.order("late 40000")
    play(firmware, transport, 2.5)
    [reported] = transport.troubles()
    assert reported.startswith("the device's clock ran ")
    assert firmware.current
    assert pass_time(firmware, transport, 0.1)[-1].clock_problem == ""


def test_a_brake_is_no_problem_of_the_clock(firmware):
    transport = enabled(firmware)
    transport.send(shaking(0.0005), 50)
    pass_time(firmware, transport, 0.5)
    starts = CycleStarts(firmware.now)
    transport.stop()
    measured = pass_time(firmware, transport, 1.0)
    assert State.BRAKING in firmware.states[-1000:]
    for sample in measured:
        starts, _, problem = starts.updated(sample, PERIOD, firmware.now)
        assert problem == ""


@pytest.mark.parametrize("seed", range(1))
def test_a_table_a_second_on_a_line_that_loses_3_percent(firmware, seed):
    """And no false word of the device's clock, nor an error, in ten seconds."""
    firmware.rng = np.random.default_rng(seed)
    firmware.loss = 0.03
    transport = enabled(firmware)
    assert firmware.now < 5
    tables: set[int] = set()
    for _ in range(50):
        assert transport.report() == Report(Condition.READY)
        transport.send(long_table(), 2)
        tables |= {m.table for m in pass_time(firmware, transport, 0.2)}
    assert len(tables - {0}) >= 10
    assert transport.troubles() == []


def test_long_tables_are_refused(firmware):
    transport = enabled(firmware)
    cycle = PlateCycle.from_samples(1.0, np.zeros((600, 3)))
    with pytest.raises(CycleError, match="601 knots, allowed by the device: 512"):
        transport.send(prepare(RIG, cycle, 1)[0], 1)


def test_an_enable_reports_another_protocol_version(firmware, monkeypatch):
    monkeypatch.setattr("plate_driver.transports.link.VERSION", 9)
    transport = link(firmware)
    pass_time(firmware, transport, 0.5)
    assert "and 4 motors, allowed: version 9 and 4" in transport.enable().failure
