"""The firmware: the examples' bytes, a table's whole way, limits, watchdog, faults, fuzz."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from device_orders import (
    BOOT,
    COMMIT,
    GENTLE,
    HELLO,
    HOMEWARD,
    PERIOD_S,
    READY,
    SILENCE_S,
    SPEED,
    STROKE_M,
    UPLOAD_S,
    Run,
    alive,
    changed,
    run,
    say,
    spline,
    upload,
    uploaded,
    wave,
)  # fmt: skip

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
    Pulse,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    pack,
)

ROOT = Path(__file__).resolve().parents[1]


def test_bytes_are_those_of_the_examples(device):
    with (ROOT / "firmware/frames.csv").open(encoding="utf-8") as table:
        examples = list(csv.DictReader(table))
    host = b"".join(
        bytes.fromhex(row["frame"])
        for row in examples
        if row["message"]
        not in ("Capabilities", "Acknowledgement", "Pulse", "Telemetry", "DriveTrouble")
    )
    assert run(device, host, host[:-1] + b"\xff\0", 0.02).refused == 1
    done = run(device, host, 0.02)
    assert done.refused == 0
    [reported] = [p.message for p in done.packets if isinstance(p.message, Capabilities)]
    limits = (float(np.float32(0.01)), 1.0, 100.0, 200.0, 100.0, float(np.float32(0.003)))
    assert reported == Capabilities(VERSION, 0x12345678, 0xCAFE, 4, 512, 8, 250, *limits, 10_000)
    assert done.answers() == {
        3: Status.DONE, 4: Status.DONE, 5: Status.DONE, 6: Status.DONE,
        7: Status.DONE, 256: Status.DONE, 257: Status.DONE, 258: Status.WRONG_STATE,
        259: Status.DONE,
    }  # fmt: skip
    assert done.stop == 0xCAFE + 2
    [pulse] = [p.message for p in done.packets if isinstance(p.message, Pulse)]
    assert pulse == Pulse(1_500_000_000, 1_000)
    # It sends exactly the bytes of the Python codec.
    assert done.sent == b"".join(frame(pack(packet)) for packet in done.packets)
    assert [p.sequence for p in done.packets] == list(range(len(done.packets)))


def test_table_is_played_and_taken_over_at_the_boundary(device):
    other = wave(0.002, phase=1.0)
    orders = [*READY, upload(1, GENTLE, 110), 0.13, upload(2, other, 210), 0.1]
    done = run(device, *orders, *alive(0.2))
    assert done.state is State.PLAYING
    assert set(done.answers().values()) == {Status.DONE}
    start = done.times[np.nonzero(done.setpoints[:, 2].any(axis=1))[0][0]] - 1e-3
    at = done.times - start
    for knots, begin, end in ((GENTLE, 0.0, 0.2), (other, 0.2, 0.4)):
        part = (at >= begin - 1e-9) & (at < end - 1e-9)
        assert np.count_nonzero(part) == round((end - begin) / 1e-3)
        t = (at[part] + 1e-12) % PERIOD_S
        for order, tolerance in ((0, 1e-8), (1, 1e-5), (2, 1e-2)):
            expected = spline(knots)(t, nu=order)
            np.testing.assert_allclose(done.setpoints[part, order], expected, atol=tolerance)
    reported = [p.message for p in done.packets if isinstance(p.message, Telemetry)]
    assert {m.table for m in reported} == {0, 1, 2}
    assert {m.waiting for m in reported} == {0, 2}
    assert max(abs(np.diff([m.device_us for m in reported]) - 10_000)) == 0
    for m in reported[-20:]:
        # Measured at the start of the tick: the setpoints of the previous tick.
        tick = np.argmin(abs(done.times - m.device_us * 1e-6)) - 1
        np.testing.assert_allclose(m.position, done.setpoints[tick, 0], rtol=1e-6)


@pytest.mark.parametrize("whole", [True, False])
def test_a_waiting_table_is_replaced_when_a_newer_table_is_complete(device, whole):
    frames = uploaded(3, wave(0.001, phase=2.0), 310)
    last = b"".join(frames if whole else frames[:-1])
    orders = [*READY, upload(1, GENTLE, 110, 9), 0.13, upload(2, wave(0.002, phase=1.0), 210)]
    done = run(device, *orders, UPLOAD_S, last, *alive(0.2))
    reported = [p.message for p in done.packets if isinstance(p.message, Telemetry)]
    assert {m.table for m in reported} == ({0, 1, 3} if whole else {0, 1, 2})
    assert {m.waiting for m in reported} == ({0, 2, 3} if whole else {0, 2})


def test_repeats_are_counted_and_the_plate_rests_by_itself(device):
    done = run(device, *READY, upload(1, GENTLE, 110, repeats=2), *alive(0.4))
    assert done.state is State.READY
    assert done.faults is Fault.NONE
    moved = done.times[np.any(done.setpoints[:, 1] != 0, axis=1)]
    assert moved[-1] - moved[0] == pytest.approx(0.198, abs=2e-3)
    assert not done.setpoints[-100:].any()


@pytest.mark.parametrize(
    ("repeats", "status"),
    [(0, Status.REPEATS), (100, Status.DONE), (101, Status.REPEATS), (65535, Status.REPEATS)],
)
def test_no_table_is_repeated_for_longer_than_ten_seconds(device, repeats, status):
    done = run(device, *READY, upload(1, GENTLE, 110, repeats), *alive(0.1))
    assert done.answers()[COMMIT] is status


def test_a_table_may_be_longer_than_that_if_it_is_played_once(device):
    knots = tuple(replace(knot, ticks=120 * knot.ticks) for knot in wave(1e-5))
    knots = tuple(replace(k, velocity=(0.0,) * 4, acceleration=(0.0,) * 4) for k in knots)
    assert run(device, *READY, upload(1, knots, 110, 1), 0.1).answers()[COMMIT] is Status.DONE
    assert run(device, *READY, upload(1, knots, 110, 2), 0.1).answers()[COMMIT] is Status.REPEATS


def assert_smooth(done: Run) -> None:
    """Position, speed and acceleration belong together, and keep the limits."""
    q, v, a = np.moveaxis(done.setpoints, 1, 0)
    dt = np.diff(done.times)[:, None]
    assert np.allclose(dt, 1e-3)
    # Hermite's rule for the integral of v, error O(dt^5).
    steps = dt * (v[1:] + v[:-1]) / 2 - dt**2 * np.diff(a, axis=0) / 12
    np.testing.assert_allclose(np.diff(q, axis=0), steps, atol=2e-8)
    np.testing.assert_allclose(np.diff(v, axis=0) / dt, (a[1:] + a[:-1]) / 2, atol=0.7)
    assert np.max(np.abs(q)) <= STROKE_M
    assert np.max(np.abs(v)) <= SPEED


@pytest.mark.parametrize("cause", ["silence", "stop", "hello"])
def test_brakes_within_a_cycle_and_goes_home(device, cause):
    big = wave(0.005)
    order = {"silence": b"", "stop": say(300, Stop(0)), "hello": say(1, Hello(VERSION, 78))}
    after = [1.2] if cause == "silence" else alive(1.2)
    orders = [*READY, upload(1, big, 110), *alive(0.1), 0.033, order[cause]]
    done = run(device, *orders, *after)
    assert done.state is State.OFF
    assert done.faults is (Fault.HOST_SILENT if cause == "silence" else Fault.STOPPED)
    assert done.stop == BOOT + 1
    assert_smooth(done)
    np.testing.assert_allclose(done.setpoints[-1, 0], 0, atol=1e-5)
    states = [p.message for p in done.packets if isinstance(p.message, Telemetry)]
    braking = [m.device_us * 1e-6 for m in states if m.state is State.BRAKING and m.table]
    assert 0.079 <= braking[-1] - braking[0] <= PERIOD_S
    if cause == "silence":
        received = [
            p.message.device_us * 1e-6 for p in done.packets if isinstance(p.message, Pulse)
        ]
        assert 0 < braking[0] - received[-1] - SILENCE_S <= 0.012
    after = [m for m in states if m.device_us * 1e-6 > braking[-1] + 0.02]
    assert {m.table for m in after} == {0}
    homeward = done.setpoints[done.times > braking[-1] + 0.02]
    slope = np.gradient(homeward[:, 1], 1e-3, axis=0)
    assert (np.max(np.abs(slope)) > 0.01) == (cause != "silence")  # which ends at home
    np.testing.assert_allclose(homeward[1:-1, 2], slope[1:-1], atol=1e-3)


def test_stop_now_takes_the_current_away(device):
    done = run(device, *READY, upload(1, GENTLE, 110), 0.033, say(300, Stop(1)), 0.1)
    assert (done.state, done.faults) == (State.OFF, Fault.STOPPED)
    last = max(p.message.device_us for p in done.packets if isinstance(p.message, Telemetry))
    assert done.times[-1] < last * 1e-6 - 0.09


def test_hardware_fault_and_recovery(device):
    orders = [*READY, upload(1, GENTLE, 110), 0.03, "fault 8", 0.05]
    done = run(device, *orders)
    assert (done.state, done.faults, done.stop) == (State.OFF, Fault.SUPPLY, BOOT + 1)
    again = [say(200, Enable(BOOT + 1)), "fault 0", say(201, Enable(BOOT + 1))]
    done = run(device, *orders, *again, *alive(0.7))
    assert done.answers()[200] is Status.WRONG_STATE
    assert (done.state, done.faults) == (State.READY, Fault.NONE)


def test_home_is_found_as_part_of_enable(device):
    done = run(device, "search 100", HELLO, say(101, Enable(BOOT)), 0.05)
    assert (done.state, done.faults) == (State.HOMING, Fault.NO_HOME)
    assert done.switched == [(pytest.approx(0.002), True)]
    assert not len(done.times)  # the board moves the motors, and nothing is commanded
    done = run(device, "search 100", HELLO, say(101, Enable(BOOT)), 0.05, *HOMEWARD, 0.06)
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    assert done.times[0] == pytest.approx(0.002 + 0.1, abs=2e-3)
    # Once home is known it is not searched again, except after Home.
    off = [say(200, Stop(1)), "search 100000"]
    known = [say(201, Enable(BOOT + 1)), *HOMEWARD]
    done = run(device, *READY, *off, *known)
    assert (done.state, done.faults) == (State.READY, Fault.NONE)
    done = run(device, *READY, *off, say(202, Home()), say(203, Enable(BOOT + 1)), 0.2)
    assert (done.state, done.faults) == (State.HOMING, Fault.NO_HOME)
    assert run(device, *READY, say(202, Home())).answers()[202] is Status.WRONG_STATE


def test_a_search_for_home_has_an_end(device):
    done = run(device, "search 100000", HELLO, say(101, Enable(BOOT)), *alive(4.8))
    assert done.state is State.HOMING
    done = run(device, "search 100000", HELLO, say(101, Enable(BOOT)), *alive(5.1))
    assert (done.state, done.faults) == (State.OFF, Fault.HARDWARE | Fault.NO_HOME)
    assert done.stop == BOOT + 1
    [on, off] = done.switched
    assert off[0] - on[0] == pytest.approx(5.0, abs=2e-3)


def test_telemetry_contains_the_load(device):
    done = run(device, "load 0.125", HELLO, 0.02)
    assert {p.message.load for p in done.packets if isinstance(p.message, Telemetry)} == {0.125}


def moved(position: float = 0.0, velocity: float = 0.0) -> tuple[Knot, ...]:
    """The gentle table, at its ends away from home [m] and moving [m/s]."""
    ends = {"position": (0.0, position, 0.0, 0.0), "velocity": (0.0, 0.0, -velocity, 0.0)}
    return (replace(GENTLE[0], **ends), *GENTLE[1:-1], replace(GENTLE[-1], **ends))


def still(ticks: int) -> Knot:
    """A knot at rest at home."""
    return Knot(ticks, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4)


@pytest.mark.parametrize(
    ("knots", "status"),
    [
        (wave(0.0099), Status.DONE),
        (wave(0.0125), Status.LIMIT),
        (changed(3, velocity=(0.0, 1.1, 0.0, 0.0)), Status.LIMIT),
        # Within limits at all knots, and beyond between them.
        (changed(3, acceleration=(0.0, 3e5, 0.0, 0.0)), Status.LIMIT),
        (changed(0, ticks=1), Status.WRONG_TIMES),
        (changed(4, ticks=0), Status.WRONG_TIMES),
        (changed(-1, position=(1e-5, 0.0, 0.0, 0.0)), Status.JUMP),
        (changed(0, velocity=(0.0, 0.0, 0.01, 0.0)), Status.JUMP),
        # Closed, and moving where it closes; closed, and not at home.
        (moved(velocity=0.0021), Status.JUMP),
        (moved(velocity=0.0019), Status.DONE),
        (moved(position=2.1e-6), Status.JUMP),
        (moved(position=1.9e-6), Status.DONE),
        # Shorter than 10 ms, and as short as a table may be in the numbers of the wire.
        (tuple(still(k * 250_000) for k in range(4)), Status.WRONG_TIMES),
        (tuple(still(k * 250_000) for k in range(5)), Status.DONE),
        ((still(0), still(1)), Status.WRONG_TIMES),
    ],
)
def test_the_device_checks_tables(device, knots, status):
    # One that begins in motion cannot be repeated.
    frames = uploaded(1, knots, 110, 1 if status is Status.JUMP else 50)
    done = run(device, *READY, b"".join(frames), *alive(0.1))
    assert done.answers()[110 + len(frames) - 1] is status
    assert done.state is (State.PLAYING if status is Status.DONE else State.READY)
    if status is not Status.DONE:
        assert not done.setpoints.any()


def test_a_received_knot_is_not_overwritten(device):
    frames = uploaded(1, GENTLE, 110)
    other = say(300, Knots(1, 4, wave(0.0125)[4:8]))
    done = run(device, *READY, b"".join([*frames[:4], other, *frames[4:]]), *alive(0.1))
    assert done.answers()[300] is Status.DONE
    assert done.answers()[COMMIT] is Status.DONE
    assert done.state is State.PLAYING


def test_a_commit_that_waits_for_its_answer_is_answered_once(device):
    """A table that arrives at once is checked for many ticks."""
    knots = tuple(still(k * 100_000) for k in range(401))
    frames = uploaded(1, knots, 110, 3)
    commit, number = frames[-1], 110 + len(frames) - 1
    orders = [*READY, b"".join(frames[:1] + frames[2:-1]), *alive(0.3)]
    last = b"".join([frames[1], commit])  # the second knot is the last one to come
    done = run(device, *orders, last, commit, commit, 0.2)
    about = [p.message for p in done.packets if isinstance(p.message, Acknowledgement)]
    assert [m.status for m in about if m.sequence == number] == [Status.DONE]
    # A command that comes before the answer is done, and the commit is old.
    done = run(device, *orders, last, say(500, Home()), 0.2)
    assert done.answers()[number] is Status.OLD
    assert done.answers()[500] is Status.WRONG_STATE
    assert done.state is State.READY
    done = run(device, *orders, last, say(500, Stop(1)), 0.2)
    assert done.answers()[number] is Status.WRONG_STATE
    assert (done.answers()[500], done.state) == (Status.DONE, State.OFF)


def test_damaged_upload_is_not_taken(device):
    whole = upload(1, GENTLE, 110)
    frames = [f + b"\0" for f in whole.split(b"\0")[:-1]]
    wrong_crc = say(110, Begin(1, 25, 12345))
    for data in (b"".join(frames[:3] + frames[4:]), wrong_crc + b"".join(frames[1:])):
        done = run(device, *READY, data, *alive(0.1))
        assert done.answers()[COMMIT] is Status.INCOMPLETE
        assert done.state is State.READY
    # In another order, and twice, it is.
    order = [0, 4, 1, 1, 3, 2, 7, 6, 5, 2, 8, 4]
    done = run(device, *READY, b"".join(frames[i] for i in order), *alive(0.1))
    assert done.state is State.PLAYING


def test_random_frames_do_not_stop_the_firmware(device):
    rng = np.random.default_rng(3)
    frames = [f + b"\0" for f in upload(1, wave(0.009), 110).split(b"\0")[:-1]]
    some = (Enable(BOOT), Enable(7), Home(), Stop(0), Stop(1))
    frames += [say(s, m) for s in (100, 109, 150) for m in some]
    frames += [HELLO, say(0, Heartbeat(9)), say(120, Commit(1, 3))]
    orders: list[bytes | float | str] = []
    resets = 1
    for trial in range(150):
        if trial % 10 == 0:  # it plays again
            orders += ["reset", HELLO, say(101, Enable(BOOT + resets)), *HOMEWARD]
            orders += [upload(1, wave(0.009), 110), 2 * UPLOAD_S]
            resets += 1
        stream = bytearray()
        for _ in range(40):
            data = bytearray(frames[int(rng.integers(len(frames)))])
            kind = int(rng.integers(5))
            if kind == 0:
                data[int(rng.integers(len(data)))] = int(rng.integers(256))
            elif kind == 1:
                data = data[: int(rng.integers(len(data)))]
            elif kind == 2:
                data = bytearray(rng.bytes(int(rng.integers(300))))
            elif kind == 3:  # a right CRC, and nonsense inside
                packet = bytes([int(rng.integers(0, 20))]) + rng.bytes(int(rng.integers(240)))
                data = bytearray(frame(packet))
            stream += data
        orders += [bytes(stream), len(stream) / 128e3 + float(rng.uniform(0, 0.05))]
    done = run(device, *orders)
    assert np.max(np.abs(done.setpoints[:, 0])) <= STROKE_M
    assert np.max(np.abs(done.setpoints[:, 1])) <= SPEED
    assert np.max(np.abs(done.setpoints[:, 0])) > 0.8 * STROKE_M
    assert done.refused > 100  # since the last reset
    assert sum(isinstance(p.message, Acknowledgement) for p in done.packets) > 300
