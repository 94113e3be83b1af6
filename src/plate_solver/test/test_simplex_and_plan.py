"""The linear programme, the library and the order of rotations, against other methods."""

from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import linprog

from plate_solver.averages.partial import reachable_fraction
from plate_solver.averages.tour import filled, nearest_order
from plate_solver.library import Library, min_time
from plate_solver.rotations import plan_rotations

HALF = np.array([0.3, 0.15])
LIBRARY = Library.around(HALF)


def by_highs(matrix, requested, cost, miss_cost):
    """The same problem by scipy's HiGHS, with positive variables only."""
    size = len(requested)
    columns = np.hstack([matrix, -matrix, np.eye(size), -np.eye(size)])
    prices = np.concatenate([cost, cost, miss_cost, miss_cost])
    return linprog(prices, A_eq=columns, b_eq=requested, bounds=(0, None), method="highs").fun


def check(times, matrix, requested, cost, miss_cost):
    """A feasible basic solution, and a dual one of the same value: both are optimal."""
    assert times.pivots < 2000
    miss = requested - matrix @ times.weights
    assert np.count_nonzero(times.weights) <= len(requested)
    paid = cost @ np.abs(times.weights)
    paid += miss_cost @ np.abs(miss)
    assert times.cost == pytest.approx(paid, rel=1e-6, abs=1e-9)
    assert np.all(np.abs(times.price @ matrix) <= cost * (1 + 1e-6))
    assert np.all(np.abs(times.price) <= miss_cost + 1e-6)
    assert times.price @ requested == pytest.approx(times.cost, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_optimum_is_that_of_highs_and_proves_itself(seed):
    rng = np.random.default_rng(seed)
    rows, count = int(rng.integers(3, 14)), 120
    matrix, expected = rng.normal(size=(rows, count)), rng.normal(size=rows)
    expected[rng.random(rows) < 0.3] = 0  # ties
    problem = matrix, expected, rng.uniform(0.5, 2, count), rng.uniform(0.2, 3, rows)
    times = min_time(*problem)
    check(times, *problem)
    assert times.cost == pytest.approx(by_highs(*problem), rel=1e-6)


def test_last_basis_is_a_good_start(scene):
    _, position = scene(3, 8)
    rng = np.random.default_rng(0)
    expected, ones, dear = rng.normal(size=16), np.ones(len(LIBRARY.twist)), np.full(16, 50.0)
    cold = min_time(LIBRARY.forces(position), expected, ones, dear)
    # The parts have moved and the request has changed, some of it to the opposite.
    matrix = LIBRARY.forces(position + 1e-3 * rng.normal(size=position.shape))
    changed = expected + 0.1 * rng.normal(size=16)
    changed[:2] *= -1
    warm = min_time(matrix, changed, ones, dear, cold.basis)
    check(warm, matrix, changed, ones, dear)
    fresh = min_time(matrix, changed, ones, dear)
    assert warm.cost == pytest.approx(fresh.cost, rel=1e-6)
    assert warm.pivots < fresh.pivots
    again = min_time(matrix, changed, ones, dear, warm.basis)
    assert again.pivots == 0


def test_basis_of_dependent_columns_does_no_harm():
    matrix, expected = np.random.default_rng(0).normal(size=(4, 30)), np.ones(4)
    matrix[:, 1] = matrix[:, 0]
    problem = matrix, expected, np.ones(30), np.full(4, 9.0)
    times = min_time(*problem, start=np.array([0, 1, 2, 3]))
    check(times, *problem)


def test_no_request_and_parts_in_one_place():
    ones, dear = np.ones(len(LIBRARY.twist)), np.full(4, 30.0)
    here = np.array([[0.1, 0.05], [0.1, 0.05]])
    none = min_time(LIBRARY.forces(here), np.zeros(4), ones, dear)
    assert not np.any(none.weights)
    apart = np.array([0.1, -0.1, 0.0, 0.0])  # x of both, y of both
    times = min_time(LIBRARY.forces(here), apart, ones, dear)
    assert times.cost == pytest.approx(30 * 0.2)  # given up, at the price of doing so
    assert not np.any(times.weights)


def test_forces_and_curls_of_the_library(scene):
    _, position = scene(1, 3)
    forces = LIBRARY.forces(position).reshape(2, 3, -1)
    for k in (0, 100, 479, 480, 487):
        u, v, spin = LIBRARY.twist[k]
        slip = np.array([u - spin * position[:, 1], v + spin * position[:, 0]])
        np.testing.assert_allclose(forces[:, :, k], slip / np.hypot(*slip), atol=1e-12)
        np.testing.assert_allclose(LIBRARY.curls(position)[:, k], spin / np.hypot(*slip))
    assert len(LIBRARY.twist) == 488
    assert np.all(np.isinf(LIBRARY.clearance(position)[480:]))


@pytest.mark.parametrize("count", [1, 4, 10])
def test_plan_gives_the_forces_and_closes(scene, count):
    rng, position = scene(5, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    force = 0.06 * np.column_stack([np.cos(angle), np.sin(angle)])
    plan = plan_rotations(LIBRARY, position, force)
    assert plan.fraction.sum() < 1
    assert len(plan.fraction) <= 2 * count + 3
    for sequence in (plan, filled(plan)):
        x, y = position.T
        u, v, spin = sequence.twist.T
        slip = np.array([u - np.outer(y, spin), v + np.outer(x, spin)])
        got = (slip / np.hypot(*slip)) @ sequence.fraction
        np.testing.assert_allclose(got.T, force, atol=1e-8)
        np.testing.assert_allclose(sequence.fraction @ sequence.twist, 0, atol=1e-8)
    assert plan.fraction.sum() == pytest.approx(plan.times.cost, rel=1e-6)
    assert filled(plan).fraction.sum() == pytest.approx(1)
    # Closure costs little.
    free = 1 / reachable_fraction(LIBRARY, position, force)
    assert free - 1e-9 <= plan.times.cost <= 1.15 * free


def test_an_infeasible_request_is_partly_met(scene):
    _, position = scene(2, 6)
    force = np.random.default_rng(0).normal(size=(6, 2))
    plan = plan_rotations(LIBRARY, position, force)
    assert plan.fraction.sum() == pytest.approx(1)
    met = 1 / np.abs(plan.times.weights).sum()
    assert 0 < met < 1
    reach = reachable_fraction(LIBRARY, position, force)
    assert met <= reach * (1 + 1e-6)
    assert plan_rotations(LIBRARY, position, 0.9 * met * force).fraction.sum() < 1


def tour(twists, order):
    """Length of a sequence: changes of the fastest corner, from rest to rest."""
    stops = np.vstack([np.zeros(3), twists[order], np.zeros(3)])
    step = np.diff(stops, axis=0)
    corners = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return sum(max(np.hypot(u - w * y, v + w * x) for x, y in corners) for u, v, w in step)


@pytest.mark.parametrize("seed", range(4))
def test_nearest_order_is_short(seed):
    twists = np.random.default_rng(seed).normal(size=(6, 3)) * [0.3, 0.3, 1.0]
    order = nearest_order(twists, HALF)
    assert sorted(order) == list(range(6))
    best = min(tour(twists, list(p)) for p in permutations(range(6)))
    assert tour(twists, order) <= 1.15 * best
