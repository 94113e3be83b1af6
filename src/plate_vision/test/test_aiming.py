"""Measurements for aiming a camera, in pictures drawn without the detector's code."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_plate import View, board_picture, disc, draw, rectangle

from plate_core import load_rig
from plate_core.status import Level
from plate_vision import make_vision
from plate_vision.aiming import (
    AimField,
    Focus,
    edge_blur_px,
    light_finding,
    measure_light,
    measure_sharpness,
    outline_finding,
    outline_px,
    size_finding,
)
from plate_vision.camera import Board, draw_board
from plate_vision.camera.boards import find_board
from plate_vision.camera.lens_pictures import LensPictures
from plate_vision.errors import CalibrationError
from plate_vision.overlooked import Expected
from plate_vision.plate.corners import find_plate_corners
from plate_vision.plate.outline import measure_outline

RIG = load_rig()
VIEW = View()
PLATE, ROOM = 200.0, 60.0
PARTS = [(0.1, 0.05), (-0.15, -0.06), (0.2, -0.1), (-0.05, 0.08)]


def rig_of(view):
    """The rig whose camera is this one."""
    corners = tuple(map(tuple, view.see(RIG.plate.corners).tolist()))
    return replace(RIG, camera=replace(RIG.camera, corners_px=corners, lens=None))


def picture(view=VIEW, parts=PARTS, **more):
    shapes = [(rectangle(RIG.plate.length_m, RIG.plate.width_m), PLATE)]
    shapes += [(disc(x, y, RIG.parts.radius_m), 40.0) for x, y in parts]
    return draw(view, shapes, ROOM, **more)


def outline_of(image, field):
    """Where the outline is seen [px], and how it agrees."""
    outline = measure_outline(image, field.grid)
    return outline_px(outline, field), outline_finding(image, outline, field)


@pytest.fixture(scope="module")
def field():
    rig = rig_of(VIEW)
    return AimField.of(rig, make_vision(rig), Expected(0.008, 0.008))


def test_sharpness_falls_with_defocus_and_not_with_light(field):
    image = picture()
    sharp = measure_sharpness(image, field)
    blurred = [measure_sharpness(cv2.GaussianBlur(image, (0, 0), s), field) for s in (1, 2, 4)]
    assert sharp > 1.08 * blurred[0] > 1.2 * blurred[1] > 1.5 * blurred[2]
    darker = measure_sharpness((image * 0.6).astype(np.uint8), field)
    assert darker == pytest.approx(sharp, rel=0.02)
    bare = picture(parts=[])
    assert measure_sharpness(bare, field) > 1.4 * measure_sharpness(
        cv2.GaussianBlur(bare, (0, 0), 3), field
    )


def test_a_covered_lens_has_no_sharpness(field):
    rng = np.random.default_rng(1)
    covered = np.clip(rng.normal(12, 2, (480, 640)), 0, 255).astype(np.uint8)
    found = Focus().add(1.0, measure_sharpness(covered, field)).finding
    assert found.level == Level.ERROR
    assert "covered" in found.message
    light = light_finding(covered, measure_light(covered, field), field)
    assert light.level == Level.ERROR
    assert "check that the light is on and the lens is open" in light.message
    seen_px, outline = outline_of(covered, field)
    assert len(seen_px) == 0
    assert "not seen" in outline.message


def turned(focus, values, blur_px=np.nan):
    """The focus after more values, 0.4 s apart."""
    for value in values:
        stamp = focus.values[-1][0] + 0.4 if focus.values else 0.0
        focus = focus.add(stamp, value, blur_px)
    return focus


def test_the_trend_distinguishes_falling_from_rising():
    focus = turned(Focus(), [0.20] * 8, 1.0)
    assert focus.trend == "steady"
    assert focus.finding.level == Level.OK
    focus = turned(focus, [0.18, 0.16, 0.14, 0.12])
    assert focus.trend == "falls"
    assert focus.finding.level == Level.WARN
    assert "turn the focus back" in focus.finding.message
    focus = turned(focus, [0.14, 0.16, 0.18, 0.20])
    assert focus.trend == "rises"
    assert focus.best == pytest.approx(0.20)
    assert focus.add(0.0, 0.1).best == pytest.approx(0.1)  # a clock that was set back


def test_a_focus_is_found_once_its_maximum_was_passed():
    blurred = turned(Focus(), [0.12] * 200)  # for longer than the best value is kept
    assert blurred.finding.level == Level.STALE
    assert "turn the focus past the best value and back" in blurred.finding.message
    rising = turned(blurred, [0.14, 0.16, 0.18, 0.20])
    assert rising.finding.level == Level.STALE
    assert turned(rising, [0.18, 0.16]).finding.level == Level.WARN
    found = turned(rising, [0.18, 0.16, 0.18, 0.20])
    assert found.finding.level == Level.OK
    assert turned(found, [0.20] * 200).finding.level == Level.OK
    lost = turned(found, [0.16] * 200)
    assert lost.finding.level == Level.STALE  # not its own best value


def test_a_focus_is_found_where_the_plates_edges_are_sharp():
    found = turned(Focus(), [0.12], 1.2)
    assert found.finding.level == Level.OK
    assert "blur of the plate's edges is 1.2 px" in found.finding.message
    assert turned(found, [0.12]).finding.level == Level.OK  # a plate that moves
    blurred = turned(found, [0.12], 1.9)
    assert blurred.finding.level == Level.WARN
    assert "edges is 1.9 px, allowed: up to 1.5 px; turn the focus" in blurred.finding.message
    assert turned(blurred, [0.12]).finding.level == Level.STALE
    beveled = turned(blurred, [0.16, 0.20, 0.16, 0.20], 1.7)
    assert beveled.finding.level == Level.OK


@pytest.mark.parametrize("view", [VIEW, View(distance=1.3, tilt_x=20.0, tilt_y=-12.0)])
def test_the_blur_of_the_plates_edges(view):
    rig = rig_of(view)
    field, image = AimField.of(rig, make_vision(rig), Expected(0.008, 0.008)), picture(view)

    def blur(by_px):
        seen = cv2.GaussianBlur(image, (0, 0), by_px) if by_px else image
        return edge_blur_px(seen, measure_outline(seen, field.grid), field)

    sharp = blur(0)
    assert sharp < 1.1
    for by_px in (1.0, 2.0, 3.0):
        assert blur(by_px) == pytest.approx(np.hypot(sharp, by_px), rel=0.03)
    nothing = np.full((480, 640), 60, np.uint8)
    assert np.isnan(edge_blur_px(nothing, measure_outline(nothing, field.grid), field))


def test_light_and_clipping_of_the_plate_alone(field):
    image = picture(parts=[], noise=0.0)
    light = measure_light(image, field)
    assert light.histogram.argmax() == PLATE // 4
    assert light.histogram.sum() == pytest.approx(np.count_nonzero(field.plate), abs=1)
    assert light.black == light.white == 0
    lamp = np.dstack([image] * 3)
    x, y = np.rint(VIEW.see(np.zeros((1, 2)))[0]).astype(int)
    lamp[y - 40 : y + 40, x - 40 : x + 40, 2] = 255  # one channel is enough
    light = measure_light(lamp, field)
    assert light.white == pytest.approx(80 * 80 / np.count_nonzero(field.plate), rel=0.01)
    assert light.black == 0
    found = light_finding(lamp, light, field)
    assert found.level == Level.WARN
    assert "clipped at 255" in found.message
    dark = np.clip(picture(parts=[]).astype(int) - 150, 0, 255).astype(np.uint8)
    dark[y - 40 : y + 40, x - 40 : x + 40] = 0
    assert measure_light(dark, field).black > 0.03


def test_the_outline_where_it_is_expected_and_where_it_is_not(field):
    seen_px, outline = outline_of(picture(), field)
    assert outline.level == Level.OK
    assert len(seen_px) == 36
    corners = rig_of(VIEW).camera.corners_px
    ends = seen_px.reshape(4, 9, 2)[:, 0]
    assert np.abs(ends - corners).max() < 0.6
    moved_px, moved = outline_of(picture(View(at=(0.015, 0.0))), field)
    assert moved.level == Level.ERROR
    assert "shifted by (-15.0, 0.0) mm" in moved.message
    assert np.abs(moved_px - seen_px).max() > 10


def test_the_size_of_parts(field):
    low, high = field.part_px
    assert low == pytest.approx(high) == pytest.approx(0.016 * VIEW.focal / VIEW.distance, rel=0.01)
    assert size_finding((low, high)).level == Level.OK
    assert "allowed: at least 10 px" in size_finding((7.0, 9.0)).message


@pytest.mark.parametrize(
    "view",
    [
        View(at=(0.015, 0.02)),
        View(distance=1.2, roll=14.0),
        View(distance=1.3, tilt_x=20.0, tilt_y=-12.0, at=(0.05, 0.0)),
        View(distance=1.3, roll=-25.0, at=(0.0, -0.1)),
    ],
)
def test_home_is_found_for_any_position_of_the_camera(view):
    corners_px, error = find_plate_corners(picture(view, seed=3), rig_of(VIEW))
    assert np.abs(corners_px - view.see(RIG.plate.corners)).max() < 0.3
    assert error < 5e-4


def test_home_is_not_found_without_the_whole_plate():
    with pytest.raises(CalibrationError, match="not visible on all four sides"):
        find_plate_corners(picture(View(at=(0.3, 0.0))), rig_of(VIEW))
    with pytest.raises(CalibrationError, match="not visible on all four sides"):
        find_plate_corners(np.full((480, 640), 90, np.uint8), rig_of(VIEW))


BOARD = Board(9, 7, 0.03, 0.022)
FOCAL, BEND = 800.0, np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
MATRIX = np.array([[FOCAL, 0, 319.5], [0, FOCAL, 239.5], [0, 0, 1]])


def seen_board(turn_deg, place):
    return board_picture(draw_board(BOARD, 40), BOARD, MATRIX, BEND, turn_deg, place)


POSES = [
    ((0, 0, 0), (0, 0, 0.5)),
    ((0, 25, 0), (0, 0, 0.55)),
    ((0, -25, 0), (0, 0, 0.55)),
    ((25, 0, 0), (0, 0, 0.55)),
    ((-25, 0, 0), (0, 0, 0.55)),
    ((0, 0, 10), (-0.12, -0.08, 0.6)),
    ((0, 0, 0), (0.12, -0.08, 0.6)),
    ((0, 0, 0), (-0.12, 0.08, 0.6)),
    ((0, 0, -10), (0.12, 0.08, 0.6)),
    ((0, 0, 30), (0, 0, 0.8)),
]


def take(pictures, image):
    board, corners = find_board(image, pictures.board, fast=True)
    return pictures.shown(board, corners)


def test_pictures_for_the_lens_differ_and_missing_ones_are_reported():
    pictures = LensPictures(BOARD, (640, 480))
    assert pictures.missing[0] == "hold it in the top left corner"
    assert take(pictures, np.full((480, 640), 150, np.uint8))[1] == "the board is not detected"
    facing = seen_board(*POSES[0])
    pictures, text = take(pictures, facing)
    assert text == "hold the board still"
    pictures, text = take(pictures, facing)
    assert text == "picture 1 taken"
    assert pictures.tilts == frozenset()
    pictures, text = take(pictures, facing)
    assert text.startswith("similar to an earlier picture")
    assert len(pictures.kept) == 1
    pictures, text = take(pictures, seen_board(*POSES[1]))
    assert text == "hold the board still"  # it moves
    with pytest.raises(CalibrationError, match="allowed: at least 5"):
        pictures.fit()


def test_a_tilt_is_named_by_the_side_that_is_nearer():
    for (turn, place), side in zip(POSES[1:5], ("right", "left", "top", "bottom"), strict=True):
        pictures = LensPictures(BOARD, (640, 480))
        for _ in range(2):
            pictures, _ = take(pictures, seen_board(turn, place))
        corner = pictures.places[0].reshape(4, 2)  # from the top left, clockwise
        names = ("top", "right", "bottom", "left")
        long = np.linalg.norm(np.roll(corner, -1, axis=0) - corner, axis=1)
        length = dict(zip(names, long.tolist(), strict=True))
        opposite = {"top": "bottom", "bottom": "top", "left": "right", "right": "left"}[side]
        assert length[side] > 1.1 * length[opposite]  # nearer objects look larger
        assert pictures.tilts == {side}


def test_ten_pictures_determine_the_lens():
    pictures = LensPictures(BOARD, (640, 480))
    for pose in POSES:
        for _ in range(2):
            pictures, text = take(pictures, seen_board(*pose))
        assert text.endswith("taken")
    assert pictures.missing == ()
    fit = pictures.fit()
    assert fit.error_px < 0.3
    assert fit.lens.matrix[0, 0] == pytest.approx(FOCAL, rel=0.01)
    assert fit.lens.distortion[0] == pytest.approx(BEND[0], abs=0.02)
