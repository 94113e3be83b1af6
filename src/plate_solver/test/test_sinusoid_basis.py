"""Families of sinusoidal motions: closed, consistent, at rest where they promise it."""

import numpy as np
import pytest

from plate_core.motion import usage
from plate_solver import Limits
from plate_solver.sinusoids import SinusoidFamily, sinusoid_basis

FAMILIES = [(1, 0.05, False), (2, 0.05, False), (3, 0.1, False), (2, 0.1, True), (8, 0.2, True)]


def random_motion(basis, rig, seed):
    """Coefficients (h, 3) of a motion at full amplitude."""
    family = SinusoidFamily(basis, Limits.of(rig))
    return family.coefficients(family.random(np.random.default_rng(seed)))


@pytest.mark.parametrize(("number", "period", "at_rest"), FAMILIES)
def test_basis_is_closed_and_its_derivatives_are_its_own(number, period, at_rest):
    family = sinusoid_basis(number, period, at_rest, steps=2000)
    assert family.size == 2 * number - (2 if at_rest else 0)
    assert family.dt == period / 2000
    # Closed: velocity and acceleration have no mean. (Equal steps integrate sinusoids exactly.)
    for basis in (family.twist, family.accel):
        np.testing.assert_allclose(basis.mean(axis=0), 0, atol=1e-12 * np.abs(basis).max())
    # Central differences of the periodic samples miss (w dt)^2/6 = 1e-4 at eight harmonics.
    for of, derivative in ((family.pose, family.twist), (family.twist, family.accel)):
        slope = (np.roll(of, -1, axis=0) - np.roll(of, 1, axis=0)) / (2 * family.dt)
        np.testing.assert_allclose(slope, derivative, atol=2e-4 * np.abs(derivative).max())
    # As many motions as parameters, and nothing above the highest harmonic.
    spectrum = np.abs(np.fft.rfft(family.twist, axis=0))
    assert np.max(spectrum[number + 1 :]) < 1e-9 * np.max(spectrum)
    assert np.linalg.cond(family.twist) < 10


@pytest.mark.parametrize(("number", "period", "at_rest"), FAMILIES)
def test_cycle_agrees_with_the_samples_it_was_found_on(rig, number, period, at_rest):
    family = sinusoid_basis(number, period, at_rest)
    coefficients = random_motion(family, rig, number)
    cycle = family.cycle(coefficients)
    assert cycle.period == period
    t = (np.arange(family.steps) + 0.5) * family.dt
    np.testing.assert_allclose(cycle.pose(t), family.pose @ coefficients, atol=1e-7)
    np.testing.assert_allclose(cycle.twist(t), family.twist @ coefficients, atol=1e-4)
    accel = family.accel @ coefficients
    np.testing.assert_allclose(cycle.accel(t), accel, atol=5e-3 * np.abs(accel).max())


def test_many_cycles_together_equal_the_single_cycles(rig):
    """To the last bit."""
    family = sinusoid_basis(4, 0.1, True)
    many = np.stack([random_motion(family, rig, seed) for seed in range(3)])
    for own, cycle in zip(many, family.cycles(many), strict=True):
        alone = family.cycle(own)
        assert np.array_equal(cycle.coefficients, alone.coefficients)
        for one, other in zip(cycle.knots, alone.knots, strict=True):
            assert np.array_equal(one, other)


@pytest.mark.parametrize(("number", "period", "at_rest"), FAMILIES)
def test_rest_at_the_edge(rig, number, period, at_rest):
    family = sinusoid_basis(number, period, at_rest)
    cycle = family.cycle(random_motion(family, rig, 0))
    assert cycle.starts_at_rest == at_rest
    edge = np.array([cycle.pose(0.0)[0], cycle.twist(0.0)[0], cycle.accel(0.0)[0]])
    if at_rest:
        np.testing.assert_allclose(edge, 0, atol=1e-10)
    else:
        mean = cycle.pose((np.arange(500) + 0.5) / 500 * period).mean(axis=0)
        np.testing.assert_allclose(mean, 0, atol=1e-8)  # it swings about home
        assert np.max(np.abs(edge)) > 1e-4


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("number", [2, 6])
def test_random_motions_use_the_limits_in_full(rig, number, seed):
    family = sinusoid_basis(number, 0.1, True)
    cycle = family.cycle(random_motion(family, rig, seed))
    assert 0.96 < usage(rig, cycle).worst < 1


def test_a_motion_of_zero_amplitude_remains_zero(rig):
    family = SinusoidFamily(sinusoid_basis(2, 0.1, True), Limits.of(rig))
    still = np.zeros(3 * family.basis.size)
    assert np.all(family.admissible(still) == 0)
