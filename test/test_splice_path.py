"""Tables that follow upon each other in motion, by the driver's serial transport and the C firmware
in simulated time."""

import numpy as np
import pytest
from simulated_firmware import PERIOD, RIG, TICK_S, enabled, pass_time

from plate_core import PlateCycle
from plate_core.motion import motor_state
from plate_core.serial_protocol import State, Status
from plate_driver.cycle_starts import CycleStarts
from plate_driver.setpoints import MotorTable, prepare
from plate_driver.transports import LATE_IN_MOTION

TAIL_S = 0.05
PIECES = 32


def shaken(number: int) -> PlateCycle:
    """Cycle by cycle a plate that begins to circle and goes on, each with a tail."""
    own = np.linspace(0, PERIOD, PIECES + 1)
    t = number * PERIOD + own
    u = np.minimum(t / PERIOD, 1)[:, None]
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds, dds = 30 * u**2 * (1 - u) ** 2 / PERIOD, 60 * u * (1 - u) * (1 - 2 * u) / PERIOD**2
    w = 2 * np.pi / 0.07  # a cycle does not end as it begins
    angle = w * t[:, None] + np.array([0.0, 1.0, 2.0])
    size = np.array([5e-4, 5e-4, 1e-3])
    p, v, a = size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)
    states = s * p, ds * p + s * v, dds * p + 2 * ds * v + s * a
    end = np.stack([state[-1] for state in states])
    tail = PlateCycle.stopping(end, TAIL_S)
    times = np.concatenate([own, PERIOD + tail.times])
    both = zip(states, tail.knots[1:], strict=True)
    return PlateCycle.from_knots(times, *(np.concatenate(pair) for pair in both))


def table(number: int, off: float = 0.0) -> MotorTable:
    """Of cycle `number`, and its first travel is `off` [m] from where the one before is spliced."""
    cycle = shaken(number)
    q, qd, qdd = motor_state(RIG, *cycle.knots[1:])
    q[0] += off
    return MotorTable(1 + number, cycle, q, qd, qdd)


def cycle_starts(measured) -> list[tuple[float, float]]:
    """When cycles began, and how long they last [s]."""
    starts, reported = CycleStarts(measured[0].time), []
    for sample in measured:
        period = sample.playing.cycle.period if sample.playing else PERIOD
        starts, began, problem = starts.updated(sample, period, sample.time)
        assert problem == ""
        reported += [] if began is None or not sample.playing else [(began, period)]
    return reported


def test_the_plate_continues_in_motion_and_rests_without_new_cycles(firmware):
    transport = enabled(firmware)
    transport.send(table(0), 1)
    measured, tables = [], 1
    while tables < 12:  # as soon as there is room
        measured += pass_time(firmware, transport, 0.005)
        if not transport.busy:
            transport.send(table(tables, 5e-7), 1)  # rounding
            tables += 1
    measured += pass_time(firmware, transport, 0.5)
    assert transport.troubles() == []
    assert firmware.states[-1] is State.READY
    firmware.check_limits()
    firmware.check_smooth()
    began, periods = np.array(cycle_starts(measured)).T
    np.testing.assert_allclose(periods, [PERIOD] * tables + [TAIL_S], atol=1e-9)
    np.testing.assert_allclose(np.diff(began), PERIOD, atol=3e-3)
    moving = [row[0] for row in firmware.setpoints if any(row[9:13])]
    assert moving[-1] - moving[0] == pytest.approx(tables * PERIOD + TAIL_S, abs=3 * TICK_S)


def test_a_table_with_another_start_is_refused_and_the_tail_is_played(firmware):
    transport = enabled(firmware)
    transport.send(table(0), 1)
    pass_time(firmware, transport, 0.05)
    transport.send(table(1, 2e-6), 1)
    measured = pass_time(firmware, transport, 0.3)
    [trouble] = transport.troubles()
    assert trouble == LATE_IN_MOTION
    assert firmware.states[-1] is State.READY
    firmware.check_smooth()
    assert [period for _, period in cycle_starts(measured)] == pytest.approx([PERIOD, TAIL_S])


@pytest.mark.parametrize("dead", [False, True])
def test_after_a_stop_or_the_end_of_the_host_the_plate_rests(firmware, dead):
    transport = enabled(firmware)
    for number in range(3):
        transport.send(table(number), 1)
        while transport.busy:
            pass_time(firmware, transport, 0.005)
    if dead:
        firmware.tick(1000)
    else:
        transport.stop()
        pass_time(firmware, transport, 1.0)
    assert firmware.states[-1] is State.OFF
    firmware.check_limits()
    firmware.check_smooth()
    np.testing.assert_allclose(firmware.setpoints[-1][1:5], 0, atol=1e-5)


def test_a_table_with_a_tail_is_played_once(firmware):
    transport = enabled(firmware)
    transport.send(table(0), 2)
    pass_time(firmware, transport, 0.1)
    [trouble] = transport.troubles()
    assert Status.REPEATS.name.lower() in trouble


def towards(state: np.ndarray, period: float) -> PlateCycle:
    """One quintic from rest to a state (3, 3), and a tail."""
    times = np.array([0, period, period, period + TAIL_S])
    rows = [np.vstack([np.zeros(3), own, own, np.zeros(3)]) for own in state]
    return PlateCycle.from_knots(times, *rows)


def test_a_third_table_continues_the_latest_of_two_tables_with_equal_ends(firmware):
    """The first one plays, the second one waits, and a third one begins where both end."""
    first, third = shaken(0), table(1)
    second = towards(first.state(-1), 0.12)
    tables = [table(0), prepare(RIG, second, 2)[0], third]
    np.testing.assert_array_equal(second.state(-1), first.state(-1))
    transport = enabled(firmware)
    measured = []
    for each in tables:
        transport.send(each, 1)
        measured += pass_time(firmware, transport, 0.03)
    measured += pass_time(firmware, transport, 0.6)
    assert transport.troubles() == []
    assert firmware.states[-1] is State.READY
    firmware.check_limits()
    firmware.check_smooth()
    periods = [period for _, period in cycle_starts(measured)]
    assert periods == pytest.approx([PERIOD, TAIL_S, 0.12, PERIOD, TAIL_S])
