"""Films and strips show events at their places: pixels compared with places in metres."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from PIL import Image
from record.film import Film
from record.pictures import (
    FILM,
    STRIP,
    Arrows,
    Scene,
    class_sample,
    draw_film,
    draw_parts,
    draw_strip,
    draw_task,
    rectify_images,
    round_number,
    samples,
)

from plate_core import PlateCycle, load_rig
from plate_core.colours import class_colour, part_colour
from plate_core.rig import PartType
from plate_core.tasks import Bin, load_scenario

TIME, ARROWS = np.arange(4) * 0.1, Arrows(0.1, 0.03)
LEFT = np.array([-0.29, 0.14])
"""Where the second part was before it fell off [m]."""


def scene(name, ids, position, angle=0.0, **changes):
    """A run of four cycles on a plate that swings along x."""
    rig = load_rig()
    t = np.arange(64) / 640
    twist = np.zeros((64, 3))
    twist[:, 0] = 0.1 * np.sin(20 * np.pi * t) + 0.1 * np.cos(40 * np.pi * t)
    cycle = PlateCycle.from_samples(0.1, np.cumsum(twist, axis=0) / 640, twist)
    image = np.full((rig.camera.height_px, rig.camera.width_px), 200, np.uint8)
    position = np.array(position, float)
    angles = np.full(position.shape[:2], angle)
    film = Film(ids, TIME, position, angles, 0.3, TIME - 0.05, (cycle,) * 4, TIME, (image,) * 4)
    return Scene(rig, replace(load_scenario(name), **changes), film)


@pytest.fixture
def dropped():
    position = np.tile([[0.0, 0.0], LEFT], (4, 1, 1))
    position[2:, 1] = np.nan
    return scene("sort_10", ("black_1", "grey_2"), position)


def at(canvas, point):
    """Return the pixel at a place [m]."""
    x, y = np.round(np.multiply(point, [canvas.scale, -canvas.scale]) + canvas.origin).astype(int)
    return tuple(canvas.pixels[y, x].tolist())


def near(colour, wanted):
    return max(abs(a - b) for a, b in zip(colour, wanted, strict=True)) < 25


def test_a_part_that_fell_off_leaves_a_cross_where_it_was(dropped):
    before, after = STRIP.canvas(dropped), STRIP.canvas(dropped)
    draw_parts(dropped, before, 0.1, faces=True)
    draw_parts(dropped, after, 0.3, faces=True)
    assert near(at(before, LEFT), part_colour("grey"))
    assert near(at(after, LEFT), class_colour("grey"))
    for canvas in (before, after):
        assert near(at(canvas, (0.0, 0.0)), part_colour("black"))
    reported = [one.text for one in samples(dropped, ARROWS, after)]
    assert "fell off here" in reported
    assert "mean force; longest arrows: 0.1 mu mg or more (a part's friction)" in reported
    assert "100 mm" in reported


def test_a_part_that_a_real_camera_lost_and_found_again_did_not_fall_off(dropped):
    position = np.full((4, 3, 2), np.nan)
    position[:2, 1] = position[2, 2] = LEFT  # the detector gives the part a new name, then loses it
    position[:, 0] = 0.0
    ids = ("black_1", "grey_2", "grey_3")
    film = replace(dropped.film, ids=ids, position=position, angle=np.zeros((4, 3)))
    assert (film.parts, film.dropped) == (3, 2)  # in a simulation, names are unique
    film = replace(film, simulated=False)
    assert (film.parts, film.dropped) == (2, 1)
    run = replace(dropped, film=film)
    reported = [one.text for one in samples(run, ARROWS, STRIP.canvas(run))]
    assert "last detected here" in reported
    assert "fell off here" not in reported


def test_a_long_part_stays_in_its_line_of_the_legend(dropped):
    outline = ((-0.06, -0.004), (0.06, -0.004), (0.06, 0.004), (-0.06, 0.004))
    part = PartType("rod", outline, mass_kg=0.01)
    rig = replace(dropped.rig, types={"rod": part})
    film = replace(dropped.film, ids=("rod_1", "rod_2"))
    run = replace(dropped, rig=rig, film=film, scenario=load_scenario("play"))
    canvas = STRIP.canvas(run)
    class_sample(run, "rod", 0.008).draw(canvas)
    x = canvas.origin[0]
    drawn = np.flatnonzero(np.any(canvas.pixels < 200, axis=(0, 2))) - x
    assert 4.0 * 0.008 * canvas.scale < drawn.max() < 8.0 * 0.008 * canvas.scale
    assert drawn.min() >= -2


def test_targets_have_the_colour_of_their_class_and_the_plate_has_none(dropped):
    canvas = STRIP.canvas(dropped)
    draw_task(dropped, canvas)
    red, _, blue = at(canvas, (-0.25, 0.0))  # black to the left, grey to the right
    assert red > blue + 10
    red, _, blue = at(canvas, (0.25, 0.0))
    assert blue > red + 10
    assert at(canvas, (0.0, 0.0)) == (255, 255, 255)


def test_a_bin_is_drawn_where_it_is():
    run = scene("sort_10", ("black_1",), np.zeros((4, 1, 2)))
    corner = ((0.1, 0.05), (0.2, 0.05), (0.2, 0.1), (0.1, 0.1))
    task = replace(run.scenario.task, regions={"black": Bin(corner)})
    run = replace(run, scenario=replace(run.scenario, task=task))
    canvas = FILM.canvas(run)
    draw_task(run, canvas)
    assert at(canvas, (0.15, 0.08)) != (255, 255, 255)
    assert at(canvas, (0.15, 0.03)) == (255, 255, 255)
    assert near(at(canvas, (0.1, 0.08)), class_colour("black"))


def test_measured_and_requested_angles_are_drawn():
    run = scene("spin_1", ("black_1",), np.zeros((4, 1, 2)), angle=np.radians(180))
    canvas = FILM.canvas(run)
    draw_parts(run, canvas, 0.2, faces=True)
    radius = run.rig.parts.radius_m
    assert near(at(canvas, (-2 * radius, 0.0)), (34, 34, 34))  # it points to the left
    assert near(at(canvas, (0.0, 1.4 * radius)), class_colour("black"))  # and must point up
    assert at(canvas, (0.0, -2 * radius)) == (255, 255, 255)
    assert [pose[2] for pose in run.poses] == [np.radians(90)]


def test_arrows_have_the_length_of_the_legend(dropped):
    forces = dropped.forces(0.2, np.zeros((1, 2)))
    assert abs(forces[0, 1]) < 0.02 < abs(forces[0, 0])  # the plate swings along x
    canvas = STRIP.canvas(dropped)
    ARROWS.draw(canvas, np.array([[0.0, 0.0]]), np.array([[0.05, 0.0]]), 1, 0.0)
    dark = np.flatnonzero(np.any(canvas.pixels < 200, axis=(0, 2)))
    assert np.ptp(dark) == pytest.approx(0.5 * 0.03 * canvas.scale, abs=3)  # half of the force


def test_strip_and_film_of_a_short_run(dropped, tmp_path):
    draw_strip(dropped, tmp_path / "strip.png", "title")
    assert draw_film(dropped, tmp_path / "film.gif", "title") == 1.0
    with Image.open(tmp_path / "strip.png") as strip, Image.open(tmp_path / "film.gif") as film:
        assert min(strip.size) > 1000
        assert 1 <= film.n_frames <= 4
        assert film.width < 800


def test_cycles_are_counted_by_motor_tables_if_there_is_no_simulator():
    run = scene("sort_10", ("black_1",), np.zeros((4, 1, 2)))
    images = np.arange(10) / 30  # three images per cycle
    film = replace(run.film, time=images, position=np.zeros((10, 1, 2)), simulated=False)
    still = replace(film.tables[0], knot_twist=np.zeros_like(film.tables[0].knot_twist))
    film = replace(film, table_time=TIME, tables=(still, *film.tables[1:]))
    run = replace(run, film=film)
    assert [run.clock(t).split(", ")[1] for t in (0.05, 0.19, 0.3)] == [
        "cycle 0 of 3",
        "cycle 1 of 3",
        "cycle 3 of 3",
    ]
    assert film.running(0.19) is still  # computed during the cycle before
    assert film.running(0.21) is not still


def test_the_film_corrects_the_distortion_of_the_lens(dropped):
    """The rig file contains the corners of the plate as they are in the image."""
    lens = replace(dropped.rig.camera.lens, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
    rig = replace(dropped.rig, camera=replace(dropped.rig.camera, lens=lens))
    image = np.full((rig.camera.height_px, rig.camera.width_px), 200, np.uint8)
    for x, y in np.round(rig.camera.corners_px).astype(int):
        image[y - 4 : y + 5, x - 4 : x + 5] = 0
    run = replace(dropped, rig=rig)
    canvas = FILM.canvas(run)
    _, (view,), _ = rectify_images(run, canvas, [image])
    canvas = replace(canvas, pixels=view)
    assert [at(canvas, corner) for corner in rig.plate.corners] == [(0,)] * 4
    assert at(canvas, (0.0, 0.0)) == (200,)


def test_in_a_film_under_a_lamp_that_flickers_only_parts_cover_the_targets(dropped):
    bright = dropped.film.images[0]
    dark = (0.85 * bright).astype(np.uint8)
    dark[230:250, 310:330] = 30  # a part in the middle of the plate
    canvas = FILM.canvas(dropped)
    _, _, (empty, _, part) = rectify_images(dropped, canvas, [bright, bright, dark])
    assert not np.any(empty)
    assert at(replace(canvas, pixels=part[..., None]), (0.0, 0.0)) == (True,)
    assert np.mean(part) < 0.01


def test_a_film_with_many_images_is_not_in_slow_motion(dropped, tmp_path):
    image_time = np.linspace(0, 0.3, 40)
    film = replace(dropped.film, image_time=image_time, images=dropped.film.images[:1] * 40)
    assert draw_film(replace(dropped, film=film), tmp_path / "film.gif", "title") == 1.0
    with Image.open(tmp_path / "film.gif") as drawn:
        assert drawn.n_frames <= 5  # 0.4 s


@pytest.mark.parametrize(
    ("value", "rounded"), [(0.1, 0.1), (0.199, 0.1), (0.2, 0.2), (7.0, 5.0), (0.0099, 0.005)]
)
def test_round_numbers(value, rounded):
    assert round_number(value) == pytest.approx(rounded)
