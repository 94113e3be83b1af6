"""The lens against OpenCV's, and the pose of the camera that the corners tell."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core import RigError, load_rig
from plate_core.rig import Lens, camera_pose, homography, project, to_image

STRONG = Lens((600.0, 605.0), (318.0, 243.0), (-0.3, 0.09, 1e-3, -2e-3, 0.01))
LENSES = [
    STRONG,
    Lens((600.0, 600.0), (320.0, 240.0), (0.3, 0.0, 0.0, 0.0, 0.0)),
    Lens((900.0, 890.0), (300.0, 250.0), (0.1, -0.2, -3e-3, 1e-3, 0.3)),
]
TURN, PLACE = np.array([3.05, 0.04, -0.03]), np.array([0.01, -0.005, 0.65])
"""Of plate_home in the camera's frame: rotation vector [rad], translation [m]."""


@pytest.fixture(name="pixels")
def _pixels():
    return np.random.default_rng(0).uniform([0, 0], [640, 480], (300, 2))


def seen_by_opencv(lens, points):
    there = np.column_stack([points, np.zeros(len(points))])
    return cv2.projectPoints(there, TURN, PLACE, lens.matrix, np.array(lens.distortion))[0][:, 0]


def rig_with(lens):
    """The default plate as an ideal camera with this lens sees it."""
    rig = load_rig()
    corners = tuple(map(tuple, seen_by_opencv(lens, rig.plate.corners).tolist()))
    return replace(rig, camera=replace(rig.camera, corners_px=corners, lens=lens))


@pytest.mark.parametrize("lens", LENSES)
def test_bends_as_opencv(lens, pixels):
    rays = np.column_stack([(pixels - lens.centre_px) / lens.focal_px, np.ones(len(pixels))])
    seen = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion)
    )[0][:, 0]
    assert np.allclose(lens.bend(pixels), seen, atol=1e-9)
    assert np.abs(seen - pixels).max() > 5


@pytest.mark.parametrize("lens", LENSES)
def test_straightens_what_it_bends(lens, pixels):
    assert np.allclose(lens.bend(lens.straighten(pixels)), pixels, atol=1e-9)
    grid = pixels.reshape(30, 10, 2)
    assert np.array_equal(lens.straighten(grid).reshape(-1, 2), lens.straighten(pixels))


@pytest.mark.parametrize("lens", LENSES)
def test_slopes_are_those_of_bending(lens, pixels):
    h = 1e-4
    for axis in range(2):
        step = h * np.eye(2)[axis]
        slope = (lens.bend(pixels + step) - lens.bend(pixels - step)) / (2 * h)
        assert np.allclose(lens.slopes(pixels)[..., axis], slope, atol=1e-7)


def test_what_a_lens_does_not_show():
    """r (1 - 0.3 r2) grows to r = 1.054, where it is 0.703: nothing is seen beyond that."""
    lens = Lens((100.0, 100.0), (0.0, 0.0), (-0.3, 0.0, 0.0, 0.0, 0.0))
    straight = lens.straighten(np.array([[70.0, 0.0], [0.0, -70.0], [70.5, 0.0], [60.0, 60.0]]))
    assert np.array_equal(np.isnan(straight[:, 0]), [False, False, True, True])


@pytest.mark.parametrize("lens", LENSES)
def test_corners_tell_all(lens):
    """Homography, image points and pose from the bent corners, against OpenCV's projection."""
    rig = rig_with(lens)
    points = np.random.default_rng(1).uniform(-1, 1, (100, 2)) * rig.plate.half
    seen = seen_by_opencv(lens, points)
    assert np.allclose(to_image(rig, points), seen, atol=1e-8)
    assert np.allclose(project(homography(rig), points), lens.straighten(seen), atol=1e-8)
    rotation, translation = camera_pose(rig)
    assert np.allclose(rotation, cv2.Rodrigues(TURN)[0], atol=1e-9)
    assert np.allclose(translation, PLACE, atol=1e-9)


def test_pose_needs_a_lens():
    rig = load_rig()
    with pytest.raises(RigError, match="focal_px and centre_px are missing"):
        camera_pose(replace(rig, camera=replace(rig.camera, lens=None)))


def test_default_camera_is_a_rigid_one():
    """What camera_info says and where the corners are agree to a hundredth of a pixel."""
    rig = load_rig()
    rotation, translation = camera_pose(rig)
    corners = np.column_stack([rig.plate.corners, np.zeros(4)])
    lens = rig.camera.lens
    seen = cv2.projectPoints(
        corners, cv2.Rodrigues(rotation)[0], translation, lens.matrix, np.array(lens.distortion)
    )[0][:, 0]
    assert np.abs(seen - rig.camera.corners_px).max() < 0.02
