"""Parts to targets: the best match, intervals that lead there, round others, clear of edges."""

from itertools import permutations

import numpy as np
import pytest

from plate_core import Parts, load_rig
from plate_core.tasks import AssembleTask
from plate_planner.tasks import AssembleOptions, Assembler, DriftRequest
from plate_planner.tasks.targets import (
    APPROACH,
    LOOSE,
    OVER,
    approach_drift,
    assign,
    hold_back,
    match_targets,
    pass_by,
    rematch_targets,
    speed_scaling,
)

RIG = load_rig()
SPEED, BAND = 0.012, 0.001


def drift(position, aim):
    position = np.array(position)
    speed = np.full(len(position), SPEED)
    return approach_drift(position, np.array(aim), BAND, speed, OVER * SPEED)


def test_any_drift_in_the_interval_leads_nearer_until_the_band_is_reached():
    rng = np.random.default_rng(0)
    position, aim = rng.uniform(-0.2, 0.2, (2, 500, 2))
    aim[::2] = position[::2] + rng.uniform(-0.01, 0.01, (250, 2))  # near ones too
    request = drift(position, aim)
    gap = aim - position
    assert np.all(request.low <= request.high)
    outside = np.max(np.abs(gap), axis=1) > 3 * BAND
    assert np.sum(outside) > 400
    worst = np.minimum(gap * request.low, gap * request.high).sum(axis=1)
    assert np.all(worst[outside] > 0)
    assert np.max(np.abs([request.low, request.high])) <= OVER * SPEED * (1 + 1e-12)


def test_in_the_band_it_may_drift_but_not_out_within_a_time_constant():
    request = drift([[0.0005, 0.0]], [[0.0, 0.0]])
    beside = BAND + LOOSE * 0.5e-3
    assert request.high[0] == pytest.approx([APPROACH * (beside - 0.5e-3), APPROACH * beside])
    assert request.low[0] == pytest.approx([-APPROACH * (beside + 0.5e-3), -APPROACH * beside])


def test_parts_that_meet_both_turn_right_and_one_at_rest_stays():
    position = np.array([[0.0, 0.0], [0.02, 0.0]])
    towards = np.array([[0.01, 0.0], [-0.01, 0.0]])
    request = pass_by(position, DriftRequest(towards, towards), 0.008)
    assert request.low[0, 1] < -0.005  # the one that goes right turns down
    assert request.low[1, 1] > 0.005
    assert 0 <= request.low[0, 0] < 0.003
    one = pass_by(position, DriftRequest(towards * [[1], [0]], towards * [[1], [0]]), 0.008)
    assert one.low[1] == pytest.approx([0, 0])
    assert one.low[0] == pytest.approx(request.low[0])
    apart = pass_by(position * 2, DriftRequest(towards, towards), 0.008)
    assert apart.low == pytest.approx(towards)
    away = pass_by(position, DriftRequest(-towards, -towards), 0.008)
    assert away.low == pytest.approx(-towards)


def test_drift_towards_an_edge_is_cut_off_but_a_place_near_it_is_reached():
    half = RIG.plate.half
    wild = DriftRequest(np.full((2, 2), -0.02), np.full((2, 2), 0.02))
    position = np.array([[0.95 * half[0], 0.0], [0.0, -0.93 * half[1]]])
    request = hold_back(position, np.zeros((2, 2)), half, wild)
    assert request.high[0, 0] < 0  # beyond the line: back
    assert request.low[1, 1] == pytest.approx(0, abs=1e-9)
    assert request.high[1] == pytest.approx([0.02, 0.02])
    near_edge = np.array([[0.97 * half[0], 0.0]] * 2)
    assert hold_back(position, near_edge, half, wild).high[0, 0] > 0


def test_each_part_gets_a_place_of_its_class_and_a_stranger_none():
    parts = Parts.make(
        ("grey_1", "red_1", "black_1", "black_2"),
        np.array([[0.0, 0.0], [0.0, 0.1], [0.1, 0.0], [0.0, 0.01]]),
    )
    place = np.array([[0.0, 0.0], [0.1, 0.01], [0.1, 0.02]])
    assert list(assign(("black", "grey", "black"), place, parts)) == [1, -1, 2, 0]
    task = AssembleTask(("black", "grey", "black"), tuple(map(tuple, place)), 0.003, 1.0)
    assembly = Assembler(task, RIG)
    distance = assembly.distance(parts)
    assert distance == pytest.approx([np.hypot(0.1, 0.01), np.nan, 0.02, 0.01], nan_ok=True)
    request = assembly.request(parts, 0.1)
    assert request.low[1] == pytest.approx([-AssembleOptions.drift_max] * 2)
    assert request.high[1] == pytest.approx([AssembleOptions.drift_max] * 2)


def test_nobody_is_asked_nothing():
    nobody = Parts.make((), np.zeros((0, 2)))
    assembly = Assembler(AssembleTask(("black",), ((0.0, 0.0),), 0.003, 1.0), RIG)
    assert assembly.request(nobody, 0.1).low.shape == (0, 2)
    assert assembly.distance(nobody).shape == (0,)


def test_parts_with_shorter_ways_are_asked_for_less_and_all_arrive_together():
    scaling = speed_scaling(np.array([0.3, 0.24, 0.02, 0.0, np.nan]))
    assert scaling[0] == 1
    assert scaling[1] == pytest.approx(0.8, abs=0.02)
    assert list(scaling[2:]) == [0.3, 0.3, 0.3]
    assert list(speed_scaling(np.zeros(2))) == [1, 1]  # all there: nobody is slowed for others
    assert len(speed_scaling(np.zeros(0))) == 0


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


def test_nobody_to_match():
    empty = Parts.make((), np.zeros((0, 2)))
    assert match_targets(["black"], np.zeros((1, 2)), empty) == ("",)
    assert match_targets([], np.zeros((0, 2)), empty) == ()


def test_a_part_back_under_a_new_number_takes_its_target_again():
    match, labels = ("black_1", "black_2"), ["black", "black"]
    target = np.array([[0.0, 0.0], [0.1, 0.0]])
    parts = Parts.make(("black_1", "black_7"), np.array([[0.0, 0.0], [0.105, 0.0]]))
    assert rematch_targets(match, labels, target, parts, 0.03) == ("black_1", "black_7")
    assert rematch_targets(match, labels, target, parts, 0.001) == match
    only = Parts.make(("black_1",), np.zeros((1, 2)))
    assert rematch_targets(match, labels, target, only, 0.03) == match
