"""Posing: which part gets which pose, what is asked, and that it gets there on a lazy plate."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import Parts, load_rig
from plate_core.tasks import Pose, PoseTask
from plate_planner.tasks import Poser
from plate_planner.tasks.pose import DRIFT_MAX, SPIN_MAX

RIG = load_rig()
T = 0.2


def task(*poses):
    return PoseTask(poses, tolerance_m=0.003, tolerance_rad=np.radians(3), hold_s=1.0)


def parts(place, angle, labels=None):
    names = labels or tuple(f"black_{k + 1}" for k in range(len(place)))
    return Parts.make(names, np.array(place), angle=np.array(angle))


def test_poses_with_a_place_go_to_the_nearest_and_the_others_stay():
    poser = Poser(task(Pose("black", None, 1.0), Pose("black", (0.1, 0.0), 0.0)), RIG)
    state = poser.begin(parts([[0.09, 0.01], [-0.1, 0.02]], [0.0, 0.0]))
    assert state.match == ("black_2", "black_1")
    assert state.place == pytest.approx(np.array([[-0.1, 0.02], [0.1, 0.0]]))


def test_errors_take_the_short_way_round():
    poser = Poser(task(Pose("black", (0.0, 0.0), np.radians(170))), RIG)
    there = parts([[0.003, 0.004]], [np.radians(-170)])
    distance, angle = poser.errors(poser.begin(there), there)
    assert distance == pytest.approx([0.005])
    assert np.degrees(angle) == pytest.approx([-20])


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.3])
def test_it_gets_there_where_the_plate_gives_less_or_more(gain):
    poses = (Pose("black", (0.1, -0.05), np.radians(135)), Pose("black", None, np.radians(-90)))
    poser = Poser(task(*poses), RIG)
    seen = parts([[0.06, 0.0], [-0.1, 0.0]], [-2.0, 2.9])
    state, spin, drift = poser.begin(seen), np.zeros(2), np.zeros((2, 2))
    for _ in range(80):
        # What was asked acts in the cycle after the one that runs.
        ahead = seen.position + T * drift
        state, request = poser.request(state, seen, ahead, T)
        assert np.all(np.abs(state.spin) <= SPIN_MAX)
        assert np.all(np.hypot(*request.low.T) <= DRIFT_MAX * (1 + 1e-9))
        place, angle = seen.position + T * drift, seen.angle + T * spin
        seen = replace(seen, position=place, angle=angle)
        spin, drift = gain * state.spin, gain * request.low
    assert poser.count(state, seen) == 2
    distance, angle = poser.errors(state, seen)
    assert np.max(distance) < 0.1e-3
    assert np.max(np.abs(angle)) < np.radians(0.5)


def test_torque_is_what_changes_the_turning_within_a_cycle():
    poser = Poser(task(Pose("black", None, 1.0)), RIG)
    seen = parts([[0.0, 0.0]], [0.0])
    state, _ = poser.request(poser.begin(seen), seen, seen.position, T)
    inertia = RIG.parts.mass_kg * RIG.parts.radius_m**2 / 2
    assert poser.torque(state, seen, T) * T / inertia == pytest.approx(state.spin)


def test_a_part_that_was_to_stay_and_did_not_is_named():
    poser = Poser(task(Pose("black", None, 1.0)), RIG)
    state = poser.begin(parts([[0.0, 0.0]], [0.0]))
    assert poser.problem(state, parts([[0.0029, 0.0]], [0.0])) == ""
    text = poser.problem(state, parts([[0.004, 0.0]], [0.0]))
    assert text.startswith(
        "black_1 is 4.0 mm from where it was to turn, allowed: 3 mm (tolerance_m);"
    )
