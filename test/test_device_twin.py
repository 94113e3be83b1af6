"""Limits of acceleration, force and heat on both devices, which are alike to the last bit."""

import numpy as np
import pytest
from desk import (
    HELLO,
    HOME,
    READY,
    alive,
    heard,
    ordered,
    run,
    running,
    say,
    twin,
    upload,
    wave,
)  # fmt: skip

from plate_core.serial_protocol import (
    Enable,
    Fault,
    Heartbeat,
    Hello,
    Home,
    Knot,
    State,
    Status,
    Stop,
    Telemetry,
)  # fmt: skip

LIFT, TURN = (0.0, 0.0, 1.0, 1.0), (1.0, -1.0, 0.0, 0.0)
"""Two motors push 2 kg: 1 N for each m/s2. Or they turn it: 0.15 N, and 0.3 N for the others."""


def swing(size: float, period: float, share: tuple[float, ...]) -> tuple[Knot, ...]:
    """size (1 - cos)/w^2 [m]: accelerations up to `size` [m/s2], times a share for each motor."""
    t = np.linspace(0, period, 41)
    w = 2 * np.pi / period
    states = np.stack([(1 - np.cos(w * t)) / w**2, np.sin(w * t) / w, np.cos(w * t)], axis=1)
    states[[0, -1], :2] = 0
    rows = np.float32(size * states[:, :, None] * np.array(share)).tolist()
    ticks = np.round(t * 1e8).astype(int).tolist()
    return tuple(Knot(k, *map(tuple, row)) for k, row in zip(ticks, rows, strict=True))


def answer(device, knots: tuple[Knot, ...]) -> Status:
    orders = ordered(*READY, upload(1, knots, 110), *alive(0.1))
    done = heard(device(orders, "60", "60"))  # motors that bear 60 N for ever
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
def test_acceleration_and_heat_are_looked_at(device, knots, status):
    assert answer(device, knots) is status


def test_peak_force_is_looked_at(device):
    # Motors 3 and 4: 0.15 * 2 * 40 - or + (0.8 + 0.2) * 40 N, 52 N at most
    orders = ordered(*READY, upload(1, swing(40, 0.02, (1.0, -1.0, 1.0, 1.0)), 110))
    for limit, status in (("52.5", Status.DONE), ("51.5", Status.LIMIT)):
        assert heard(device(orders, "60", "60", limit)).answers()[110 + 1 + 11] is status


def test_heat_builds_up_and_brakes(device):
    orders = ordered(*READY, upload(1, swing(84.0, 0.045, LIFT), 110), *alive(0.6))
    assert heard(device(orders, "60", "60")).faults is Fault.NONE  # a minute to warm up
    done = heard(device(orders, "0.02", "60"))  # quicker than the table
    assert (done.state, done.faults) == (State.OFF, Fault.HEAT)
    heats = [p.message.heat for p in done.said if isinstance(p.message, Telemetry)]
    assert max(heats) > 0.8
    assert heats[-1] < 0.1


def test_home_is_found_before_anything_moves(device):
    done = run(device, HELLO, say(100, Enable()), 0.1)
    assert done.answers()[100] is Status.WRONG_STATE
    assert (done.state, done.faults) == (State.OFF, Fault.NO_HOME)
    done = run(device, HELLO, HOME, 0.01)
    assert (done.state, done.faults) == (State.OFF, Fault.NONE)


def spoilt(rng: np.random.Generator, whole: bytes) -> bytes:
    """An upload with one byte changed, or some bytes gone."""
    data = bytearray(whole)
    at = int(rng.integers(len(data)))
    if rng.random() < 0.5:
        data[at] = int(rng.integers(256))
    else:
        del data[at : at + int(rng.integers(1, 300))]
    return bytes(data)


def drawn_orders(rng: np.random.Generator) -> list[bytes | float | str]:
    """A run of any commands, in more or less any order, with tables near the limits."""
    orders: list[bytes | float | str] = [] if rng.random() < 0.1 else [*READY]
    number, beat = 200, say(1, Heartbeat(7))
    simple = [Enable(), Enable(), Home(), Stop(0), Stop(1), Hello(1, 77), Hello(1, 78), Hello(9, 1)]
    for _ in range(int(rng.integers(5, 25))):
        kind, number = rng.random(), number + int(rng.integers(1, 30))
        if kind < 0.45:
            phase = float(rng.uniform(0, 7)) if rng.random() < 0.3 else 0.0
            knots = wave(float(rng.uniform(0, 0.0115)), phase, bool(rng.random() < 0.3))
            whole = upload(int(rng.integers(1, 4)), knots, number, int(rng.integers(0, 4)))
            orders.append(whole if rng.random() < 0.8 else spoilt(rng, whole))
        elif kind < 0.65:
            message = simple[int(rng.integers(len(simple)))]
            orders.append(say(number - int(rng.integers(0, 40)), message))
        elif kind < 0.7:
            orders.append(f"fault {int(rng.choice([0, 0, 8, 16]))}")
        elif kind < 0.75:
            orders.append(0.3)  # long enough for the watchdog
        orders += [beat, float(rng.integers(1, 160)) * 1e-3]
    return orders


def test_twin_is_the_firmware_bit_by_bit(program):
    firmware, rng = running(program), np.random.default_rng(11)
    states: set[State] = set()
    statuses: set[Status] = set()
    count = 0
    for trial in range(40):
        orders = ordered(*drawn_orders(rng))
        heat = ["0.05", "20"] if trial % 5 == 0 else []
        printed = firmware(orders, *heat)
        assert twin(orders, *heat) == printed
        done = heard(printed)
        states |= {p.message.state for p in done.said if isinstance(p.message, Telemetry)}
        statuses |= set(done.answers().values())
        count += len(done.times)
    assert states == set(State)
    assert statuses >= set(Status) - {Status.TOO_LONG, Status.WRONG_TIMES}
    assert count > 10_000  # setpoints, all bits alike
