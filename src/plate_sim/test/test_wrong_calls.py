"""Kernels refuse arrays of another type or shape, and indices out of range."""

import numpy as np
import pytest

from plate_sim import _kernels

CANVAS = np.zeros((4, 5), np.float32)


def run_arguments():
    """A disc and a square of two pieces, on two plates."""
    square = np.array([[0, 0], [0.01, 0], [0.01, 0.01], [0, 0.01]])
    bodies = np.zeros((2, 10))
    bodies[:, 1] = 1.0
    bodies[0, 2:6] = 0.01, 0.01, 0.01, 1.0
    bodies[1, 3:6] = 0.01, 0.01, 1.0
    bodies.view(np.int64)[1, 6:] = 0, 3, 0, 2
    states = np.zeros((2, 2, 6))
    states[:, 0, 0] = 1.0
    factors = np.zeros((3, 6, 3))
    factors[0, 1, 0] = 1.0  # along x
    return {
        "times": np.array([0, 0.1, 0, 0.05, 0.1]), "coefficients": factors,
        "counts": np.array([[1, 2], [2, 2]]), "cycles": 3, "every": 1,
        "ground": np.tile([0, 0, 1.0, 0, 0], (2, 1)), "states": states, "limit": np.ones((2, 2)),
        "here": np.ones((2, 2), bool), "record": np.zeros((2, 7, 2, 6)), "bodies": bodies,
        "mesh": np.ones((4, 3)), "pieces": np.array([[0, 4], [4, 8]]),
        "corners": np.column_stack([*np.tile(square, (2, 1)).T, np.ones((8, 3))]),
        "restitution": 0.0, "friction": 0.0, "meets": True, "walls": True, "allowed": 0.1,
        "half": np.ones(2), "threads": 2,
    }  # fmt: skip


def test_parts_run_with_right_arguments():
    assert _kernels.run(**run_arguments()).tolist() == 2 * [[-1, -1, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("times", np.zeros(4)),
        ("coefficients", np.zeros((2, 6, 3))),
        ("coefficients", np.zeros((3, 6, 2))),
        ("counts", np.array([[1, 2], [2, 0]])),
        ("counts", np.array([[1, 2], [3, 2]])),
        ("counts", np.array([[3, 2], [0, 2]])),
        ("counts", np.array([[1, 2]])),
        ("every", 0),
        ("cycles", 4),
        ("ground", np.zeros((2, 3))),
        ("states", np.zeros((2, 3, 6))),
        ("states", np.zeros((2, 2, 6), np.float32)),
        ("states", np.zeros((6, 2, 2)).T),
        ("limit", np.ones((2, 3))),
        ("here", np.ones((2, 3), bool)),
        ("here", np.ones((2, 2))),
        ("record", np.zeros((2, 7, 3, 6))),
        ("record", np.zeros((2, 6, 2, 6))),
        ("record", np.zeros((1, 7, 2, 6))),
        ("bodies", np.zeros((2, 9))),
        ("mesh", np.ones((7, 3))),
        ("mesh", np.ones((4, 2))),
        ("pieces", np.array([[0, 4], [4, 9]])),
        ("pieces", np.array([[-1, 4], [4, 8]])),
        ("pieces", np.array([[4, 8], [0, 4]])),
        ("pieces", np.array([[0, 8]])),
        ("corners", np.zeros((8, 4))),
        ("half", np.ones(1)),
    ],
)
def test_the_simulation_of_parts_refuses_wrong_arrays(name, wrong):
    """Before any plate has begun."""
    right = run_arguments()
    before = right["states"].copy()
    with pytest.raises((TypeError, ValueError)):
        _kernels.run(**{**right, name: wrong})
    assert np.array_equal(right["states"], before)


def part_arguments():
    """A square with a hole, in the order of the kernel."""
    edges = np.tile([[1.0, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]], (2, 1))
    counts = [np.array([number]) for number in (0, 1, 2)]
    return [
        CANVAS.copy(), CANVAS, np.zeros((4, 5, 2)), np.array([[0, 4, 0, 5]]), np.ones(1),
        np.array([2]), np.zeros((2, 1, 2)), np.ones(1), np.ones((1, 2)), np.ones(1), np.ones(1),
        edges, np.array([0, 4, 8]), *counts,
    ]  # fmt: skip


def test_a_part_is_drawn_with_right_arguments():
    _kernels.draw_parts(*part_arguments())


@pytest.mark.parametrize(
    ("position", "wrong"),
    [
        (0, np.zeros((4, 5))),
        (0, np.zeros((5, 4), np.float32).T),
        (1, CANVAS[:3]),
        (2, np.zeros((4, 4, 2))),
        (3, np.array([[0, 5, 0, 5]])),
        (3, np.array([[0, 4, -1, 5]])),
        (4, np.ones(2)),
        (5, np.array([0])),
        (6, np.zeros((1, 1, 2))),
        (8, np.ones((1, 1))),
        (11, np.ones((7, 3))),
        (12, np.array([0, 4, 3])),
        (13, np.array([-1])),
        (15, np.array([3])),
    ],
)
def test_drawing_parts_refuses_wrong_arrays(position, wrong):
    arguments = part_arguments()
    arguments[position] = wrong
    with pytest.raises((TypeError, ValueError)):
        _kernels.draw_parts(*arguments)


@pytest.mark.parametrize(
    ("position", "wrong"),
    [
        (1, np.zeros(19, np.float32)),
        (2, np.zeros((20, 3))),
        (3, np.array([20])),
        (3, np.array([-1])),
        (4, np.zeros((0, 3))),
        (5, 0),
        (7, np.ones(3)),
    ],
)
def test_drawing_the_plate_refuses_wrong_arrays(position, wrong):
    arguments = [
        CANVAS.ravel(), CANVAS.ravel(), np.zeros((20, 2)), np.arange(20), np.zeros((1, 3)), 1, 0.0,
        np.ones(2), 1.0, 60.0, 220.0,
    ]  # fmt: skip
    _kernels.draw_plate(*arguments)
    arguments[position] = wrong
    with pytest.raises((TypeError, ValueError)):
        _kernels.draw_plate(*arguments)


def test_an_exposure_refuses_arrays_of_other_sizes_and_types():
    grey, image = np.zeros(20, np.float32), np.zeros(20, np.uint8)
    _kernels.expose(grey, grey, 1.0, image)
    for wrong in ((grey, grey[1:], 1.0, image), (grey, grey, 1.0, image[1:])):
        with pytest.raises(ValueError, match="size"):
            _kernels.expose(*wrong)
    with pytest.raises(TypeError):
        _kernels.expose(grey, grey, 1.0, grey)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("times", np.arange(2.0)),
        ("coefficients", np.zeros((2, 5, 3))),
        ("table", np.empty((3, 24))),
        ("table", np.empty((2, 24), np.float32)),
        ("scales", np.empty(7)),
    ],
)
def test_tabulating_the_plate_refuses_wrong_arrays(name, wrong):
    right = {
        "times": np.arange(3.0), "coefficients": np.zeros((2, 6, 3)), "gravity_x": 0.0,
        "gravity_y": 0.0, "closed": True, "table": np.empty((2, 24)), "scales": np.empty(8),
    }  # fmt: skip
    _kernels.tabulate(**right)
    with pytest.raises((TypeError, ValueError)):
        _kernels.tabulate(**{**right, name: wrong})


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("table", np.zeros((1, 23))),
        ("table", np.zeros((0, 24))),
        ("scales", np.zeros(7)),
        ("limit", np.ones(3)),
        ("cycles", 0),
        ("path", np.zeros((4, 2, 2))),
        ("path", np.zeros((3, 2, 2), np.float32)),
        ("speed", np.zeros((3, 2, 3))),
        ("checked", np.ones(1, bool)),
        ("checked", np.ones(2)),
    ],
)
def test_the_simulation_of_points_refuses_wrong_arrays(name, wrong):
    table = np.zeros((1, 24))
    table[0, 1] = 0.1
    right = {
        "table": table, "scales": np.zeros(8), "limit": np.ones(2), "static": 1.0,
        "tolerance": 1e-7, "cycles": 1, "path": np.zeros((3, 2, 2)), "speed": np.zeros((3, 2, 2)),
        "checked": np.ones(2, bool),
    }  # fmt: skip
    assert _kernels.run_points(**right) == 2
    with pytest.raises((TypeError, ValueError)):
        _kernels.run_points(**{**right, name: wrong})
