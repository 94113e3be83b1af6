"""Exact steps of a linear system under a polynomial input, against integration."""

from math import factorial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plate_sim.plate.drive import DEGREE, shift_derivatives
from plate_sim.plate.response import advance, step_responses

RNG = np.random.default_rng(5)
OSCILLATOR = np.array([[0.0, 1.0], [-(220.0**2), -13.0]])
DRIFTING = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -900.0]])  # not diagonalisable


@pytest.mark.parametrize("system", [OSCILLATOR, DRIFTING])
def test_a_step_follows_a_polynomial_input(system):
    step, size = 0.02, len(system)
    state = RNG.normal(size=size) * 0.1
    derivatives = RNG.normal(size=(DEGREE + 1, size)) * 100.0 ** np.arange(DEGREE + 1)[:, None]
    weights = np.array([1 / factorial(k) for k in range(DEGREE + 1)])

    def rates(t, z):
        return system @ z + (weights * t ** np.arange(DEGREE + 1)) @ derivatives

    truth = solve_ivp(rates, (0, step), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    found = advance(step_responses(system, np.array([step])), state[None], derivatives[None])[0]
    np.testing.assert_allclose(found, truth, rtol=1e-10)
    # Two halves make the whole.
    half = step_responses(system, np.array([step / 2]))
    middle = advance(half, state[None], derivatives[None])
    moved = shift_derivatives(derivatives[None], np.array([step / 2]))
    np.testing.assert_allclose(advance(half, middle, moved)[0], found, rtol=1e-10)


def test_derivatives_later():
    powers = RNG.normal(size=6)
    polynomial = np.polynomial.Polynomial(powers)

    def at(t):
        return np.array([polynomial.deriv(k)(t) if k else polynomial(t) for k in range(6)])

    start = np.stack([at(0.0), at(0.3)])[:, :, None]
    moved = shift_derivatives(start, np.array([0.7, 0.4]))
    np.testing.assert_allclose(moved[0, :, 0], at(0.7), rtol=1e-12)
    np.testing.assert_allclose(moved[1, :, 0], at(0.7), rtol=1e-12)
    np.testing.assert_array_equal(shift_derivatives(start, np.zeros(2)), start)
