"""The descent and the restarts: steps, condition numbers, and searches with known ends."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from plate_solver._kernels import condition_of, least_norm_step
from plate_solver.fit import basin_hopping, fit


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_the_step_has_the_minimum_norm(damping):
    rng = np.random.default_rng(0)
    jacobian, error = rng.normal(size=(4, 12)), rng.normal(size=4)
    step = least_norm_step(jacobian, error, damping)
    square = jacobian @ jacobian.T
    more = damping * np.trace(square) / 4 * np.eye(4)
    np.testing.assert_allclose(step, jacobian.T @ np.linalg.solve(square + more, error), atol=1e-12)
    if damping == 0:
        np.testing.assert_allclose(
            step, np.linalg.lstsq(jacobian, error, rcond=None)[0], atol=1e-12
        )
    # More errors than parameters: the same equation in the other space.
    tall, many = jacobian.T.copy(), rng.normal(size=12)
    square = tall.T @ tall
    more = damping * np.trace(square) / 4 * np.eye(4)
    expected = np.linalg.solve(square + more, tall.T @ many)
    np.testing.assert_allclose(least_norm_step(tall, many, damping), expected, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 2, 6, 10])
def test_condition_number(rows):
    matrix = np.random.default_rng(rows).normal(size=(rows, 12))
    matrix[0] *= 1e-3
    assert condition_of(matrix) == pytest.approx(np.linalg.cond(matrix), rel=1e-6)
    assert condition_of(np.vstack([matrix, matrix[:1]])) == np.inf
    assert condition_of(matrix.T.copy()) == pytest.approx(np.linalg.cond(matrix), rel=1e-6)


def test_descent_ends_where_scipy_does():
    # Rosenbrock's valley, as two errors of two parameters.
    def evaluate(theta):
        error = np.array([10 * (theta[1] - theta[0] ** 2), 1 - theta[0]])
        return error, lambda: np.array([[20 * theta[0], -10.0], [1.0, 0.0]])

    start = np.array([-1.2, 1.0])
    found = fit(evaluate, lambda theta: theta, start, 1e-9, 200)
    truth = least_squares(lambda theta: evaluate(theta)[0], start, method="lm").x
    np.testing.assert_allclose(found.parameters, truth, atol=1e-8)
    assert found.iterations < 60
    few = fit(evaluate, lambda theta: theta, start, 1e-9, 3)
    assert few.iterations == 3
    assert few.cost <= evaluate(start)[0] @ evaluate(start)[0]


def test_steps_are_taken_among_what_is_admissible():
    def evaluate(theta):
        return np.array([3.0 - theta[0]]), lambda: np.ones((1, 1))

    found = fit(evaluate, lambda theta: np.minimum(theta, 2.0), np.array([5.0]), 1e-9, 20)
    np.testing.assert_allclose(found.parameters, [2.0])


@pytest.mark.parametrize("afresh", [False, True])
def test_restarts_find_the_deepest_of_many_valleys(afresh):
    rng = np.random.default_rng(0)

    def height(x):
        return 0.02 * (x - 7) ** 2 + 1 + np.cos(3 * (x - 7) + np.pi)

    def attempt(x, number):
        for _ in range(60):  # down into the nearest valley
            x -= 0.02 * (0.04 * (x - 7) - 3 * np.sin(3 * (x - 7) + np.pi))
        return x, height(x), 1, height(x) < 1e-3

    def propose(number, near, fresh):
        assert fresh == (number % 2 == afresh)
        return rng.uniform(-20, 20) if fresh else near + rng.normal() * 2

    best, steps = basin_hopping(propose, attempt, -15.0, 400, afresh)
    assert best == pytest.approx(7, abs=0.05)
    assert steps < 400
    lost, steps = basin_hopping(propose, attempt, -15.0, 1, afresh)
    assert steps == 1
    assert lost < 0
