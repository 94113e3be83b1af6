"""The mapping between image and plate against known mappings and a second method."""

import cv2
import numpy as np
import pytest

from plate_core import load_rig
from plate_core.rig import homography
from plate_vision import (
    Calibration,
    CalibrationError,
    Lens,
    calibrate,
    calibrate_by_matrix,
    calibrate_by_rig,
)
from plate_vision.camera.lens import check_quadrilateral

CORNERS = np.array([[-0.3, -0.15], [0.3, -0.15], [0.3, 0.15], [-0.3, 0.15]])
TILTED_PX = np.array([[40.0, 420.0], [610.0, 400.0], [540.0, 80.0], [90.0, 100.0]])
LENS = Lens(
    np.array([[600.0, 0, 318], [0, 605, 243], [0, 0, 1]]), np.array([-0.2, 0.05, 1e-3, -2e-3, 0])
)


@pytest.fixture
def points(rng):
    return rng.uniform([-0.3, -0.15], [0.3, 0.15], (200, 2))


def test_camera_straight_above(points):
    """1000 px per metre, the middle at (320, 240), y of the image down."""
    seen = np.array([[20.0, 390.0], [620.0, 390.0], [620.0, 90.0], [20.0, 90.0]])
    calibration = calibrate(seen, CORNERS)
    expected = np.stack([320 + 1000 * points[:, 0], 240 - 1000 * points[:, 1]], axis=1)
    assert np.allclose(calibration.to_image(points), expected, atol=1e-9)
    assert np.allclose(calibration.to_home(expected), points, atol=1e-12)
    assert np.allclose(calibration.scale(points), 1000)


def test_tilted_camera_agrees_with_opencv(points):
    calibration = calibrate(TILTED_PX, CORNERS)
    matrix = cv2.getPerspectiveTransform(CORNERS.astype(np.float32), TILTED_PX.astype(np.float32))
    expected = cv2.perspectiveTransform(points[:, None], matrix)[:, 0]
    assert np.allclose(calibration.to_image(points), expected, atol=1e-3)  # OpenCV took floats


def test_to_home_inverts_to_image(points):
    for calibration in (
        calibrate(TILTED_PX, CORNERS),
        calibrate(TILTED_PX, CORNERS, LENS),
        calibrate_by_rig(load_rig()),
    ):
        assert np.allclose(calibration.to_home(calibration.to_image(points)), points, atol=1e-7)
        assert calibration.to_home(np.empty((0, 2))).shape == (0, 2)
        assert calibration.to_image(np.empty((0, 2))).shape == (0, 2)


def test_calibrations_by_matrix_and_by_rig_agree():
    rig = load_rig()
    by_rig = calibrate_by_rig(rig)
    assert np.allclose(by_rig.to_image(rig.plate.corners), rig.camera.corners_px, atol=1e-9)
    by_matrix = calibrate_by_matrix(5 * homography(rig))  # the scale of a homography is free
    assert np.allclose(by_matrix.to_image(rig.plate.corners), rig.camera.corners_px, atol=1e-9)
    assert np.allclose(by_matrix.scale(CORNERS), by_rig.scale(CORNERS))


def test_scale_is_that_of_small_areas(points):
    calibration = calibrate(TILTED_PX, CORNERS)
    h = 1e-6
    along_x = calibration.to_image(points + [h, 0]) - calibration.to_image(points - [h, 0])
    along_y = calibration.to_image(points + [0, h]) - calibration.to_image(points - [0, h])
    area = np.abs(along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]) / (2 * h) ** 2
    assert np.allclose(calibration.scale(points), np.sqrt(area), rtol=1e-5)


def test_lens_bends_as_in_the_model(rng):
    """Brown and Conrady's formula, as in OpenCV's and sensor_msgs/CameraInfo's definition."""
    straight = rng.uniform([0, 0], [640, 480], (100, 2))
    k1, k2, p1, p2, k3 = LENS.distortion
    x = (straight[:, 0] - 318) / 600
    y = (straight[:, 1] - 243) / 605
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    seen_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    seen_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    expected = np.stack([600 * seen_x + 318, 605 * seen_y + 243], axis=1)
    assert np.allclose(LENS.bend(straight), expected, atol=1e-9)
    assert np.abs(expected - straight).max() > 10
    assert np.allclose(LENS.straighten(expected), straight, atol=0.01)


def test_lens_is_taken_into_account(points):
    """The image of a bending lens of a plate seen through a known homography."""
    ideal = calibrate(TILTED_PX, CORNERS)
    seen = LENS.bend(ideal.to_image(points))
    calibration = calibrate(LENS.bend(TILTED_PX), CORNERS, LENS)
    assert np.allclose(calibration.to_home(seen), points, atol=1e-5)
    without = calibrate(LENS.bend(TILTED_PX), CORNERS)
    assert np.abs(without.to_home(seen) - points).max() > 1e-3


@pytest.mark.parametrize(
    ("corners_px", "corners", "name"),
    [
        (TILTED_PX[:3], CORNERS, "corners_px"),
        (TILTED_PX[[0, 2, 1, 3]], CORNERS, "corners_px"),
        (TILTED_PX[[0, 0, 2, 3]], CORNERS, "corners_px"),
        (TILTED_PX * 0.01, CORNERS, "corners_px"),
        (TILTED_PX * np.nan, CORNERS, "corners_px"),
        ([[0, 0], [100, 0], [200, 0], [300, 0]], CORNERS, "corners_px"),
        (TILTED_PX, CORNERS[:3], "corners"),
        (TILTED_PX, CORNERS[[0, 2, 1, 3]], "corners"),
        (TILTED_PX, CORNERS * [1, 0], "corners"),
        (TILTED_PX, CORNERS * 0, "corners"),
        (TILTED_PX, CORNERS * np.inf, "corners"),
    ],
)
def test_degenerate_corners_are_refused(corners_px, corners, name):
    with (
        np.errstate(invalid="ignore"),
        pytest.raises(CalibrationError, match=f"^{name}: .*allowed:"),
    ):
        calibrate(np.array(corners_px), corners)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), np.ones((3, 3)), np.eye(2), np.full((3, 3), np.nan)]
)
def test_degenerate_matrices_are_refused(matrix):
    with pytest.raises(CalibrationError, match=r"^homography: .*allowed:"):
        calibrate_by_matrix(matrix)


def test_an_area_of_the_minimum_size_is_allowed():
    square = np.array([[1.0, 1], [5, 1], [5, 5], [1, 5]])
    assert check_quadrilateral(square, "it", CalibrationError, min_area=16.0) is not None
    with pytest.raises(CalibrationError, match=r"at least 16\.1 px2"):
        check_quadrilateral(square, "it", CalibrationError, min_area=16.1)


def test_small_plate_is_no_degenerate_plate():
    assert isinstance(calibrate(TILTED_PX, CORNERS * 1e-3), Calibration)


@pytest.mark.parametrize(
    ("matrix", "distortion"),
    [
        (np.eye(2), np.zeros(5)),
        (np.zeros((3, 3)), np.zeros(5)),
        (np.eye(3), np.full(3, 0.1)),
        (np.eye(3), np.full(5, np.nan)),
        (np.diag([600.0, 600, 0]), np.zeros(5)),
        (np.array([[600.0, 5, 320], [0, 600, 240], [0, 0, 1]]), np.zeros(5)),
    ],
)
def test_wrong_lenses_are_refused(matrix, distortion):
    with pytest.raises(CalibrationError, match=r"^lens: .*allowed:"):
        Lens(matrix, distortion)
