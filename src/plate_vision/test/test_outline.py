"""The plate's outline in the image against that of `corners_px`, in drawn pictures."""

import dataclasses
import re

import numpy as np
import pytest
from drawn_plate import View, disc, draw, rectangle
from shown_text import says

from plate_core import load_rig
from plate_core.rig import Lens as RigLens
from plate_core.status import Level
from plate_vision import make_vision
from plate_vision.plate.outline import IMAGES, OutlineCheck

LENGTH, WIDTH = 0.6, 0.3
RIG = load_rig()
BARE = [(rectangle(LENGTH, WIDTH), 205.0)]


def rig_of(view, lens=True, rig=RIG):
    """Return the rig as it is measured by hand from a view; with its lens or without."""
    half = np.array([LENGTH, WIDTH]) / 2
    corner = view.see(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half)
    known = None
    if lens and any(view.lens):
        k1, k2, k3 = view.lens
        known = RigLens(
            (view.focal, view.focal), tuple(view.centre.tolist()), (k1, k2, 0.0, 0.0, k3)
        )
    width, height = view.size
    camera = dataclasses.replace(
        rig.camera, width_px=width, height_px=height, corners_px=corner.tolist(), lens=known
    )
    return dataclasses.replace(rig, camera=camera)


def evaluate(rig, images):
    """Return the check after these images."""
    check = OutlineCheck.of(rig, make_vision(rig).calibration)
    for k, image in enumerate(images):
        check = check.add(image, 0.1 * k)
    return check


def seen(rig, view, shapes=BARE, room=60.0, noise=2.0, **options):
    """Return the check after five pictures of the same scene."""
    still = draw(view, shapes, room, noise=0.0, **options).astype(float)
    rng = np.random.default_rng(11)
    noisy = (still + noise * rng.standard_normal(still.shape) for _ in range(IMAGES))
    return evaluate(rig, [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy])


def parts_over_edges(rng, count=40):
    """Discs on the plate, some of them over its edges."""
    place = rng.uniform(-0.5, 0.5, (count, 2)) * [LENGTH + 0.01, WIDTH + 0.01]
    return [(disc(x, y, 0.008), 40.0 + 90 * (k % 2)) for k, (x, y) in enumerate(place)]


def no_claim(check):
    """Assert that no problem is reported, and return the text."""
    assert check.done
    assert check.finding is None, check.finding.message
    return check.text


TILTS = [(0, 0, 0), (15, 0, 3), (0, 25, 0), (0, -25, 5), (40, 0, 0), (0, 40, 0), (20, 20, 10)]


@pytest.mark.parametrize(("tilt_x", "tilt_y", "roll"), [*TILTS, (0, 0, 180)])
@pytest.mark.parametrize("noise", [2.0, 15.0])
def test_a_plate_at_its_predicted_place_causes_no_warning(tilt_x, tilt_y, roll, noise, rng):
    far = max(tilt_x, abs(tilt_y)) > 30
    view = View(tilt_x=tilt_x, tilt_y=tilt_y, roll=roll, distance=1.05 if far else 0.95)
    shapes = [*BARE, *parts_over_edges(rng)]
    check = seen(rig_of(view), view, shapes, noise=noise, slope=0.1)
    assert no_claim(check).startswith("as predicted, within 0.")
    assert check.agrees


@pytest.mark.parametrize(
    ("focal", "distance", "lens"),
    [(600, 0.62, (-0.3, 0.08, 0)), (900, 0.95, (-0.3, 0.1, 0)), (500, 0.55, (0.2, 0, 0))],
)
def test_a_known_lens_is_used_and_a_lens_left_out_is_named(focal, distance, lens, rng):
    view = View(focal=focal, distance=distance, lens=lens)
    shapes = [*BARE, *parts_over_edges(rng)]
    assert no_claim(seen(rig_of(view), view, shapes)).startswith("as predicted, within 0.")
    found = seen(rig_of(view, lens=False), view, shapes).finding
    kind, side = ("barrel", "outwards") if lens[0] < 0 else ("pincushion", "inwards")
    assert f"the {kind} distortion is unknown" in found.message
    assert f"its edges bend {side} by " in found.message


@pytest.mark.parametrize("focal", [500, 700, 1000])
@pytest.mark.parametrize("tilt", [0, 15])
def test_a_published_barrel_lens_left_out_is_named(focal, tilt, rng):
    view = View(focal=focal, distance=1.1e-3 * focal, lens=(-0.3, 0, 0), tilt_x=tilt)
    rig = rig_of(view, lens=False)
    found = seen(rig, view, [*BARE, *parts_over_edges(rng)]).finding
    assert "the barrel distortion is unknown (calibrate lens" in found.message
    # The size of the error: where a part in the middle of an edge seems to be.
    edge = np.column_stack([np.linspace(-0.3, 0.3, 41), np.full(41, 0.15)])
    truth = float(np.abs(make_vision(rig).calibration.to_home(view.see(edge)) - edge).max())
    stated_mm = float(found.message.rsplit("up to ", 1)[1].split()[0])
    assert stated_mm == pytest.approx(1e3 * truth, rel=0.25)
    assert (found.level == Level.ERROR) == (stated_mm > 8)  # more than a part's radius


def test_a_lens_applied_to_straightened_images_is_named():
    view = View(focal=600, distance=0.65)
    rig = rig_of(view)
    lens = RigLens((600.0, 600.0), tuple(view.centre.tolist()), (-0.3, 0.0, 0.0, 0.0, 0.0))
    rig = dataclasses.replace(rig, camera=dataclasses.replace(rig.camera, lens=lens))
    found = seen(rig, view).finding
    assert says(found.message, "lens", "do not fit", "rectified")


@pytest.mark.parametrize(
    ("way", "level"),
    [((0.005, 0), Level.WARN), ((0, -0.005), Level.WARN), ((0.02, 0.01), Level.ERROR)],
)
def test_a_camera_that_was_shifted_is_named(way, level, rng):
    before = View(distance=0.95)
    after = dataclasses.replace(before, at=way)
    found = seen(rig_of(before), after, [*BARE, *parts_over_edges(rng)]).finding
    x, y = re.search(
        r"it is shifted by \((.*), (.*)\) mm, because the camera was", found.message
    ).groups()
    assert (float(x), float(y)) == pytest.approx((-1e3 * way[0], -1e3 * way[1]), abs=0.3)
    assert found.level == level  # a part's radius is 8 mm


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"roll": 2}, "rotated by 2.0 degrees"),
        ({"distance": 0.95 / 1.03}, "3.1 % larger"),
        ({"distance": 0.95 * 1.03}, "2.9 % smaller"),
    ],
)
def test_a_camera_that_was_rotated_or_zoomed_is_named(change, text, rng):
    before = View(distance=0.95)
    after = dataclasses.replace(before, **change)
    found = seen(rig_of(before), after, [*BARE, *parts_over_edges(rng)]).finding
    assert says(found.message, text, "camera")
    assert found.level == Level.ERROR


def test_another_plate_is_named():
    view = View(distance=0.95)
    found = seen(rig_of(view), view, [(rectangle(0.63, WIDTH), 205.0)]).finding
    assert says(found.message, "5.0 % larger in length", "0.1 % larger in width", "length_m")


FLIPPED = {"mirrored left to right": (1, -1), "mirrored upside down": (-1, 1),
           "rotated by 180 degrees": (-1, -1)}  # fmt: skip


@pytest.mark.parametrize("name", FLIPPED)
@pytest.mark.parametrize(
    "view", [View(tilt_x=25, tilt_y=10, distance=1.05), View(at=(0.02, 0.03), distance=1.05)]
)
def test_a_flipped_image_is_named(view, name, rng):
    down, across = FLIPPED[name]
    shapes = [*BARE, *parts_over_edges(rng)]
    image = np.ascontiguousarray(draw(view, shapes, 60.0)[::down, ::across])
    found = evaluate(rig_of(view), [image] * IMAGES).finding
    assert found.message.startswith(f"the image is {name}, because the plate's outline")
    assert found.level == Level.ERROR


@pytest.mark.parametrize(("turns", "name"), [(-1, "clockwise"), (1, "anticlockwise")])
def test_a_square_image_rotated_by_90_degrees_is_named(turns, name, rng):
    view = View(tilt_x=25, tilt_y=10, distance=1.05, size=(700, 700))
    image = draw(view, [*BARE, *parts_over_edges(rng)], 60.0)
    found = evaluate(rig_of(view), [np.ascontiguousarray(np.rot90(image, turns))] * IMAGES).finding
    assert found.message.startswith(f"the image is rotated by 90 degrees {name}, because")
    assert found.level == Level.ERROR
    no_claim(evaluate(rig_of(view), [image] * IMAGES))


def test_all_possible_flips_of_the_image_are_named():
    view = View(tilt_y=20, distance=1.0)  # symmetric about the image's horizontal axis
    image = draw(view, BARE, 60.0)
    turned = evaluate(rig_of(view), [np.ascontiguousarray(image[::-1, ::-1])] * IMAGES)
    assert "mirrored left to right or rotated by 180 degrees" in turned.finding.message
    alike = evaluate(rig_of(view), [np.ascontiguousarray(image[::-1])] * IMAGES)
    no_claim(alike)  # nothing can be seen by the outline


def test_a_small_shift_may_be_a_flip():
    view = View(at=(0.004, 0), distance=1.05)
    image = np.ascontiguousarray(draw(view, BARE, 60.0)[:, ::-1])
    text = evaluate(rig_of(view), [image] * IMAGES).finding.message
    assert says(text, "shifted by (8.", "mirrored left to right", "rotated by 180 degrees")


LINE = [(rectangle(0.56, 0.26), 20.0), (rectangle(0.556, 0.256), 205.0)]
HELD = (rectangle(0.3, 0.1, (-0.1, 0.16)), 30.0)


@pytest.mark.parametrize(
    ("distance", "shapes", "room", "text"),
    [
        (0.5, BARE, 60.0, "not seen"),  # the plate fills the image
        (0.8, BARE, 60.0, "not seen, only 2 of 4 edges"),
        (0.95, BARE, 205.0, "not seen"),  # no contrast
        (0.95, LINE, 205.0, "not seen"),  # but a line on the plate
        (0.95, BARE, 195.0, "as predicted"),
        (0.95, [(rectangle(LENGTH, WIDTH), 70.0)], 200.0, "as predicted"),  # darker than the room
        (0.95, [(rectangle(0.8, 0.42), 150.0), *BARE, *LINE], 60.0, "as predicted"),  # on a table
        (0.95, [(rectangle(LENGTH, WIDTH, (0.01, -0.01)), 25.0), *BARE], 60.0, "as predicted"),
        (0.95, [*BARE, HELD], 60.0, "as predicted"),  # half an edge is hidden
        (0.95, [(rectangle(LENGTH, WIDTH), (60, 180, 120))], (120, 120, 120), "as predicted"),
        (0.95, [(rectangle(LENGTH, WIDTH), (60, 150, 120))], (140, 120, 140), "as predicted"),
    ],
)
def test_no_outline_is_reported_if_the_plate_is_not_visible(distance, shapes, room, text, rng):
    view = View(distance=distance)
    assert no_claim(seen(rig_of(view), view, shapes, room)).startswith(text)


def test_a_plate_that_shakes_is_no_camera_that_was_moved():
    view, rng = View(distance=0.95), np.random.default_rng(5)
    for amplitude in (0.003, 0.006, 0.01):
        phase = rng.uniform(0, 2 * np.pi) + np.pi * np.arange(IMAGES)
        place = 0.002 + amplitude * np.column_stack([np.sin(phase), np.cos(phase)])
        turn = 0.03 * np.sin(2 * phase)
        scenes = [rectangle(LENGTH, WIDTH, at, by) for at, by in zip(place, turn, strict=True)]
        check = evaluate(rig_of(view), [draw(view, [(one, 205.0)], 60.0) for one in scenes])
        assert says(no_claim(check), "as predicted", "plate moves")
        assert not check.agrees  # it is checked again at rest


def test_a_plate_seen_at_one_place_of_its_cycle_is_no_camera_that_was_moved():
    view = View(distance=0.95)
    image = draw(view, [(rectangle(LENGTH, WIDTH, (0.007, -0.004), 0.02), 205.0)], 60.0)
    assert evaluate(rig_of(view), [image] * IMAGES).finding is not None
    check = OutlineCheck.of(rig_of(view), make_vision(rig_of(view)).calibration)
    for k in range(IMAGES):
        check = check.add(image, 0.1 * k, moving=k == 2)  # a task begins meanwhile
    no_claim(check)


def test_a_lens_left_out_is_named_while_the_plate_moves():
    view = View(focal=600, distance=0.66, lens=(-0.3, 0, 0))
    places = [(0.006 * (-1) ** k, 0.0) for k in range(IMAGES)]
    images = [draw(view, [(rectangle(LENGTH, WIDTH, at), 205.0)], 60.0) for at in places]
    assert "barrel" in evaluate(rig_of(view, lens=False), images).finding.message


def test_a_finding_stays_until_the_outline_agrees():
    view = View(distance=0.95)
    right = draw(view, BARE, 60.0)
    wrong = draw(dataclasses.replace(view, at=(0.01, 0)), BARE, 60.0)
    check = evaluate(rig_of(view), [wrong] * IMAGES)
    assert check.finding is not None
    assert check.add(right, 0.6) is check  # too soon after the last one
    for k in range(IMAGES):  # while a task runs, the place of the plate is not reported
        check = check.add(right, 2.0 + 0.1 * k, moving=True)
        assert check.finding is not None
    for k in range(IMAGES):
        check = check.add(right, 4.0 + 0.1 * k)
        assert (check.finding is None) == (k == IMAGES - 1)
    assert check.agrees
    assert check.add(wrong, 100.0) is check  # it is judged once


def test_an_image_of_another_time_is_measured_again():
    view = View(distance=0.95)
    dark = np.zeros((480, 640), np.uint8)
    check = evaluate(rig_of(view), [dark] * IMAGES)
    assert no_claim(check) == "not seen"
    check = evaluate(rig_of(view), [dark] * IMAGES)
    for k in range(IMAGES):
        check = check.add(draw(view, BARE, 60.0), 20.0 + 0.1 * k)
    assert check.agrees
