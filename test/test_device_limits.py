"""Limits of acceleration, force and heat; and orders at random."""

from dataclasses import replace

import numpy as np
import pytest
from device_orders import (
    BOOT,
    ENABLE,
    HELLO,
    HOMEWARD,
    READY,
    alive,
    assert_bounded,
    ordered,
    parse_run,
    running,
    say,
    simulated,
    spline,
    upload,
    uploaded,
    wave,
)  # fmt: skip

from plate_core.serial_protocol import (  # fmt: skip
    VERSION,
    Begin,
    Commit,
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    Knots,
    State,
    Status,
    Stop,
    Telemetry,
    Trigger,
)

LIFT, TURN = (0.0, 0.0, 1.0, 1.0), (1.0, -1.0, 0.0, 0.0)
"""Two motors push 2 kg: 1 N for each m/s2. Or they turn it: 0.15 N, and 0.3 N for the others."""


def swing(
    size: float, period: float, fraction: tuple[float, ...], pieces: int = 40
) -> tuple[Knot, ...]:
    """size (1 - cos)/w^2 [m]: accelerations up to `size` [m/s2], times a share for each motor."""
    t = np.linspace(0, period, pieces + 1)
    w = 2 * np.pi / period
    states = np.stack([(1 - np.cos(w * t)) / w**2, np.sin(w * t) / w, np.cos(w * t)], axis=1)
    states[[0, -1], :2] = 0
    rows = np.float32(size * states[:, :, None] * np.array(fraction)).tolist()
    ticks = np.round(t * 1e8).astype(int).tolist()
    return tuple(Knot(k, *map(tuple, row)) for k, row in zip(ticks, rows, strict=True))


def answer(device, knots: tuple[Knot, ...]) -> Status:
    orders = ordered(*READY, upload(1, knots, 110), *alive(0.1))
    done = parse_run(device(orders, "60", "60"))  # motors that bear 60 N continuously
    return done.answers()[110 + 1 + -(-len(knots) // 4)]


@pytest.mark.parametrize(
    ("knots", "status"),
    [
        (swing(99, 0.02, TURN), Status.DONE),
        (swing(101, 0.02, TURN), Status.LIMIT),  # acceleration
        # Root mean square of 59.4 and 60.8 N, of 60
        (swing(84, 0.045, LIFT), Status.DONE),
        (swing(86, 0.045, LIFT), Status.LIMIT),
    ],
)
def test_the_device_checks_acceleration_and_heat(device, knots, status):
    assert answer(device, knots) is status


def test_the_device_checks_the_peak_force(device):
    # Motors 3 and 4: 0.15 * 2 * 40 - or + (0.8 + 0.2) * 40 N, 52 N at most
    orders = ordered(*READY, upload(1, swing(40, 0.02, (1.0, -1.0, 1.0, 1.0)), 110), 0.1)
    for limit, status in (("52.5", Status.DONE), ("51.5", Status.LIMIT)):
        assert parse_run(device(orders, "60", "60", limit)).answers()[110 + 1 + 11] is status


def test_heat_builds_up_and_brakes(device):
    orders = ordered(*READY, upload(1, swing(84.0, 0.045, LIFT), 110), *alive(0.8))
    assert parse_run(device(orders, "60", "60")).faults is Fault.NONE  # a minute to warm up
    done = parse_run(device(orders, "0.02", "60"))  # quicker than the table
    assert (done.state, done.faults) == (State.OFF, Fault.HEAT)
    heats = [p.message.heat for p in done.packets if isinstance(p.message, Telemetry)]
    assert max(heats) > 0.8
    assert heats[-1] < 0.1


def spoilt(rng: np.random.Generator, whole: bytes) -> bytes:
    """An upload with one changed byte, or some missing bytes."""
    data = bytearray(whole)
    at = int(rng.integers(len(data)))
    if rng.random() < 0.5:
        data[at] = int(rng.integers(256))
    else:
        del data[at : at + int(rng.integers(1, 300))]
    return bytes(data)


def wrong_table(rng: np.random.Generator) -> bytes:
    """One with a knot in the wrong place, or at a wrong time; numbers 150 to 158."""
    knots, at = list(wave(0.003)), int(rng.choice([0, 3, 24]))
    name, value = [("position", (1e-4,) * 4), ("ticks", 17)][int(rng.integers(2))]
    knots[at] = replace(knots[at], **{name: value})
    return upload(4, tuple(knots), 150)


def drawn_orders(rng: np.random.Generator) -> list[bytes | float | str]:
    """A run of any commands, in more or less any order, with tables and streams near the limits."""
    orders: list[bytes | float | str] = [] if rng.random() < 0.1 else [*READY]
    if rng.random() < 0.3:
        orders += [wrong_table(rng), 0.03, say(159, Commit(5, 1))]
    if rng.random() < 0.7:
        orders.append(say(199, Trigger(int(rng.integers(2**16)), int(rng.integers(9)))))
    number, beat, stops = 200, say(1, Heartbeat(7)), 0
    kinds = ("limits", "simple", "fault", "silence", "late", "jam", "enable", "stream", "reset")
    fractions = (0.38, 0.17, 0.05, 0.05, 0.08, 0.04, 0.13, 0.07, 0.03)
    for _ in range(int(rng.integers(5, 25))):
        kind, number = str(rng.choice(kinds, p=fractions)), number + int(rng.integers(1, 30))
        if kind == "limits":
            phase = float(rng.uniform(0, 7)) if rng.random() < 0.3 else 0.0
            knots = near_limits(rng, wave(float(rng.uniform(0, 0.0115)), phase))
            frames = uploaded(int(rng.integers(1, 4)), knots, number, int(rng.integers(0, 4)))
            if rng.random() < 0.2:
                rng.shuffle(frames[1:-1])
            whole = b"".join(frames)
            orders.append(whole if rng.random() < 0.8 else spoilt(rng, whole))
            number += len(frames)
        elif kind == "simple":
            some = [Home(), Stop(0), Stop(1), Hello(VERSION, 77), Hello(VERSION, 78), Hello(9, 1)]
            message = some[int(rng.integers(len(some)))]
            orders.append(say(number - int(rng.integers(0, 40)), message))
        elif kind == "enable":  # sooner or later it names the present stop
            frames = [say(number + k, Enable(BOOT + stops + k)) for k in range(4)]
            orders += [b"".join(frames), *(HOMEWARD if rng.random() < 0.5 else [])]
            number, stops = number + 4, stops + int(rng.integers(0, 2))
        elif kind == "stream":
            knots = wave(float(rng.uniform(0, 0.0115)))
            frames = [say(number, Begin(9, 0, 0))]
            for k in range(0, 96, 4):
                part = [replace(knots[i % 24], ticks=knots[i % 24].ticks + i // 24 * 10**7)
                        for i in range(k, k + 4)]  # fmt: skip
                frames.append(say(k, Knots(9, k, tuple(part))))
            orders += [b"".join([*frames, say(number + 1, Commit(9, 1))]), 0.05]
            number += 2
        elif kind == "fault":
            orders.append(f"fault {int(rng.choice([0, 0, 8, 16, 24]))}")
        elif kind == "jam":
            orders.append(f"jam {int(rng.integers(2))}")
        elif kind == "late":
            orders.append(f"late {int(rng.choice([300, 1000, 7000, 30_000, 2_000_000]))}")
        elif kind == "reset":
            orders += ["reset", f"search {int(rng.integers(1, 400))}", HELLO]
            stops += 1
        else:
            orders.append(0.3)  # long enough for the watchdog
        orders += [beat, float(rng.integers(1, 160)) * 1e-3]
    return orders


def near_limits(rng: np.random.Generator, knots: tuple[Knot, ...]) -> tuple[Knot, ...]:
    """A table with hulls that pass a limit: with pieces left out, and a speed or an acceleration
    somewhere that makes the spline swing between its knots."""
    kept = [k for k in range(len(knots)) if k in (0, 24) or rng.random() < 0.7]
    table = [knots[k] for k in kept]
    if rng.random() < 0.5:
        at, motor = int(rng.integers(1, len(table) - 1)), int(rng.integers(4))
        name, size = [("velocity", 1.0), ("acceleration", 100.0), ("position", 0.01)][
            int(rng.integers(3))
        ]
        row = list(getattr(table[at], name))
        row[motor] = float(np.float32(size * rng.uniform(0.8, 1.05)))
        table[at] = replace(table[at], **{name: tuple(row)})
    return tuple(table)


def test_the_simulator_keeps_the_limits_for_all_requests(program):
    """The simulator's device does the same, to the last bit."""
    firmware, rng = running(program), np.random.default_rng(11)
    states: set[State] = set()
    statuses: set[Status] = set()
    faults = Fault.NONE
    count = pulses = 0
    for trial in range(18):
        orders = ordered(*drawn_orders(rng))
        heat = ["0.05", "20"] if trial % 5 == 0 else []
        printed = firmware(orders, *heat)
        assert simulated(orders, *heat) == printed
        done = parse_run(printed)
        assert_bounded(done)
        reported = [p.message for p in done.packets if isinstance(p.message, Telemetry)]
        states |= {m.state for m in reported}
        for m in reported:
            faults |= m.faults
        statuses |= set(done.answers().values())
        count += len(done.times)
        pulses += len(done.line) // 2
    assert states == set(State)
    assert faults == ~Fault.LIMIT  # no setpoint was ever outside
    assert statuses >= set(Status) - {Status.TOO_LONG}
    assert count > 6_000  # setpoints
    assert pulses > 150  # of the camera's line


def scaled(knots: tuple[Knot, ...], peak: float) -> tuple[Knot, ...]:
    """Knots of which the spline's acceleration has a peak [m/s2]."""
    t = np.linspace(0, knots[-1].ticks * 1e-8, 20_001)
    fraction = peak / np.max(np.abs(spline(knots)(t, nu=2)))
    return tuple(
        Knot(k.ticks, *(tuple(np.float32(fraction * np.array(x)).tolist()) for x in states))
        for k in knots
        for states in [(k.position, k.velocity, k.acceleration)]
    )


def test_tables_near_the_limit_are_taken_and_those_beyond_refused(device):
    """Of pieces that need many halvings, with the commit right behind: more than a tick's work."""
    rng = np.random.default_rng(5)
    seen: set[Status] = set()
    for trial in range(30):
        knots = swing(100.0, 0.04, tuple(rng.choice([-1.0, 1.0], 4)), 9 + 2 * (trial % 5))
        beyond = trial % 3 == 0
        near = 10 ** rng.uniform(-6, -4)
        frames = uploaded(1, scaled(knots, 100.2 * (1 + near if beyond else 1 - near)), 110, 2)
        done = parse_run(device(ordered(*READY, b"".join(frames), 0.1)))
        status = done.answers()[110 + len(frames) - 1]
        assert status is (Status.LIMIT if beyond else Status.DONE)
        seen.add(status)
    assert seen == {Status.DONE, Status.LIMIT}


def test_a_piece_that_is_hard_to_decide_is_refused(device):
    """Of all motors, and so close to the limit that 64 halvings do not decide."""
    knots = scaled(swing(100.2, 0.05, (1.0, 1.0, 1.0, 1.0), 3), 100.2 * (1 - 1e-7))
    text = ordered(*READY, upload(1, knots, 110, 2), 0.1)
    assert parse_run(device(text, "60", "100", "100")).answers()[112] is Status.LIMIT


def test_heat_is_followed_in_single_precision(device):
    """A minute's time constant, a thousand ticks a second: what a tick adds is near the rounding
    error of the sum. By theory the heat of a mean square S of force is S (1 - exp(-t/T))."""
    knots = swing(84.0, 0.045, LIFT)
    orders = [HELLO, ENABLE, *HOMEWARD, upload(1, knots, 110, 200), *alive(8.0)]
    done = parse_run(device(ordered(*orders), "60", "60"))
    playing = [m for p in done.packets if isinstance(m := p.message, Telemetry) and m.table]
    accel = done.setpoints[:, 2, 2]  # 1 N for each m/s2
    begin = done.times[np.flatnonzero(accel)[0]]
    looked = 0
    for m in playing:
        t = m.device_us * 1e-6 - begin
        if t > 4 and abs(t / 0.045 - round(t / 0.045)) < 0.05:  # a whole number of cycles
            expected = 84.0**2 / 2 / 60.0**2 * (1 - np.exp(-t / 60.0))
            assert m.heat == pytest.approx(expected, rel=2e-3)
            looked += 1
    assert looked > 20
