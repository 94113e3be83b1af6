"""Starts of cycles from telemetry: all of a true device, none that cannot be."""

from types import SimpleNamespace

import numpy as np
import pytest

from plate_driver.cycle_starts import CycleStarts
from plate_driver.transports import Measured

PERIOD, EACH_S, OFFSET_S = 0.2, 0.01, 5.0  # of a cycle; between telemetries; of the device's clock
TABLE = SimpleNamespace(cycle=SimpleNamespace(period=PERIOD), length=PERIOD)


def reported_starts(telemetry):
    """Starts (K,) reported from telemetry (time, table, ticks), and the message about them."""
    starts, begins, problems = CycleStarts(0.0), [], []
    for time, table, ticks in telemetry:
        playing = TABLE if table else None
        new = Measured(time, time - OFFSET_S, table, (0,) * 4, (0,) * 4, playing, time - ticks)
        starts, began, problem = starts.updated(new, PERIOD if table else 0.1, time + 0.004)
        begins += [] if began is None else [began]
        problems += [problem] * bool(problem)
    return np.array(begins), problems


def plays(ticks=lambda true, time: true, lost=0.0):
    """Telemetry of 3 s: rest, then tables that play twice each. `ticks` is the reported time since
    the start of the play [s]."""
    rng = np.random.default_rng(3)
    for time in np.arange(0.005, 3.0, EACH_S):
        if rng.random() < lost:
            continue
        played = time - 1.0
        table = 0 if played < 0 else 1 + int(played / (2 * PERIOD))
        yield time, table, ticks(played % PERIOD, time) if table else 0.0


@pytest.mark.parametrize("lost", [0.0, 0.5, 0.9])
def test_every_start_of_a_true_device_is_reported_once(lost):
    begins, problems = reported_starts(plays(lost=lost))
    assert problems == []
    moving = begins[begins > 0.99]
    plays_of = (moving - 1.0) / PERIOD
    np.testing.assert_allclose(plays_of, np.round(plays_of), atol=1e-9)
    assert len(np.unique(np.round(plays_of))) == len(moving)
    if lost < 0.9:  # no telemetry for a whole cycle is rare
        assert len(moving) == 10
    if not lost:
        assert len(begins) - len(moving) in (10, 11)  # of rest, each 0.1 s


@pytest.mark.parametrize(
    "wrong_ticks",
    [
        lambda true, time: 0.05,  # frozen
        lambda true, time: 0.0,
        lambda true, time: PERIOD - true,  # backwards
        lambda true, time: true + 3.0,  # seconds off
        lambda true, time: 2 * true,  # a clock of twice the speed
        lambda true, time: np.random.default_rng(round(1e3 * time)).uniform(0, PERIOD),
    ],
    ids=["frozen", "zero", "backwards", "seconds", "twice", "random"],
)
def test_no_start_is_reported_for_impossible_ticks(wrong_ticks):
    begins, problems = reported_starts(plays(wrong_ticks))
    assert len(problems) > 100
    wrong = [began for began in begins if began > 1.01 and abs((began - 1) % PERIOD) > 0.01]
    # Where the first telemetry of a play happens to be possible it cannot be known.
    assert len(wrong) <= 5


@pytest.mark.parametrize("lost", [0.0, 0.5])
@pytest.mark.parametrize("rate", [0.8, 0.99, 1.01, 1.2])
def test_ticks_that_run_fast_or_slow_are_found(rate, lost):
    """Each table of 0.2 s then lasts as much longer or shorter by the device's clock."""
    rng = np.random.default_rng(5)

    def telemetry(seconds=2.0):
        for time in np.arange(0.005, seconds, EACH_S):
            if rng.random() < lost:
                continue
            ticks = rate * (time - 0.05)
            table = 0 if ticks < 0 else 1 + int(ticks / PERIOD)
            yield time, table, ticks % PERIOD if table else 0.0

    _, problems = reported_starts(telemetry())
    assert problems
    if rate in (0.8, 1.2):
        assert len(problems) > 5


def test_a_jump_is_not_reported_and_later_starts_are():
    def late(true, time):
        return true + 0.05 * (1.65 < time < 1.73)

    begins, problems = reported_starts(plays(late))
    assert len(problems) == 2
    moving = begins[begins > 0.99]
    np.testing.assert_allclose((moving - 1.0 + 1e-9) % PERIOD, 0.0, atol=1e-6)
    assert len(moving) >= 9


def test_telemetry_from_the_future_is_rejected():
    new = Measured(8.0, 3.0, 1, (0,) * 4, (0,) * 4, TABLE, 7.9)
    _, began, problem = CycleStarts(0.0).updated(new, PERIOD, 7.0)
    assert began is None
    assert "1 s in the future" in problem
