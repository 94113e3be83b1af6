"""Cycles as an endless stream of setpoints."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from plate_core import PlateCycle, load_rig
from plate_driver.setpoints.motor_table import MotorTable
from plate_driver.setpoints.setpoint_stream import (
    MAX_S,
    TICKS,
    SetpointStream,
    densest,
    knots,
    refined,
)

RIG = load_rig()


def cycle(period: float, count: int, seed: int) -> MotorTable:
    rng = np.random.default_rng(seed)
    t = np.linspace(0, period, count)
    states = 1e-3 * rng.normal(size=(3, count, 3))
    states[:, [0, -1]] = 0
    return MotorTable.of(RIG, PlateCycle.from_knots(t, *states), 1)


def test_refined_pieces_are_the_same_motion():
    table = cycle(0.5, 5, 0)
    made = refined(table)
    t = np.array([k.ticks * 1e-8 for k in made])
    assert np.max(np.diff(t)) <= MAX_S + 1e-8
    ends = np.stack([table.q, table.qd, table.qdd], axis=1)
    exact = BPoly.from_derivatives(table.cycle.times.copy(), ends)
    for order, name in enumerate(("position", "velocity", "acceleration")):
        got = np.array([getattr(k, name) for k in made])
        np.testing.assert_allclose(got[:-1], exact(t[:-1], order), rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(got[-1], ends[-1, order], rtol=1e-6)


def test_a_fine_table_stays_as_it_is():
    table = cycle(0.2, 49, 1)
    assert refined(table) == knots(table)


def test_the_stream_continues_with_the_newest_cycle_at_a_boundary():
    tables = [cycle(0.2, 9, seed) for seed in (2, 3)]
    first, second = (knots(table) for table in tables)
    stream, sent = SetpointStream.of(tables[0], 9).until(0.3)
    assert sent[0] == first[0]
    assert abs(stream.time - 0.3) <= 0.025
    stream = stream.followed_by(tables[1], 9)
    stream, more = stream.until(0.7)
    both = [*sent, *more]
    assert stream.sent == len(both)
    assert [k.ticks for k in both] == [2_500_000 * i for i in range(len(both))]
    states = [(k.position, k.velocity) for k in both]
    expected = [*first, *first[1:], *second[1:], *second[1:]]
    assert states == [(k.position, k.velocity) for k in expected[: len(both)]]


def test_times_wrap():
    stream = SetpointStream.of(cycle(0.2, 9, 2), 1000)
    stream, sent = stream.until(50.0)
    ticks = np.array([k.ticks for k in sent])
    assert np.all(np.diff(ticks) % TICKS == 2_500_000)
    assert ticks.max() < TICKS


def test_a_stream_ends_at_rest_when_its_cycles_have_been_sent():
    stream, sent = SetpointStream.of(cycle(0.2, 9, 2), 3).until(50.0)
    assert stream.ended
    assert len(sent) == 3 * 8 + 1 + 1
    assert sent[-2].ticks == 60_000_000
    last = sent[-1]
    assert not any((*last.position, *last.velocity, *last.acceleration))
    assert 0 < last.ticks - sent[-2].ticks <= 5_000_000  # no piece may be longer
    assert abs(stream.time - last.ticks * 1e-8) < 1e-12
    assert stream.until(60.0) == (stream, ())
    # The path to rest: no larger acceleration than before, and hardly any distance.
    ends = [[k.position[0], k.velocity[0], 100.0 if k is sent[-2] else 0.0] for k in sent[-2:]]
    way = BPoly.from_derivatives([0.0, (last.ticks - sent[-2].ticks) * 1e-8], ends)
    t = np.linspace(0, way.x[-1], 200)
    assert np.max(np.abs(way(t, 2))) <= 100.0 * (1 + 1e-9)
    assert np.max(np.abs(way(t))) < 2e-4


def test_rest_up_to_rounding_can_follow_rest():
    tables = []
    for off in (9e-7, -9e-7):
        pose = np.full((9, 3), off)
        tables.append(MotorTable.of(RIG, PlateCycle.from_samples(0.2, pose), 1))
    stream, _ = SetpointStream.of(tables[0], 1).until(0.1)
    stream, _ = stream.followed_by(tables[1], 1).until(50.0)
    assert abs(stream.time - (0.2 + 0.2 + 0.01)) < 1e-9


def test_a_newer_cycle_restarts_the_count():
    first, second = (cycle(0.2, 9, seed) for seed in (2, 3))
    stream, _ = SetpointStream.of(first, 2).until(0.3)
    stream, _ = stream.followed_by(second, 3).until(50.0)
    assert abs(stream.time - (0.4 + 0.6 + 0.01)) < 1e-9


@pytest.mark.parametrize("repeats", [1, 2, 9])
@pytest.mark.parametrize("window_s", [0.03, 0.15, 0.7])
@pytest.mark.parametrize("seed", range(3))
def test_the_computed_maximum_number_of_setpoints_agrees_with_the_stream(seed, window_s, repeats):
    rng = np.random.default_rng(seed)
    t = 0.01 * np.append(0, np.sort(rng.choice(np.arange(1, 20), 7, replace=False)))
    states = 1e-3 * rng.normal(size=(3, 8, 3))
    states[:, [0, -1]] = 0
    table = MotorTable.of(RIG, PlateCycle.from_knots(t, *states), 1)
    _, sent = SetpointStream.of(table, repeats).until(50.0)
    ticks = np.array([k.ticks for k in sent])
    counts = [np.sum((first <= ticks) & (ticks <= first + 1e8 * window_s)) for first in ticks]
    assert densest(table, repeats, window_s) == max(counts)
