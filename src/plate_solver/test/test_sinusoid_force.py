"""The force map of sinusoids: against adaptive quadrature, at dips, and its derivatives."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from plate_solver import average_force
from plate_solver._kernels import force_of, slip_at
from plate_solver.averages import force_rules, sinusoid_forces
from plate_solver.sinusoids import sinusoid_basis

ADAPTIVE, USUAL = -1, 1  # as in sinusoid_force.hpp

NONE = np.empty((0, 0))


def work(number: int) -> np.ndarray:
    return np.empty((5, force_rules(number).waves.shape[1]))


def exact(slip: np.ndarray, dips: list[float]) -> np.ndarray:
    """Average direction of a slip (2 N + 1, 2), by quad between given times."""
    number = len(slip) // 2
    order = np.arange(1, number + 1)

    def direction(t: float, axis: int) -> float:
        waves = np.concatenate([np.sin(order * t), np.cos(order * t), [1.0]])
        w = waves @ slip
        return w[axis] / np.hypot(*w)

    edges = [0.0, *sorted(d % (2 * np.pi) for d in dips), 2 * np.pi]
    return np.array(
        [
            sum(
                quad(direction, a, b, args=(axis,), epsabs=1e-10, limit=500)[0]
                for a, b in pairwise(edges)
            )
            / (2 * np.pi)
            for axis in (0, 1)
        ]
    )


def with_dip(rng: np.random.Generator, number: int, at: float, depth: float) -> np.ndarray:
    """A random slip whose speed falls to about `depth` times its usual one at phase `at`."""
    slip = rng.normal(size=(2 * number + 1, 2))
    slip[-1] = 0
    order = np.arange(1, number + 1)
    here = np.concatenate([np.sin(order * at), np.cos(order * at)])
    slip[:-1] -= np.outer(here, here @ slip[:-1] - depth * rng.normal(size=2)) / (here @ here)
    return slip


@pytest.mark.parametrize("depth", [1.0, 0.1, 1e-2, 1e-3, 1e-5, 1e-8])
@pytest.mark.parametrize("number", [2, 3, 5])
def test_dips_do_not_matter(number, depth):
    rng = np.random.default_rng(number)
    plain = []
    for _ in range(4):
        at = rng.uniform(0, 2 * np.pi)
        slip = with_dip(rng, number, at, depth)
        near = [at + s * 10.0**-k for k in range(0, 9) for s in (-1, 1)]
        truth = exact(slip, [at, *near])
        got = force_of(slip, force_rules(number), ADAPTIVE, work(number), NONE)
        np.testing.assert_allclose(got, truth, atol=1e-6)
        once = force_of(slip, force_rules(number), USUAL, work(number), NONE)
        plain.append(np.max(np.abs(once - truth)))
    if depth == 1e-3:
        assert max(plain) > 1e-4, "equal steps would have done: the test shows nothing"


@pytest.mark.parametrize("number", [2, 4])
def test_derivatives_agree_with_differences_also_at_dips(number):
    rng = np.random.default_rng(number)
    for depth in (1.0, 0.1, 0.01):
        slip = with_dip(rng, number, 1.0, depth)
        gradient = np.empty((3, 2 * number))
        force_of(slip, force_rules(number), ADAPTIVE, work(number), gradient)
        step = 1e-4 * depth
        for j in range(2 * number):
            for axis in range(2):
                ends = []
                for sign in (1, -1):
                    moved = slip.copy()
                    moved[j, axis] += sign * step
                    ends.append(force_of(moved, force_rules(number), ADAPTIVE, work(number), NONE))
                slope = (np.array(ends[0]) - ends[1]) / (2 * step)
                expected = gradient[[axis, axis + 1], j]
                np.testing.assert_allclose(slope, expected, rtol=5e-3, atol=2e-3 + 1e-7 / step)


@pytest.mark.parametrize("number", [2, 3])
def test_agrees_with_the_map_of_the_finished_cycle(number):
    # Another integrator, on the spline. 8 knots per wave: splines and sines differ by some 1e-7.
    rng = np.random.default_rng(number)
    basis = sinusoid_basis(number, 0.1, False)
    motion = rng.normal(size=(6, 2 * number, 3)) * [0.2, 0.2, 1.0]
    position, velocity = rng.uniform(-0.2, 0.2, (6, 2)), rng.normal(size=(6, 2)) * 0.03
    got = sinusoid_forces(motion, position, velocity, force_rules(number))
    for k in range(6):
        other = average_force(basis.cycle(motion[k]), position[k : k + 1], velocity[k : k + 1])[0]
        np.testing.assert_allclose(got[k], other, atol=2e-5)


def test_a_line_through_zero_and_no_motion():
    slip = np.zeros((5, 2))
    slip[0], slip[3] = [0.3, 0.4], [0.15, 0.2]  # sin t + 0.5 cos 2t: see Observation 3
    fraction = 2 / np.pi * np.arcsin((np.sqrt(3) - 1) / 2)
    got = force_of(slip, force_rules(2), ADAPTIVE, work(2), NONE)
    np.testing.assert_allclose(got, fraction * np.array([0.6, 0.8]), atol=1e-8)
    assert force_of(0 * slip, force_rules(2), ADAPTIVE, work(2), NONE) == (0.0, 0.0)


def test_slip_is_the_surfaces_velocity_less_the_parts():
    motion = np.array([[1.0, 2.0, 3.0], [0.5, -1.0, 2.0]])
    slip = np.empty((3, 2))
    slip_at(motion, 0.1, -0.2, 0.3, 0.4, slip)
    np.testing.assert_allclose(slip, [[1.6, 2.3], [0.9, -0.8], [-0.3, -0.4]])
