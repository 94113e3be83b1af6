"""Following paths, against a plant that does what it is asked one cycle later."""

import numpy as np
import pytest
from plant import RIG, Plant, T, run

from plate_core import Parts
from plate_core.tasks import load_scenario
from plate_planner import FollowOptions, Planner, PlannerOptions
from plate_planner.following import Follower


@pytest.mark.parametrize("shuffle", [False, True])
def test_it_follows_the_papers_rectangles(shuffle):
    scenario = load_scenario("follow_2")
    plant = Plant(scenario, shuffle=shuffle, seed=5)
    _, _, progress = run(Planner(RIG, scenario), plant)
    assert progress.text == "done"
    assert progress.time_s == pytest.approx(0.56 / 0.04 + T, abs=T)
    assert progress.rms_error_m < 1e-12  # a plant without error can be followed without error


def test_it_follows_in_spite_of_disturbances():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario, disturbance=1e-3)
    options = PlannerOptions(follow=FollowOptions(kp=0.3))
    _, _, progress = run(Planner(RIG, scenario, options), plant)
    assert progress.text == "done"
    assert progress.rms_error_m < 1e-3
    assert progress.max_error_m < 3e-3


def test_following_corrects_an_offset_at_the_start():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.position += [0.02, -0.01]
    planner = Planner(RIG, scenario)
    state, _, progress = run(planner, plant, cycles=100)
    reference = Follower(scenario.task, RIG).reference(state.follow, 100 * T)
    assert progress.phase == "running"
    assert np.max(np.abs(plant.position - reference)) < 1e-3


def test_references_wait_for_a_part_that_stays_behind_and_then_it_is_stuck():
    scenario = load_scenario("follow_2")
    plant = Plant(scenario)
    plant.answer = lambda asked: np.zeros((2, 2))
    _, asked, progress = run(Planner(RIG, scenario), plant)
    assert progress.pace == 0
    assert 0.0045 < progress.max_error_m <= 0.5 * scenario.task.max_error_m + 1e-3
    assert progress.text.startswith("stuck after ")
    assert "no nearer to the goal for 30 s; black_" in progress.text
    assert "asked for (" in progress.text
    assert len(asked.parts) == 0


def test_a_part_pushed_far_off_its_path_ends_the_task():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=50)
    plant.position[1] += [0.0, 0.04]
    _, asked, progress = planner.plan(state, plant.seen(), 5.0)
    assert progress.text == "stuck after 5.0 s: black_2 is 40.0 mm off its path, allowed: 30 mm"
    assert len(asked.parts) == 0


class Weak(Plant):
    """A plant on which parts get a share of the drift that is asked of them, up to a bound."""

    share, bound = 1.0, np.inf

    def answer(self, asked):
        drift = self.share * super().answer(asked)
        return np.clip(drift, -self.bound, self.bound)


def test_the_observer_takes_away_what_friction_costs():
    errors = {}
    for gain in (0.0, 0.7):
        plant = Weak(load_scenario("follow_2"))
        plant.share = 0.8
        options = PlannerOptions(follow=FollowOptions(observer_gain=gain))
        planner = Planner(RIG, plant.scenario, options)
        state, _, _ = run(planner, plant, cycles=240)
        follower = Follower(plant.scenario.task, RIG)
        errors[gain] = np.max(follower.errors(state.follow, plant.seen(), 240 * T))
    # Without: (1/0.8 - 1) v (1 + 1/kp) T, as in test_pd, of which 0.8 arrives. With: none is left.
    assert errors[0.0] > 0.8e-3
    assert errors[0.7] < 0.02 * errors[0.0]


def test_it_slows_down_instead_of_failing_when_the_plate_cannot_give_so_much():
    plant = Weak(load_scenario("follow_2"))
    plant.bound = 0.014  # of the 40 mm/s that the paths are run at
    _, _, progress = run(Planner(RIG, plant.scenario), plant)
    assert progress.text == "done"
    assert 0.9 < progress.time_s / (0.56 / 0.014) < 1.1
    assert progress.max_error_m < 0.016


@pytest.mark.parametrize(("share", "paces"), [(0.05, (1.0, 1.0)), (0.2, (0.7, 0.49))])
def test_references_slow_down_as_soon_as_a_cycle_lacks_what_was_asked(share, paces):
    scenario = load_scenario("follow_2")
    plant, follower = Plant(scenario), Follower(scenario.task, RIG)
    state = follower.begin(plant.seen(), 0.0)
    short = np.array([share * 0.04, 0.0])
    for k, pace in enumerate(paces):
        seen = Parts.make(plant.ids, follower.reference(state, k * T))  # no error at all as yet
        state = follower.measure(state, seen, k * T, (k + 1) * T, short, FollowOptions())
        assert state.paces[1] == pytest.approx(pace)
    for k in range(2, 12):
        seen = Parts.make(plant.ids, follower.reference(state, k * T))
        state = follower.measure(state, seen, k * T, (k + 1) * T, 0 * short, FollowOptions())
    assert state.paces[1] == 1.0


def test_a_part_back_under_a_new_number_is_followed_on():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=20)
    plant.ids = ("black_1", "black_9")
    _, _, progress = run(planner, plant, t=20 * T, state=state)
    assert progress.text == "done"
    assert progress.max_error_m < 1e-3
