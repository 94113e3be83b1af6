"""Manipulability against cases that can be worked out by hand, and against scipy's programmes."""

import numpy as np
import pytest
from scipy.optimize import linprog

from plate_core import PlateError
from plate_solver import RotationSolver, library_force, manipulability
from plate_solver.library import Library, condition_number

WAYS = np.array([[np.cos(a), np.sin(a)] for a in np.arange(7)])


def columns(rig, position):
    """Unit forces of the library's twists, straight from v = u + w x P: part by part."""
    twist = Library.around(rig.plate.half).twist
    x, y = np.array(position).T
    speed = np.stack([twist[:, :1] - twist[:, 2:] * y, twist[:, 1:2] + twist[:, 2:] * x], axis=2)
    size = np.linalg.norm(speed, axis=2, keepdims=True)
    return (speed / np.where(size > 0, size, np.inf)).reshape(len(twist), -1).T


def scipy_force(matrix, direction):
    """The most r with r d in the hull of plus and minus the columns."""
    rows, count = matrix.shape
    result = linprog(
        np.append(np.zeros(2 * count), -1),
        np.append(np.ones(2 * count), 0)[None], [1],
        np.column_stack([matrix, -matrix, -direction]), np.zeros(rows), method="highs",
    )  # fmt: skip
    assert result.status == 0
    return result.x[-1]


def test_one_part_can_be_pushed_fully_in_every_direction(rig):
    position = np.array([[0.1, 0.05]])
    force = library_force(rig, position, WAYS)
    assert np.all(force <= 1 + 1e-9)
    np.testing.assert_allclose(
        force, 1, atol=2e-3
    )  # the library's directions are some degrees apart
    found = manipulability(rig, position)
    assert found.weakest_force == pytest.approx(1, abs=2e-3)
    assert 1 <= found.condition < 2


def test_two_parts_far_apart(rig):
    # Turning about the middle pushes them against each other across, shifts together: both fully.
    position = np.array([[-0.25, 0.0], [0.25, 0.0]])
    together, across = np.array([1.0, 0, 1, 0]), np.array([0, 1.0, 0, -1])
    np.testing.assert_allclose(library_force(rig, position, [together, across]), 1, atol=0.01)
    found = manipulability(rig, position)
    assert 0.3 < found.weakest_force < 0.6
    # No random direction is weaker than the reported weakest one.
    ways = np.random.default_rng(0).normal(size=(40, 4))
    assert np.min(library_force(rig, position, ways)) >= found.weakest_force - 1e-9


def test_condition_grows_as_one_over_the_distance(rig):
    gaps = np.array([4e-3, 2e-3, 1e-3, 5e-4])
    conditions, forces = [], []
    for gap in gaps:
        position = np.array([[0.05 - gap / 2, 0.031], [0.05 + gap / 2, 0.031]])
        found = manipulability(rig, position)
        conditions.append(found.condition)
        forces.append(found.weakest_force)
        opposite = found.worst_direction[:2] + found.worst_direction[2:]
        assert np.linalg.norm(opposite) < 0.02
        assert found.condition == condition_number(rig, position)
    slopes = np.polyfit(np.log(gaps), np.log(np.transpose([conditions, forces])), 1)[0]
    np.testing.assert_allclose(slopes, [-1, 1], atol=0.05)


def test_parts_in_one_place_cannot_be_moved_separately(rig):
    found = manipulability(rig, np.array([[0.05, 0.03], [0.05, 0.03]]))
    assert np.isinf(found.condition)
    assert found.weakest_force == 0
    np.testing.assert_allclose(found.worst_direction[:2], -found.worst_direction[2:], atol=1e-6)
    same = library_force(rig, [[0.05, 0.03], [0.05, 0.03]], [[1, 0, 1, 0], [1, 0, -1, 0]])
    np.testing.assert_allclose(same, [1, 0], atol=2e-3)


@pytest.mark.parametrize("count", [1, 2, 4, 10])
def test_the_hull_is_that_of_scipy(rig, scene, count):
    rng, position = scene(count, count)
    matrix = columns(rig, position)
    for direction in rng.normal(size=(3, 2 * count)):
        unit = direction / np.sqrt(np.sum(direction**2) / count)
        expected = scipy_force(matrix, unit)
        np.testing.assert_allclose(library_force(rig, position, direction), expected, rtol=1e-6)
    found = manipulability(rig, position)
    assert np.sum(found.weakest_direction**2) == pytest.approx(count)
    assert scipy_force(matrix, found.weakest_direction) == pytest.approx(
        found.weakest_force, rel=1e-6
    )
    values = np.linalg.svd(matrix, compute_uv=False)
    assert found.condition == pytest.approx(values[0] / values[-1], rel=1e-6)


def test_the_weakest_force_can_be_done(rig, scene):
    # Before ramps and closure: Method A reaches most of the hull's force in the weakest direction.
    _, position = scene(2, 2)
    found = manipulability(rig, position)
    force = found.weakest_force * found.weakest_direction.reshape(2, 2)
    solution = RotationSolver(rig).solve(position, 0.7 * force)
    assert solution.success


@pytest.mark.parametrize(
    ("position", "direction", "message"),
    [
        ([0.1, 0.2], [[1, 0]], r"position has shape \(2,\), allowed: \(M, 2\)"),
        ([[np.nan, 0.2]], [[1, 0]], "position has values that are not finite"),
        ([[0.1, 0.2]], [[1, 0, 0]], r"direction has shape \(1, 3\), allowed: \(D, 2\)"),
        ([[0.1, 0.2]], [[0, 0]], "allowed: .*nonzero"),
    ],
)
def test_wrong_input_is_named(rig, position, direction, message):
    with pytest.raises(PlateError, match=message):
        library_force(rig, position, direction)
