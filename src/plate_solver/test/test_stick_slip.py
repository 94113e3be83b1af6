"""The cycle map against closed forms, and against the simulator: another implementation."""

import numpy as np
import pytest
from harmonic import waves

from plate_core import PlateCycle
from plate_sim import simulate
from plate_solver import average_force
from plate_solver.averages import step_forces
from plate_solver.cycle_map import end_state, end_state_gradient

KNOTS = 64
MU, GRAVITY = 0.25, 9.81
ACCEL = MU * GRAVITY
EACH = np.full(20, ACCEL)  # of as many parts as any test has
UNEVEN = np.linspace(0.7, 1.3, 20) * ACCEL


def sampled(cycle: PlateCycle, steps: int, part: float = 1.0):
    """Pose and twist at the middles of `steps` equal steps over a part of the cycle, and these."""
    dt = part * cycle.period / steps
    t = (np.arange(steps) + 0.5) * dt
    return cycle.pose(t), cycle.twist(t), np.full(steps, dt)


@pytest.fixture(name="shaken", scope="module")
def _shaken(scene):
    """Function seed to (cycle at 10 to 40 times mu g, positions, velocities) of 6 parts."""

    def make(seed: int):
        rng, position = scene(seed, 6)
        sin, cos = rng.normal(size=(2, 3, 3)) * [0.15, 0.15, 0.6]
        velocity = rng.normal(size=(6, 2)) * 0.03
        return waves(0.1, sin, cos, KNOTS), position, velocity

    return make


# Closed forms.


@pytest.mark.parametrize("way", [0.0, 2.0, 4.0])
def test_part_on_a_plate_that_moves_off_slips_then_rides(way):
    # Constant acceleration mu g up to the plate's speed V, at t = V/(mu g); then it sticks.
    speed, period, n = 0.2, 0.15, 3000
    unit = np.array([np.cos(way), np.sin(way)])
    t = (np.arange(n) + 0.5) / n * period
    twist = np.tile([*speed * unit, 0.0], (n, 1))
    start = np.array([[0.1, -0.05]])
    position, velocity = end_state(
        start, np.zeros((1, 2)), t[:, None] * twist, twist, np.full(n, period / n), EACH
    )
    slipping = speed / ACCEL
    assert slipping < period
    travel = speed * period - 0.5 * speed * slipping
    np.testing.assert_allclose(position - start, [travel * unit], atol=speed * period / n)
    np.testing.assert_allclose(velocity, [speed * unit], atol=1e-12)


def test_sliding_part_brakes_to_rest_on_a_still_plate():
    n, period, velocity = 2000, 0.2, np.array([[0.3, -0.4], [0.06, 0.08], [0.0, 0.0]])
    still = np.zeros((n, 3))
    end, left = end_state(np.zeros((3, 2)), velocity, still, still, np.full(n, period / n), EACH)
    speed = np.hypot(*velocity.T)
    unit = velocity / np.where(speed > 0, speed, 1)[:, None]
    lasts = np.minimum(period, speed / ACCEL)
    travel = speed * lasts - 0.5 * ACCEL * lasts**2
    np.testing.assert_allclose(end, travel[:, None] * unit, atol=0.5 * period / n)
    np.testing.assert_allclose(left, (speed - ACCEL * lasts)[:, None] * unit, atol=1e-12)


def test_gently_moved_part_sticks_and_rides():
    # Peak acceleration 0.3 m/s2 and 1 rad/s2 at 0.3 m: below mu g = 2.45 m/s2.
    cycle = waves(0.1, [[0.005, -0.004, 0.015]], [[-0.003, 0.002, 0.01]], KNOTS)
    pose, twist, dt = sampled(cycle, 4000, part=0.37)
    start_pose, start_twist = cycle.pose(0.0)[0], cycle.twist(0.0)[0]
    arm = np.array([[0.2, 0.1], [-0.25, 0.0], [0.0, 0.0]])

    def riding(pose, twist):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        turned = arm @ [[cos, sin], [-sin, cos]]
        return pose[:2] + turned, twist[:2] + twist[2] * turned[:, ::-1] * [-1, 1]

    position, velocity = end_state(*riding(start_pose, start_twist), pose, twist, dt, EACH)
    t = 0.37 * cycle.period
    ridden, moving = riding(cycle.pose(t)[0], cycle.twist(t)[0])
    np.testing.assert_allclose(position, ridden, atol=5e-7)
    np.testing.assert_allclose(velocity, moving, atol=dt[0] * 0.6)
    assert np.min(np.hypot(*(ridden - riding(start_pose, start_twist)[0]).T)) > 1e-5


# The simulator.


@pytest.mark.parametrize("seed", range(4))
def test_fine_steps_agree_with_the_simulator(shaken, seed):
    cycle, position, velocity = shaken(seed)
    truth = simulate(cycle, position, velocity, MU, GRAVITY)
    end, left = end_state(position, velocity, *sampled(cycle, 8000), EACH)
    moved = np.hypot(*(truth.position[-1] - position).T)
    assert np.max(moved) > 1e-3
    np.testing.assert_allclose(end, truth.position[-1], atol=2e-6)
    np.testing.assert_allclose(left, truth.velocity[-1], atol=2e-4)


def test_the_error_decreases_at_least_linearly_with_the_step(shaken):
    steps = np.array([100, 200, 400, 800, 1600])
    error = np.zeros(len(steps))
    for seed in range(10):
        cycle, position, velocity = shaken(seed)
        truth = simulate(cycle, position, velocity, MU, GRAVITY).position[-1]
        for k, n in enumerate(steps):
            end, _ = end_state(position, velocity, *sampled(cycle, n), EACH)
            error[k] += np.mean(np.abs(end - truth)) / 10
    order = -np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order > 0.85
    assert error[0] < 4e-5  # 1 % of the travel at 100 steps a cycle


def test_parts_do_not_feel_each_other(shaken):
    cycle, position, velocity = shaken(0)
    pose, twist, dt = sampled(cycle, 200)
    together, _ = end_state(position, velocity, pose, twist, dt, EACH)
    for i in range(len(position)):
        alone, _ = end_state(position[i : i + 1], velocity[i : i + 1], pose, twist, dt, EACH)
        np.testing.assert_array_equal(alone[0], together[i])


# Unequal steps, and the derivatives.


@pytest.fixture(name="uneven")
def _uneven(scene):
    """Cycle, positions and velocities of 5 parts, and random steps that fill the cycle."""

    def make(seed: int, steps: int, size: float = 1.0):
        rng, position = scene(seed, 5)
        sin, cos = size * rng.normal(size=(2, 3, 3)) * [0.15, 0.15, 0.6]
        cycle = waves(0.1, sin, cos, KNOTS)
        dt = rng.uniform(0.3, 1.0, steps)
        dt *= cycle.period / dt.sum()
        t = np.cumsum(dt) - dt / 2
        velocity = size * 0.03 * rng.normal(size=(5, 2))
        return cycle, position, velocity, cycle.pose(t), cycle.twist(t), dt

    return make


@pytest.mark.parametrize("seed", range(3))
def test_equal_and_unequal_steps_agree(uneven, seed):
    cycle, position, velocity, pose, twist, dt = uneven(seed, 20_000)
    n = 20_000
    t = (np.arange(n) + 0.5) / n * cycle.period
    equal = np.full(n, cycle.period / n)
    end, _ = end_state(position, velocity, cycle.pose(t), cycle.twist(t), equal, UNEVEN)
    moved, _ = end_state(position, velocity, pose, twist, dt, UNEVEN)
    assert np.max(np.abs(end - position)) > 1e-3
    np.testing.assert_allclose(moved, end, atol=2e-6)
    force = step_forces(position, velocity, twist, dt)
    np.testing.assert_allclose(force[:, :2], average_force(cycle, position, velocity), atol=2e-3)
    # The third column is the curl of the first two, as differences have it.
    step = 1e-4
    by_x = step_forces(position + [step, 0], velocity, twist, dt)
    by_x -= step_forces(position - [step, 0], velocity, twist, dt)
    by_y = step_forces(position + [0, step], velocity, twist, dt)
    by_y -= step_forces(position - [0, step], velocity, twist, dt)
    curl = (by_x[:, 1] - by_y[:, 0]) / (2 * step)
    np.testing.assert_allclose(force[:, 2], curl, atol=0.03 * np.max(np.abs(curl)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1.0, 0.05, 0.005], ids=["slip", "slip and stick", "stick"])
def test_gradient_agrees_with_differences(uneven, seed, size):
    # A step of 1e-7 m/s switches a part between slip and stick with a chance of 1e-6 a step.
    _, position, velocity, pose, twist, dt = uneven(seed, 60, size)
    found = end_state_gradient(position, velocity, pose, twist, dt, UNEVEN)

    def end():
        return end_state(position, velocity, pose, twist, dt, UNEVEN)[0].T.ravel()

    for target, slopes, relative in ((pose, found[0], 1e-4), (twist, found[1], 1e-5)):
        slope = np.empty((3, len(dt), 10))
        for k, c in np.ndindex(*target.shape):
            kept, ends = target[k, c], []
            for sign in (1, -1):
                target[k, c] = kept + sign * 1e-7
                ends.append(end())
            target[k, c] = kept
            slope[c, k] = (ends[0] - ends[1]) / 2e-7
        scale = np.max(np.abs(slope))
        used = len(slopes)
        np.testing.assert_allclose(slopes, slope[:used], rtol=0, atol=relative * scale + 1e-9)
        assert np.all(slope[used:] == 0), "the end position does not depend on theta itself"
    for k in range(len(dt)):
        kept, ends = dt[k], []
        for sign in (1, -1):
            dt[k] = kept + sign * 1e-9
            ends.append(end())
        dt[k] = kept
        slope_dt = (ends[0] - ends[1]) / 2e-9
        bound = 1e-4 * np.max(np.abs(found[2]))
        np.testing.assert_allclose(found[2][k], slope_dt, rtol=0, atol=bound)
