"""The closed form on triangular waves against quadrature of the same waves."""

import numpy as np
import pytest
from scipy.integrate import quad

from plate_solver.averages.triangular_waves import intervals, triangle_sine, triangular_forces


@pytest.mark.parametrize(("number", "count"), [(1, 4), (2, 8), (3, 16)])
def test_as_many_intervals_as_the_paper_says(number, count):
    kinks, fractions = intervals(number)
    assert len(fractions) == count
    assert fractions.sum() == pytest.approx(1)
    assert kinks.shape == (count + 1, 2 * number)
    # Linear in between: the middle of each interval is the mean of its ends.
    edges = np.concatenate([[0], np.cumsum(fractions)])
    middle = 2 * np.pi * np.outer((edges[1:] + edges[:-1]) / 2, np.arange(1, number + 1))
    got = np.hstack([triangle_sine(middle), triangle_sine(middle + np.pi / 2)])
    np.testing.assert_allclose(got, (kinks[1:] + kinks[:-1]) / 2, atol=1e-12)


def test_the_waves_are_the_papers():
    t = np.array([-np.pi, -np.pi / 2, 0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4])
    np.testing.assert_allclose(triangle_sine(t), [0, -1, 0, 0.5, 1, 0.5], atol=1e-12)


@pytest.mark.parametrize("number", [2, 3])
def test_agrees_with_quadrature(number):
    rng = np.random.default_rng(number)
    motion = rng.normal(size=(4, 2 * number, 3)) * [0.2, 0.2, 1.0]
    place = rng.uniform(-0.3, 0.3, (4, 2))
    kinks, fractions = intervals(number)
    force = triangular_forces(motion, place, kinks, fractions)
    order = np.arange(1, number + 1)

    def direction(t, i, axis):
        waves = np.concatenate([triangle_sine(order * t), triangle_sine(order * t + np.pi / 2)])
        u = waves @ motion[i]
        slip = np.array([u[0] - place[i, 1] * u[2], u[1] + place[i, 0] * u[2]])
        return slip[axis] / np.hypot(*slip)

    breaks = 2 * np.pi * np.cumsum(fractions)[:-1]
    for i in range(4):
        for axis in range(2):
            exact, error = quad(
                direction, 0, 2 * np.pi, args=(i, axis), points=breaks, limit=2000, epsabs=1e-7
            )
            assert error < 1e-5
            assert force[i, axis] == pytest.approx(exact / (2 * np.pi), abs=1e-5)


def test_motion_along_a_line_reverses_at_once():
    motion = np.zeros((1, 4, 3))
    motion[0, 0, :2], motion[0, 3, :2] = [0.3, 0.4], [0.15, 0.2]  # sin t + 0.5 cos 2t
    kinks, fractions = intervals(2)
    t = 2 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    sign = np.mean(np.sign(triangle_sine(t) + 0.5 * triangle_sine(2 * t + np.pi / 2)))
    force = triangular_forces(motion, np.array([[0.1, -0.2]]), kinks, fractions)[0]
    np.testing.assert_allclose(force, sign * np.array([0.6, 0.8]), atol=1e-4)
    assert np.all(triangular_forces(0 * motion, np.zeros((1, 2)), kinks, fractions) == 0)
