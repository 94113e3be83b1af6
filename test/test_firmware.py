"""The C firmware and its twin in Python, by the same tests, and bit by bit against each other:
the document's bytes, a table's whole way, limits, watchdog, faults, fuzz."""

import re
from pathlib import Path

import numpy as np
import pytest
from desk import (
    COMMIT,
    GENTLE,
    HELLO,
    HOME,
    PERIOD_S,
    READY,
    SILENCE_S,
    SPEED,
    STROKE_M,
    Run,
    alive,
    changed,
    run,
    say,
    spline,
    upload,
    wave,
)  # fmt: skip

from plate_core.serial_protocol import (
    Acknowledgement,
    Begin,
    Capabilities,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Pulse,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    pack,
)  # fmt: skip

ROOT = Path(__file__).resolve().parents[1]


def test_bytes_are_those_of_the_document(device):
    text = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    examples = re.findall(r"^\| (\w+) \| .* \| `([0-9a-f ]+)` \|$", text, re.MULTILINE)
    host = b"".join(
        bytes.fromhex(h)
        for name, h in examples
        if name not in ("Capabilities", "Acknowledgement", "Pulse", "Telemetry")
    )
    assert run(device, host, host[:-1] + b"\xff\0").refused == 1
    done = run(device, host)
    assert done.refused == 0
    [told] = [p.message for p in done.said if isinstance(p.message, Capabilities)]
    limits = (float(np.float32(0.01)), 1.0, 100.0, 200.0, 100.0)
    assert told == Capabilities(1, 0x12345678, 0xCAFE, 4, 512, 8, 250, *limits)
    assert done.answers() == {
        3: Status.WRONG_STATE, 4: Status.DONE, 5: Status.DONE, 6: Status.DONE,
        256: Status.DONE, 257: Status.DONE, 258: Status.WRONG_STATE,
    }  # fmt: skip
    [pulse] = [p.message for p in done.said if isinstance(p.message, Pulse)]
    assert pulse == Pulse(1_500_000_000, 1_000)
    # All that it sends is what the Python codec would send.
    assert done.sent == b"".join(frame(pack(packet)) for packet in done.said)
    assert [p.sequence for p in done.said] == list(range(len(done.said)))


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
    told = [p.message for p in done.said if isinstance(p.message, Telemetry)]
    assert {m.table for m in told} == {0, 1, 2}
    assert {m.waiting for m in told} == {0, 2}
    assert max(abs(np.diff([m.device_us for m in told]) - 10_000)) == 0
    for m in told[-20:]:
        tick = np.argmin(abs(done.times - m.device_us * 1e-6))
        np.testing.assert_allclose(m.position, done.setpoints[tick, 0], rtol=1e-6)


def test_a_table_that_moves_throughout_cannot_begin_from_rest(device):
    moving = wave(0.001, moving=True)
    done = run(device, *READY, upload(1, moving, 110))
    assert done.answers()[COMMIT] is Status.JUMP
    assert done.state is State.READY


def test_repeats_are_counted(device):
    done = run(device, *READY, upload(1, GENTLE, 110, repeats=2), *alive(0.4))
    assert done.state is State.READY
    assert done.faults is Fault.NONE
    moved = done.times[np.any(done.setpoints[:, 1] != 0, axis=1)]
    assert moved[-1] - moved[0] == pytest.approx(0.198, abs=2e-3)


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
    order = {"silence": b"", "stop": say(300, Stop(0)), "hello": say(1, Hello(1, 78))}
    after = [1.2] if cause == "silence" else alive(1.2)
    orders = [*READY, upload(1, big, 110), *alive(0.1), 0.033, order[cause]]
    done = run(device, *orders, *after)
    assert done.state is State.OFF
    assert done.faults is (Fault.HOST_SILENT if cause == "silence" else Fault.STOPPED)
    assert_smooth(done)
    np.testing.assert_allclose(done.setpoints[-1, 0], 0, atol=1e-5)
    states = [p.message for p in done.said if isinstance(p.message, Telemetry)]
    braking = [m.device_us * 1e-6 for m in states if m.state is State.BRAKING and m.table]
    assert 0.079 <= braking[-1] - braking[0] <= PERIOD_S
    if cause == "silence":
        heard = [p.message.device_us * 1e-6 for p in done.said if isinstance(p.message, Pulse)]
        assert 0 < braking[0] - heard[-1] - SILENCE_S <= 0.012


def test_stop_now_takes_the_current_away(device):
    done = run(device, *READY, upload(1, GENTLE, 110), 0.033, say(300, Stop(1)), 0.1)
    assert (done.state, done.faults) == (State.OFF, Fault.STOPPED)
    last = max(p.message.device_us for p in done.said if isinstance(p.message, Telemetry))
    assert done.times[-1] < last * 1e-6 - 0.09


def test_hardware_fault_and_recovery(device):
    orders = [*READY, upload(1, GENTLE, 110), 0.03, "fault 8", 0.05]
    done = run(device, *orders)
    assert (done.state, done.faults) == (State.OFF, Fault.SUPPLY)
    done = run(device, *orders, say(200, Enable()), "fault 0", say(201, Enable()), *alive(0.7))
    assert done.answers()[200] is Status.WRONG_STATE
    assert (done.state, done.faults) == (State.READY, Fault.NONE)


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
    ],
)
def test_tables_are_looked_at(device, knots, status):
    done = run(device, *READY, upload(1, knots, 110), *alive(0.1))
    assert done.answers()[COMMIT] is status
    assert done.state is (State.PLAYING if status is Status.DONE else State.READY)
    if status is not Status.DONE:
        assert not done.setpoints.any()


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


def test_repeated_and_old_commands_start_nothing(device):
    done = run(device, *READY, say(300, Stop(0)), 0.1, say(101, Enable()), 0.1)
    assert done.state is State.OFF
    assert done.answers()[101] is Status.OLD
    done = run(device, HELLO, say(101, Home()), say(102, Stop(1)), say(102, Enable()), 0.1)
    assert done.state is State.OFF


def test_without_a_session_nothing_moves(device):
    done = run(device, say(1, Enable()), say(2, Hello(2, 9)), say(3, Enable()), 0.5)
    assert done.state is State.OFF
    assert done.answers() == {1: Status.NO_SESSION, 3: Status.NO_SESSION}


def test_fuzz(device):
    rng = np.random.default_rng(3)
    frames = [f + b"\0" for f in upload(1, wave(0.009), 110).split(b"\0")[:-1]]
    frames += [say(s, m) for s in (100, 109, 150) for m in (Enable(), Home(), Stop(0), Stop(1))]
    frames += [HELLO, say(0, Heartbeat(9)), say(120, Commit(1, 3))]
    orders: list[bytes | float] = []
    for trial in range(150):
        if trial % 10 == 0:  # it plays again
            begin = [say(99, Hello(1, 1000 + trial)), *alive(0.9), HOME, say(101, Enable())]
            orders += [*begin, *alive(0.6), upload(1, wave(0.009), 110), 0.02]
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
        orders += [bytes(stream), float(rng.uniform(0, 0.05))]
    done = run(device, *orders)
    assert np.max(np.abs(done.setpoints[:, 0])) <= STROKE_M
    assert np.max(np.abs(done.setpoints[:, 1])) <= SPEED
    assert np.max(np.abs(done.setpoints[:, 0])) > 0.8 * STROKE_M
    assert done.refused > 1000
    assert sum(isinstance(p.message, Acknowledgement) for p in done.said) > 300
