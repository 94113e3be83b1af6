"""Rotation centres against the numbers printed in section 3.1 of the paper."""

import numpy as np
import pytest

from plate_solver.averages import solve_weights
from plate_solver.library import grid, rotation_matrix
from plate_solver.library.library import Library, curl_matrix, unit_twists

CORNERS = np.array([[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]])
PARTS = np.array([[0.5, 0.0], [-0.75, 0.25]])
MU_M_G = 0.1  # N, section 3.1.1
HALF = np.array([0.3, 0.15])  # the default rig's half sides [m]


def example_311() -> tuple[np.ndarray, np.ndarray]:
    force = np.array([[0.01, 0.01], [-0.01, 0.0]])
    return rotation_matrix(PARTS, CORNERS), len(CORNERS) / MU_M_G * force.T.ravel()


def ring(half, count=24):
    """Centres (count, 2) [m] on an ellipse slightly larger than the plate."""
    angle = 2 * np.pi * np.arange(count) / count
    return half * np.column_stack([1.1 * np.cos(angle), 1.2 * np.sin(angle)])


def test_force_example_of_the_paper():
    matrix, expected = example_311()
    printed = [
        [-0.316, -0.707, 0.707, 0.316],
        [-0.949, -0.394, 0.141, 0.707],
        [0.949, -0.707, -0.707, 0.949],
        [0.316, -0.919, -0.990, 0.707],
    ]
    np.testing.assert_allclose(matrix, printed, atol=5.1e-4)
    np.testing.assert_allclose(expected, [0.4, -0.4, 0.4, 0])
    weights, condition = solve_weights(matrix, expected)
    assert np.all(np.abs(weights - [0.58, -0.39, 0.48, -0.095]) < [5e-3, 5e-3, 5e-3, 5e-4])
    assert condition == pytest.approx(np.linalg.cond(matrix), rel=1e-9)


def test_curl_example_of_the_paper():
    part, centres = PARTS[:1], CORNERS[:3]
    matrix = np.vstack([rotation_matrix(part, centres), curl_matrix(part, centres)])
    printed = [[-0.316, -0.707, 0.707], [0.949, -0.707, -0.707], [0.633, 1.41, 1.41]]
    np.testing.assert_allclose(matrix[:2], printed[:2], atol=5.1e-4)
    # The paper prints .633 for 1/sqrt(2.5) = .63246: half a unit and a bit.
    assert np.all(np.abs(matrix[2] - printed[2]) < [6e-4, 5e-3, 5e-3])
    expected = len(centres) / MU_M_G * np.array([0, 0, -0.05])
    np.testing.assert_allclose(expected, [0, 0, -1.5])
    weights, _ = solve_weights(matrix, expected)
    np.testing.assert_allclose(weights, [-0.59, -0.27, -0.53], atol=5e-3)


def test_priorities_follow_the_formula_not_the_printed_numbers():
    weights, _ = solve_weights(*example_311())
    nearest = [min(np.hypot(*(part - centre)) for part in PARTS) for centre in CORNERS]
    np.testing.assert_allclose(Library.about(CORNERS, HALF).clearance(PARTS), nearest)
    priority = np.abs(weights) / nearest
    np.testing.assert_allclose(priority, [0.739, 0.550, 0.679, 0.268], atol=5e-4)
    assert list(np.argsort(-priority)) == [0, 2, 1, 3]


@pytest.mark.parametrize("seed", range(3))
def test_columns_are_the_directions_in_which_turned_parts_move(seed):
    rng = np.random.default_rng(seed)
    part, centre = rng.uniform(-HALF, HALF, (2, 5, 2))
    angle = 1e-6
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = rotation_matrix(part, centre)
    for i, j in np.ndindex(5, 5):
        moved = centre[j] + turn @ (part[i] - centre[j]) - part[i]
        np.testing.assert_allclose(
            matrix[[i, 5 + i], j], moved / np.hypot(*moved), rtol=0, atol=1e-5
        )
        distance = np.hypot(*(part[i] - centre[j]))
        assert curl_matrix(part, centre)[i, j] == pytest.approx(1 / distance)


def test_a_part_on_a_centre_feels_no_force_from_it():
    centre = grid(HALF)
    matrix = np.vstack([rotation_matrix(centre[5:6], centre), curl_matrix(centre[5:6], centre)])
    assert np.all(matrix[:, 5] == 0)
    assert np.all(np.hypot(*np.delete(matrix[:2], 5, axis=1)) > 0.999)


def test_more_centres_than_rows_give_the_smallest_weights():
    rng = np.random.default_rng(0)
    matrix = rotation_matrix(rng.uniform(-HALF, HALF, (3, 2)), ring(HALF))
    expected = rng.normal(size=6)
    weights, _ = solve_weights(matrix, expected)
    np.testing.assert_allclose(weights, np.linalg.lstsq(matrix, expected, rcond=None)[0], rtol=1e-9)


# Section 3.1.5: parts that come close.


def pair(distance: float) -> np.ndarray:
    return rotation_matrix(np.array([[0.05, 0.02], [0.05 + distance, 0.02]]), ring(HALF))


def test_condition_grows_as_one_over_distance():
    condition = [solve_weights(pair(d), np.ones(4))[1] for d in (8e-3, 4e-3, 2e-3, 1e-3)]
    growth = np.divide(condition[1:], condition[:-1])
    np.testing.assert_allclose(growth, 2, rtol=0.02)


@pytest.mark.parametrize("max_gain", [1, 3, 30])
def test_bounded_gain_bounds_the_weights_and_keeps_what_can_be_met(max_gain):
    matrix = pair(1e-3)
    together, apart = np.array([0.1, 0.1, 0.0, 0.0]), np.array([0.1, -0.1, 0.0, 0.0])
    free, _ = solve_weights(matrix, apart)
    assert np.linalg.norm(free) > 30 * np.linalg.norm(apart), "not a hard case"
    for expected in (together, apart, together + apart):
        weights, _ = solve_weights(matrix, expected, max_gain)
        assert np.linalg.norm(weights) <= max_gain * np.linalg.norm(expected)
        # The part that both share is met, the difference is given up.
        force = matrix @ weights
        np.testing.assert_allclose(force[:2].mean(), expected[:2].mean(), atol=2e-3)
        np.testing.assert_allclose(force[0], force[1], atol=2e-3)


def test_unit_twists_turn_about_their_centres():
    centre = np.vstack([grid(HALF), ring(HALF), [[2.0, -1.0]]])
    corners = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for (x, y), (u, v, spin) in zip(centre, unit_twists(centre, HALF), strict=True):
        assert spin > 0
        np.testing.assert_allclose([u - spin * y, v + spin * x], 0, atol=1e-15)
        assert max(np.hypot(u - spin * b, v + spin * a) for a, b in corners) == pytest.approx(1)


def test_grid_covers_the_plate():
    np.testing.assert_allclose(np.abs(grid(HALF)).max(axis=0), HALF)
    np.testing.assert_allclose(grid(HALF).mean(axis=0), 0, atol=1e-15)
    assert len(grid(HALF, 5, 3)) == 15
