"""A hopper that drops parts, and a robot that takes them."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import MAX_PARTS, Parts, PlateCycle, PlateError, load_rig, part_class
from plate_core.tasks import MAX_OPEN_S, free_gap, load_scenario
from plate_sim import Disturbances, Move, Simulation
from plate_sim.world import NONE
from plate_sim.world.hopper import Flow
from plate_sim.world.robot import GRIP_REACH_M, NUDGE_M, NUDGE_RAD

DISCS, SHAPES = load_rig(), load_rig("shapes")
REST = PlateCycle.rest(0.1)
SLOPE = 0.3
"""A plate that leans so far holds no part [rad]: the tangent of 0.25 is friction's."""


def world(scenario="feed", seed=3, disturbances=NONE, parts=True, noise=2.0, **hopper):
    """A simulation of a feeder; without parts on the plate; with another hopper."""
    task = load_scenario(scenario)
    if hopper:
        feed = replace(task.task, hopper=replace(task.task.hopper, **hopper))
        task = replace(task, task=feed)
    if not parts:
        task = replace(task, parts=tuple(replace(group, count=0) for group in task.parts))
    rig = load_rig(task.rig) if task.rig else DISCS
    return Simulation(rig, task, seed, disturbances, noise=noise)


def shaking(period=0.1):
    t = 2 * np.pi * np.arange(64) / 64
    pose = np.column_stack([4e-3 * np.sin(t), 3e-3 * np.sin(2 * t), 0.02 * np.sin(t)])
    return PlateCycle.from_samples(period, pose)


def lying(simulation):
    """The parts on the plate."""
    state, here = simulation.state, np.flatnonzero(simulation.state.on_plate)
    ids = tuple(state.ids[i] for i in here)
    return Parts.make(ids, state.position[here], angle=state.angle[here])


def run(simulation, count, cycle=REST):
    for _ in range(count):
        simulation.run(cycle)


# The hopper


@pytest.mark.parametrize("scenario", ["feed", "feed_bars", "feed_nuts"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_heap_is_dense_and_its_parts_do_not_overlap(scenario, seed):
    rig = DISCS if scenario == "feed" else SHAPES
    simulation = world(scenario, seed, parts=False)
    hopper = load_scenario(scenario).task.hopper
    assert simulation.open_hopper(3.0) == 30
    run(simulation, 31)
    parts = lying(simulation)
    assert len(parts) == 30
    gap = free_gap(parts, rig)
    assert np.all(gap > 0)
    assert np.count_nonzero(gap < 1e-5) > 10  # they touch
    reach = np.array([rig.part_type(part_class(name)).reach_m for name in parts.ids])
    assert np.all(np.abs(parts.position) <= rig.plate.half - reach[:, None])
    # Pushed out of the spread, but not far: they cover a third of a disc of twice its radius.
    far = np.hypot(*(parts.position - hopper.place).T)
    assert np.mean(far < 2 * hopper.spread_m) > 0.9
    assert len(set(parts.angle)) == 30
    run(simulation, 3, shaking())  # an overlap would be refused


def test_dropped_parts_lie_within_the_spread_of_the_hopper():
    position = []
    for seed in range(60):
        simulation = world(seed=seed, parts=False)
        simulation.open_hopper(0.1)
        run(simulation, 1)
        position.append(simulation.state.position[0])
    hopper = load_scenario("feed").task.hopper
    far = np.hypot(*(np.array(position) - hopper.place).T) / hopper.spread_m
    assert np.all(far <= 1)
    # Evenly over a disc the square of the distance is even from 0 to 1: within 4 standard errors
    assert np.mean(far**2) == pytest.approx(0.5, abs=4 / np.sqrt(12 * 60))


def test_parts_drop_at_the_rate_while_it_is_open():
    simulation = world(rate=8.0)
    begin = len(simulation.state.ids)
    run(simulation, 5)
    assert simulation.open_hopper(1.0) == 8
    time, open_s = 0.0, 1.0
    for period in (0.07, 0.13, 0.2, 0.05, 0.31, 0.11, 0.2, 0.3, 0.4):
        simulation.run(PlateCycle.rest(period))
        time += period
        count = len(simulation.state.ids) - begin
        assert count == int(8 * min(time, open_s) + 1e-9)
    assert count == 8
    # The time already waited counts, and a further call replaces the remaining time.
    assert simulation.open_hopper(0.1) == 0
    simulation.run(REST)
    assert simulation.open_hopper(10.0) == 80
    simulation.run(PlateCycle.rest(0.03))
    assert len(simulation.state.ids) - begin == 9
    assert simulation.open_hopper(0.0) == 0
    run(simulation, 10)
    assert len(simulation.state.ids) - begin == 9


def test_times_of_drops_do_not_depend_on_how_time_is_cut():
    whole, times = Flow(2.0, 0.02).after(3.0, 7.0)
    assert times == pytest.approx(np.arange(1, 15) / 7 - 0.02)
    flow, found, time = Flow(2.0, 0.02), [], 0.0
    for step in np.random.default_rng(0).uniform(0, 0.2, 60):
        flow, drops = flow.after(step, 7.0)
        found += [time + drop for drop in drops]
        time += step
    assert found == pytest.approx(times)
    assert (flow.left_s, flow.waited_s) == pytest.approx((whole.left_s, whole.waited_s))


def test_a_part_dropped_during_a_cycle_moves_and_does_not_change_the_other_motions():
    period, seed = 0.1, 4
    alone, fed = (world(seed=seed, rate=10 / 0.7) for _ in range(2))
    fed.open_hopper(0.08)  # at 0.07 s
    alone.run(shaking(period))
    fed.run(shaking(period))
    count = len(alone.state.ids)
    assert fed.state.position[:count] == pytest.approx(alone.state.position, abs=2e-6)
    assert len(fed.state.ids) == count + 1
    early = world(seed=seed, rate=10 / 0.7)
    early.open_hopper(0.08)
    early.run(PlateCycle.rest(0.07))
    landed, moved = early.state.position[-1], fed.state.position[-1]
    assert 1e-6 < np.hypot(*(moved - landed)) < 0.01


def test_classes_come_as_the_mix_has_it_and_each_by_its_own_chance():
    labels = []
    for seed in range(10):
        simulation = world(seed=seed, parts=False, spread_m=0.12, place=(0.0, 0.0))
        simulation.open_hopper(4.0)
        run(simulation, 41)
        labels.append([part_class(name) for name in simulation.state.ids])
        other = world(seed=seed, rate=4.0, disturbances=Disturbances(missed_parts=0.5))
        other.open_hopper(3.0)
        run(other, 31)
        assert [part_class(name) for name in other.state.ids[10:]] == labels[-1][:12]
    fraction = np.mean(np.concatenate(labels) == "grey")
    assert fraction == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / 400))
    assert labels[0] != labels[1]


def fed_run(seed, **options):
    simulation = world(seed=seed, disturbances=Disturbances(pick_failure=0.3), **options)
    simulation.open_hopper(1.0)
    images = []
    for k in range(12):
        simulation.run(shaking())
        images.append(simulation.capture())
        simulation.move_robot(Move.GRIP, *simulation.state.position[k % 3])
    return simulation.state, np.array(images)


def test_a_seed_is_repeated_to_the_last_bit():
    (state, images), (again, images_again) = fed_run(5), fed_run(5)
    assert state.ids == again.ids
    assert np.array_equal(state.position, again.position)
    assert np.array_equal(images, images_again)
    assert not np.array_equal(state.position[-1], fed_run(6)[0].position[-1])


def test_friction_of_new_parts_differs_as_that_of_others_does():
    simulation = world(disturbances=Disturbances(friction_spread=0.4), parts=False)
    simulation.open_hopper(4.0)
    run(simulation, 41)
    mu = simulation.mu / DISCS.friction.mu
    assert np.all(np.abs(mu - 1) <= 0.4)
    assert np.std(mu) == pytest.approx(0.4 / np.sqrt(3), rel=0.3)


def test_no_number_is_used_twice():
    simulation = world(parts=False, mix={"black": 1.0})
    seen = []
    for _ in range(6):
        simulation.open_hopper(0.2)
        run(simulation, 3)
        seen += [simulation.place("", "black", np.array([0.2, 0.0]))]
        seen += [name for name in simulation.state.ids if name not in seen]
        for name in simulation.state.ids[:-1]:
            row = simulation.state.ids.index(name)
            assert simulation.move_robot(Move.GRIP, *simulation.state.position[row]).id == name
        simulation.run(REST)
        simulation.remove(simulation.state.ids[-1])
        assert not simulation.state.ids
    assert len(seen) == 18
    assert set(seen) == {f"black_{k}" for k in range(1, 19)}


def test_parts_for_which_there_is_no_room_stay_in_the_hopper():
    simulation = world(rate=50.0, place=(0.0, 0.0))
    simulation.open_hopper(5.0)
    run(simulation, 40)
    assert np.count_nonzero(simulation.state.on_plate) == MAX_PARTS
    with pytest.raises(PlateError, match="100 parts are on the plate, allowed: fewer than 100"):
        simulation.open_hopper(0.1)
    simulation.open_hopper(0.0)
    assert simulation.move_robot(Move.GRIP, *simulation.state.position[0]).success
    simulation.open_hopper(0.1)
    simulation.run(REST)
    assert np.count_nonzero(simulation.state.on_plate) == MAX_PARTS


@pytest.mark.parametrize("duration", [-0.1, np.nan, np.inf, MAX_OPEN_S + 0.1])
def test_a_hopper_is_opened_for_a_time_that_makes_sense(duration):
    simulation = world()
    with pytest.raises(PlateError, match=r"duration is .* s, allowed: 0 .* to 60 s"):
        simulation.open_hopper(duration)
    run(simulation, 3)
    assert len(simulation.state.ids) == 10


def test_a_hopper_can_be_opened_only_if_the_scenario_has_one():
    feed = load_scenario("feed")
    shut = replace(feed, task=replace(feed.task, hopper=None))
    for scenario in (load_scenario("sort_4"), shut):
        with pytest.raises(PlateError, match="this scenario has no hopper, required: "):
            Simulation(DISCS, scenario).open_hopper(1.0)


# The robot


@pytest.mark.parametrize("scenario", ["feed", "feed_bars"])
def test_the_robot_hides_what_is_below_it_and_nothing_else(scenario):
    simulation = world(scenario, noise=0.0)
    before = simulation.capture().astype(float)
    position = simulation.state.position[0]
    assert simulation.move_robot(Move.OVER, *position).success
    over = simulation.capture().astype(float)
    assert over.shape == before.shape
    changed = np.abs(over - before).reshape(*over.shape[:2], -1).max(axis=2) > 1
    places = simulation._view._camera._places - position
    arm = (np.abs(places[..., 0]) < 0.029) & (places[..., 1] > 0)
    # In the image of the arm, only pixels with its grey value are unchanged.
    assert np.mean(changed[arm]) > 0.99
    beyond = (np.abs(places[..., 0]) > 0.031) | (places[..., 1] < -0.031)
    assert not changed[beyond].any()
    row, column = np.argwhere(np.hypot(*places.transpose(2, 0, 1)) < 0.015).mean(axis=0).astype(int)
    assert np.ptp(over[row - 8 : row + 9, column - 8 : column + 9], axis=(0, 1)).max() < 3
    assert simulation.move_robot(Move.AWAY, np.nan).success
    assert np.array_equal(simulation.capture(), before)


def test_the_image_of_the_robot_contains_noise():
    simulation = world(noise=3.0)
    simulation.move_robot(Move.OVER, 0.1, 0.0)
    places = simulation._view._camera._places - [0.1, 0.0]
    head = np.hypot(*places.transpose(2, 0, 1)) < 0.015
    assert np.std(simulation.capture()[head].astype(float)) == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize(("scenario", "symmetry"), [("feed_bars", 2), ("feed_nuts", 6)])
def test_errors_of_a_grip_are_true_but_for_symmetry(scenario, symmetry):
    rng = np.random.default_rng(2)
    simulation = world(scenario)
    for name in simulation.state.ids:
        row = simulation.state.ids.index(name)
        position, angle = simulation.state.position[row], simulation.state.angle[row]
        way = rng.normal(size=2)
        way *= 0.9 * GRIP_REACH_M * rng.random() / np.hypot(*way)
        error = rng.uniform(-1, 1) * np.pi / symmetry
        turns = rng.integers(-3, 4) * 2 * np.pi / symmetry
        grip = simulation.move_robot(Move.GRIP, *(position + way), angle - error + turns)
        assert (grip.success, grip.id) == (True, name)
        assert grip.error_m == pytest.approx(np.hypot(*way))
        assert grip.error_rad == pytest.approx(error)
        assert not simulation.state.on_plate[row]
        simulation.run(REST)
        assert name not in simulation.state.ids
    grip = simulation.move_robot(Move.GRIP, 0.0, 0.0)
    assert (grip.success, grip.id, grip.error_m) == (False, "", np.inf)
    assert (simulation.dropped, simulation.discharged) == (0, 0)


def test_round_parts_have_an_angle_only_if_they_are_marked():
    for marked in (False, True):
        simulation = Simulation(DISCS, replace(load_scenario("sort_4"), marked=marked))
        angle = 0.4
        simulation.state = replace(simulation.state, angle=np.full(4, angle))
        grip = simulation.move_robot(Move.GRIP, *simulation.state.position[1], angle - 0.3)
        assert grip.error_rad == pytest.approx(0.3 if marked else 0.0)


def test_a_grip_that_misses_all_parts_takes_none_and_reports_this():
    simulation = world()
    position = simulation.state.position[4]
    before = simulation.state
    grip = simulation.move_robot(Move.GRIP, *(position + [0.0, 1.004 * GRIP_REACH_M]))
    assert (grip.success, grip.id) == (False, "")
    assert grip.error_m == pytest.approx(1.004 * GRIP_REACH_M)
    assert "no part within 5 mm of" in grip.message
    assert "the nearest is 5.0 mm away" in grip.message
    assert simulation.state is before


def test_a_neighbour_in_the_jaws_is_reported():
    simulation, position = world(parts=False), np.array([0.1, 0.0])
    for x in (0.0, 0.018, 0.06):
        simulation.place("", "black", position + [x, 0.0])
    grip = simulation.move_robot(Move.GRIP, *position)
    assert grip.message == "black_1 is taken, another is 2.0 mm beside it"
    grip = simulation.move_robot(Move.GRIP, *(position + [0.018, 0.0]))
    assert grip.message == "black_2 is taken"


def test_grips_fail_at_the_requested_rate_and_move_the_part_a_little():
    fraction, count, slipped = 0.3, 0, 0
    for seed in range(16):
        simulation = world("feed_bars", seed, Disturbances(pick_failure=fraction))
        for name in simulation.state.ids:
            row = simulation.state.ids.index(name)
            position, angle = simulation.state.position[row], simulation.state.angle[row]
            grip = simulation.move_robot(Move.GRIP, *position, angle)
            assert grip.id == name
            assert grip.success != simulation.state.on_plate[row]
            assert grip.message.startswith(f"{name} {'is taken' if grip.success else 'slipped'}")
            count, slipped = count + 1, slipped + (not grip.success)
            moved = np.hypot(*(simulation.state.position[row] - position))
            turned = abs(simulation.state.angle[row] - angle)
            assert moved <= NUDGE_M
            assert turned <= NUDGE_RAD
            assert (moved > 0) == (not grip.success)
    assert slipped / count == pytest.approx(
        fraction, abs=4 * np.sqrt(fraction * (1 - fraction) / count)
    )


def test_a_part_that_slips_from_the_gripper_does_not_overlap_others():
    simulation = world(parts=False, seed=1, disturbances=Disturbances(pick_failure=1.0))
    simulation.open_hopper(3.0)
    run(simulation, 31)
    before = simulation.state.position
    for position in before:
        assert not simulation.move_robot(Move.GRIP, *position).success
    assert np.all(free_gap(lying(simulation), DISCS) > 0)
    assert np.count_nonzero(np.any(simulation.state.position != before, axis=1)) > 3
    run(simulation, 2)


def test_the_rate_of_failures_may_change_meanwhile():
    simulation = world(disturbances=Disturbances(pick_failure=1.0))
    position = simulation.state.position[0]
    assert not simulation.move_robot(Move.GRIP, *position).success
    simulation.change(NONE, 2.0, 1.0)
    assert simulation.move_robot(Move.GRIP, *simulation.state.position[0]).success


@pytest.mark.parametrize(
    ("move", "words"),
    [
        ((3, 0.0, 0.0), r"to is 3, allowed: 0 \(away\), 1 \(over\), 2 \(grip\)"),
        ((1, 0.31, 0.0), r"gripper is at \(0\.31, 0\) m, allowed: \|x\| up to 0\.3, \|y\| up to"),
        ((2, 0.0, np.nan), r"gripper is at \(0, nan\) m"),
        ((2, 0.0, 0.0, np.inf), "angle is inf, allowed: finite"),
    ],
)
def test_impossible_robot_moves_are_refused(move, words):
    simulation = world(noise=0.0)
    before, image = simulation.state, simulation.capture()
    with pytest.raises(PlateError, match=words):
        simulation.move_robot(*move)
    assert simulation.state is before
    assert np.array_equal(simulation.capture(), image)


# Parts that have left the plate


def dark(image, simulation, position):
    """Whether an image shows a black part at a place."""
    near = np.hypot(*(simulation._view._camera._places - position).transpose(2, 0, 1)) < 0.005
    return np.mean(image[near]) < 80


def test_late_images_show_parts_and_robot_as_they_were():
    late = Disturbances(latency=0.15)
    simulation = world(disturbances=late, parts=False, mix={"black": 1.0})
    position = np.array([0.1, 0.0])
    simulation.place("", "black", position)
    run(simulation, 3)
    assert dark(simulation.capture(), simulation, position)
    simulation.move_robot(Move.GRIP, *position)
    simulation.move_robot(Move.AWAY)
    simulation.open_hopper(0.1)
    shown = []
    for _ in range(3):
        simulation.run(REST)
        image = simulation.capture()
        new = simulation.state.position[simulation.state.ids.index("black_2")]
        shown.append((dark(image, simulation, position), dark(image, simulation, new)))
    # It was taken at 0 s, and the other one dropped at 0.1 s.
    assert shown == [(True, False), (False, False), (False, True)]
    simulation.move_robot(Move.OVER, *position)
    still = []
    for _ in range(3):
        image = simulation.capture().astype(float)
        simulation.run(REST)
        near = np.hypot(*(simulation._view._camera._places - position).transpose(2, 0, 1)) < 0.015
        still.append(np.mean(image[near]) > 150)  # the plate, not the gripper
    assert still == [True, True, False]


@pytest.mark.parametrize("readout", [0.0, 0.02])
def test_the_next_image_shows_what_came_and_what_was_taken(readout):
    rig = replace(DISCS, camera=replace(DISCS.camera, readout_s=readout))
    task = load_scenario("feed")
    feed = replace(task.task, hopper=replace(task.task.hopper, mix={"black": 1.0}))
    simulation = Simulation(rig, replace(task, task=feed))
    position = simulation.state.position[0]
    simulation.open_hopper(0.1)
    simulation.run(REST)
    simulation.move_robot(Move.GRIP, *position)
    simulation.move_robot(Move.AWAY)
    image = simulation.capture()
    assert not dark(image, simulation, position)
    assert dark(image, simulation, simulation.state.position[-1])


@pytest.mark.parametrize(
    ("lean", "ends"),
    [
        ({"tilt_x": SLOPE}, "discharged"),
        ({"tilt_x": -SLOPE}, "dropped"),
        ({"tilt_y": SLOPE}, "dropped"),
    ],
)
def test_parts_over_the_chute_are_not_taken_for_lost(lean, ends):
    """The chute of `feed` is on the right."""
    simulation = world(disturbances=Disturbances(**lean), parts=False)
    simulation.open_hopper(0.5)
    run(simulation, 60)
    assert not simulation.state.ids  # forgotten
    simulation.place("", "black", np.array([-0.2, -0.1]))
    run(simulation, 30)
    counts = {"discharged": simulation.discharged, "dropped": simulation.dropped}
    assert counts.pop(ends) == 6
    assert counts.popitem()[1] == 0
    assert simulation.discharged_classes.total() == simulation.discharged
    assert (simulation.discharged_classes["black"] > 0) == (ends == "discharged")


def test_other_scenarios_keep_what_has_left_the_plate():
    lean = Disturbances(tilt_x=-SLOPE)
    simulation = Simulation(DISCS, load_scenario("sort_4"), 0, lean)
    taken = simulation.move_robot(Move.GRIP, *simulation.state.position[0])
    run(simulation, 40)
    assert len(simulation.state.ids) == 3
    assert (simulation.dropped, simulation.state.dropped, simulation.discharged) == (3, 3, 0)
    with pytest.raises(PlateError, match="id is"):
        simulation.place(taken.id, "", np.zeros(2))
    simulation.place(simulation.state.ids[0], "", np.zeros(2))
    assert simulation.dropped == 2


def test_a_taken_part_that_is_placed_again_counts_as_on_the_plate():
    simulation = Simulation(DISCS, load_scenario("sort_4"), 0, Disturbances(tilt_x=-SLOPE))
    taken = simulation.move_robot(Move.GRIP, *simulation.state.position[0])
    simulation.place(taken.id, "", np.zeros(2))
    run(simulation, 40)
    assert simulation.dropped == 4


@pytest.mark.parametrize("world_of", [NONE, Disturbances(latency=0.12, pick_failure=0.2)])
def test_a_long_production_stays_as_small_as_it_was(world_of):
    simulation = world(disturbances=world_of, seed=7)
    rng, taken, made = np.random.default_rng(0), 0, set(simulation.state.ids)
    rows = []
    for k in range(300):
        here = np.flatnonzero(simulation.state.on_plate)
        if k % 2 == 0 and len(here) > 8:
            position = simulation.state.position[rng.choice(here)]
            taken += simulation.move_robot(Move.GRIP, *position).success
        elif k % 2:
            simulation.move_robot(Move.AWAY)
        if len(here) < 12:
            simulation.open_hopper(0.3)
        simulation.run(REST)
        made |= set(simulation.state.ids)
        rows.append(len(simulation.state.ids))
        sizes = (
            len(simulation._view.history.passages),
            len(simulation._robot.stations),
            len(simulation._robot.taken),
        )
        assert max(sizes) <= 4
        assert len(simulation.mu) == rows[-1]
    assert taken > 75
    assert max(rows[100:]) <= max(rows[:100]) <= 20
    gone = taken + simulation.dropped + simulation.discharged
    assert len(made) == gone + np.count_nonzero(simulation.state.on_plate)
    numbers = sorted(int(name.split("_")[1]) for name in made if part_class(name) == "black")
    assert numbers == list(range(1, len(numbers) + 1))
