"""Posing: the pose of each part, the requests, and that parts arrive on a slow plate."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, config_path, load_rig
from plate_core.rig import load_part_types
from plate_core.tasks import Pose, PoseTask
from plate_planner.tasks import Poser

RIG = load_rig()


def task(*poses):
    return PoseTask(poses, tolerance_m=0.003, tolerance_rad=np.radians(3), hold_s=1.0)


def parts(position, angle, labels=None):
    names = labels or tuple(f"black_{k + 1}" for k in range(len(position)))
    return Parts.make(names, np.array(position), angle=np.array(angle))


def test_poses_with_a_place_go_to_the_nearest_and_the_others_stay():
    poser = Poser(task(Pose("black", None, 1.0), Pose("black", (0.1, 0.0), 0.0)), RIG)
    state = poser.begin(parts([[0.09, 0.01], [-0.1, 0.02]], [0.0, 0.0]))
    assert state.match == ("black_2", "black_1")
    assert state.position == pytest.approx(np.array([[-0.1, 0.02], [0.1, 0.0]]))


def test_errors_take_the_short_way_round():
    poser = Poser(task(Pose("black", (0.0, 0.0), np.radians(170))), RIG)
    there = parts([[0.003, 0.004]], [np.radians(-170)])
    distance, angle = poser.errors(poser.begin(there), there)
    assert distance == pytest.approx([0.005])
    assert np.degrees(angle) == pytest.approx([-20])


def test_a_part_turns_to_the_nearest_angle_at_which_it_looks_the_same():
    rig = replace(RIG, types=load_part_types(config_path("parts.yaml")))
    poser = Poser(replace(task(Pose("bar", None, 0.0)), anywhere=True), rig)
    bar = parts([[0.0, 0.0]], [np.radians(160)], ("bar_1",))
    state = poser.begin(bar)
    assert np.degrees(poser.errors(state, bar)[1]) == pytest.approx([20])
    targets = poser.request(state, bar)
    assert np.degrees((targets.angles.low + targets.angles.high) / 2) == pytest.approx([180])
    assert np.all(targets.weight == 0)  # it may be anywhere
    assert np.isnan(poser.begin(bar).position).all()
    assert not poser.precise
    assert replace(poser, task=replace(poser.task, anywhere=False)).precise  # it stays in place


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.3])
def test_poses_are_reached_with_too_small_and_too_large_gains(gain):
    poses = (Pose("black", (0.1, -0.05), np.radians(135)), Pose("black", None, np.radians(-90)))
    poser = Poser(task(*poses), RIG)
    seen = parts([[0.06, 0.0], [-0.1, 0.0]], [-2.0, 2.9])
    state = poser.begin(seen)
    for _ in range(80):
        to = poser.request(state, seen)
        position = np.clip(seen.position, to.low, to.high) - seen.position
        turn = np.clip(seen.angle, to.angles.low, to.angles.high) - seen.angle
        position, turn = np.clip(gain * position, -2e-3, 2e-3), np.clip(gain * turn, -0.1, 0.1)
        seen = replace(seen, position=seen.position + position, angle=seen.angle + turn)
    assert poser.count(state, seen) == 2
    distance, angle = poser.errors(state, seen)
    assert np.max(distance) < 0.5 * poser.task.tolerance_m
    assert np.max(np.abs(angle)) < 0.5 * poser.task.tolerance_rad


def test_a_part_that_was_to_stay_and_did_not_is_named():
    poser = Poser(task(Pose("black", None, 1.0)), RIG)
    state = poser.begin(parts([[0.0, 0.0]], [0.0]))
    assert poser.problem(state, parts([[0.0029, 0.0]], [0.0])) == ""
    text = poser.problem(state, parts([[0.004, 0.0]], [0.0]))
    assert text.startswith(
        "black_1 is 4.0 mm from the place at which it must rotate, allowed: 3 mm (tolerance_m);"
    )
