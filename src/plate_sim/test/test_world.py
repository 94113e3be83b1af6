"""States and steps: pure, repeatable, and parts that leave the plate are removed."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import to_home
from plate_core.tasks import load_scenario
from plate_sim import WorldState, record_cycle, run_cycle

RIG = load_rig()
HALF = RIG.plate.half


def shaking():
    rng = np.random.default_rng(2)
    return PlateCycle.from_samples(0.1, 1e-3 * rng.normal(size=(12, 3)) * [1, 1, 4])


def test_a_part_that_slides_off_is_removed_and_counted():
    state = WorldState.at_rest(("black_1", "grey_1"), [[HALF[0] - 0.01, 0], [0, 0]])
    state = replace(state, velocity=np.array([[0.5, 0], [0, 0]]))
    end = run_cycle(state, PlateCycle.rest(0.1), RIG)
    assert end.on_plate.tolist() == [False, True]
    assert end.dropped == 1
    assert end.position[0] == pytest.approx([HALF[0], 0], abs=1e-4)
    assert np.all(end.velocity == 0)
    later = run_cycle(end, shaking(), RIG)
    assert np.array_equal(later.position[0], end.position[0])
    assert not np.array_equal(later.position[1], end.position[1])


def test_a_lost_part_is_no_obstacle():
    state = WorldState.at_rest(("black_1", "black_2"), [[0, 0], [0.03, 0]])
    state = replace(state, velocity=np.array([[0.5, 0], [0, 0]]), on_plate=np.array([True, False]))
    end = run_cycle(state, PlateCycle.rest(0.1), RIG, mu=0.0)
    assert end.position[0] == pytest.approx([0.05, 0])


@pytest.mark.parametrize("epsilon", [1e-6, -1e-6])
def test_the_edge_is_that_of_the_moved_plate(epsilon):
    still = np.zeros((8, 3))
    pose = np.tile([0.004, -0.003, 0.02], (8, 1))
    cycle = PlateCycle.from_samples(0.01, pose, still, still)
    corner = to_home(pose[0], np.array([HALF - [epsilon, epsilon]]))
    end = run_cycle(WorldState.at_rest(("black_1",), corner), cycle, RIG)
    assert end.dropped == (epsilon < 0)


def test_a_step_is_pure_and_repeatable():
    start = WorldState.of_scenario(load_scenario("sort_10"), RIG, np.random.default_rng(0))
    copy = start.position.copy()
    first, second = (run_cycle(start, shaking(), RIG) for _ in range(2))
    assert np.array_equal(start.position, copy)
    assert np.array_equal(first.position, second.position)
    assert np.array_equal(first.velocity, second.velocity)
    recorded, run = record_cycle(start, shaking(), RIG)
    assert np.array_equal(recorded.position, first.position)
    assert np.array_equal(run.position[-1], first.position)
    assert np.array_equal(run.position[0], start.position)
    assert run.time[-1] == pytest.approx(0.1)


def test_friction_can_differ_from_the_rigs():
    start = WorldState.at_rest(("black_1",), [[0, 0]])
    start = replace(start, velocity=np.array([[0.2, 0]]))
    end = run_cycle(start, PlateCycle.rest(0.5), RIG, mu=0.1)
    assert end.position[0, 0] == pytest.approx(0.2**2 / (2 * 0.1 * RIG.friction.gravity))


def test_a_scenario_gives_the_parts():
    state = WorldState.of_scenario(load_scenario("sort_4"), RIG, np.random.default_rng(7))
    assert state.ids == ("black_1", "black_2", "grey_1", "grey_2")
    assert np.all(np.abs(state.position) < HALF)
    assert np.all(state.on_plate)
    again = WorldState.of_scenario(load_scenario("sort_4"), RIG, np.random.default_rng(7))
    assert np.array_equal(state.position, again.position)


def test_an_empty_plate_is_a_state_too():
    end, run = record_cycle(WorldState.at_rest((), np.zeros((0, 2))), shaking(), RIG)
    assert end.dropped == 0
    assert run.position.shape[1:] == (0, 2)


def test_names_and_places_must_agree():
    with pytest.raises(PlateError, match="position has shape"):
        WorldState.at_rest(("black_1",), [[0, 0], [0.1, 0]])
    with pytest.raises(PlateError, match="each once"):
        WorldState.at_rest(("black_1", "black_1"), [[0, 0], [0.1, 0]])
