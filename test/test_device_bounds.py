"""Nothing that comes makes a setpoint jump: hostile packets with right CRC, tables
that would ratchet, periods shorter than a tick, ticks that come late, a plate that is jammed."""

import subprocess

import numpy as np
import pytest
from device_orders import (
    ACCEL,
    BOOT,
    GENTLE,
    HELLO,
    HOMEWARD,
    READY,
    SLACK,
    SPEED,
    STEP_M,
    STROKE_M,
    UPLOAD_S,
    alive,
    assert_bounded,
    ordered,
    parse_run,
    run,
    say,
    upload,
    wave,
)  # fmt: skip
from simulated_firmware import FIRMWARE

from plate_core.serial_protocol import (  # fmt: skip
    Acknowledgement,
    Begin,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    Pulse,
    State,
    Status,
    Telemetry,
    frame,
    table_crc,
)

PLAYING = [*READY, upload(1, wave(0.009), 110), UPLOAD_S, 0.05]


def hostile(rng: np.random.Generator, number: int) -> bytes:
    """A packet with right CRC: any type, and values that are as large as a float goes, tiny, near
    the limits, or at random; some of a wrong length."""
    kind = rng.random()

    def value(unit: float) -> float:
        sizes = (0.0, 1e-9, 0.5, 0.999, 1.0, 1.001, 1.01, 5.0, 1e6, 3e38 / unit)
        size = sizes[rng.integers(len(sizes))]
        return float(np.float32((-1, 1)[rng.integers(2)] * unit * size))

    def knot() -> Knot:
        row = [tuple(value(unit) for _ in range(4)) for unit in (STROKE_M, SPEED, ACCEL)]
        return Knot(int(rng.choice([0, 1, 999, 10**6, 10**7, 2**31, 2**32 - 1])), *row)

    if kind < 0.25:
        size = int(rng.integers(1, 240))
        return frame(
            bytes([int(rng.choice([1, 2, 3, 4, 5, 16, 17, 18, 129, 77]))]) + rng.bytes(size)
        )
    table = int(rng.integers(0, 3))
    if kind < 0.6:
        knots = tuple(knot() for _ in range(int(rng.integers(1, 5))))
        return say(number, Knots(table, int(rng.choice([0, 1, 4, 511, 65535])), knots))
    splice_ticks = int(rng.choice([0, 0, 0, 10**6, 2**32 - 1]))
    crc, count = int(rng.integers(2**32)), int(rng.choice([0, 1, 2, 5, 512, 513, 65535]))
    messages = [
        Begin(table, count, crc, splice_ticks),
        Commit(table, int(rng.integers(0, 4))),
        Home(),
        Heartbeat(2**64 - 1),
        Hello(int(rng.integers(0, 256)), 77),
        Enable(int(rng.integers(2**16))),
    ]
    return say(number, messages[int(rng.integers(len(messages)))])


def short_table(rng: np.random.Generator, number: int) -> bytes:
    """A whole table of a few knots with right CRC, of any values and periods."""
    count = int(rng.integers(2, 6))
    times = np.sort(rng.integers(1, int(rng.choice([10, 10**6, 10**7])), count - 1))
    rows = rng.normal(0, 0.3, (count, 3, 4)) * np.array([STROKE_M, SPEED, ACCEL])[:, None]
    rows[[0, -1], :2] *= float(rng.choice([0.0, 1e-4, 1.0]))
    knots = tuple(
        Knot(int(t), *(tuple(x) for x in np.float32(row).tolist()))
        for t, row in zip([0, *times], rows, strict=True)
    )
    splice_ticks = knots[count - 2].ticks if rng.random() < 0.3 else 0
    messages = [Begin(2, count, table_crc(knots), splice_ticks), Knots(2, 0, knots[:4])]
    messages += [Knots(2, 4, knots[4:])] if count > 4 else []
    messages.append(Commit(2, int(rng.integers(1, 5))))
    return b"".join(say(number + i, message) for i, message in enumerate(messages))


def test_ten_thousand_hostile_packets(device):
    trials = 25
    rng = np.random.default_rng(23)
    orders: list[bytes | float | str] = []
    for trial in range(trials):
        stop = BOOT + trial
        orders += ["reset"] if trial else []
        orders += [HELLO, say(101, Enable(stop)), *HOMEWARD, upload(1, wave(0.009), 110), UPLOAD_S]
        number = 200
        for _ in range(40):
            packets = []
            for _ in range(10):
                number += int(rng.integers(0, 3))
                packets.append(hostile(rng, number))
            number += 7
            data = b"".join([*packets, short_table(rng, number), say(0, Heartbeat(1))])
            orders += [data, len(data) / 128e3 + 0.01]
            number += 7
    done = run(device, *orders)
    assert_bounded(done)
    assert np.max(np.abs(done.setpoints[:, 0])) > 0.8 * STROKE_M  # it moved meanwhile
    assert len(done.times) > 800 * trials
    statuses = {p.message.status for p in done.packets if isinstance(p.message, Acknowledgement)}
    assert statuses >= set(Status) - {Status.NO_SESSION}
    assert Fault.LIMIT not in {
        p.message.faults for p in done.packets if isinstance(p.message, Telemetry)
    }


def test_tables_with_growing_end_speeds_are_refused(device):
    """Each begins as fast as the one before has ended, and ends 2 mm/s faster."""
    orders: list[bytes | float | str] = [*PLAYING]
    begin = 0.0
    for i in range(12):
        end = begin + 0.0019
        ticks, rows = (0, 2_000_000), np.zeros((2, 3, 4), np.float32)
        rows[0, 1], rows[1, 1] = begin, end
        knots = tuple(
            Knot(k, *(tuple(x) for x in row.tolist())) for k, row in zip(ticks, rows, strict=True)
        )
        messages = [Begin(2, 2, table_crc(knots)), Knots(2, 0, knots), Commit(2, 1)]
        orders.append(b"".join(say(200 + 4 * i + j, m) for j, m in enumerate(messages)))
        orders += [say(1, Heartbeat(1)), 0.1]
        begin = end
    done = run(device, *orders)
    answers = [done.answers()[200 + 4 * i + 2] for i in range(12)]
    assert answers == [Status.DONE] + 11 * [Status.JUMP]
    assert_bounded(done)


@pytest.mark.parametrize("period", [1, 999_999])
def test_a_table_shorter_than_a_tick_is_refused_and_the_tick_ends(device, period):
    still = ((0.0,) * 4,) * 3
    for playing in ([], [upload(1, GENTLE, 110), UPLOAD_S, 0.05]):
        tiny = upload(2, (Knot(0, *still), Knot(period, *still)), 200, 65535)
        done = run(device, *READY, *playing, tiny, 0.1)
        assert done.answers()[202] is Status.REPEATS or period == 1
        once = upload(2, (Knot(0, *still), Knot(period, *still)), 200, 1)
        done = run(device, *READY, *playing, once, 0.1)
        assert done.answers()[202] is Status.WRONG_TIMES
        assert done.state is (State.PLAYING if playing else State.READY)


@pytest.mark.parametrize("late", [1_500, 5_000, 40_000])
def test_a_late_tick_moves_the_plate_by_two_milliseconds(device, late):
    orders: list[bytes | float | str] = [*PLAYING]
    for k in range(20):
        orders += [f"late {late}", 0.007 + 0.001 * (k % 5), say(1, Heartbeat(1))]
    done = run(device, *orders)
    assert_bounded(done)
    assert (done.state, done.faults) == (State.PLAYING, Fault.NONE)
    # In a late tick, the table's time advances by 2 ms: the played motion is otherwise the same.
    in_time = run(device, *PLAYING, *alive(0.5))
    begin, expected = (
        np.flatnonzero(np.any(d.setpoints[:, 2] != 0, axis=1))[0] for d in (done, in_time)
    )
    passed = np.minimum(np.diff(done.times[begin:]), 2e-3)
    ticks = np.round(np.cumsum(passed) * 1e3, 3)
    assert np.sum(passed > 1.5e-3) == 20
    whole = np.flatnonzero(ticks % 1 == 0)
    np.testing.assert_allclose(
        done.setpoints[begin + 1 :, 0][whole],
        in_time.setpoints[expected + ticks[whole].astype(int), 0],
        atol=2e-7,
    )


def test_a_jammed_plate_is_a_fault(device):
    done = run(device, *PLAYING, "jam 1", *alive(0.1))
    assert (done.state, done.faults) == (State.OFF, Fault.FOLLOWING)
    assert done.stop == BOOT + 1
    # From the third tick in which it was further off than 3 mm there is no setpoint more.
    stood = np.searchsorted(done.times, jam_time(device))
    miss = np.max(np.abs(done.setpoints[stood:, 0] - done.setpoints[stood - 1, 0]), axis=1)
    assert np.all(miss[-3:] > 0.003)
    runs = np.convolve(miss[:-1] > 0.003, np.ones(3), "valid")
    assert not np.any(runs == 3)
    reported = max(p.message.following_m for p in done.packets if isinstance(p.message, Telemetry))
    assert 0.003 < reported < STROKE_M


def jam_time(device) -> float:
    return run(device, *PLAYING).times[-1] - 0.5e-3


def test_a_small_or_short_following_error_is_reported_and_is_no_fault(device):
    small = [*READY, upload(1, wave(0.0014), 110), UPLOAD_S, "jam 1", *alive(0.1)]
    done = run(device, *small)
    assert (done.state, done.faults) == (State.PLAYING, Fault.NONE)
    reported = [p.message.following_m for p in done.packets if isinstance(p.message, Telemetry)]
    assert 0.001 < max(reported) < 0.003
    assert reported[1] == 0
    # Beyond it for one tick or two, again and again
    short: list[bytes | float | str] = [*PLAYING]
    for _ in range(40):
        short += ["jam 1", 0.006, "jam 0", 0.001, say(1, Heartbeat(1))]
    done = run(device, *short)
    assert (done.state, done.faults) == (State.PLAYING, Fault.NONE)
    reported = [p.message.following_m for p in done.packets if isinstance(p.message, Telemetry)]
    assert max(reported) > 0.003


def test_the_motion_home_is_monitored_too(device):
    done = run(device, *PLAYING, say(300, Home()), 0.26, "jam 1", 1.0)
    assert done.state is State.OFF
    assert Fault.FOLLOWING in done.faults


def test_following_is_not_watched_where_the_rig_gives_no_limit(device):
    orders = ordered(*PLAYING, "jam 1", *alive(0.2))
    done = parse_run(device(orders, "60", "100", "200", "0"))
    assert (done.state, done.faults) == (State.PLAYING, Fault.NONE)
    reported = max(p.message.following_m for p in done.packets if isinstance(p.message, Telemetry))
    assert reported > 0.005


@pytest.mark.parametrize("place", [0.01, -0.0099, 1e-9])
def test_the_plate_goes_home_from_any_position(device, place):
    done = run(device, HELLO, f"place {place}", say(101, Enable(BOOT)), *HOMEWARD)
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    assert_bounded(done)
    q, v = done.setpoints[:, 0], done.setpoints[:, 1]
    assert np.max(np.abs(q[0] - place)) < abs(place) * 1e-4 + 1e-12
    assert np.max(np.abs(v)) == pytest.approx(abs(place) / 0.5 * 15 / 8, rel=1e-3)
    assert not done.setpoints[-1].any()


@pytest.mark.parametrize("place", ["0.0101", "-1.0", "nan", "inf"])
def test_a_plate_that_is_where_it_cannot_be_is_not_moved(device, place):
    done = run(device, HELLO, f"place {place}", say(101, Enable(BOOT)), *HOMEWARD)
    assert not len(done.setpoints)
    assert (done.state, done.faults, done.stop) == (State.OFF, Fault.LIMIT, BOOT + 1)
    # Whatever the sensors report, telemetry can be read, and shows that the motors are off.
    reported = [p.message for p in done.packets if isinstance(p.message, Telemetry)]
    assert (reported[-1].state, reported[-1].faults) == (State.OFF, Fault.LIMIT)


CHECK = """
#include <stdio.h>
#include "controller.c"
#include "host.h"
#undef main
int main(void)
{
    static Controller c;
    Setpoint at = {0};
    c.limits = motors_start();
    while (scanf("%f %f", &at.position[2], &at.velocity[2]) == 2)
        printf("%d", setpoint_allowed(&c, &at, 1e-3f));
}
"""
"""A program that computes which setpoints are allowed 1 ms after rest at home."""


def test_a_setpoint_too_far_from_the_last_is_not_commanded(tmp_path):
    """No message leads to one; so the check itself is tested."""
    program = tmp_path / "check"
    program.with_suffix(".c").write_text(CHECK, encoding="utf-8")
    others = [file for file in FIRMWARE.glob("*.c") if file.name != "controller.c"]
    desk = [FIRMWARE / "host" / name for name in ("host.c", "motors.c")]
    command = ["cc", "-Dmain=desk", f"-I{FIRMWARE}", f"-I{FIRMWARE}/host", "-o", program]
    subprocess.run([*command, program.with_suffix(".c"), *others, *desk, "-lm"], check=True)
    step, change = SPEED * SLACK * 1e-3 + STEP_M, ACCEL * 1.1e-3 + 4e-3
    fractions = np.array([0.999, 1.001, -0.999, -1.001, np.nan])
    rows = [*np.outer(fractions * step, [1, 0]), *np.outer(fractions * change, [0, 1])]
    text = "\n".join(f"{q} {v}" for q, v in np.nan_to_num(rows, nan=np.nan))
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    assert done.stdout == 2 * "10100"


def test_a_tick_reads_and_executes_a_limited_number_of_messages(device):
    """128 bytes and four packets; the rest is read in the following ticks."""
    beats = b"".join(say(k, Heartbeat(k)) for k in range(1, 101))  # 18 bytes and less each
    done = run(device, HELLO, beats, 0.1)
    pulses = [p.message for p in done.packets if isinstance(p.message, Pulse)]
    assert [m.host_ns for m in pulses] == list(range(1, 101))
    at_once = np.unique([m.device_us for m in pulses], return_counts=True)[1]
    assert max(at_once) == 4
    assert len(at_once) == 25
    padding = bytes(127) + say(1, Heartbeat(1))
    done = run(device, HELLO, padding)
    [pulse] = [p.message for p in done.packets if isinstance(p.message, Pulse)]
    assert pulse.device_us == 3_000  # HELLO is read in the first tick
