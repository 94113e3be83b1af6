"""The correction of equal steps at dips: against panels, which know nothing of it, and where two
dips are close to each other or lie between samples."""

import numpy as np
import pytest

from plate_solver._kernels import branch_point, find_dips, force_of
from plate_solver.averages import force_rules

ADAPTIVE, PANELS, USUAL = -1, -2, 1  # as in sinusoid_force.hpp
NONE = np.empty((0, 0))


def work(number: int) -> np.ndarray:
    return np.empty((5, force_rules(number).waves.shape[1]))


def slip_with_zeros(zeros: np.ndarray) -> np.ndarray:
    """The slip (2 N + 1, 2) for which wx + i wy is zero at the given 2 N complex times."""
    power = np.poly(np.exp(1j * zeros))[::-1]  # of exp(i t), ascending; middle one is constant
    number = len(zeros) // 2
    above, below = power[number + 1 :], power[:number][::-1]
    rows = np.concatenate([1j * (above - below), above + below, [power[number]]])
    return np.ascontiguousarray(np.stack([rows.real, rows.imag], axis=1))


@pytest.mark.parametrize("number", [1, 2, 3, 8])
def test_forces_and_derivatives_agree_with_panels(number):
    rng = np.random.default_rng(number)
    gradient, other = np.empty((3, 2 * number)), np.empty((3, 2 * number))
    missed = 0.0
    for _ in range(200):
        slip = rng.normal(size=(2 * number + 1, 2))
        got = force_of(slip, force_rules(number), ADAPTIVE, work(number), gradient)
        truth = force_of(slip, force_rules(number), PANELS, work(number), other)
        np.testing.assert_allclose(got, truth, atol=2e-7)
        np.testing.assert_allclose(gradient, other, atol=1e-4 * np.abs(other).max())
        plain = force_of(slip, force_rules(number), USUAL, work(number), NONE)
        missed = max(missed, np.max(np.abs(np.subtract(plain, truth))))
    assert missed > 1e-4, "equal steps would have done: the test shows nothing"


@pytest.mark.parametrize("apart", [0.5, 0.1, 0.03, 0.01, 1e-3, 1e-5])
@pytest.mark.parametrize("side", [1, -1])
def test_the_force_is_accurate_near_two_close_minima_of_the_slip(apart, side):
    rng = np.random.default_rng(5)
    for _ in range(5):
        depth = 10.0 ** rng.uniform(-4, -1, 2)
        at = rng.uniform(0, 2 * np.pi)
        zeros = np.array([at + 1j * depth[0], at + apart + 1j * side * depth[1], 3 + 1j, 1 - 2j])
        slip = slip_with_zeros(zeros)
        got = force_of(slip, force_rules(2), ADAPTIVE, work(2), NONE)
        truth = force_of(slip, force_rules(2), PANELS, work(2), NONE)
        np.testing.assert_allclose(got, truth, atol=3e-6)


@pytest.mark.parametrize("depth", [1e-1, 1e-3, 1e-6])
def test_a_branch_point_is_found_where_it_was_put(depth):
    zeros = np.array([1.0 - 1j * depth, 2 + 1j, 4 - 1j, 5 + 0.5j])
    start = np.cos(1.02), np.sin(1.02)
    real, imag, b, alone = branch_point(slip_with_zeros(zeros), *start, 0.2)
    assert alone
    assert np.arctan2(imag, real) == pytest.approx(1.0, abs=1e-8)
    assert b == pytest.approx(depth, rel=1e-6)
    assert not branch_point(slip_with_zeros(zeros), *start, 3.0)[3]  # one at 2 + i


def test_a_dip_between_two_equal_samples_is_found_once():
    found = np.empty(8)
    square = np.array([9.0, 5, 2, 0.1, 0.1, 2, 5, 9])
    assert find_dips(square, 8, found) == 1
    assert found[0] == 4
    assert find_dips(np.roll(square, 4), 8, found) == 1  # across the period's edge
    assert found[0] == 0


@pytest.mark.parametrize("depth", [1e-8, 1e-10, 1e-12])
def test_there_are_nodes_for_the_narrowest_dip(depth):
    slip = slip_with_zeros(np.array([1.0 - 1j * depth, 2 + 1j, 4 - 1j, 5 + 0.5j]))
    got = force_of(slip, force_rules(2), ADAPTIVE, work(2), NONE)
    truth = force_of(slip, force_rules(2), PANELS, work(2), NONE)
    np.testing.assert_allclose(got, truth, atol=1e-7)
