"""Setpoints streamed one by one."""

from dataclasses import replace

import numpy as np
import pytest
from device_orders import (
    PERIOD_S,
    READY,
    SPEED,
    STROKE_M,
    assert_bounded,
    ordered,
    parse_run,
    run,
    running,
    say,
    simulated,
    spline,
    upload,
    wave,
)  # fmt: skip

from plate_core.serial_protocol import (  # fmt: skip
    Begin,
    Commit,
    Fault,
    Heartbeat,
    Knot,
    Knots,
    State,
    Status,
    Telemetry,
)

ACCEL = 100.0
AHEAD = 16
"""Messages of four knots before the stream begins: 0.27 s."""


def endless(periods: int, size: float = 0.002) -> tuple[Knot, ...]:
    """Knots of a motion from rest that is repeated, and ends at rest; times go on, modulo 2^32."""
    knots = wave(size)
    ticks = round(PERIOD_S * 1e8)
    made = [
        replace(knot, ticks=(2**32 - 10_000_000 + p * ticks + knot.ticks) % 2**32)
        for p in range(periods)
        for knot in knots[: -1 if p < periods - 1 else None]
    ]
    made[-1] = replace(made[-1], velocity=(0.0,) * 4, acceleration=(0.0,) * 4)
    return tuple(made)


def streamed(knots: tuple[Knot, ...], late: int = 0) -> list[bytes | float]:
    """Orders that stream knots, four each 16.7 ms; after `late` messages the host falls silent."""
    parts = [knots[i : i + 4] for i in range(0, len(knots), 4)]
    orders: list[bytes | float] = [say(110, Begin(1, 0, 0))]
    passed = 0
    for i, part in enumerate(parts[: late or None]):
        orders += [say(200 + i, Knots(1, 4 * i, part)), say(1, Heartbeat(3))]  # 1 ms each
        if i + 1 == AHEAD:
            orders.append(say(111, Commit(1, 1)))
        if i + 1 > AHEAD:
            due = round(1e3 * (i + 1 - AHEAD) * 4 * PERIOD_S / 24)
            orders.append((due - passed - 2) * 1e-3)
            passed = due
    return orders


def quiet(seconds: float) -> list[bytes | float]:
    return [say(1, Heartbeat(5)), 0.1] * round(seconds / 0.1)


def limits_kept(setpoints: np.ndarray) -> bool:
    peaks = np.max(np.abs(setpoints), axis=(0, 2))
    return bool(np.all(peaks <= np.array([STROKE_M, SPEED, ACCEL]) * 1.002))


def test_the_plate_follows_the_stream_to_its_end(device):
    knots = endless(30)
    done = run(device, *READY, *streamed(knots), *quiet(1.0))
    assert set(done.answers().values()) == {Status.DONE}
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    moving = np.flatnonzero(np.max(np.abs(done.setpoints[:, 1]), axis=1) > 1e-4)
    expected, begin = spline(wave(0.002)), done.times[moving[0]]
    t = done.times[:, None] - begin + np.arange(0, 0.03, 1e-3)  # it had begun a little before
    inside = (t[:, 0] > 0) & (t[:, -1] < 30 * PERIOD_S)
    miss = np.max(np.abs(done.setpoints[:, :1] - expected(t % PERIOD_S))[inside], axis=(0, 2))
    assert np.min(miss) < 1e-7
    assert np.sum(inside) > 2900
    assert limits_kept(done.setpoints)


def test_a_stream_that_stops_brakes_on_the_path_that_is_left(device):
    knots = endless(40, 0.008)
    done = run(device, *READY, *streamed(knots, late=100), *quiet(1.5))
    assert (done.state, done.faults) == (State.OFF, Fault.HOST_SILENT)
    assert limits_kept(done.setpoints)
    assert np.max(np.abs(done.setpoints[:, 0])) > 0.006
    steps = np.diff(done.setpoints[:, 0], axis=0)
    assert np.max(np.abs(steps)) < 1.01 * SPEED * 1e-3  # nothing jumps
    assert np.max(np.abs(done.setpoints[-1, 0])) < 1e-6  # at home
    reported = [p.message.table for p in done.packets if isinstance(p.message, Telemetry)]
    assert reported[-1] == 0


@pytest.mark.parametrize(
    ("at", "values", "status"),
    [
        (70, {"position": (0.0, 0.0, 0.011, 0.0)}, Status.LIMIT),
        (70, {"velocity": (0.0, 1.1, 0.0, 0.0)}, Status.LIMIT),
        (70, {"acceleration": (101.0, 0.0, 0.0, 0.0)}, Status.LIMIT),
        (70, {"position": (0.0, 0.0, 0.005, 0.0)}, Status.LIMIT),  # too fast from where it was
        (70, {"ticks": 5}, Status.WRONG_TIMES),
    ],
)
def test_wrong_setpoints_are_refused_and_the_plate_brakes(device, at, values, status):
    knots = list(endless(8))
    knots[at] = replace(knots[at], **values)
    done = run(device, *READY, *streamed(tuple(knots)), *quiet(1.5))
    answers = done.answers()
    assert answers[200 + at // 4] is status
    later = {answers[200 + k] for k in range(at // 4 + 2, 40)}
    assert later <= {Status.INCOMPLETE, Status.WRONG_TABLE}
    assert (done.state, done.faults) == (State.OFF, Fault.HOST_SILENT)
    assert limits_kept(done.setpoints)


def test_after_a_stream_that_ended_away_from_home_no_table_begins(device):
    knots = endless(8)
    u = np.linspace(0, 1, len(knots))
    shift = 1e-3 * (10 * u**3 - 15 * u**4 + 6 * u**5)  # to 1 mm, from rest to rest
    away = tuple(
        replace(k, position=tuple(x + s for x in k.position))
        for k, s in zip(knots, shift.tolist(), strict=True)
    )
    end = replace(away[-1], velocity=(0.0,) * 4, acceleration=(0.0,) * 4)
    done = run(
        device, *READY, *streamed((*away[:-1], end)), *quiet(0.5), upload(2, wave(0.001), 400),
        0.2,
    )  # fmt: skip
    assert np.max(np.abs(done.setpoints[-1, 0])) > 5e-4
    assert done.state is State.READY
    assert done.answers()[400 + 1 + 7] is Status.JUMP


def test_a_stream_begins_where_the_plate_is_with_room_to_brake(device):
    knots = endless(8)
    short = [say(110, Begin(1, 0, 0)), say(200, Knots(1, 0, knots[:4])), say(111, Commit(1, 1))]
    assert run(device, *READY, *short).answers()[111] is Status.INCOMPLETE
    off = tuple(replace(k, position=tuple(x + 1e-5 for x in k.position)) for k in knots)
    assert run(device, *READY, *streamed(off)).answers()[111] is Status.JUMP


def test_repeated_and_missing_messages(device):
    knots = endless(8)
    parts = [say(200 + i, Knots(1, 4 * i, knots[4 * i : 4 * i + 4])) for i in range(30)]
    orders = [say(110, Begin(1, 0, 0)), parts[0], parts[0], parts[2], parts[1], parts[2]]
    done = run(device, *READY, *orders, *parts[3:20], say(111, Commit(1, 1)), 0.05)
    reported = [
        p.message for p in done.packets if p.message.__class__.__name__ == "Acknowledgement"
    ]
    about = [m.status for m in reported if m.sequence == 202]
    assert about == [Status.INCOMPLETE, Status.DONE]
    assert done.answers()[111] is Status.DONE
    assert done.state is State.PLAYING


def test_streams_with_gaps_keep_the_limits_in_the_simulator_too(program):
    firmware, rng = running(program), np.random.default_rng(7)
    states: set[Status] = set()
    for _ in range(8):
        knots = endless(int(rng.integers(6, 40)), float(rng.uniform(0.001, 0.011)))
        orders = streamed(knots, int(rng.integers(0, 2)) * int(rng.integers(20, 200)))
        for _ in range(int(rng.integers(0, 6))):  # lost, doubled, out of turn
            k = int(rng.integers(len(orders)))
            orders[k] = orders[int(rng.integers(len(orders)))]
        text = ordered(*READY, *orders, *quiet(0.8))
        printed = firmware(text)
        assert simulated(text) == printed
        done = parse_run(printed)
        assert_bounded(done)
        states |= set(done.answers().values())
    assert {Status.DONE, Status.INCOMPLETE, Status.LIMIT, Status.WRONG_TABLE} <= states
