"""The maps over unequal steps against those over equal ones, and against differences."""

import numpy as np
import pytest

from plate_solver import average_force
from plate_solver.cycle_map import end_state
from plate_solver.stepped_map import end_position_slopes, end_positions, mean_forces

UNEVEN = np.linspace(0.7, 1.3, 20) * 2.4525  # of as many parts as any test has


@pytest.fixture(name="shaken")
def _shaken(sinusoid_cycle, scene):
    """Cycle, positions and velocities of 5 parts, and random steps that fill the cycle."""

    def make(seed: int, steps: int):
        rng, position = scene(seed, 5)
        sin, cos = rng.normal(size=(2, 3, 3)) * [0.15, 0.15, 0.6]
        cycle = sinusoid_cycle(sin, cos)
        dt = rng.uniform(0.3, 1.0, steps)
        dt *= cycle.period / dt.sum()
        t = np.cumsum(dt) - dt / 2
        return cycle, position, 0.03 * rng.normal(size=(5, 2)), cycle.pose(t), cycle.twist(t), dt

    return make


@pytest.mark.parametrize("seed", range(3))
def test_equal_and_unequal_steps_agree(shaken, seed):
    cycle, position, velocity, pose, twist, dt = shaken(seed, 20_000)
    n = 20_000
    t = (np.arange(n) + 0.5) / n * cycle.period
    end, _ = end_state(position, velocity, cycle.pose(t), cycle.twist(t), cycle.period / n, UNEVEN)
    moved = end_positions(position, velocity, pose, twist, dt, UNEVEN)
    assert np.max(np.abs(end - position)) > 1e-3
    np.testing.assert_allclose(moved, end, atol=2e-6)
    force = mean_forces(position, velocity, twist, dt)
    np.testing.assert_allclose(force[:, :2], average_force(cycle, position, velocity), atol=2e-3)
    # The third column is the curl of the first two, as differences have it.
    step = 1e-4
    by_x = mean_forces(position + [step, 0], velocity, twist, dt)
    by_x -= mean_forces(position - [step, 0], velocity, twist, dt)
    by_y = mean_forces(position + [0, step], velocity, twist, dt)
    by_y -= mean_forces(position - [0, step], velocity, twist, dt)
    curl = (by_x[:, 1] - by_y[:, 0]) / (2 * step)
    np.testing.assert_allclose(force[:, 2], curl, atol=0.03 * np.max(np.abs(curl)))


@pytest.mark.parametrize("seed", range(3))
def test_slopes_agree_with_differences(shaken, seed):
    _, position, velocity, pose, twist, dt = shaken(seed, 60)
    rng = np.random.default_rng(seed)
    ways = [rng.normal(size=a.shape) for a in (pose, twist, dt)]
    step = 1e-7

    def ends(sign):
        moved = [a + sign * step * w for a, w in zip((pose, twist, dt), ways, strict=True)]
        return end_positions(position, velocity, *moved, UNEVEN).ravel()

    slope = (ends(1) - ends(-1)) / (2 * step)
    found = end_position_slopes(position, velocity, pose, twist, dt, UNEVEN)
    along = sum((s * w).reshape(10, -1).sum(axis=1) for s, w in zip(found, ways, strict=True))
    np.testing.assert_allclose(along, slope, atol=1e-5 * np.max(np.abs(slope)))
