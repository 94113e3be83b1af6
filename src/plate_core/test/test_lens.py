"""The lens compared with OpenCV's, and the pose of the camera computed from the corners."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core import RigError, load_rig
from plate_core.rig import (
    LENS_MODELS,
    Lens,
    camera_pose,
    camera_position,
    homography,
    lens_of_matrix,
    project,
    to_image,
)

RATIONAL = (0.5, -0.2, 1e-3, -2e-3, 0.01, 0.8, -0.1, 0.02)
PRISM = (0.01, -0.02, 0.03, 0.01)
STRONG = Lens((600.0, 605.0), (318.0, 243.0), (-0.3, 0.09, 1e-3, -2e-3, 0.01))
LENSES = [
    STRONG,
    Lens((600.0, 600.0), (320.0, 240.0), (0.3, 0.0, 0.0, 0.0, 0.0)),
    Lens((900.0, 890.0), (300.0, 250.0), (0.1, -0.2, -3e-3, 1e-3, 0.3)),
    Lens((350.0, 350.0), (319.5, 239.5), (1.0, 0.0, 0.0, 0.0)),
    Lens((600.0, 605.0), (318.0, 243.0), (-0.3, 0.09, 1e-3, -2e-3, 0.01), "rational_polynomial"),
    Lens((600.0, 590.0), (318.0, 243.0), (*RATIONAL,), "rational_polynomial"),
    Lens((600.0, 590.0), (318.0, 243.0), (*RATIONAL, *PRISM), "rational_polynomial"),
    Lens((600.0, 590.0), (318.0, 243.0), (*RATIONAL, *PRISM, 0.1, -0.15), "rational_polynomial"),
    Lens((300.0, 305.0), (318.0, 243.0), (), "equidistant"),
    Lens((300.0, 305.0), (318.0, 243.0), (0.05, -0.02, 0.01, -0.003), "equidistant"),
]
"""One for each model and number of values."""

TURN, PLACE = np.array([3.05, 0.04, -0.03]), np.array([0.01, -0.005, 0.65])
"""Of plate_home in the camera's frame: rotation vector [rad], translation [m]."""


@pytest.fixture(name="pixels")
def _pixels():
    return np.random.default_rng(0).uniform([0, 0], [640, 480], (300, 2))


def through_opencv(lens, points, turn, position):
    """Where OpenCV sees points (n, 3) [m]."""
    values = np.array(lens.distortion)
    if lens.model == "equidistant":
        seen = cv2.fisheye.projectPoints(points[:, None], turn, position, lens.matrix, values)
    else:
        seen = cv2.projectPoints(points, turn, position, lens.matrix, values)
    return seen[0].reshape(-1, 2)


def seen_by_opencv(lens, points):
    return through_opencv(lens, np.column_stack([points, np.zeros(len(points))]), TURN, PLACE)


def rig_with(lens):
    """The default plate as an ideal camera with this lens sees it."""
    rig = load_rig()
    corners = tuple(map(tuple, seen_by_opencv(lens, rig.plate.corners).tolist()))
    return replace(rig, camera=replace(rig.camera, corners_px=corners, lens=lens))


@pytest.mark.parametrize("lens", LENSES)
def test_bends_as_opencv(lens, pixels):
    rays = np.column_stack([(pixels - lens.centre_px) / lens.focal_px, np.ones(len(pixels))])
    seen = through_opencv(lens, rays, np.zeros(3), np.zeros(3))
    assert np.allclose(lens.bend(pixels), seen, atol=1e-9)
    assert np.allclose(lens.straighten(seen), pixels, atol=1e-9)
    assert np.abs(seen - pixels).max() > 5


@pytest.mark.parametrize("lens", LENSES)
def test_straighten_inverts_bend(lens, pixels):
    pixels = pixels[np.all(np.isfinite(lens.straighten(pixels)), axis=1)]
    assert len(pixels) >= 290  # the other points are outside of the lens's image
    assert np.allclose(lens.bend(lens.straighten(pixels)), pixels, atol=1e-9)
    pixels = pixels[:290]
    grid = pixels.reshape(29, 10, 2)
    assert np.array_equal(lens.straighten(grid).reshape(-1, 2), lens.straighten(pixels))


@pytest.mark.parametrize("lens", LENSES)
def test_slopes_are_those_of_bending(lens, pixels):
    h = 1e-4
    for axis in range(2):
        step = h * np.eye(2)[axis]
        slope = (lens.bend(pixels + step) - lens.bend(pixels - step)) / (2 * h)
        assert np.allclose(lens.slopes(pixels)[..., axis], slope, atol=1e-7)


def test_points_beyond_the_image_of_a_lens_are_nan():
    """r (1 - 0.3 r2) grows to r = 1.054, where it is 0.703: nothing is seen beyond that."""
    lens = Lens((100.0, 100.0), (0.0, 0.0), (-0.3, 0.0, 0.0, 0.0, 0.0))
    straight = lens.straighten(np.array([[70.0, 0.0], [0.0, -70.0], [70.5, 0.0], [60.0, 60.0]]))
    assert np.array_equal(np.isnan(straight[:, 0]), [False, False, True, True])


def test_an_equidistant_lens_sees_angles():
    """x' = atan(r): 45 degrees off the axis a ray is seen at f pi / 4."""
    lens = Lens((400.0, 400.0), (320.0, 240.0), (0.0, 0.0, 0.0, 0.0), "equidistant")
    assert lens.bends
    assert np.allclose(lens.bend([720.0, 240.0]), [320 + 100 * np.pi, 240])
    centre = np.array([[320.0, 240.0], [320.0 + 1e-9, 240.0]])
    assert np.allclose(lens.straighten(centre), centre, atol=1e-12)
    assert np.isnan(lens.straighten([320.0 + 400 * np.pi / 2, 240.0])).all()  # 90 degrees


def test_if_the_distortion_is_ambiguous_the_branch_near_the_axis_counts():
    """r (1 - r2 / 2 + r2^2 / 20) grows to 0.566 at r = 0.874, and again from 2.29 on: steps from
    the seen point may end on either side."""
    lens = Lens((300.0, 300.0), (320.0, 240.0), (-0.5, 0.05, 0.0, 0.0, 0.0))
    r = np.linspace(0, 0.87, 50)
    ray = np.column_stack([r * np.cos(7 * r), r * np.sin(7 * r)])
    straight = 300 * ray + [320, 240]
    assert np.allclose(lens.straighten(lens.bend(straight)), straight, atol=1e-7)
    r = np.linspace(2.8, 4.0, 20)  # seen where nothing on the axis's side is
    beyond = np.column_stack([320 + 300 * r, np.full(20, 240.0)])
    seen = lens.bend(beyond)
    assert np.isnan(lens.straighten(seen[seen[:, 0] > 320 + 300 * 0.58])).all()


def test_a_plate_beyond_the_fold_is_folded_although_the_image_grows_there():
    """r - 0.565 r^3 + 0.139 r^5 grows up to r = 1, and again from 1.2 on."""
    lens = Lens((400.0, 400.0), (320.0, 240.0), (-61 / 108, 5 / 36, 0.0, 0.0, 0.0))
    square = np.array([[-20.0, -20], [20, -20], [20, 20], [-20, 20]])
    assert lens.folds(square + [320 + 400 * 0.9, 240], straight=True) == ""
    assert "folds" in lens.folds(square + [320 + 400 * 1.33, 240], straight=True)


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial"])
def test_zeros_of_any_number_are_no_distortion(model):
    for count in (0, 4, 5, 8, 12, 14):
        lens = Lens((600.0, 600.0), (320.0, 240.0), (0.0,) * count, model)
        assert not lens.bends
        assert len(lens.distortion) in LENS_MODELS[model]
    assert not Lens((600.0, 600.0), (320.0, 240.0), (), "").bends


@pytest.mark.parametrize(
    ("matrix", "distortion", "model", "words"),
    [
        (np.eye(2), [], "plumb_bob", r"lens: K is \[\[1.0, 0.0\], .*allowed: \[fx, 0, cx\]"),
        (np.array([[9, 1, 0], [0, 9, 0], [0, 0, 1.0]]), [], "plumb_bob", "lens: K is .*allowed: "),
        (np.diag([9, 9, 0.0]), [], "plumb_bob", "lens: K is .*allowed: "),
        (np.diag([0, 9, 1.0]), [], "plumb_bob", "lengths are 0 and 9 px, allowed: 10 px or m"),
        (np.diag([9, np.inf, 1.0]), [], "plumb_bob", "lens: .* of K are .*allowed: "),
        (np.diag([9, 9, 1.0]), [0.1], "plumb_bob", "distortion has 1 values, allowed: 4 or 5 for"),
        (np.diag([9, 9, 1.0]), [0.1] * 8, "plumb_bob", "has 8 values, allowed: 4 or 5 for plumb"),
        (np.diag([9, 9, 1.0]), [0.1] * 6, "rational_polynomial", "allowed: 5 or 8 or 12 or 14 for"),
        (np.diag([9, 9, 1.0]), [0.1] * 5, "equidistant", "has 5 values, allowed: 4 for equidist"),
        (np.diag([9, 9, 1.0]), [0.1] * 4, "fisheye", "distortion_model is 'fisheye', allowed: pl"),
        (np.diag([9, 9, 1.0]), [0.0] * 4, "fisheye", "distortion_model is 'fisheye', allowed: pl"),
        (np.diag([9, 9, 1.0]), [0.1] * 4, "", "distortion_model is '', allowed: plumb_bob, "),
        (np.diag([9, 9, 1.0]), [np.nan] * 4, "plumb_bob", "distortion is .*allowed: numbers from"),
    ],
)
def test_an_invalid_lens_is_refused(matrix, distortion, model, words):
    with pytest.raises(RigError, match=words):
        lens_of_matrix(matrix, distortion, model)


def test_points_beyond_a_pole_of_the_lens_are_not_visible():
    """r (1 + r2) / (1 - r2) grows to infinity at r = 1, so every visible point has a ray below
    it."""
    lens = Lens((100.0, 100.0), (0.0, 0.0), (1, 0, 0, 0, 0, -1, 0, 0), "rational_polynomial")
    r = np.array([0.0, 0.3, 0.7, 0.9, 0.99])
    straight = 100 * np.column_stack([r * np.cos(r), r * np.sin(r)])
    assert np.allclose(lens.straighten(lens.bend(straight)), straight, atol=1e-7)
    assert lens.folds(75 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]]), straight=True)
    assert not lens.folds(60 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]]), straight=True)


@pytest.mark.parametrize("side", [0.6, 0.9, 1.02, 1.3])
def test_folding_is_found_where_it_is(side):
    """r (1 - r2 / 3) folds at r = 1: squares about the axis whose corners are nearer do not
    reach it."""
    lens = Lens((100.0, 100.0), (0.0, 0.0), (-1 / 3, 0.0, 0.0, 0.0, 0.0))
    square = side / 1.1 * 100 / np.sqrt(2) * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]])
    assert bool(lens.folds(square, straight=True)) == (side > 1)
    if side < 1:
        assert not lens.folds(lens.bend(square))
    assert lens.folds(square / np.abs(square) * 48)  # r = 2 / 3 is the last that is seen
    assert not Lens(lens.focal_px, lens.centre_px).folds(square)
    assert not Lens(lens.focal_px, lens.centre_px, (), "equidistant").folds(square, straight=True)


def test_a_tilted_mirror_image_is_no_lens():
    """Tangential terms fold off the axis too, where the radial part does not."""
    lens = Lens((100.0, 100.0), (0.0, 0.0), (0.0, 0.0, 0.0, 0.4, 0.0))
    square = 60.0 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1.0]])
    assert "folds the image of the plate, allowed: " in lens.folds(square, straight=True)


@pytest.mark.parametrize("lens", LENSES)
def test_corners_determine_homography_and_pose(lens):
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
    """camera_info and the places of the corners agree to a hundredth of a pixel."""
    rig = load_rig()
    rotation, translation = camera_pose(rig)
    corners = np.column_stack([rig.plate.corners, np.zeros(4)])
    lens = rig.camera.lens
    seen = through_opencv(lens, corners, cv2.Rodrigues(rotation)[0], translation)
    assert np.abs(seen - rig.camera.corners_px).max() < 0.02


def rig_seen_from(tilt_deg, about_deg, height=0.8, focal=900.0, roll_deg=3.0, **camera):
    """The default rig, and the place of a camera (3,) that looks at the plate's middle, tilted from
    straight above towards a direction; corners by OpenCV's projection."""
    rig, (tilt, about, roll) = load_rig(), np.radians([tilt_deg, about_deg, roll_deg])
    reach = height * np.tan(tilt)
    position = np.array([reach * np.cos(about), reach * np.sin(about), height])
    ahead = -position / np.linalg.norm(position)
    right = np.array([np.cos(roll), np.sin(roll), 0.0])
    right -= ahead * (right @ ahead)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    corners = np.column_stack([rig.plate.corners, np.zeros(4)])
    vector = cv2.Rodrigues(rotation)[0]
    seen = cv2.projectPoints(corners, vector, -rotation @ position, matrix, np.zeros(5))[0][:, 0]
    corners_px = tuple(map(tuple, seen.tolist()))
    changed = replace(rig.camera, **({"corners_px": corners_px, "lens": None} | camera))
    return replace(rig, camera=changed), position, matrix


@pytest.mark.parametrize("lens", LENSES)
def test_place_with_a_lens(lens):
    """The centre of projection is -R^T t of OpenCV's pose."""
    position = camera_position(rig_with(lens))
    assert np.allclose(position, -cv2.Rodrigues(TURN)[0].T @ PLACE, atol=1e-9)


@pytest.mark.parametrize("about", [0, 50, 90, 200])
@pytest.mark.parametrize("tilt", [0, 1, 15, 30, 44])
def test_place_by_height_alone(tilt, about):
    rig, position, _ = rig_seen_from(tilt, about, height_m=0.8)
    assert np.allclose(camera_position(rig), position, atol=1e-6)


@pytest.mark.parametrize("about", [0, 50, 90, 200])
@pytest.mark.parametrize("tilt", [25, 35, 55])
def test_place_by_perspective_alone(tilt, about):
    rig, position, _ = rig_seen_from(tilt, about)
    assert np.allclose(camera_position(rig), position, atol=1e-6)
    lens = Lens((900.0, 900.0), (319.5, 239.5))
    known = replace(rig, camera=replace(rig.camera, lens=lens))
    assert np.allclose(camera_position(known), position, atol=1e-9)


@pytest.mark.parametrize(("tilt", "height"), [(0, 0.8), (4, 0.8), (10, 5.0)])
def test_without_perspective_the_camera_position_is_unknown(tilt, height):
    """A camera straight above, nearly so, or far away: a pixel of a corner decides."""
    rig, _, _ = rig_seen_from(tilt, 30, height, focal=900 * height / 0.8)
    assert camera_position(rig) is None


def test_place_gives_the_parallax_of_opencv():
    """A point h above the plate is seen where the plate's point c + (p - c) H/(H - h) is."""
    rig, _, _ = rig_seen_from(25, 40, height_m=0.8)
    points = np.random.default_rng(3).uniform(-1, 1, (50, 2)) * rig.plate.half
    known, _, matrix = rig_seen_from(25, 40, lens=Lens((900.0, 900.0), (319.5, 239.5)))
    rotation, translation = camera_pose(known)
    above = np.column_stack([points, np.full(50, 0.012)])
    vector = cv2.Rodrigues(rotation)[0]
    seen = cv2.projectPoints(above, vector, translation, matrix, np.zeros(5))[0][:, 0]
    x, y, height = camera_position(rig)
    middle = np.array([x, y])
    shifted = middle + (points - middle) * height / (height - 0.012)
    assert np.abs(to_image(rig, shifted) - seen).max() < 1e-3
    assert np.abs(to_image(rig, points) - seen).max() > 3
