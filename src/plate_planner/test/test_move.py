"""Moving: each part to its own target, the others stay; and targets changed while it runs."""

import re
from dataclasses import replace

import numpy as np
import pytest
from plant import RIG, Plant, T, ready, run, without

from plate_core import Parts, PlateError
from plate_core.tasks import MoveTask, PartTarget, Scenario, load_scenario
from plate_planner.planner import Planner
from plate_planner.supervision import Phase, Reason
from plate_planner.tasks import MoveMemory, Mover

SORT_4 = load_scenario("sort_4")
THERE = PartTarget("black_1", (0.1, 0.05))


def task(*targets, **changed):
    given = {"tolerance_m": 0.002, "tolerance_rad": 0.05, "hold_s": 0.5} | changed
    return MoveTask(targets, **given)


def scenario(*targets, limit=60.0, **changed) -> Scenario:
    return replace(SORT_4, name="move", task=task(*targets, **changed), time_limit_s=limit)


def endless(*targets) -> Planner:
    return Planner(RIG, scenario(*targets, limit=np.inf, until_canceled=True))


def parts(position, angle=None):
    return Parts.make(
        tuple(f"black_{k + 1}" for k in range(len(position))), np.array(position), angle=angle
    )


def test_a_part_moves_to_its_target_and_the_others_stay_or_clear_it():
    mover = Mover(task(THERE), RIG)
    near, far = ([x, 0.05] for x in (0.095, -0.2))
    for position, first in ((near, True), (far, False)):
        seen = parts([position, [0.01, -0.1]])
        remaining = mover.remaining(
            MoveMemory({"black_1": (0.0, 0.0), "black_2": (0.0, -0.1)}), seen
        )
        (target, *_), (home, *_) = mover.request(seen, remaining).weight
        assert (home < target) == first
    seen = parts([[0.0, 0.0], [0.01, -0.1]])
    memory = MoveMemory({"black_1": (0.0, 0.0), "black_2": (0.0, -0.1)})
    to = mover.request(seen, mover.remaining(memory, seen))
    assert (to.low + to.high)[0] / 2 == pytest.approx(THERE.place)
    assert (to.low + to.high)[1] / 2 == pytest.approx([0.0, -0.1])
    assert to.angles is None


def test_an_angle_is_requested_of_parts_that_have_one():
    turned = replace(THERE, angle=np.radians(-170))
    mover = Mover(task(turned), RIG)
    seen = parts([THERE.place, [0.0, 0.0]], np.radians([170.0, 40.0]))
    remaining = mover.remaining(MoveMemory({"black_1": (0, 0), "black_2": (0, 0)}), seen)
    assert np.degrees(remaining.missing) == pytest.approx([20.0, 0.0])
    angles = mover.request(seen, remaining).angles
    assert np.degrees(angles.low + angles.high)[0] / 2 == pytest.approx(190.0)
    assert list(angles.weight > 0) == [True, False]


def test_the_task_is_done_when_all_targets_are_reached():
    plant = Plant(SORT_4)
    planner = Planner(RIG, scenario(THERE, PartTarget("grey_2", (-0.1, 0.05))))
    _, _, progress = run(planner, plant)
    assert progress.phase is Phase.DONE
    assert ": 2 of 2 at their targets, " in progress.text
    assert np.hypot(*(plant.position[plant.ids.index("black_1")] - THERE.place)) < 0.002


def test_a_move_task_continues_until_it_is_canceled():
    plant, planner = Plant(SORT_4), endless(THERE)
    state, _, progress = run(planner, plant, cycles=400)
    assert (progress.phase, progress.parts_sorted) == (Phase.RUNNING, 1)
    assert progress.text.startswith("running: 1 of 1 at their targets, ")
    state = planner.start(state)
    held = plant.seen()
    for k in range(400, 400 + round(40 / T)):  # nothing moves for longer than stuck_timeout_s
        state, _, progress = planner.plan(state, replace(held, position=0.5 * held.position), k * T)
    assert progress.phase is Phase.RUNNING


def test_targets_are_replaced_in_mid_way_of_those_named_alone():
    plant, other = Plant(SORT_4), PartTarget("grey_2", (-0.1, 0.05))
    planner = Planner(RIG, scenario(THERE, other))
    state, _, _ = run(planner, plant, cycles=5)
    new = replace(THERE, place=(-0.1, -0.05))
    planner, state, refused = planner.retarget(state, [new])
    assert not refused
    assert planner.scenario.task.targets == (new, other)
    _, _, progress = run(planner, plant, t=5 * T, state=state)
    assert progress.phase is Phase.DONE
    assert np.hypot(*(plant.position[plant.ids.index("black_1")] - new.place)) < 0.002


def test_a_new_target_far_away_is_no_lack_of_progress():
    plant, planner = Plant(SORT_4), Planner(RIG, scenario(THERE, limit=1e4, hold_s=1e3))
    state, _, progress = run(planner, plant, cycles=500)
    assert progress.parts_sorted == 1
    planner, state, _ = planner.retarget(state, [replace(THERE, place=(0.25, 0.1))])
    state, _, progress = planner.plan(state, plant.seen(), 500 * T)
    assert progress.phase is Phase.RUNNING
    assert state.task.nearest_m == pytest.approx(progress.to_go_m)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (PartTarget("black_9", (0.0, 0.0)), "black_9 is unknown, allowed: black_1, black_2"),
        (PartTarget("x" * 5000, (0.0, 0.0)), "x is unknown"),
        (PartTarget("grey_1", (0.295, 0.0)), r"grey_1 is \(0.295, 0\) m, .* up to 0.2"),
        (PartTarget("nut_1", (0.0, 0.0)), "class of nut_1 is not in this task, .*black, grey"),
        (PartTarget("grey_1", (np.nan, 0.0)), r"grey_1 is \(nan, 0\) m"),
        (PartTarget("grey_1", (0.0, -np.inf)), r"grey_1 is \(0, -inf\) m"),
        (PartTarget("grey_1", (0.0, 0.0), 1.0), "angle of grey_1 is given, .*marked"),
        (PartTarget("grey_1", (0.0, 0.0), np.inf), "angle of grey_1 is inf, allowed: finite"),
    ],
)
def test_a_wrong_target_is_refused_and_the_others_count(target, words):
    plant, planner = Plant(SORT_4), endless()
    state, _, _ = run(planner, plant, cycles=3)
    state = replace(state, known=(*state.known, "nut_1"))
    planner, _, (text,) = planner.retarget(state, [target, THERE])
    assert re.search(words, text)
    assert len(text) < 300
    assert planner.scenario.task.targets == (THERE,)


def test_targets_are_refused_while_no_task_of_move_runs():
    plant = Plant(SORT_4)
    for planner in (Planner(RIG, SORT_4), endless()):
        state = planner.initial()
        with pytest.raises(PlateError, match="no task of kind move runs"):
            planner.retarget(state, [THERE])
    sorting = Planner(RIG, SORT_4)
    with pytest.raises(PlateError, match="no task of kind move runs"):
        sorting.retarget(ready(sorting, plant.seen()), [THERE])


@pytest.mark.parametrize("gone", ["black_1", "grey_2"])
def test_a_lost_part_ends_the_task_with_the_name_of_the_part(gone):
    plant, planner = Plant(SORT_4), endless(THERE)
    state, _, _ = run(planner, plant, cycles=3)
    for k in range(3, 25):
        state, _, progress = planner.plan(state, without(plant.seen(), gone), k * T)
    assert (progress.phase, state.task.reason) == (Phase.LOST, Reason.PART_UNSEEN)
    assert f"{gone} was last detected at (" in progress.text


def test_a_target_of_a_part_that_never_was_ends_it():
    planner = Planner(RIG, scenario(PartTarget("black_9", (0.0, 0.0))))
    state, _, progress = run(planner, Plant(SORT_4))
    assert (progress.phase, state.task.reason) == (Phase.LOST, Reason.PART_UNSEEN)
    assert "black_9 was not detected" in progress.text


def test_a_new_part_stays_where_it_is_seen_first():
    plant, planner = Plant(SORT_4), endless(THERE)
    state, _, _ = run(planner, plant, cycles=3)
    more = plant.seen()
    more = Parts.make((*more.ids, "grey_3"), np.vstack([more.position, [[0.2, -0.1]]]))
    state, request, progress = planner.plan(state, more, 3 * T)
    assert progress.phase is Phase.RUNNING
    row = request.parts.ids.index("grey_3")
    assert (request.targets.low + request.targets.high)[row] / 2 == pytest.approx([0.2, -0.1])
    state, _, progress = planner.plan(state, plant.seen(), 4 * T)
    assert progress.phase is Phase.RUNNING


def test_parts_on_a_target_are_reported():
    plant = Plant(SORT_4)
    where = tuple(plant.position[plant.ids.index("grey_2")])
    _, _, progress = run(endless(replace(THERE, place=where)), plant, cycles=3)
    assert progress.text.endswith("; grey_2 is on the target of black_1")
