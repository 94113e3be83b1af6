"""Parts put down, moved and taken off by hand, and a world that changes while it runs."""

import re
from dataclasses import replace

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, config_path, load_rig
from plate_core.rig import load_part_types
from plate_core.tasks import load_scenario
from plate_sim import Disturbances, Simulation
from plate_sim.world import NONE

RIG = load_rig()
REST = PlateCycle.rest(0.1)
FREE = (0.28, 0.14)
"""Place near a corner, without a scattered part."""


def world(disturbances=NONE, rig=RIG, scenario="sort_4", seed=3):
    return Simulation(rig, load_scenario(scenario), seed, disturbances)


def test_a_moved_part_is_at_rest_at_its_new_place_and_the_others_stay():
    simulation = world()
    before = simulation.state
    simulation.state = replace(before, velocity=np.full((4, 2), 0.01), spin=np.ones(4))
    assert simulation.place("grey_1", "", np.array(FREE), 7.0) == "grey_1"
    state, row = simulation.state, before.ids.index("grey_1")
    assert state.ids == before.ids
    assert state.position[row] == pytest.approx(FREE)
    assert state.angle[row] == pytest.approx(7.0 - 2 * np.pi)
    assert not state.velocity[row].any()
    assert state.spin[row] == 0
    others = np.arange(4) != row
    assert np.array_equal(state.position[others], before.position[others])
    assert np.all(state.velocity[others] == 0.01)


@pytest.mark.parametrize("world_of", [NONE, Disturbances(latency=0.05, friction_spread=0.3)])
def test_a_new_part_has_the_next_number_is_seen_and_moves(world_of):
    simulation = world(world_of)
    simulation.run(REST)
    bare = simulation.capture().astype(float)
    assert simulation.place("", "black", np.array(FREE)) == "black_3"
    assert simulation.place("", "grey", -np.array(FREE)) == "grey_3"
    assert len(simulation.mu) == len(simulation.state.ids) == 6
    assert np.all(np.abs(simulation.mu / RIG.friction.mu - 1) <= world_of.friction_spread)
    simulation.run(REST)
    dark = np.count_nonzero(bare - simulation.capture() > 40)
    assert dark > 100  # pixels of a black part that was not there before
    simulation.remove("black_3")
    simulation.run(REST)
    assert np.count_nonzero(bare - simulation.capture() > 40) < dark
    assert simulation.state.ids[-1] == "grey_3"


def test_a_part_that_fell_off_is_put_back():
    simulation = world()
    state = simulation.state
    simulation.state = replace(state, on_plate=np.array([False, True, True, True]))
    simulation.place(state.ids[0], "", np.array(FREE))
    assert simulation.state.dropped == 0


def test_parts_of_other_shapes():
    rig = replace(RIG, types=load_part_types(config_path("parts.yaml")))
    simulation = world(rig=rig, scenario="align_6")
    label = next(name for name in rig.types if rig.types[name].symmetry != 0)
    room = rig.plate.half - rig.part_type(label).reach_m
    name = simulation.place("", label, room, 0.3)
    simulation.run(REST)
    assert simulation.state.ids[-1] == name
    assert simulation.capture() is not None


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (("", "black", (0.295, 0.0)), r"place is \(0.295, 0\) m, allowed for black: \|x\| up to"),
        (("", "black", (0.0, np.nan)), r"place is \(0, nan\) m"),
        (("", "black", FREE, np.inf), "angle is inf, allowed: finite"),
        (("", "blak", FREE), "type is 'blak' .*black.*, allowed: black, grey"),
        (("", "", FREE), "type is '', allowed: black, grey"),
        (("black_9", "", FREE), "id is 'black_9'.*, allowed: black_1, black_2, grey_1, grey_2"),
        (("x" * 9999, "", FREE), "id is 'xxx"),
        (("black_1", "", "grey_1"), "parts black_1 and grey_1 overlap by 1[0-9.]* mm"),
        (("", "black", "grey_1"), "parts black_3 and grey_1 overlap by 1[0-9.]* mm"),
    ],
)
def test_a_part_that_cannot_be_placed_is_refused(what, words):
    simulation = world()
    before = simulation.state
    name, label, position, *angle = what
    if isinstance(position, str):
        position = before.position[before.ids.index(position)] + [0.001, 0.0]
    with pytest.raises(PlateError) as caught:
        simulation.place(name, label, np.array(position), *angle)
    assert re.search(words, str(caught.value))
    assert len(str(caught.value)) < 300
    assert simulation.state is before


def test_surplus_parts_and_the_removal_of_missing_parts_are_refused():
    simulation = world()
    with pytest.raises(PlateError, match=r"id is 'grey_7' \(did you mean"):
        simulation.remove("grey_7")
    for name in simulation.state.ids:
        simulation.remove(name)
    simulation.run(REST)
    assert simulation.capture() is not None
    with pytest.raises(PlateError, match="id is 'grey_1', allowed: none"):
        simulation.remove("grey_1")
    grid = np.stack(np.meshgrid(np.linspace(-0.28, 0.28, 12), np.linspace(-0.12, 0.12, 9)), -1)
    for position in grid.reshape(-1, 2)[:100]:
        simulation.place("", "black", position)
    with pytest.raises(PlateError, match="100 parts exist, allowed: fewer than 100"):
        simulation.place("", "black", grid[-1, -1])


def test_the_world_changes_as_if_it_had_been_so_from_the_start():
    changed = Disturbances(friction_spread=0.3, friction_patches=0.2, shadows=0.4, tilt_x=0.002)
    late, early = world(), world(changed)
    late.change(changed, 2.0, 1.5)
    assert late.mu == pytest.approx(1.5 * early.mu)
    late.run(REST)
    early.run(REST)
    still = Simulation(RIG, load_scenario("sort_4"), 3, changed, noise=2.0)
    still.run(REST)
    assert np.array_equal(late.capture(), still.capture())
    assert not np.array_equal(early.capture(), still.capture())  # of another noise
    with pytest.raises(PlateError, match=r"mu_scale is 0, allowed: 0\.1 to 10"):
        late.change(NONE, 1.0, 0.0)
