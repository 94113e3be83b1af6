"""Past states: between samples, across cycles, before the first and after the last one."""

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_sim import PlateMotion, WorldState, record_cycle, simulate
from plate_sim.world import BodyTrajectory
from plate_sim.world.history import History, Passage

RIG = load_rig()


def passage(start, period=0.1, count=11, accel=2.0, there=True):
    """One part that accelerates evenly for `period` from a start (t, place, velocity)."""
    t = np.linspace(0, period, count)
    position = start[0] + start[1] * t + 0.5 * accel * t**2
    run = BodyTrajectory(
        t,
        np.stack([position, 0 * t], -1)[:, None],
        3 * position[:, None],
        np.stack([start[1] + accel * t, 0 * t], -1)[:, None],
        3 * (start[1] + accel * t)[:, None],
        np.array([there]),
    )
    motion = PlateMotion.of_cycle(PlateCycle.rest(period))
    return Passage(motion, run, np.array([there]))


def test_even_acceleration_is_met_exactly_at_any_age():
    past = History().after(passage((0.0, 0.0)), 0.15).after(passage((0.01, 0.2)), 0.15)
    for age in (0.0, 0.003, 0.0999, 0.1, 0.1234, 0.15):
        t = 0.2 - age
        assert past.ago(age).position[0] == pytest.approx([t**2, 0], abs=1e-12)
        assert past.ago(age).angle == pytest.approx(3 * t**2, abs=1e-12)
    # Before the first cycle the plate rests, after the last one the motion continues.
    assert past.ago(0.5).position[0] == pytest.approx([0, 0])
    assert past.ago(-0.01).position[0] == pytest.approx([0.04 + 0.01 * 0.4, 0])


def test_the_history_keeps_only_the_requested_time():
    past = History()
    for k in range(10):
        past = past.after(passage((float(k), 0.0)), 0.25)
        assert len(past.passages) == min(k + 1, 3)
    assert past.ago(0.25).position[0, 0] == pytest.approx(7.0, abs=0.01)


@pytest.mark.parametrize("age", [0.0, 0.013, 0.05, 0.0871])
def test_a_shaken_part_is_where_the_exact_integrator_has_it(age):
    rng = np.random.default_rng(5)
    cycle = PlateCycle.from_samples(0.1, 2e-3 * rng.normal(size=(16, 3)) * [1, 1, 0])
    start = WorldState.at_rest(("black_1",), [[0.05, -0.02]])
    end, run = record_cycle(start, cycle, RIG)
    plate = PlateMotion.of_cycle(cycle)
    view = History().after(Passage(plate, run, end.on_plate), 0.1).ago(age)
    samples = 1000
    true = simulate(
        cycle, start.position, start.velocity, RIG.friction.mu, samples=samples, tolerance=1e-9
    )
    row = round((0.1 - age) / 0.1 * samples)
    assert view.position[0] == pytest.approx(true.position[row, 0], abs=2e-6)
    assert view.pose == pytest.approx(cycle.pose(0.1 - age)[0], abs=1e-12)


def test_a_part_is_on_the_plate_until_it_falls():
    start = WorldState.at_rest(("black_1",), [[RIG.plate.half[0] - 0.01, 0]])
    start.velocity[0, 0] = 0.5
    cycle = PlateCycle.rest(0.1)
    end, run = record_cycle(start, cycle, RIG)
    fell = run.time[np.flatnonzero(run.velocity[:, 0, 0])[-1]]
    assert 0.01 < fell < 0.05
    past = History().after(Passage(PlateMotion.of_cycle(cycle), run, end.on_plate), 0.1)
    assert past.ago(0.1 - fell + 1e-3).on_plate.tolist() == [True]
    assert past.ago(0.1 - fell - 1e-3).on_plate.tolist() == [False]
