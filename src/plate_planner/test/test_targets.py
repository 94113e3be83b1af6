"""Parts to targets: the best assignment, and the requests for assembled parts."""

from itertools import permutations

import numpy as np
import pytest

from plate_core import Parts, load_rig
from plate_core.tasks import AssembleTask
from plate_planner.tasks import Assembler
from plate_planner.tasks.targets import assign, match_targets, rematch_targets

RIG = load_rig()


def test_each_part_gets_a_place_of_its_class_and_other_parts_none():
    parts = Parts.make(
        ("grey_1", "red_1", "black_1", "black_2"),
        np.array([[0.0, 0.0], [0.0, 0.1], [0.1, 0.0], [0.0, 0.01]]),
    )
    position = np.array([[0.0, 0.0], [0.1, 0.01], [0.1, 0.02]])
    assert list(assign(("black", "grey", "black"), position, parts)) == [1, -1, 2, 0]
    task = AssembleTask(("black", "grey", "black"), tuple(map(tuple, position)), 0.003, 1.0)
    assembly = Assembler(task, RIG)
    distance = assembly.distance(parts)
    assert distance == pytest.approx([np.hypot(0.1, 0.01), np.nan, 0.02, 0.01], nan_ok=True)
    to = assembly.request(parts)
    assert (to.low + to.high)[[0, 2, 3]] / 2 == pytest.approx(position[[1, 2, 0]])
    assert np.all(to.high - to.low < 0.003)
    assert np.all(to.weight[1] == 0)
    assert np.all(to.weight[[0, 2, 3]] > 0)


def test_no_parts_means_no_request():
    nobody = Parts.make((), np.zeros((0, 2)))
    assembly = Assembler(AssembleTask(("black",), ((0.0, 0.0),), 0.003, 1.0), RIG)
    assert assembly.request(nobody).low.shape == (0, 2)
    assert assembly.distance(nobody).shape == (0,)


def test_the_match_is_the_best_of_all_permutations():
    rng = np.random.default_rng(0)
    for _ in range(20):
        target, position = rng.normal(size=(2, 5, 2))
        parts = Parts.make(tuple(f"black_{i}" for i in range(5)), position)
        match = match_targets(["black"] * 5, target, parts)
        order = [parts.ids.index(i) for i in match]
        best = min(permutations(range(5)), key=lambda p: np.sum((target - position[list(p)]) ** 2))
        assert order == list(best)


def test_a_part_takes_only_a_target_of_its_class():
    parts = Parts.make(("grey_1", "black_1"), np.array([[0.0, 0.0], [1.0, 0.0]]))
    target = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert match_targets(["black", "grey"], target, parts) == ("black_1", "grey_1")
    assert match_targets(["black", "red"], target, parts) == ("black_1", "")


def test_without_parts_no_target_is_matched():
    empty = Parts.make((), np.zeros((0, 2)))
    assert match_targets(["black"], np.zeros((1, 2)), empty) == ("",)
    assert match_targets([], np.zeros((0, 2)), empty) == ()


def test_a_part_that_returns_with_a_new_id_gets_its_target_again():
    match, labels = ("black_1", "black_2"), ["black", "black"]
    target = np.array([[0.0, 0.0], [0.1, 0.0]])
    parts = Parts.make(("black_1", "black_7"), np.array([[0.0, 0.0], [0.105, 0.0]]))
    assert rematch_targets(match, labels, target, parts, 0.03) == ("black_1", "black_7")
    assert rematch_targets(match, labels, target, parts, 0.001) == match
    only = Parts.make(("black_1",), np.zeros((1, 2)))
    assert rematch_targets(match, labels, target, only, 0.03) == match
