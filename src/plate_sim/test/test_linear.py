"""Linear systems under polynomial inputs, against the matrix exponential and integration."""

from math import factorial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from plate_sim.linear import DEGREE, advance, depth, later, rate, step_responses

RNG = np.random.default_rng(5)
OSCILLATOR = np.array([[0.0, 1.0], [-(220.0**2), -13.0]])
DRIFTING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -900.0]])  # not diagonalisable


@pytest.mark.parametrize("system", [OSCILLATOR, DRIFTING, np.zeros((2, 2))])
def test_responses_are_the_blocks_of_a_larger_exponential(system):
    """exp of [[A, I, 0..], [0, 0, I..], ..] has them in its first row (Van Loan 1978)."""
    steps, size, count = np.array([0.03, 1e-3]), len(system), DEGREE + 2
    halvings = depth(system, 0.03) + 1
    response = step_responses(system, steps, halvings)
    assert response.shape == (halvings + 1, 2, count, size, size)
    large = np.kron(np.eye(count, k=1), np.eye(size))
    large[:size, :size] = system
    for level in (0, halvings):
        for i, step in enumerate(steps / 2**level):
            units = np.repeat(step ** -np.arange(count), size)  # so that no block is tiny
            row = expm(large * step / units[:, None] * units)[:size]
            blocks = row.reshape(size, count, size).swapaxes(0, 1)
            got = response[level, i] / step ** np.arange(count)[:, None, None]
            largest = np.max(np.abs(blocks), axis=(1, 2), keepdims=True)
            np.testing.assert_allclose(got / largest, blocks / largest, rtol=0, atol=1e-11)


def test_advance_follows_a_polynomial_input():
    step, state = 0.02, RNG.normal(size=2) * [1e-3, 0.1]
    derivatives = RNG.normal(size=(DEGREE + 1, 2)) * 100.0 ** np.arange(DEGREE + 1)[:, None]
    weights = np.array([1 / factorial(k) for k in range(DEGREE + 1)])

    def rates(t, z):
        return OSCILLATOR @ z + (weights * t ** np.arange(DEGREE + 1)) @ derivatives

    truth = solve_ivp(rates, (0, step), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    response = step_responses(OSCILLATOR, np.array([step]), depth(OSCILLATOR, step))[0]
    found = advance(response, state[None], derivatives[None])[0]
    np.testing.assert_allclose(found, truth, rtol=1e-10)


def test_the_rate_does_not_depend_on_units():
    units = np.diag([1.0, 1e-3])
    other = units @ OSCILLATOR @ np.linalg.inv(units)
    assert 220 <= rate(OSCILLATOR) <= 3 * 220
    assert rate(other) == pytest.approx(rate(OSCILLATOR), rel=1.0)


def test_derivatives_later():
    powers = RNG.normal(size=6)
    polynomial = np.polynomial.Polynomial(powers)

    def at(t):
        return np.array([polynomial.deriv(k)(t) if k else polynomial(t) for k in range(6)])

    start = np.stack([at(0.0), at(0.3)])[:, :, None]
    moved = later(start, np.array([0.7, 0.4]))
    np.testing.assert_allclose(moved[0, :, 0], at(0.7), rtol=1e-12)
    np.testing.assert_allclose(moved[1, :, 0], at(0.7), rtol=1e-12)
    np.testing.assert_array_equal(later(start, np.zeros(2)), start)
