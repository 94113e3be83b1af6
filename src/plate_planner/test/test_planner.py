"""The planner as a whole, with a plant that follows each request one cycle later."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from plant import RIG, Plant, T, ready, run, without
from shaking import shaking
from shown_text import says

from plate_core import Parts, PlateCycle, ScenarioError, part_class
from plate_core.tasks import Bin, Side, SortTask, load_scenario
from plate_planner import Planner, PlannerOptions
from plate_planner.supervision import Phase, Reason

SWING = np.outer(np.sin(np.linspace(0, np.pi, 16, endpoint=False)) ** 4, [1e-3, 0, 0])
"""Poses of a plate that shakes."""


@pytest.mark.parametrize("name", ["sort_4", "sort_6", "sort_8", "sort_10"])
def test_the_planner_sorts_parts(name):
    scenario = load_scenario(name)
    plant = Plant(scenario, seed=1, disturbance=2e-3)
    planner = Planner(RIG, scenario)
    _, request, progress = run(planner, plant)
    side = np.array([scenario.task.regions[part_class(i)].x for i in plant.ids])
    assert progress.phase == "done"
    assert progress.parts_sorted == progress.parts_total == scenario.count
    assert np.all(plant.position[:, 0] * side > 0.6 * RIG.plate.half[0])
    assert np.all(np.abs(plant.position) < 0.9 * RIG.plate.half)
    assert len(request.parts) == 0  # no part gets a request once the task is done


def test_sorted_parts_stay_sorted_while_others_are_on_their_way():
    scenario = load_scenario("sort_4")
    plant = Plant(scenario, seed=2, disturbance=3e-3)
    planner = Planner(RIG, scenario)
    state = ready(planner, plant.seen())
    best = 0
    for k in range(400):
        state, request, progress = planner.plan(state, plant.seen(), k * T)
        assert progress.parts_sorted >= best
        best = progress.parts_sorted
        plant.step(request)
    assert progress.phase == "done"


def test_the_hold_time_has_passed_when_it_is_done():
    scenario = load_scenario("sort_4")
    planner = Planner(RIG, scenario)
    x = np.array([[-0.2, -0.05], [-0.2, 0.05], [0.2, -0.05], [0.2, 0.05]])
    parts = Parts.make(("black_1", "black_2", "grey_1", "grey_2"), x)
    state = ready(planner, parts)
    phases = []
    for k in range(9):
        state, _, progress = planner.plan(state, parts, k * T)
        phases.append(progress.phase)
    assert phases == ["running"] * 7 + ["done"] * 2  # held for 0.5 s, and then seen at rest
    assert progress.time_s == pytest.approx(0.7)


@pytest.mark.parametrize("cycle_recorded", [False, True])
@pytest.mark.parametrize("falls", [None, 6, 7])
def test_a_part_that_falls_off_in_the_last_cycle_is_lost_and_the_task_not_done(
    cycle_recorded, falls
):
    """All are in their regions, one at the rim; the image with which they have been so for long
    enough still shows it, the next one or the one after does not."""
    planner = Planner(RIG, load_scenario("sort_4"), PlannerOptions(image_age_s=0.0))
    x = np.array([[-0.2, -0.05], [-0.2, 0.05], [0.2, -0.05], [0.299, 0.05]])
    parts = Parts.make(("black_1", "black_2", "grey_1", "grey_2"), x)
    state = ready(planner, parts)
    for k in range(30):
        seen = without(parts, "grey_2") if falls is not None and k >= falls else parts
        state, request, progress = planner.plan(state, seen, k * T)
        assert (len(request.parts) > 0) == (k < 5)  # after the hold time the plate must rest
        if progress.phase != "running":
            break
        if cycle_recorded:
            swing = PlateCycle.from_samples(T, SWING) if len(request.parts) else PlateCycle.rest(T)
            state = planner.record_cycle(state, swing, k * T + T / 2)
    if falls is None:
        assert (progress.phase, k) == ("done", 7)
    else:
        assert state.task.reason is Reason.PART_LEFT
        assert progress.text.startswith("lost part after ")
        assert "grey_2 left the plate at (0.299, 0.050) m" in progress.text


def test_a_lost_part_is_reported_at_its_last_detection_and_not_at_a_later_prediction():
    planner = Planner(RIG, load_scenario("sort_4"), PlannerOptions(image_age_s=0.0))
    x = np.array([[-0.2, -0.05], [-0.2, 0.05], [0.2, -0.05], [-0.1, 0.05]])
    parts = Parts.make(("black_1", "black_2", "grey_1", "grey_2"), x)
    state, cycle = ready(planner, parts), PlateCycle.from_samples(T, SWING)
    for k in range(40):
        seen = without(parts, "grey_2") if k >= 4 else parts
        state, _, progress = planner.plan(state, seen, k * T)
        state = planner.record_cycle(state, cycle, k * T + T / 2)
        if progress.phase != "running":
            break
    assert "grey_2 was last detected at (-0.100, 0.050) m, 0.3 s after" in progress.text


@pytest.mark.parametrize("seed", range(3))
def test_the_planner_assembles_parts(seed):
    scenario = load_scenario("assemble_8")
    plant = Plant(scenario, seed=seed, disturbance=1e-3)
    _, request, progress = run(Planner(RIG, scenario), plant)
    assert progress.phase == "done"
    assert progress.parts_sorted == 8
    assert progress.max_error_m <= scenario.task.tolerance_m
    position = np.array(scenario.task.place)
    distance = np.hypot(*(plant.position[:, None] - position[None]).transpose(2, 0, 1))
    nearest = np.argmin(distance, axis=1)
    assert sorted(nearest) == list(range(8))  # each place has one part, of its class
    assert [scenario.task.labels[k] for k in nearest] == [part_class(i) for i in plant.ids]
    assert np.max(np.min(distance, axis=1)) <= scenario.task.tolerance_m
    assert len(request.parts) == 0


def test_the_time_of_a_task_is_that_of_the_cycles_not_of_wrong_stamps():
    """Images of a camera that runs free, whose stamps jump back by 1000 s in mid-task."""
    scenario = load_scenario("sort_4")
    planner = Planner(RIG, scenario)
    x = np.array([[-0.05, -0.05], [-0.05, 0.05], [0.05, -0.05], [0.05, 0.05]])
    parts = Parts.make(("black_1", "black_2", "grey_1", "grey_2"), x)
    state = planner.start(planner.initial())
    for k in range(6):
        begin = 2000.0 + k * T
        state = planner.started(state, PlateCycle.rest(T), begin)
        state = planner.see(state, parts, begin + T / 2 - (1000.0 if k == 4 else 0.0))
        state, _, progress = planner.next_request(state)
        assert progress.time_s >= 0.0
    assert state.task.reason is Reason.NO_PARTS
    assert state.task.text.startswith("aborted after 0.1 s: no parts for 1000 s")


BINS = {
    "black": Bin(((-0.2, -0.12), (-0.08, -0.12), (-0.14, 0.02))),
    "grey": Bin(((0.05, 0.02), (0.15, 0.02), (0.15, 0.12), (0.05, 0.12))),
}


@pytest.mark.parametrize("seed", range(3))
def test_the_planner_sorts_parts_into_bins(seed):
    task = SortTask(BINS, goal_fraction=0.0, hold_s=0.5)
    scenario = replace(load_scenario("sort_8"), task=task)
    plant = Plant(scenario, seed=seed, disturbance=1e-3)
    _, _, progress = run(Planner(RIG, scenario), plant)
    assert (progress.phase, progress.parts_sorted) == ("done", 8)
    x, y = plant.position[[part_class(i) == "grey" for i in plant.ids]].T
    assert np.all((x > 0.05) & (x < 0.15) & (y > 0.02) & (y < 0.12))
    x, y = plant.position[[part_class(i) == "black" for i in plant.ids]].T
    height = 0.14 * (1 - np.abs(x + 0.14) / 0.06)
    assert np.all((y > -0.12) & (y < -0.12 + height))


def test_the_planner_sorts_parts_into_corners():
    corners = {"black": Side(-1, 1), "grey": Side(0, -1)}
    scenario = replace(load_scenario("sort_8"), task=SortTask(corners, 0.4, 0.5))
    plant = Plant(scenario, seed=4, disturbance=1e-3)
    _, _, progress = run(Planner(RIG, scenario), plant)
    assert progress.phase == "done"
    for part_id, (x, y) in zip(plant.ids, plant.position / RIG.plate.half, strict=True):
        assert (x < -0.4 and y > 0.4) if part_class(part_id) == "black" else y < -0.4


def test_idle_requests_nothing():
    scenario = load_scenario("sort_4")
    planner = Planner(RIG, scenario)
    _, request, progress = planner.plan(planner.initial(), Plant(scenario).seen(), 0.0)
    assert (len(request.parts), progress.phase, progress.parts_seen) == (0, "idle", 4)


def test_stop_aborts_and_start_restarts():
    scenario = load_scenario("sort_4")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, progress = run(planner, plant, cycles=20)
    assert progress.time_s == pytest.approx(1.9)
    state, request, progress = planner.plan(planner.stop(state), plant.seen(), 2.0)
    assert (len(request.parts), progress.text) == (0, "aborted after 1.9 s: stopped")
    state, request, progress = planner.plan(planner.start(state), plant.seen(), 2.1)
    assert (len(request.parts), progress.phase, progress.time_s) == (4, "running", 0.0)


@pytest.mark.parametrize("name", ["sort_4", "follow_2"])
def test_the_clock_waits_until_the_same_parts_are_seen_twice(name):
    scenario = load_scenario(name)
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state = planner.start(planner.initial())
    glare = replace(plant.seen(), ids=("black_9", *plant.ids[1:]))
    for t, parts in ((0.0, without(plant.seen(), "black_1")), (4.8, glare), (4.9, plant.seen())):
        state, request, progress = planner.plan(state, parts, t)
        assert (len(request.parts), progress.phase, progress.time_s) == (0, "running", 0.0)
    state, request, progress = planner.plan(state, plant.seen(), 5.0)
    assert (len(request.parts), progress.time_s) == (scenario.count, 0.0)
    state, request, progress = planner.plan(state, plant.seen(), 5.1)
    assert progress.time_s == pytest.approx(0.1)


def test_a_part_that_is_only_carried_on_is_not_seen_twice():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state = planner.start(planner.initial())
    for k in range(4):  # in the second and fourth image black_1 is where it should still be
        state = planner.record_cycle(state, PlateCycle.rest(T), (k - 1) * T)
        parts = without(plant.seen(), "black_1") if k % 2 else plant.seen()
        state, request, progress = planner.plan(state, parts, k * T)
        assert (progress.parts_seen, len(request.parts)) == (2, 0 if k < 2 else 2)


def test_parts_that_never_come_are_named():
    planner = Planner(RIG, load_scenario("sort_4"))
    state = planner.start(planner.initial())
    nobody = Parts.make((), np.zeros((0, 2)))
    for t in (0.0, 10.0, 10.1):
        state, request, progress = planner.plan(state, nobody, t)
        assert len(request.parts) == 0
    expected = "aborted: 2 of 2 black parts, 2 of 2 grey parts not detected within 10 s of"
    assert progress.text.startswith(expected)
    assert progress.text.endswith("detections_image")


def test_a_part_that_is_placed_on_the_plate_again_is_detected():
    planner = Planner(RIG, load_scenario("sort_4"))

    def seen(before, x, t):
        return planner._update_last_seen(before, Parts.make(("black_1",), np.array([[x, 0.0]])), t)

    off = seen({}, 0.31, 1.0)
    assert seen(off, 0.35, 2.0) == off  # where it left
    back = seen(off, 0.1, 3.0)["black_1"]
    assert (back.position, back.stamp) == ((0.1, 0.0), 3.0)
    state = replace(planner.initial(), last=off)
    assert planner.start(state).last == {}


@pytest.mark.parametrize("name", ["sort_4", "follow_2"])
@pytest.mark.parametrize("fallen", [False, True])
def test_a_lost_part_is_named_while_the_others_continue(name, fallen):
    scenario = load_scenario(name)
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=5)
    parts = plant.seen()
    if fallen:
        parts.position[parts.ids.index("black_2")] = [0.0, 0.151]
    else:
        parts = without(parts, "black_2")
    for k in range(5, 16):
        state, request, progress = planner.plan(state, parts, k * T)
        assert progress.phase == "running"
        assert set(request.parts.ids) == set(plant.ids) - {"black_2"}
    state, request, progress = planner.plan(state, parts, 16 * T)
    assert progress.text.startswith("lost part after 1.6 s: black_2 ")
    reported = (
        "left the plate at (0.000, 0.151) m, 0.5 s after" if fallen else "was last detected at ("
    )
    assert reported in progress.text
    assert len(request.parts) == 0


def test_without_parts_the_request_is_empty():
    scenario = load_scenario("sort_4")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=5)
    state, request, progress = planner.plan(state, Parts.make((), np.zeros((0, 2))), 5 * T)
    assert (len(request.parts), progress.phase, progress.parts_seen) == (0, "running", 0)


@pytest.mark.parametrize("name", ["sort_4", "follow_2"])
def test_a_part_of_an_unknown_class_is_free_and_does_not_count(name):
    scenario = load_scenario(name)
    plant, planner = Plant(scenario, seed=1), Planner(RIG, scenario)
    plant.ids += ("red_1",)
    plant.position = np.vstack([plant.position, [0.0, 0.0]])
    plant.drift = plant.coming = np.zeros_like(plant.position)
    _, request, progress = planner.plan(ready(planner, plant.seen()), plant.seen(), 0.0)
    assert progress.phase == "running"
    assert np.all(np.abs(request.forces.force[-1]) < 0.02 * RIG.force_unit)
    assert np.all(request.forces.tolerance[-1] > 0)
    _, _, progress = run(planner, plant)
    assert progress.phase == "done"


def test_the_same_image_again_gets_the_same_answer_and_changes_nothing():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=5)
    state, request, progress = planner.plan(state, plant.seen(), 5 * T)
    again_state, again, again_progress = planner.plan(state, plant.seen(), 5 * T)
    assert again_state is state
    assert again is request
    assert again_progress is progress


def test_the_same_image_again_after_a_stop_is_answered_by_rest():
    """The driver refuses the cycle of a task that has ended, and in lockstep the next image comes
    only after a cycle that it accepts."""
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=5)
    state, request, _ = planner.plan(state, plant.seen(), 5 * T)
    assert len(request.parts)
    stopped = planner.stop(state)
    again_state, again, _ = planner.plan(stopped, plant.seen(), 5 * T)
    assert again_state is stopped
    assert not len(again.parts)


def test_time_going_back_begins_a_running_task_again():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, progress = run(planner, plant, cycles=50, t=1000.0)
    assert progress.time_s == pytest.approx(4.9)
    fresh = Plant(scenario)
    state, request, progress = planner.plan(state, fresh.seen(), 0.0)
    assert (len(request.parts), progress.phase, progress.time_s) == (2, "running", 0.0)
    assert progress.period_s == pytest.approx(T)
    _, _, progress = run(planner, fresh, t=0.0, state=state)
    assert progress.phase == "done"
    assert progress.rms_error_m < 1e-9


def test_time_put_on_ends_a_running_task():
    scenario = load_scenario("follow_2")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    state, _, _ = run(planner, plant, cycles=50, t=1000.0)
    late, request, progress = planner.plan(state, plant.seen(), 1e9)
    assert (late.task.reason, len(request.parts)) == (Reason.NO_PARTS, 0)
    assert says(progress.text, "aborted after 4.9 s", "no parts for 999998995 s", "clock")
    _, _, progress = planner.plan(state, plant.seen(), state.estimator.stamp + 9.9)
    assert progress.phase is not Phase.ABORTED


def test_time_going_back_leaves_a_finished_task_finished():
    scenario = load_scenario("sort_4")
    planner = Planner(RIG, scenario)
    plant = Plant(scenario)
    state, _, _ = run(planner, plant, t=1000.0)
    state, request, progress = planner.plan(state, Plant(scenario).seen(), 0.0)
    assert (progress.phase, len(request.parts)) == ("done", 0)


def test_the_same_input_gives_the_same_output_to_the_last_bit():
    scenario = load_scenario("sort_10")
    results = []
    for _ in range(2):
        plant = Plant(scenario, seed=3, disturbance=2e-3)
        _, _, progress = run(Planner(RIG, scenario), plant)
        results.append((progress, plant.position.tobytes()))
    assert results[0] == results[1]


def test_the_time_limit_counts_from_when_all_parts_were_seen():
    scenario = replace(load_scenario("sort_4"), time_limit_s=2.0)
    plant = Plant(scenario)
    plant.answer = lambda asked: np.zeros((4, 2))
    _, _, progress = run(Planner(RIG, scenario), plant)
    assert progress.text.startswith("stuck after 2.1 s: time limit of 2 s; black_")
    assert "mm to go: its requested drift was (-" in progress.text
    assert (
        "its actual drift was (0.0, 0.0) mm/s; friction.mu or the motors may differ"
        in progress.text
    )
    assert progress.time_s == pytest.approx(2.1)


def test_forces_are_bounded_for_any_measured_drift():
    scenario = load_scenario("sort_4")
    plant, planner = Plant(scenario), Planner(RIG, scenario)
    parts = replace(plant.seen(), velocity=np.full((4, 2), 5.0))
    _, request, _ = planner.plan(ready(planner, parts), parts, 0.0)
    assert np.all(np.abs(request.forces.force) <= RIG.force_unit)


def test_a_scenario_that_does_not_fit_the_plate_is_refused_at_once():
    small = replace(RIG, plate=replace(RIG.plate, length_m=0.3))
    with pytest.raises(ScenarioError, match=r"\(-0.22, -0.06\) m, .*allowed: \|x\| up to 0.142"):
        Planner(small, load_scenario("follow_2"))


@pytest.mark.parametrize("error_m", [0.0, 0.002])
def test_near_targets_the_plate_rests_after_each_motion_if_predictions_are_wrong(error_m):
    """Parts are 6 to 8 mm from their places. A motion of the plate displaces all parts by an error
    that the planner does not predict. Cycles with motion and cycles at rest alternate."""
    scenario = load_scenario("assemble_8")
    planner, state = Planner(RIG, scenario, PlannerOptions(image_age_s=0.0)), None
    number = Counter()
    ids = [f"{label}_{number.update([label]) or number[label]}" for label in scenario.task.labels]
    position = np.array(scenario.task.place) + [0.0, 0.006]
    rests = {True: [], False: []}
    for k in range(24):
        moves = k % 2 == 1
        if not moves:  # the cycle that has ended was a motion
            position = position + [0.0, error_m * (1 - k % 4)]
        parts = Parts.make(tuple(ids), position)
        state = ready(planner, parts) if state is None else state
        state = planner.started(state, shaking(1e-5) if moves else PlateCycle.rest(T), k * T, True)
        state, request, progress = planner.plan(state, parts, k * T)
        assert progress.phase == "running"
        rests[moves].append(len(request.parts) == 0)
    assert rests[True][8:] == [error_m > 0] * 4
    assert not any(rests[False])
