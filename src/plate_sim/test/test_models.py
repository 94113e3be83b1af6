"""One scene, three models: what they record, and what they have in common."""

import numpy as np
import pytest

from plate_core import PlateCycle, load_rig
from plate_sim.contacts import INELASTIC
from plate_sim.models import BODIES, DISCS, POINTS, Scene, run_model, samples

RIG = load_rig()


def scene(period):
    rng = np.random.default_rng(4)
    cycle = PlateCycle.from_samples(period, 1e-3 * rng.normal(size=(12, 3)) * [1, 1, 4])
    return Scene(
        ids=("black_1", "black_2", "black_3"),
        motion=cycle,
        limit=np.full(3, RIG.friction.accel),
        pull=np.zeros(2),
        static_ratio=1.0,
        radius=RIG.parts.radius_m,
        half=RIG.plate.half,
        contacts=INELASTIC,
        step=None,
        position=np.array([[0.0, 0.0], [0.018, 0.0], [0.1, 0.1]]),
        velocity=rng.normal(size=(3, 2)) * 0.1,
        angle=np.zeros(3),
        spin=rng.normal(size=3),
        on_plate=np.ones(3, bool),
    )


@pytest.mark.parametrize("model", [POINTS, DISCS, BODIES])
@pytest.mark.parametrize("period", [0.01, 0.0333, 0.05003])
@pytest.mark.parametrize("often", [2e-4, 1.3e-3, 1.0])
def test_few_samples_are_some_of_all(model, period, often):
    few, many = (run_model(scene(period), model, record) for record in (often, 0.0))
    none = run_model(scene(period), model)
    assert len(none.run.time) == 0
    assert np.diff(few.run.time).max() <= often + 1e-12
    assert few.run.time[[0, -1]] == pytest.approx([0, period])
    rows = np.searchsorted(many.run.time, few.run.time - 1e-9)
    assert np.array_equal(few.run.position, many.run.position[rows])
    assert np.array_equal(few.run.velocity, many.run.velocity[rows])
    for outcome in (few, many, none):
        assert np.array_equal(outcome.position, many.run.position[-1])
        assert np.array_equal(outcome.velocity, many.run.velocity[-1])
        assert np.array_equal(outcome.angle == 0, np.full(3, model != BODIES))


def test_samples_end_with_the_last_step_and_have_no_gap():
    for steps in range(1, 60):
        for every in range(1, 70):
            rows = samples(steps, 1.0, float(every))
            assert (rows[0], rows[-1]) == (0, steps)
            assert len(rows) == -(-steps // every) + 1
            assert np.diff(rows).min() > 0
            assert np.diff(rows).max() <= every
    assert len(samples(5, 1.0, None)) == 0
