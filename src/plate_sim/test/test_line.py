"""Parts that slip along one line: against other methods, and where a motion is too restless."""

import numpy as np
import pytest
from harmonic import MU, G, waves

from plate_core import PlateCycle
from plate_sim import Ground, simulate, simulate_bodies
from plate_sim.friction import disc

STILL = np.zeros((1, 2))


def on_a_line(rng, period, size, heading, knots=128, harmonics=4):
    """Cycle of random velocity along a direction [rad]."""
    way = np.array([np.cos(heading), np.sin(heading), 0])
    sine, cosine = size * rng.normal(size=(harmonics, 2)).T[:, :, None] * way
    return waves(period, sine, cosine, knots), way[:2]


def scenes(seed, count):
    rng = np.random.default_rng(seed)
    for i in range(count):
        heading = (0.0, np.pi / 2, rng.uniform(0, 7))[i % 3]
        knots = (3, 8, 128)[rng.integers(3)]  # long pieces hold several zeros of the slip
        cycle, way = on_a_line(
            rng, rng.uniform(0.02, 0.2), 10 ** rng.uniform(-1.5, 0), heading, knots
        )
        velocity = rng.uniform(-0.5, 0.5, (3, 1)) * way
        pull = rng.uniform(-1, 1) * (i % 2) * way
        ground = Ground(1 + 0.5 * (i % 4 == 3), tuple(np.arcsin(pull / G)))
        yield cycle, velocity, rng.uniform(0.05, 0.8, 3), ground, way


def test_agrees_with_the_world_in_small_steps():
    for cycle, velocity, mu, ground, _ in scenes(0, 24):
        position = np.zeros((3, 2))
        exact = simulate(cycle, position, velocity, mu, cycles=3, samples=1, ground=ground)
        steps = simulate_bodies(
            cycle, disc(0.01), position, 0, velocity, 0, mu, cycles=3, samples=0, ground=ground,
            step=cycle.period / 20_000,
        )  # fmt: skip
        assert steps.position[-1] == pytest.approx(exact.position[-1], abs=5e-6)


def test_agrees_with_the_integration_in_the_plane():
    # A slip across the line by far less than matters, and the plane's steps do the work.
    for cycle, velocity, mu, ground, way in scenes(1, 24):
        across = 1e-11 * np.array([-way[1], way[0]])
        line, plane = (
            simulate(cycle, np.zeros((3, 2)), v, mu, G, 3, 1, 1e-11, ground=ground).position[-1]
            for v in (velocity, velocity + across)
        )
        assert plane == pytest.approx(line, abs=1e-9)


def test_samples_lie_on_one_motion():
    for cycle, velocity, _, ground, _ in scenes(4, 8):
        start = np.ones((3, 2))
        few, many = (
            simulate(cycle, start, velocity, MU, G, 2, count, 1e-7, ground=ground)
            for count in (3, 3000)
        )
        assert many.position[::1000] == pytest.approx(few.position, abs=1e-13)
        assert many.velocity[::1000] == pytest.approx(few.velocity, abs=1e-12)
        step = cycle.period / 3000
        middle = 0.5 * (many.velocity[1:] + many.velocity[:-1]) * step
        assert np.max(np.abs(np.diff(many.position, axis=0) - middle)) <= 10 * MU * G * step**2


@pytest.mark.parametrize("turning", [0.0, 0.02])
def test_a_motion_with_too_many_events_is_finished_and_reported(turning):
    # The plate jumps to and fro at every one of 120 000 knots; the part cannot follow.
    count, period = 120_000, 1.0
    pose = np.zeros((count, 3))
    pose[::2, 0] = 1e-7
    pose[::2, 2] = turning * 1e-7
    cycle = PlateCycle.from_samples(period, pose, 0 * pose, 0 * pose)
    run = simulate(
        cycle, [[0, 0], [0, 0.1]], [[0, 0], [5.0, 0]], [MU, 1e-70], samples=4, tolerance=1e-7
    )
    assert run.unchecked == (0,)
    assert np.all(np.isfinite(run.position))
    fastest = np.abs(cycle.twist(np.linspace(0, 4 / count, 100))[:, 0]).max()
    assert np.abs(run.position[:, 0]).max() <= 1.01 * fastest * period  # no part outruns the plate
    assert run.position[-1, 1] == pytest.approx([5.0, 0.1])
    calm = simulate(PlateCycle.rest(1.0), STILL, STILL, MU)
    assert calm.unchecked == ()
