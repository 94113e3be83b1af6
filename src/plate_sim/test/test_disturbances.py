"""Disturbances of the world: ranges, and friction that differs between parts and over the plate."""

from itertools import pairwise
from math import comb

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import to_home
from plate_sim import Disturbances, PlateMotion, WorldState, run_cycle
from plate_sim.world import NONE, RANGES
from plate_sim.world.friction_field import WAVELENGTH, FrictionField

RIG = load_rig()
HOME = np.zeros(3)
MU = RIG.friction.mu
GRID = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 61), np.linspace(-0.15, 0.15, 31)), -1)
GRID = GRID.reshape(-1, 2)


@pytest.mark.parametrize("name", RANGES)
def test_values_out_of_range_are_refused(name):
    for value in RANGES[name]:
        Disturbances(**{name: value})
    for value in (RANGES[name][0] - 1e-9, RANGES[name][1] + 1e-9, np.nan):
        with pytest.raises(PlateError, match=f"{name} is .*, allowed: "):
            Disturbances(**{name: value})


def test_a_camera_that_is_too_slow_is_refused():
    Disturbances(image_rate=1.0)
    with pytest.raises(PlateError, match=r"image_rate is 0\.5, allowed: 0, or 1 to 200"):
        Disturbances(image_rate=0.5)


def test_both_tilts_together_are_a_tilt_too():
    Disturbances(tilt_x=0.4)
    with pytest.raises(PlateError, match="tilt"):
        Disturbances(tilt_x=0.4, tilt_y=0.4)


def test_a_world_without_disturbances_has_the_friction_of_the_rig():
    assert NONE.summary == "none"
    assert Disturbances(latency=0.05, blur=False).summary == "latency 0.05, blur False"
    field = FrictionField.draw(NONE, 4, np.random.default_rng(0))
    assert np.all(field.friction(MU, GRID[:4], HOME) == MU)


def test_parts_differ_by_the_spread_and_each_seed_by_its_own():
    rng = np.random.default_rng(1)
    part = np.concatenate(
        [FrictionField.draw(Disturbances(friction_spread=0.1), 10, rng).part for _ in range(400)]
    )
    assert np.all(np.abs(part - 1) <= 0.1)
    # Even: mean and standard deviation, within 4 standard errors
    assert np.mean(part) == pytest.approx(1, abs=4 * 0.1 / np.sqrt(3 * part.size))
    assert np.std(part) == pytest.approx(0.1 / np.sqrt(3), rel=0.04)
    again = [
        FrictionField.draw(Disturbances(friction_spread=0.1), 5, np.random.default_rng(7))
        for _ in "ab"
    ]
    assert np.array_equal(again[0].part, again[1].part)
    twice = FrictionField.draw(Disturbances(friction_spread=0.2), 5, np.random.default_rng(7))
    assert np.allclose(twice.part - 1, 2 * (again[0].part - 1))


def patches(seed, fraction=0.1):
    return FrictionField.draw(
        Disturbances(friction_patches=fraction), len(GRID), np.random.default_rng(seed)
    )


def test_friction_over_the_plate_is_even_within_its_share():
    fraction = np.concatenate([patches(k).friction(1.0, GRID, HOME) for k in range(60)]) - 1
    assert np.all(np.abs(fraction) <= 0.1)
    # A tenth of the plate in each tenth of the range; patches on one plate are not independent.
    count, _ = np.histogram(fraction, 10, (-0.1, 0.1))
    assert count / len(fraction) == pytest.approx(np.full(10, 0.1), abs=0.03)


def test_patches_have_their_wavelength():
    """Correlation over a distance d is that of waves of all directions: J0(2 pi d / wavelength)."""
    from scipy.special import erfinv, j0

    for d in (0.02, 0.05, 0.1):
        heights = []
        for k in range(150):
            position = np.array([[0.01, 0.02], [0.01 + d, 0.02], [0.01, 0.02 + d]])
            field = FrictionField.draw(
                Disturbances(friction_patches=0.5), 3, np.random.default_rng(k)
            )
            heights.append(np.sqrt(2) * erfinv((field.friction(1.0, position, HOME) - 1) / 0.5))
        height = np.array(heights)
        correlation = np.mean(height[:, :1] * height[:, 1:])
        assert correlation == pytest.approx(j0(2 * np.pi * d / WAVELENGTH), abs=0.25)


def test_patches_are_fixed_in_the_plate():
    pose, field = np.array([0.006, -0.004, 0.03]), patches(3)
    moved = field.friction(MU, to_home(pose, GRID), pose)
    assert np.allclose(moved, field.friction(MU, GRID, HOME), atol=1e-12)
    assert np.abs(moved - field.friction(MU, to_home(pose, GRID), HOME)).max() > 1e-3 * MU


def cut(cycle, count):
    """A cycle in `count` pieces of equal length."""
    edges = np.linspace(0, cycle.period, count + 1)
    times = np.unique(np.round(np.append(cycle.times, edges), 12))
    k = np.clip(np.searchsorted(cycle.times, times[:-1] + 1e-9, "right") - 1, 0, None)
    later = (times[:-1] - cycle.times[k])[:, None]
    powers = np.zeros((len(k), 6, 3))
    for i in range(6):
        for j in range(i, 6):
            powers[:, i] += comb(j, i) * later ** (j - i) * cycle.coefficients[k, j]
    rows = np.searchsorted(times, edges - 1e-9)
    return [PlateMotion(times[a : b + 1] - times[a], powers[a:b]) for a, b in pairwise(rows)]


def shaking(rng, period=0.2):
    """A cycle with eight harmonics that uses most of the stroke."""
    t, h = np.arange(64) / 64, np.arange(1, 9)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (8, 3, 1))
    size = rng.normal(size=(8, 3, 1)) / h[:, :, None] ** 1.5
    pose = np.sum(size * np.sin(2 * np.pi * h[:, :, None] * t + phase), axis=0).T
    return PlateCycle.from_samples(period, pose / np.abs(pose).max(axis=0) * [0.008, 0.005, 0.015])


def test_friction_read_once_a_cycle_has_the_documented_error():
    """Against reading it 100 and 200 times, which agree with each other far better."""
    gap, fine_gap, effect = [], [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        cycle = shaking(rng)
        start = WorldState.at_rest(
            ("black_1", "black_2", "black_3", "black_4"),
            [[-0.2, 0.05], [-0.07, -0.06], [0.06, 0.07], [0.19, -0.03]],
        )
        field = FrictionField.draw(Disturbances(friction_patches=0.1), 4, rng)

        def end(pieces, start=start, field=field):
            state = start
            for piece in pieces:
                mu = field.friction(MU, state.position, piece.pose(0.0)[0])
                state = run_cycle(state, piece, RIG, mu)
            return state.position

        once, fine, finest = end([cycle]), end(cut(cycle, 100)), end(cut(cycle, 200))
        even = run_cycle(start, cycle, RIG, MU).position
        gap.append(np.linalg.norm(once - finest, axis=1).max())
        fine_gap.append(np.linalg.norm(fine - finest, axis=1).max())
        effect.append(np.linalg.norm(even - finest, axis=1).max())
    assert max(gap) < 3e-4
    assert np.median(gap) < 1e-4
    assert np.median(fine_gap) < 0.3 * np.median(gap)
    assert np.median(effect) > 1e-4
