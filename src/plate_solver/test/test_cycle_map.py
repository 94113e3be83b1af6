"""The cycle map against closed forms, and against the simulator: another implementation."""

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_sim import simulate
from plate_solver.cycle_map import end_position_gradient, end_state

MU, GRAVITY = 0.25, 9.81
ACCEL = MU * GRAVITY
EACH = np.full(20, ACCEL)  # of as many parts as any test has
UNEVEN = np.linspace(0.7, 1.3, 20) * ACCEL


def sampled(cycle: PlateCycle, steps: int, share: float = 1.0):
    """Pose and twist at the middles of `steps` equal steps over a share of the cycle, and dt."""
    dt = share * cycle.period / steps
    t = (np.arange(steps) + 0.5) * dt
    return cycle.pose(t), cycle.twist(t), dt


@pytest.fixture(name="shaken", scope="module")
def _shaken(sinusoid_cycle, scene):
    """Function seed to (cycle at 10 to 40 times mu g, positions, velocities) of 6 parts."""

    def make(seed: int):
        rng, position = scene(seed, 6)
        sin, cos = rng.normal(size=(2, 3, 3)) * [0.15, 0.15, 0.6]
        velocity = rng.normal(size=(6, 2)) * 0.03
        return sinusoid_cycle(sin, cos), position, velocity

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
        start, np.zeros((1, 2)), t[:, None] * twist, twist, period / n, EACH
    )
    slipping = speed / ACCEL
    assert slipping < period
    travel = speed * period - 0.5 * speed * slipping
    np.testing.assert_allclose(position - start, [travel * unit], atol=speed * period / n)
    np.testing.assert_allclose(velocity, [speed * unit], atol=1e-12)


def test_sliding_part_brakes_to_rest_on_a_still_plate():
    n, period, velocity = 2000, 0.2, np.array([[0.3, -0.4], [0.06, 0.08], [0.0, 0.0]])
    still = np.zeros((n, 3))
    end, left = end_state(np.zeros((3, 2)), velocity, still, still, period / n, EACH)
    speed = np.hypot(*velocity.T)
    unit = velocity / np.where(speed > 0, speed, 1)[:, None]
    lasts = np.minimum(period, speed / ACCEL)
    travel = speed * lasts - 0.5 * ACCEL * lasts**2
    np.testing.assert_allclose(end, travel[:, None] * unit, atol=0.5 * period / n)
    np.testing.assert_allclose(left, (speed - ACCEL * lasts)[:, None] * unit, atol=1e-12)


def test_gently_moved_part_sticks_and_rides(sinusoid_cycle):
    # Peak acceleration 0.3 m/s2 and 1 rad/s2 at 0.3 m: below mu g = 2.45 m/s2.
    cycle = sinusoid_cycle([[0.005, -0.004, 0.015]], [[-0.003, 0.002, 0.01]])
    pose, twist, dt = sampled(cycle, 4000, share=0.37)
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
    np.testing.assert_allclose(velocity, moving, atol=dt * 0.6)
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


def test_error_falls_at_least_in_proportion_to_the_step(shaken):
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


# The gradient.


def differences(position, velocity, pose, twist, dt, step):
    """Derivatives of the end positions as `end_position_gradient` gives them."""
    rows = 2 * len(position)
    by_twist, by_pose = np.empty((rows, len(twist), 3)), np.empty((rows, len(twist), 3))
    for target, out in ((twist, by_twist), (pose, by_pose)):
        for k, c in np.ndindex(*target.shape):
            kept, ends = target[k, c], []
            for sign in (1, -1):
                target[k, c] = kept + sign * step
                ends.append(end_state(position, velocity, pose, twist, dt, UNEVEN)[0].ravel())
            target[k, c] = kept
            out[:, k, c] = (ends[0] - ends[1]) / (2 * step)
    return by_twist, by_pose


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1.0, 0.05, 0.005], ids=["slip", "slip and stick", "stick"])
def test_gradient_agrees_with_differences(sinusoid_cycle, scene, seed, size):
    # A step of 1e-7 m/s switches a part between slip and stick with a chance of 1e-6 a step.
    rng, position = scene(seed, 3)
    sin, cos = size * rng.normal(size=(2, 3, 3)) * [0.15, 0.15, 0.6]
    velocity = size * rng.normal(size=(3, 2)) * 0.1
    pose, twist, dt = sampled(sinusoid_cycle(sin, cos), 60)
    end, left, by_twist, by_pose = end_position_gradient(
        position, velocity, pose, twist, dt, UNEVEN
    )
    plain = end_state(position, velocity, pose, twist, dt, UNEVEN)
    np.testing.assert_allclose(end, plain[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(left, plain[1], rtol=0, atol=1e-15)
    slope_twist, slope_pose = differences(position, velocity, pose, twist, dt, 1e-7)
    scale_twist, scale_pose = np.max(np.abs(slope_twist)), np.max(np.abs(slope_pose))
    assert scale_twist > 0.1 * dt
    np.testing.assert_allclose(by_twist, slope_twist, rtol=0, atol=1e-5 * scale_twist)
    np.testing.assert_allclose(by_pose, slope_pose[:, :, :2], rtol=0, atol=1e-4 * scale_pose + 1e-9)
    assert np.all(slope_pose[:, :, 2] == 0), "the end position does not depend on theta itself"
