"""The world in the camera's images: latency, blur, missed parts and false ones."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from plate_core import PlateCycle, PlateError, load_rig
from plate_core.rig import CameraTrigger, Suspension, row_delay, to_image
from plate_core.tasks import load_scenario
from plate_sim import Camera, Disturbances, PlateMotion, Simulation, part_greys, simulate
from plate_sim.camera import PLATE
from plate_sim.world import NONE

RIG = load_rig()
SORT_4 = load_scenario("sort_4")
DARK = 0.8 * PLATE


def shaking(period=0.1, seed=2):
    """Along x and y: then points are exact."""
    rng = np.random.default_rng(seed)
    return PlateCycle.from_samples(period, 1.5e-3 * rng.normal(size=(12, 3)) * [1, 1, 0])


def blank(simulation, rig=RIG, noise=0.0):
    camera = Camera(rig, noise)
    grey = part_greys([name.split("_")[0] for name in simulation.state.ids])
    return lambda position, pose: camera.render(position, grey, np.random.default_rng(0), pose=pose)


def test_plates_simulated_together_equal_single_plates():
    """To the last bit, whatever the world, and however many cores there are."""
    worlds = [NONE, Disturbances(friction_patches=0.3, tilt_x=0.01), Disturbances(latency=0.05)]
    for name in ("sort_4", "sort_mixed"):
        scenario = load_scenario(name)
        rig = load_rig(scenario.rig)
        alone, few, many = (
            [Simulation(rig, scenario, k, world) for k, world in enumerate(worlds)]
            for _ in range(3)
        )
        for turn in range(3):
            cycles = [shaking(0.1 + 0.02 * k, seed=10 * turn + k) for k in range(3)]
            for simulation, cycle in zip(alone, cycles, strict=True):
                simulation.run(cycle)
            Simulation.run_together(few, cycles, threads=1)
            Simulation.run_together(many, cycles, threads=4)
        for one, *others in zip(alone, few, many, strict=True):
            assert np.ptp(one.state.velocity) > 0
            for other in others:
                for field in ("position", "velocity", "angle", "spin", "on_plate"):
                    assert np.array_equal(getattr(one.state, field), getattr(other.state, field))


def test_visible_parts_agree_with_the_image():
    """The same parts are hidden, the same false ones there, as late."""
    world = Disturbances(missed_parts=0.3, false_parts=0.3, latency=0.05, blur=False)
    drawn, reported = (Simulation(RIG, SORT_4, 3, world, noise=0.0) for _ in range(2))
    hidden = false = 0
    for turn in range(6):
        for simulation in (drawn, reported):
            simulation.run(shaking(seed=turn))
        image, visible = drawn.capture(), reported.visible_parts()
        places = np.vstack([visible.position[visible.seen], visible.false])
        at = np.rint(to_image(RIG, places)).astype(int)
        bare = drawn.capture_bare().astype(float)
        dark = bare - image
        assert np.all(dark[at[:, 1], at[:, 0]] > 20)
        for x, y in at:
            dark[y - 14 : y + 15, x - 14 : x + 15] = 0
        inside = dark[115:365, 60:580]  # the plate's edges were elsewhere
        assert np.max(np.abs(inside)) < 5  # nothing else is there
        hidden, false = hidden + np.sum(~visible.seen), false + len(visible.false)
    assert hidden > 2
    assert false > 2


@pytest.mark.parametrize("setting", [{"noise": -5.0}, {"noise": np.nan}, {"mu_scale": 0.0}])
def test_a_setting_out_of_range_is_refused(setting):
    with pytest.raises(PlateError, match=f"{next(iter(setting))} is .*, allowed: 0"):
        Simulation(RIG, SORT_4, **setting)


def gap(one, other):
    """Greatest difference of grey values of two images."""
    return int(np.abs(one.astype(int) - other.astype(int)).max())


@pytest.mark.parametrize("latency", [0.013, 0.05, 0.1, 0.137])
def test_an_image_shows_the_world_as_it_was(latency):
    """Against the exact integrator and the commanded pose, two cycles on."""
    simulation = Simulation(RIG, SORT_4, 1, Disturbances(latency=latency, blur=False), noise=0.0)
    start, draw = simulation.state, blank(simulation)
    cycle, samples = shaking(), 1000
    first = simulation.capture()
    assert gap(first, draw(start.position, None)) == 0
    for _ in range(2):
        simulation.run(cycle)
    image = simulation.capture()
    true = simulate(
        cycle, start.position, start.velocity, RIG.friction.mu, cycles=2, samples=samples,
        tolerance=1e-8,
    )  # fmt: skip
    row = round((0.2 - latency) / 0.1 * samples)
    pose = cycle.pose(((0.2 - latency) / 0.1 % 1) * 0.1)[0]
    assert gap(image, draw(true.position[row], pose)) <= 1
    # The same image without latency, and one with another, do differ.
    assert gap(image, draw(true.position[-1], None)) > 20


def test_latency_changes_no_motion():
    ends = []
    for disturbances in (NONE, Disturbances(latency=0.07)):
        simulation = Simulation(RIG, SORT_4, 1, disturbances)
        for _ in range(3):
            simulation.capture()
            simulation.run(shaking())
        ends.append(simulation.state)
    assert np.array_equal(ends[0].position, ends[1].position)
    assert np.array_equal(ends[0].velocity, ends[1].velocity)


@pytest.mark.parametrize("latency", [0.0, 0.03])
def test_blur_can_be_switched_off(latency):
    rig = replace(RIG, camera=replace(RIG.camera, exposure_s=0.005))
    images = []
    for blur in (True, False):
        simulation = Simulation(rig, SORT_4, 1, Disturbances(latency=latency, blur=blur), noise=0.0)
        for _ in range(2):
            simulation.run(shaking())
        moving = replace(simulation.state, velocity=np.full((4, 2), 0.2))
        simulation.state = moving
        images.append(simulation.capture())
    draw = blank(simulation, rig)
    if latency == 0:
        assert gap(images[1], draw(simulation.state.position, None)) == 0
    assert gap(images[0], images[1]) > 20


def test_the_requested_fraction_of_images_is_missed_and_no_motion_changes():
    seen, ends = [], []
    for fraction in (0.3, 0.0):
        simulation = Simulation(RIG, SORT_4, 5, Disturbances(missed_images=fraction))
        seen.append([simulation.capture() is not None for _ in range(400)])
        simulation.run(shaking())
        ends.append(simulation.state.position)
    # 4 standard deviations
    assert np.mean(seen[0]) == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 400))
    assert all(seen[1])
    assert np.array_equal(*ends)


def dark_at(image, position):
    """Which of the places [m] are dark in an image."""
    u, v = np.round(to_image(RIG, position)).astype(int).T
    return image[v, u] < DARK


def test_the_requested_fraction_of_parts_is_missed():
    simulation = Simulation(RIG, SORT_4, 5, Disturbances(missed_parts=0.25))
    seen = np.array([dark_at(simulation.capture(), simulation.state.position) for _ in range(300)])
    assert np.mean(seen) == pytest.approx(0.75, abs=4 * np.sqrt(0.1875 / seen.size))
    # Each one alone
    assert np.abs(np.corrcoef(seen.T) - np.eye(4)).max() < 0.25


def test_false_parts_are_drawn_with_the_requested_probability():
    simulation = Simulation(RIG, SORT_4, 5, Disturbances(false_parts=0.5), noise=0.0)
    clean = Simulation(RIG, SORT_4, 5, noise=0.0).capture()
    area = np.count_nonzero(clean < DARK) / 4
    bare = np.count_nonzero(
        Simulation(RIG, SORT_4, 5, Disturbances(missed_parts=1.0), noise=0.0).capture() < DARK
    )
    area -= bare / 4
    extra = [np.count_nonzero(simulation.capture() < DARK) - bare for _ in range(200)]
    # Two false ones to four, of about a part's size; some lie over others or over the edge.
    assert np.mean(extra) / area - 4 == pytest.approx(2.0, abs=0.35)


def test_a_disturbance_does_not_change_the_random_numbers_of_the_others():
    def end(seed, **disturbances):
        simulation = Simulation(
            RIG, SORT_4, seed, Disturbances(friction_spread=0.1, **disturbances)
        )
        for _ in range(3):
            image = simulation.capture()
            simulation.run(shaking())
        return simulation, image

    one, image = end(1)
    again, image_again = end(1)
    assert np.array_equal(one.state.position, again.state.position)
    assert np.array_equal(image, image_again)
    assert not np.array_equal(one.mu, end(2)[0].mu)
    for disturbances in (
        {"latency": 0.05},
        {"missed_parts": 0.5},
        {"false_parts": 1.0},
        {"blur": False},
    ):
        other, _ = end(1, **disturbances)
        assert np.array_equal(one.mu, other.mu)
        assert np.array_equal(one.state.position, other.state.position)


def test_dirt_of_the_ground_moves_the_parts():
    # Up to 1.5 times mu g along x and back: static friction decides whether parts ride along.
    swing = 1.5 * RIG.friction.accel * (0.1 / (2 * np.pi)) ** 2
    turn = 2 * np.pi * np.arange(32) / 32
    gentle = PlateCycle.from_samples(0.1, swing * (1 - np.cos(turn))[:, None] * [1, 0, 0])

    def end(**disturbances):
        simulation = Simulation(RIG, SORT_4, 1, Disturbances(**disturbances))
        for _ in range(3):
            simulation.run(gentle)
        return simulation.state.position

    clean = end()
    for name, value in {
        "tilt_x": 0.05, "tilt_y": -0.05, "static_ratio": 2.0, "friction_spread": 0.2,
        "friction_patches": 0.2,
    }.items():  # fmt: skip
        assert np.abs(end(**{name: value}) - clean).max() > 1e-6, name
    assert np.all(end(tilt_x=0.05)[:, 0] > clean[:, 0])
    assert np.all(end(tilt_y=-0.05)[:, 1] < clean[:, 1])


def test_a_suspended_plate_is_seen_where_it_really_is():
    """A soft plate pushed by half the force: off home when the image is taken."""
    stiff = np.diag([2e4, 2e4, 4e2])
    suspension = Suspension(
        mass=np.diag([2.0, 2.0, 0.075]), damping=np.diag([4.0, 4.0, 0.1]), stiffness=stiff,
        feedforward=(1.0, 1.0, 1.0), motor_gain=(0.7, 0.7, 0.7, 0.7),
    )  # fmt: skip
    rig = replace(RIG, suspension=suspension)
    simulation = Simulation(rig, SORT_4, 1, Disturbances(blur=False), noise=0.0)
    simulation.run(shaking())
    pose = simulation.plate.pose
    assert np.abs(pose[:2]).max() > 2e-4
    draw = blank(simulation, rig)
    assert gap(simulation.capture(), draw(simulation.state.position, pose)) <= 1
    assert gap(simulation.capture(), draw(simulation.state.position, None)) > 5


@pytest.mark.parametrize("age", [0.0, 0.004, 0.031, 0.12])
def test_a_camera_that_runs_free_sees_the_middle_of_a_cycle(age):
    """A cycle in pieces, an image after each: against the exact integrator."""
    world = Disturbances(image_rate=30.0, latency=age, blur=False)
    simulation = Simulation(RIG, SORT_4, 1, world, noise=0.0)
    start, draw = simulation.state, blank(simulation)
    cycle, samples = shaking(0.2), 4000
    true = simulate(
        cycle, start.position, start.velocity, RIG.friction.mu, samples=samples, tolerance=1e-8
    )
    ends = [0.0, 0.033, 0.041, 0.141, 0.2]
    for begin, end in pairwise(ends):
        simulation.run(PlateMotion.section(cycle, begin, end))
        if end > age:
            t = end - age
            expected = draw(true.position[round(t / 0.2 * samples)], cycle.pose(t)[0])
            assert gap(simulation.capture(age), expected) <= 1
    assert simulation.state.position == pytest.approx(true.position[-1], abs=5e-6)


def test_a_rolling_shutter_shows_each_part_at_the_instant_of_its_row():
    rig = replace(RIG, camera=replace(RIG.camera, readout_s=0.03))
    world = Disturbances(image_rate=30.0, latency=0.1, blur=False)
    simulation = Simulation(rig, SORT_4, 1, world, noise=0.0)
    start, draw = simulation.state, blank(simulation)
    cycle, samples = shaking(0.2), 4000
    simulation.run(cycle)
    image = simulation.capture(0.1)
    true = simulate(
        cycle, start.position, start.velocity, RIG.friction.mu, samples=samples, tolerance=1e-8
    )
    middle = true.position[samples // 2]
    delay = row_delay(rig, middle)
    assert np.ptp(delay) > 0.005  # parts in upper and in lower rows
    row = np.rint(samples * (0.5 + delay / 0.2)).astype(int)
    own = true.position[row, np.arange(4)]
    drawn, at_once = draw(own, np.zeros(3)), draw(middle, np.zeros(3))
    for column, line in np.rint(to_image(rig, own)).astype(int):
        window = np.s_[line - 10 : line + 11, column - 10 : column + 11]
        assert gap(image[window], drawn[window]) <= 3
    assert gap(drawn, at_once) > 20


def test_images_come_at_their_rate_in_the_order_of_their_stamps():
    world = Disturbances(image_rate=60.0, latency=0.03, stamp_jitter=0.005)
    shots = Simulation(RIG, SORT_4, 3, world).shots(2.0)
    shots = [next(shots) for _ in range(2000)]
    middle, stamp, delivered = np.array([[s.middle, s.stamp, s.delivered] for s in shots]).T
    assert np.diff(middle) == pytest.approx(np.full(1999, 1 / 60))
    assert 2.0 <= middle[0] < 2.0 + 1 / 60
    assert delivered == pytest.approx(middle + 0.03)
    assert np.all(np.diff(stamp) > 0)
    assert np.mean(stamp - middle) == pytest.approx(0.03, abs=5e-4)
    assert np.std(stamp - middle) == pytest.approx(0.005, rel=0.1)


def test_a_camera_that_is_triggered_does_not_run_free():
    rig = replace(RIG, camera=replace(RIG.camera, trigger=CameraTrigger(0.5)))
    with pytest.raises(PlateError, match=r"image_rate is 30, allowed: 0, .*trigger_phase"):
        Simulation(rig, SORT_4, 1, Disturbances(image_rate=30.0))


@pytest.mark.parametrize("off", [-1.4e-17, 0.0, 1.4e-17])
def test_a_piece_that_ends_at_a_knot_but_for_rounding_has_no_piece_without_length(off):
    cycle = PlateCycle.stopping(np.array([[1e-3, 0, 0], [0.1, 0, 0], [1.0, 0, 0]]), 0.01, 0.02)
    for piece in (
        PlateMotion.section(cycle, 0.0, 0.01 + off),
        PlateMotion.section(cycle, 0.01 + off, 0.02),
    ):
        assert np.all(np.diff(piece.times) > 1e-3)
        assert piece.period == pytest.approx(0.01)
