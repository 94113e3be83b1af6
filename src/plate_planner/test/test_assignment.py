"""Parts and paths: the optimum, classes, and parts that come back under a new number."""

from itertools import permutations

import numpy as np

from plate_core import Parts
from plate_planner.assignment import match_paths, rematch_paths


def test_the_match_is_the_best_of_all_permutations():
    rng = np.random.default_rng(0)
    for _ in range(20):
        target, position = rng.normal(size=(2, 5, 2))
        parts = Parts.make(tuple(f"black_{i}" for i in range(5)), position)
        match = match_paths(["black"] * 5, target, parts)
        order = [parts.ids.index(i) for i in match]
        best = min(permutations(range(5)), key=lambda p: np.sum((target - position[list(p)]) ** 2))
        assert order == list(best)


def test_a_part_takes_only_a_path_of_its_class():
    parts = Parts.make(("grey_1", "black_1"), np.array([[0.0, 0.0], [1.0, 0.0]]))
    target = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert match_paths(["black", "grey"], target, parts) == ("black_1", "grey_1")
    assert match_paths(["black", "red"], target, parts) == ("black_1", "")


def test_nobody_to_match():
    empty = Parts.make((), np.zeros((0, 2)))
    assert match_paths(["black"], np.zeros((1, 2)), empty) == ("",)
    assert match_paths([], np.zeros((0, 2)), empty) == ()


def test_a_part_back_under_a_new_number_takes_its_path_again():
    match, labels = ("black_1", "black_2"), ["black", "black"]
    target = np.array([[0.0, 0.0], [0.1, 0.0]])
    parts = Parts.make(("black_1", "black_7"), np.array([[0.0, 0.0], [0.105, 0.0]]))
    assert rematch_paths(match, labels, target, parts, 0.03) == ("black_1", "black_7")
    assert rematch_paths(match, labels, target, parts, 0.001) == match
    only = Parts.make(("black_1",), np.zeros((1, 2)))
    assert rematch_paths(match, labels, target, only, 0.03) == match
