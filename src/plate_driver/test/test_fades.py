"""with_fades(): from rest to rest, continuous, and the foreign motion itself in between."""

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_driver.setpoints.motor_table import add_fades, reverse_time

PERIOD = 0.1


def foreign(seed: int = 0, knots: int = 24) -> PlateCycle:
    """Smooth random cycle of four harmonics that is nowhere at rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(knots) * PERIOD / knots
    pose = np.full((knots, 3), 0.001)
    for h in range(1, 5):
        pose += rng.uniform(0, 0.002, 3) * np.sin(
            2 * np.pi * h * t[:, None] / PERIOD + rng.uniform(0, 6, 3)
        )
    return PlateCycle.from_samples(PERIOD, pose)


def at_rest() -> PlateCycle:
    t = np.linspace(0, PERIOD, 13)
    u = t / PERIOD
    wave = u**3 * (1 - u) ** 3
    slope = 3 * u**2 * (1 - u) ** 2 * (1 - 2 * u)
    bend = 6 * u * (1 - u) * (1 - 5 * u + 5 * u**2)
    states = [np.column_stack([a] * 3) for a in (wave, slope / PERIOD, bend / PERIOD**2)]
    return PlateCycle.from_knots(t, *states)


def test_cycle_from_rest_is_unchanged():
    cycle = at_rest()
    assert add_fades(cycle) is cycle
    rest = PlateCycle.rest(PERIOD)
    assert add_fades(rest, repeats=3) is rest


@pytest.mark.parametrize("repeats", [1, 3])
def test_begins_and_ends_at_home_at_rest(repeats):
    made = add_fades(foreign(), repeats)
    assert made.starts_at_rest
    assert made.period == pytest.approx((2 + repeats) * PERIOD)
    for function in (made.pose, made.twist, made.accel):
        np.testing.assert_allclose(function([0, made.period]), 0, atol=1e-9)


@pytest.mark.parametrize("repeats", [1, 3])
def test_plays_the_foreign_motion(repeats):
    cycle = foreign()
    made = add_fades(cycle, repeats)
    t = np.linspace(0, PERIOD, 200)[1:-1]
    for i in range(repeats):
        later = t + (1 + i) * PERIOD
        np.testing.assert_allclose(made.pose(later), cycle.pose(t), atol=1e-12)
        np.testing.assert_allclose(made.twist(later), cycle.twist(t), atol=1e-10)
        np.testing.assert_allclose(made.accel(later), cycle.accel(t), atol=1e-7)


def test_fades_are_smoothsteps_times_the_motion():
    cycle = foreign()
    made = add_fades(cycle)
    t = np.linspace(0, PERIOD, 500)[1:-1]
    u = (t / PERIOD)[:, None]
    rise = 10 * u**3 - 15 * u**4 + 6 * u**5
    np.testing.assert_allclose(made.pose(t), rise * cycle.pose(t), atol=2e-5 * 0.006)
    faded = (1 - rise) * cycle.pose(t)
    np.testing.assert_allclose(made.pose(t + 2 * PERIOD), faded, atol=2e-5 * 0.006)


@pytest.mark.parametrize("knots", [8, 24, 48, 100])
def test_continuous_everywhere(knots):
    # At the knots no jump; everywhere, each state is the derivative of the one before.
    made = add_fades(foreign(1, knots), 2)
    inner = made.times[1:-1]
    step = 1e-10
    scales = [np.max(np.abs(f(made.times))) for f in (made.pose, made.twist, made.accel)]
    for function, scale in zip((made.pose, made.twist, made.accel), scales, strict=True):
        jump = function(inner + step) - function(inner - step)
        assert np.max(np.abs(jump)) < 1e-5 * scale
    t = np.linspace(1e-6, made.period - 1e-6, 20_000)
    step = 1e-7
    slope = (made.pose(t + step) - made.pose(t - step)) / (2 * step)
    np.testing.assert_allclose(slope, made.twist(t), atol=1e-4 * scales[1])
    bend = (made.twist(t + step) - made.twist(t - step)) / (2 * step)
    np.testing.assert_allclose(bend, made.accel(t), atol=1e-3 * scales[2])


def test_few_knots_are_made_more():
    assert len(add_fades(foreign(2, 6)).times) > 2 * 48


def test_a_reversed_cycle_runs_backwards():
    cycle = foreign(3)
    back = reverse_time(cycle)
    t = np.linspace(0, PERIOD, 100)
    np.testing.assert_allclose(back.pose(t), cycle.pose(PERIOD - t), atol=1e-12)
    np.testing.assert_allclose(back.twist(t), -cycle.twist(PERIOD - t), atol=1e-10)
    np.testing.assert_allclose(back.accel(t), cycle.accel(PERIOD - t), atol=1e-7)
