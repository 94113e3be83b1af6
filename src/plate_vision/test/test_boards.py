"""Lenses from pictures of boards, traced through a lens that is known."""

import cv2
import numpy as np
import pytest

from plate_vision import CalibrationError, Lens
from plate_vision.camera import Board, draw_board, find_corners, fit_lens

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


def sights(board, make_scene, rng, count=14):
    picture = draw_board(board, SQUARE_PX)
    rows, columns = picture.shape
    size = np.array([columns, rows]) / SQUARE_PX * board.square_m
    scene = make_scene(picture, size, MATRIX, BENT)
    for turn, move in poses(count, rng):
        yield scene.take(turn, move, rng, blur=0.7, noise=3.0), turn, move


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chess", "charuco"])
def test_lens_is_found(board, make_scene, rng):
    """Where it matters: rays through the image are seen within 0.1 px of where they are."""
    found = []
    for image, turn, move in sights(board, make_scene, rng):
        sight = find_corners(image, board)
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
    truth = Lens(MATRIX, np.array(BENT))
    grid = np.stack(np.meshgrid(np.linspace(60, 580, 9), np.linspace(50, 430, 7)), axis=2)
    # Both lenses straighten; a plane homography may take up what K cannot tell from a pose.
    ours, theirs = (lens.straighten(grid.reshape(-1, 2)) for lens in (fit.lens, truth))
    matrix, _ = cv2.findHomography(ours, theirs)
    moved = np.column_stack([ours, np.ones(len(ours))]) @ matrix.T
    assert np.abs(moved[:, :2] / moved[:, 2:] - theirs).max() < 0.15
    assert np.all(np.abs(np.diag(fit.lens.matrix)[:2] - [620, 610]) < 4 * fit.deviation[:2] + 2)


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
    assert np.mean(ours != theirs) < 0.03  # but for a pixel at the markers' rims


def test_corners_of_half_covered_boards(make_scene, rng):
    image, _, _ = next(sights(CHARUCO, make_scene, rng, 1))
    which, place = find_corners(image, CHARUCO)
    image[:, :320] = 128
    part, seen = find_corners(image, CHARUCO)
    assert 6 <= len(part) < len(which)
    same = dict(zip(which.tolist(), place, strict=True))
    assert all(
        np.linalg.norm(same[k] - p) < 0.2
        for k, p in zip(part.tolist(), seen, strict=True)
        if p[0] > 340
    )
    assert find_corners(np.full_like(image, 200), CHARUCO) is None
    assert find_corners(np.full_like(image, 200), CHESS) is None


def test_what_tells_no_lens_is_refused(rng):
    which = np.arange(len(CHESS.corners))
    flat = [(which, 60 + 12000 * CHESS.corners[:, :2] * 0.1 + k) for k in range(8)]
    with pytest.raises(CalibrationError, match="allowed: "):
        fit_lens(CHESS, flat, (640, 480))  # always from the front
    with pytest.raises(CalibrationError, match="seen in 4 pictures, allowed: at least 5"):
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
