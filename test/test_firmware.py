"""The C firmware on the host: the document's bytes, a table's whole way, watchdog, faults, fuzz."""

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BPoly

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
    Knot,
    Knots,
    Message,
    Packet,
    Pulse,
    Reader,
    State,
    Status,
    Stop,
    Telemetry,
    frame,
    pack,
    parse,
    table_crc,
)  # fmt: skip

ROOT = Path(__file__).resolve().parents[1]
STROKE_M, SPEED = 0.010, 1.0
SILENCE_S = 0.25
PERIOD_S = 0.1


@dataclass(frozen=True)
class Run:
    """What the device did: times [s], setpoints (n, 3, 4), messages, and its state in the end."""

    times: np.ndarray
    setpoints: np.ndarray
    said: list[Packet]
    sent: bytes
    state: State
    faults: Fault
    refused: int

    def answers(self) -> dict[int, Status]:
        found = [p.message for p in self.said if isinstance(p.message, Acknowledgement)]
        return {m.sequence: m.status for m in found}


def run(program: Path, *orders: bytes | float | str) -> Run:
    """Give the device bytes, seconds that pass, and lines as they are."""
    lines = []
    for order in orders:
        if isinstance(order, bytes):
            lines.append(f"rx {order.hex()}\nrun 1000")
        else:
            lines.append(order if isinstance(order, str) else f"run {round(order * 1e6)}")
    done = subprocess.run(
        [program], input="\n".join(lines) + "\nrun 1000\n", capture_output=True, text=True,
        timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    output = [line.split() for line in done.stdout.splitlines()]
    ticks = [line for line in output if line[0] == "at"]
    assert all(line[-1] != "off" for line in ticks)  # nothing is commanded without current
    sent = b"".join(bytes.fromhex(line[1]) for line in output if line[0] == "tx")
    reader, packets = Reader().fed(sent)
    assert reader == Reader()
    state, faults, refused = map(int, [line for line in output if line[0] == "state"][-1][1:])
    return Run(
        np.array([int(line[1]) * 1e-6 for line in ticks]),
        np.array([line[2:] for line in ticks], dtype=float).reshape(-1, 3, 4),
        [parse(p) for p in packets],
        sent,
        State(state),
        Fault(faults),
        refused,
    )


def say(sequence: int, message: Message) -> bytes:
    return frame(pack(Packet(sequence, message)))


def wave(size: float, phase: float = 0.0, moving: bool = False) -> tuple[Knot, ...]:
    """A closed table of 24 pieces, peak travel near `size` [m]: from rest, or moving throughout."""
    t = np.linspace(0, PERIOD_S, 25)
    w = 2 * np.pi / PERIOD_S
    lift = np.array([0.0, 0.5, 1.0, 1.5]) + phase
    angle = w * t[:, None] + lift
    q, v, a = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
    if not moving:
        s, ds, dds = (1 - np.cos(w * t)) / 2, w * np.sin(w * t) / 2, w**2 * np.cos(w * t) / 2
        s, ds, dds = s[:, None] ** 2, 2 * s[:, None] * ds[:, None], (
            2 * ds[:, None] ** 2 + 2 * s[:, None] * dds[:, None]
        )  # fmt: skip
        q, v, a = s * q, ds * q + s * v, dds * q + 2 * ds * v + s * a
        for end in (0, -1):
            q[end] = v[end] = 0
    ticks = np.round(t * 1e8).astype(int)
    rows = zip(ticks, size * q, size * v, size * a, strict=True)
    return tuple(
        Knot(int(k), *(tuple(map(float, np.float32(x))) for x in states)) for k, *states in rows
    )


def upload(table: int, knots: tuple[Knot, ...], first: int, repeats: int = 0) -> bytes:
    """All of a table's messages, numbered from `first`; the last one is Commit."""
    messages: list[Message] = [Begin(table, len(knots), table_crc(knots))]
    messages += [Knots(table, i, knots[i : i + 4]) for i in range(0, len(knots), 4)]
    messages.append(Commit(table, repeats))
    return b"".join(say(first + i, m) for i, m in enumerate(messages))


HELLO = say(100, Hello(1, 77))
READY = [HELLO, say(101, Enable()), 0.2, say(1, Heartbeat(1)), 0.2, say(1, Heartbeat(1)), 0.15]
GENTLE = wave(0.001)
COMMIT = 110 + 1 + 7  # sequence number of an upload's Commit, when its first is 110


def alive(seconds: float) -> list[bytes | float]:
    return [say(1, Heartbeat(5)), 0.1] * round(seconds / 0.1)


def test_bytes_are_those_of_the_document(program):
    text = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    examples = re.findall(r"^\| (\w+) \| .* \| `([0-9a-f ]+)` \|$", text, re.MULTILINE)
    host = b"".join(
        bytes.fromhex(h)
        for name, h in examples
        if name not in ("Capabilities", "Acknowledgement", "Pulse", "Telemetry")
    )
    assert run(program, host, host[:-1] + b"\xff\0").refused == 1
    done = run(program, host)
    assert done.refused == 0
    [told] = [p.message for p in done.said if isinstance(p.message, Capabilities)]
    assert told == Capabilities(1, 0x12345678, 0xCAFE, 4, 512, 8, 250, float(np.float32(0.01)), 1.0)
    assert done.answers() == {
        3: Status.DONE, 4: Status.DONE, 5: Status.DONE, 6: Status.DONE,
        256: Status.DONE, 257: Status.DONE, 258: Status.WRONG_STATE,
    }  # fmt: skip
    [pulse] = [p.message for p in done.said if isinstance(p.message, Pulse)]
    assert pulse == Pulse(1_500_000_000, 1_000)
    # All that it sends is what the Python codec would send.
    assert done.sent == b"".join(frame(pack(packet)) for packet in done.said)
    assert [p.sequence for p in done.said] == list(range(len(done.said)))


def spline(knots: tuple[Knot, ...]) -> BPoly:
    times = [k.ticks * 1e-8 for k in knots]
    return BPoly.from_derivatives(times, [[k.position, k.velocity, k.acceleration] for k in knots])


def test_table_is_played_and_taken_over_at_the_boundary(program):
    other = wave(0.002, phase=1.0)
    orders = [*READY, upload(1, GENTLE, 110), 0.13, upload(2, other, 210), 0.1]
    done = run(program, *orders, *alive(0.2))
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


def test_a_table_that_moves_throughout_cannot_begin_from_rest(program):
    moving = wave(0.001, moving=True)
    done = run(program, *READY, upload(1, moving, 110))
    assert done.answers()[COMMIT] is Status.JUMP
    assert done.state is State.READY


def test_repeats_are_counted(program):
    done = run(program, *READY, upload(1, GENTLE, 110, repeats=2), *alive(0.4))
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
def test_brakes_within_a_cycle_and_goes_home(program, cause):
    big = wave(0.005)
    order = {"silence": b"", "stop": say(300, Stop(0)), "hello": say(1, Hello(1, 78))}
    after = [1.2] if cause == "silence" else alive(1.2)
    orders = [*READY, upload(1, big, 110), *alive(0.1), 0.033, order[cause]]
    done = run(program, *orders, *after)
    assert done.state is State.OFF
    assert done.faults is (Fault.HOST_SILENT if cause == "silence" else Fault.STOPPED)
    assert_smooth(done)
    np.testing.assert_allclose(done.setpoints[-1, 0], 0, atol=1e-5)
    states = [p.message for p in done.said if isinstance(p.message, Telemetry)]
    braking = [m.device_us * 1e-6 for m in states if m.state is State.BRAKING and m.table]
    assert 0.08 <= braking[-1] - braking[0] <= PERIOD_S
    if cause == "silence":
        heard = [p.message.device_us * 1e-6 for p in done.said if isinstance(p.message, Pulse)]
        assert 0 < braking[0] - heard[-1] - SILENCE_S <= 0.012


def test_stop_now_takes_the_current_away(program):
    done = run(program, *READY, upload(1, GENTLE, 110), 0.033, say(300, Stop(1)), 0.1)
    assert (done.state, done.faults) == (State.OFF, Fault.STOPPED)
    last = max(p.message.device_us for p in done.said if isinstance(p.message, Telemetry))
    assert done.times[-1] < last * 1e-6 - 0.09


def test_hardware_fault_and_recovery(program):
    orders = [*READY, upload(1, GENTLE, 110), 0.03, "fault 8", 0.05]
    done = run(program, *orders)
    assert (done.state, done.faults) == (State.OFF, Fault.SUPPLY)
    done = run(program, *orders, say(200, Enable()), "fault 0", say(201, Enable()), *alive(0.7))
    assert done.answers()[200] is Status.WRONG_STATE
    assert (done.state, done.faults) == (State.READY, Fault.NONE)


def changed(at: int, **values) -> tuple[Knot, ...]:
    knots = list(GENTLE)
    knots[at] = Knot(**(vars(knots[at]) | values))
    return tuple(knots)


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
def test_tables_are_looked_at(program, knots, status):
    done = run(program, *READY, upload(1, knots, 110), *alive(0.1))
    assert done.answers()[COMMIT] is status
    assert done.state is (State.PLAYING if status is Status.DONE else State.READY)
    if status is not Status.DONE:
        assert not done.setpoints.any()


def test_damaged_upload_is_not_taken(program):
    whole = upload(1, GENTLE, 110)
    frames = [f + b"\0" for f in whole.split(b"\0")[:-1]]
    wrong_crc = say(110, Begin(1, 25, 12345))
    for data in (b"".join(frames[:3] + frames[4:]), wrong_crc + b"".join(frames[1:])):
        done = run(program, *READY, data, *alive(0.1))
        assert done.answers()[COMMIT] is Status.INCOMPLETE
        assert done.state is State.READY
    # In another order, and twice, it is.
    order = [0, 4, 1, 1, 3, 2, 7, 6, 5, 2, 8, 4]
    done = run(program, *READY, b"".join(frames[i] for i in order), *alive(0.1))
    assert done.state is State.PLAYING


def test_repeated_and_old_commands_start_nothing(program):
    done = run(program, *READY, say(300, Stop(0)), 0.1, say(101, Enable()), 0.1)
    assert done.state is State.OFF
    assert done.answers()[101] is Status.OLD
    done = run(program, HELLO, say(101, Home()), say(102, Stop(1)), say(102, Enable()), 0.1)
    assert done.state is State.OFF


def test_without_a_session_nothing_moves(program):
    done = run(program, say(1, Enable()), say(2, Hello(2, 9)), say(3, Enable()), 0.5)
    assert done.state is State.OFF
    assert done.answers() == {1: Status.NO_SESSION, 3: Status.NO_SESSION}


def test_fuzz(program):
    rng = np.random.default_rng(3)
    frames = [f + b"\0" for f in upload(1, wave(0.009), 110).split(b"\0")[:-1]]
    frames += [say(s, m) for s in (100, 109, 150) for m in (Enable(), Home(), Stop(0), Stop(1))]
    frames += [HELLO, say(0, Heartbeat(9)), say(120, Commit(1, 3))]
    orders: list[bytes | float] = []
    for trial in range(150):
        if trial % 10 == 0:  # it plays again
            begin = [say(100, Hello(1, 1000 + trial)), *alive(0.9), say(101, Enable())]
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
    done = run(program, *orders)
    assert np.max(np.abs(done.setpoints[:, 0])) <= STROKE_M
    assert np.max(np.abs(done.setpoints[:, 1])) <= SPEED
    assert np.max(np.abs(done.setpoints[:, 0])) > 0.8 * STROKE_M
    assert done.refused > 1000
    assert sum(isinstance(p.message, Acknowledgement) for p in done.said) > 300
