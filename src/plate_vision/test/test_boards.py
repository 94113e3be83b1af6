"""Lenses from pictures of boards, traced through a lens that is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_vision import CalibrationError, Lens
from plate_vision.camera import Board, draw_board, find_board, fit_lens
from plate_vision.camera.boards import choose_pictures

MATRIX = np.array([[620.0, 0, 331.0], [0, 610.0, 236.0], [0, 0, 1]])
BENT = [-0.22, 0.06, 0.0008, -0.0006, 0.0]
CHESS = Board(9, 7, 0.03)
CHARUCO = Board(9, 7, 0.03, 0.022)
SQUARE_PX = 60


def poses(count, rng):
    """Turns and places of a board before the camera: tilted to all sides, in all corners."""
    for k in range(count):
        tilt = np.deg2rad(rng.uniform(15, 35))
        side = 2 * np.pi * k / count
        turn = cv2.Rodrigues(tilt * np.array([np.cos(side), np.sin(side), 0.3]))[0]
        turn = turn @ np.diag([1.0, -1, -1])  # y of the print is up, the camera's is down
        x, y = 0.10 * np.cos(2.4 * k), 0.07 * np.sin(2.4 * k)
        yield turn, np.array([x, y, rng.uniform(0.36, 0.46)])


def sights(board, make_scene, rng, count=14, lens=(MATRIX, BENT)):
    picture = draw_board(board, SQUARE_PX)
    rows, columns = picture.shape
    size = np.array([columns, rows]) / SQUARE_PX * board.square_m
    scene = make_scene(picture, size, *lens)
    for turn, move in poses(count, rng):
        yield scene.take(turn, move, rng, blur=0.7, noise=3.0), turn, move


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chess", "charuco"])
def test_lens_is_found(board, make_scene, rng):
    """Where it matters: rays through the image are seen within 0.1 px of where they are."""
    found = []
    for image, turn, move in sights(board, make_scene, rng):
        sight = find_board(image, board)[1]
        if sight is None:
            continue
        found.append(sight)
        which, place = sight
        # Corners from the board's middle, y up, as the print lies in the scene.
        middle = 0.5 * board.square_m * np.array([board.columns, board.rows])
        point = (board.corners[which] - middle) * [1, -1]
        space = np.column_stack([point, np.zeros(len(point))])
        true = cv2.projectPoints(space, cv2.Rodrigues(turn)[0], move, MATRIX, np.array(BENT))[0]
        error = np.linalg.norm(place - true[:, 0], axis=1)
        assert np.median(error) < 0.08
        assert error.max() < 0.35
    assert len(found) >= 10
    fit = fit_lens(board, found, (640, 480))
    assert fit.error_px < 0.15
    assert len(fit.errors) == len(found)
    assert fit.warning is None
    space = np.column_stack([board.corners, np.zeros(len(board.corners))]).astype(np.float32)
    theirs = cv2.calibrateCameraExtended(
        [space[which] for which, _ in found],
        [place.astype(np.float32)[:, None] for _, place in found],
        (640, 480), np.eye(3), np.zeros(5),
    )[5]  # fmt: skip
    ratio = np.ravel(theirs)[:9] / fit.deviation  # OpenCV before 5 counts half as many errors
    assert np.allclose(ratio, ratio[0], rtol=0.05)
    assert 0.95 < ratio[0] < 1.6
    truth = Lens(MATRIX, np.array(BENT))
    grid = np.stack(np.meshgrid(np.linspace(60, 580, 9), np.linspace(50, 430, 7)), axis=2)
    # Both lenses undistort; a plane homography can absorb the difference between K and a pose.
    ours, theirs = (lens.straighten(grid.reshape(-1, 2)) for lens in (fit.lens, truth))
    matrix, _ = cv2.findHomography(ours, theirs)
    moved = np.column_stack([ours, np.ones(len(ours))]) @ matrix.T
    assert np.abs(moved[:, :2] / moved[:, 2:] - theirs).max() < 0.15
    assert np.all(np.abs(np.diag(fit.lens.matrix)[:2] - [620, 610]) < 4 * fit.deviation[:2] + 2)


WIDE = np.array([[330.0, 0, 322.0], [0, 328.0, 241.0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "bend"),
    [
        ("rational_polynomial", [0.25, 0.05, 1e-3, -5e-4, 0.0, 0.6, 0.05, 0.0]),
        ("equidistant", [0.03, -0.01, 0.004, -0.001]),
    ],
)
def test_lenses_of_other_models_are_found(model, bend, make_scene, rng):
    """A wide lens, 88 degrees across: rays within 0.25 px of where OpenCV has them, and deviations
    that cover the errors."""
    fisheye = model == "equidistant"
    found = []
    for k, (turn, move) in enumerate(poses(18, rng)):
        picture = draw_board(CHARUCO, SQUARE_PX)
        size = np.array(picture.shape[::-1]) / SQUARE_PX * CHARUCO.square_m
        scene = make_scene(picture, size, WIDE, bend, fisheye)
        move = move * [1.3, 1.3, 0.5 if k % 2 else 0.65]
        sight = find_board(scene.take(turn, move, rng, blur=0.6, noise=2.0), CHARUCO)[1]
        if sight is not None:
            found.append(sight)
    assert len(found) >= 12
    fit = fit_lens(CHARUCO, found, (640, 480), model)
    assert fit.error_px < 0.3
    assert fit.lens.model == model
    truth = Lens(WIDE, np.array(bend), model)
    off = fit.lens.matrix - WIDE
    assert np.all(np.abs([off[0, 0], off[1, 1]]) < 5 * fit.deviation[:2] + 0.5)
    assert len(fit.deviation) == 4 + len(bend)
    grid = np.stack(np.meshgrid(np.linspace(80, 560, 9), np.linspace(60, 420, 7)), axis=2)
    ours, theirs = (lens.straighten(grid.reshape(-1, 2)) for lens in (fit.lens, truth))
    matrix, _ = cv2.findHomography(ours, theirs)
    moved = np.column_stack([ours, np.ones(len(ours))]) @ matrix.T
    back = truth.bend(moved[:, :2] / moved[:, 2:])
    assert np.abs(back - grid.reshape(-1, 2)).max() < 0.25


def test_a_rational_lens_has_as_many_values_as_the_pictures_determine(make_scene):
    """Of these pictures all eight would leave a pole inside the image: it is folded nowhere."""
    rng = np.random.default_rng(20261121)
    bend = [0.25, 0.05, 1e-3, -5e-4, 0.0, 0.6, 0.05, 0.0]
    picture = draw_board(CHARUCO, SQUARE_PX)
    size = np.array(picture.shape[::-1]) / SQUARE_PX * CHARUCO.square_m
    scene = make_scene(picture, size, WIDE, bend)
    sights = []
    for turn, move in poses(9, rng):
        sight = find_board(scene.take(turn, move * [1, 1, 0.65], rng), CHARUCO)[1]
        sights += [] if sight is None else [sight]
    fit = fit_lens(CHARUCO, sights, (640, 480), "rational_polynomial")
    corners = np.array([[0, 0], [639, 0], [639, 479], [0, 479.0]])
    assert np.all(np.isfinite(fit.lens.straighten(corners)))
    assert len(fit.lens.distortion) == 8
    assert fit.warning is None
    assert np.all(np.isfinite(fit.deviation))


def opencv_board(columns, rows, legacy):
    """As OpenCV draws it; before 4.8 it knows only one pattern."""
    shape, known = (columns, rows), cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    if not hasattr(getattr(cv2.aruco, "CharucoBoard", None), "setLegacyPattern"):
        white = legacy and rows % 2 == 0
        return draw_board(Board(*shape, 0.03, 0.022, white_first=white), SQUARE_PX)
    board = cv2.aruco.CharucoBoard(shape, 0.03, 0.022, known)
    board.setLegacyPattern(legacy)
    picture = board.generateImage((columns * SQUARE_PX, rows * SQUARE_PX))
    return np.pad(picture, SQUARE_PX // 2, constant_values=255)


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (8, 6), (9, 7)])
def test_boards_that_begin_white_are_recognised(columns, rows, legacy, make_scene, rng):
    """OpenCV's legacy pattern begins white where the number of rows is even."""
    picture = opencv_board(columns, rows, legacy)
    white = picture[SQUARE_PX // 2 + 3, SQUARE_PX // 2 + 3] == 255
    assert white == (legacy and rows % 2 == 0)
    board = Board(columns, rows, 0.03, 0.022)
    assert np.mean(draw_board(replace(board, white_first=white), SQUARE_PX) != picture) < 0.03
    size = np.array(picture.shape[::-1]) / SQUARE_PX * 0.03
    turn, move = next(poses(1, rng))
    image = make_scene(picture, size, MATRIX, BENT).take(turn, move, rng)
    printed, (which, place) = find_board(image, board)
    assert printed == replace(board, white_first=white)
    middle = 0.5 * 0.03 * np.array([columns, rows])
    point = (board.corners[which] - middle) * [1, -1]
    space = np.column_stack([point, np.zeros(len(point))])
    true = cv2.projectPoints(space, cv2.Rodrigues(turn)[0], move, MATRIX, np.array(BENT))[0]
    assert np.linalg.norm(place - true[:, 0], axis=1).max() < 0.35
    assert len(which) > 0.9 * len(board.corners)
    assert find_board(np.full_like(image, 200), printed) == (printed, None)  # as the one before
    with pytest.raises(CalibrationError, match=f"they fit {columns}x{rows}.*allowed: "):
        find_board(image, Board(rows, columns, 0.03, 0.022))


def test_pictures_that_differ_most_are_chosen(rng):
    """Of a board that stays in one place for long, then moves: every place is chosen."""
    grid = np.array([[x, y] for x in (0, 150, 300) for y in (0, 100, 200)], dtype=float)
    which = np.arange(len(CHESS.corners))
    still = [(which, 60 + 3000 * CHESS.corners + rng.normal(0, 0.1, (48, 2))) for _ in range(200)]
    moved = [(which, 60 + 3000 * CHESS.corners + place) for place in grid]
    seen = [*still, *moved]
    chosen = choose_pictures(seen, CHESS, 12)
    assert len(chosen) == len(set(chosen)) == 12
    assert set(chosen) >= set(range(201, 209))
    assert choose_pictures(seen[:40], CHESS) == list(range(40))
    assert len(choose_pictures(seen, CHESS)) == 40


def test_boards_are_those_of_opencv():
    """The layout is that of OpenCV's own ChArUco boards."""
    shape = (CHARUCO.columns, CHARUCO.rows)
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    size = (CHARUCO.columns * SQUARE_PX, CHARUCO.rows * SQUARE_PX)
    if hasattr(cv2.aruco, "CharucoBoard_create"):
        theirs = cv2.aruco.CharucoBoard_create(*shape, 0.03, 0.022, known).draw(size)
    else:
        theirs = cv2.aruco.CharucoBoard(shape, 0.03, 0.022, known).generateImage(size)
    half = SQUARE_PX // 2
    ours = draw_board(CHARUCO, SQUARE_PX)[half:-half, half:-half]
    assert np.mean(ours != theirs) < 0.03  # except for a pixel at the markers' edges


def test_corners_of_half_covered_boards(make_scene, rng):
    image, _, _ = next(sights(CHARUCO, make_scene, rng, 1))
    which, place = find_board(image, CHARUCO)[1]
    image[:, :320] = 128
    part, seen = find_board(image, CHARUCO)[1]
    assert 6 <= len(part) < len(which)
    same = dict(zip(which.tolist(), place, strict=True))
    assert all(
        np.linalg.norm(same[k] - p) < 0.2
        for k, p in zip(part.tolist(), seen, strict=True)
        if p[0] > 340
    )
    assert find_board(np.full_like(image, 200), CHARUCO)[1] is None
    assert find_board(np.full_like(image, 200), CHESS)[1] is None


def test_pictures_that_determine_no_lens_are_refused(rng):
    which = np.arange(len(CHESS.corners))
    flat = [(which, 60 + 12000 * CHESS.corners[:, :2] * 0.1 + k) for k in range(8)]
    with pytest.raises(CalibrationError, match="allowed: "):
        fit_lens(CHESS, flat, (640, 480))  # always from the front
    with pytest.raises(CalibrationError, match="detected in 4 pictures, allowed: at least 5"):
        fit_lens(CHESS, flat[:4], (640, 480))
    noise = [(which, rng.uniform(0, 480, (len(which), 2))) for _ in range(6)]
    with pytest.raises(CalibrationError, match="allowed: "):
        fit_lens(CHESS, noise, (640, 480))


@pytest.mark.parametrize(
    "wrong", [(2, 7, 0.03, 0), (9, 41, 0.03, 0), (9, 7, 0, 0), (9, 7, 0.03, 0.028)]
)
def test_wrong_boards_are_refused(wrong):
    with pytest.raises(CalibrationError, match=r"board: .*allowed: "):
        Board(*wrong)
