"""Images of the camera through a lens, over an exposure and of other shapes, compared with
OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from dark_parts import BLACK, PLATE, centroid, covered, light_of, ring

from plate_core import PlateError, load_rig
from plate_core.rig import Lens, PartType, homography, moments, project, to_home, to_image, to_plate
from plate_sim import Camera

TURN, PLACE = np.array([3.07, 0.03, 0.02]), np.array([0.004, -0.003, 0.66])
"""Of plate_home in the camera's frame: rotation vector [rad], translation [m]."""

LENSES = [
    Lens((620.0, 625.0), (316.0, 243.0), (-0.3, 0.09, 1e-3, -1e-3, 0.0)),
    Lens((620.0, 620.0), (319.5, 239.5), (0.2, 0.0, 0.0, 0.0, 0.05)),
    Lens((620.0, 620.0), (319.5, 239.5)),
]
ROOM = 60.0
SQUARE = 0.009 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
SQUARE_TYPE = PartType("square", outline=tuple(map(tuple, SQUARE.tolist())), symmetry=4)


def seen(lens, point):
    there = np.column_stack([point, np.zeros(len(point))])
    return cv2.projectPoints(there, TURN, PLACE, lens.matrix, np.array(lens.distortion))[0][:, 0]


def rig_with(lens):
    rig = load_rig()
    corners = tuple(map(tuple, seen(lens, rig.plate.corners).tolist()))
    return replace(rig, camera=replace(rig.camera, lens=lens, corners_px=corners))


def shoot(camera, position, **more):
    position = np.asarray(position, float)
    grey = np.full(position.shape[-2], BLACK)
    return camera.render(position, grey, np.random.default_rng(0), **more).astype(float)


PLACES = np.stack(
    [g.ravel() for g in np.meshgrid(np.linspace(-0.27, 0.27, 6), np.linspace(-0.12, 0.12, 4))], 1
) + np.random.default_rng(5).uniform(-1e-3, 1e-3, (24, 2))


@pytest.mark.parametrize("lens", LENSES)
def test_discs_are_where_opencv_projects_them(lens):
    """Centre of the image of each disc to 0.02 px, its area to 1 %."""
    rig = rig_with(lens)
    camera = Camera(rig, 0.0)
    image = shoot(camera, PLACES)
    for position in PLACES:
        outline = seen(lens, position + ring(rig.parts.radius_m))
        expected, area = centroid(outline)
        centre, weight = covered(camera, image, expected, 15)
        assert np.hypot(*(centre - expected)) < 0.02
        assert weight == pytest.approx(area, rel=0.01)
        # The remaining difference from the image of the disc's centre is the bias of perspective
        # and lens.
        assert np.hypot(*(seen(lens, position[None])[0] - expected)) < 0.1


@pytest.mark.parametrize("lens", LENSES)
def test_the_plate_is_bent_as_the_lens_does(lens):
    """Every pixel off the edges by more than one shows plate or room, wherever the plate is."""
    rig = rig_with(lens)
    camera = Camera(rig, 0.0)
    v, u = np.mgrid[:480, :640].astype(float)
    straight = lens.straighten(np.stack([u.ravel(), v.ravel()], axis=1))
    home = project(np.linalg.inv(homography(rig)), straight)
    for pose in (None, np.array([0.009, -0.006, 0.012]), np.array([-0.03, 0.02, -0.1])):
        image = shoot(camera, np.zeros((0, 2)), pose=pose)
        point = home if pose is None else to_plate(pose, home)
        inside = np.min(rig.plate.half - np.abs(point), axis=1).reshape(480, 640)
        grey = np.where(inside > 0, PLATE, ROOM) * light_of(camera)
        clear = np.abs(inside) > 1.5e-3
        assert np.count_nonzero(clear) > 290_000
        assert np.abs(image - grey)[clear].max() <= 0.51
    corner = np.round(seen(lens, 0.985 * rig.plate.corners)).astype(int)
    assert np.all(shoot(camera, np.zeros((0, 2)))[corner[:, 1], corner[:, 0]] > 180)


def test_no_distortion_changes_nothing():
    rig = rig_with(LENSES[2])
    plain = replace(rig, camera=replace(rig.camera, lens=None))
    a, b = (shoot(Camera(r, 2.0), PLACES, velocity=0 * PLACES + 0.5) for r in (rig, plain))
    assert np.array_equal(a, b)


def test_blur_is_the_mean_over_the_exposure():
    """Parts on a bent way and a plate that vibrates: the mean of 65 sharp images."""
    rig = rig_with(LENSES[0])
    camera = Camera(rig, 0.0)
    phase = np.linspace(0, 1, 65)[:, None]
    poses = np.hstack([0.002 * phase, 0.0015 * np.sin(3 * phase), 0.01 * phase**2])
    middle = np.array([[0.1, 0.05], [-0.2, -0.1]])
    paths = np.stack([to_home(pose, middle) for pose in poses])
    blurred = shoot(camera, paths, pose=poses)
    sharp = np.mean([shoot(camera, p, pose=q) for p, q in zip(paths, poses, strict=True)], axis=0)
    assert np.abs(blurred - sharp).max() < 8  # of 160 grey values: 16 positions for 65
    assert np.abs(blurred - sharp).mean() < 0.1
    still = shoot(camera, paths[0], pose=poses[0])
    assert np.abs(still - sharp).max() > 50


def test_two_positions_are_a_velocity():
    rig = rig_with(LENSES[0])
    camera = Camera(rig, 0.0)
    velocity = np.full(PLACES.shape, 0.8)
    path = np.stack([PLACES, PLACES + rig.camera.exposure_s * velocity])
    assert np.array_equal(shoot(camera, path), shoot(camera, PLACES, velocity=velocity))


@pytest.mark.parametrize("lens", LENSES)
def test_polygons_are_drawn_as_they_lie(lens):
    camera = Camera(rig_with(lens), 0.0)
    angle = np.linspace(0, 6, len(PLACES))
    image = shoot(camera, PLACES, angle=angle, types=[SQUARE_TYPE] * len(PLACES))
    side = np.linspace(0, 1, 20, endpoint=False)[:, None]
    edge = (SQUARE[:, None] + side * (np.roll(SQUARE, -1, axis=0) - SQUARE)[:, None]).reshape(-1, 2)
    for position, turn in zip(PLACES, angle, strict=True):
        expected, area = centroid(seen(lens, to_home(np.append(position, turn), edge)))
        centre, weight = covered(camera, image, expected, 15)
        assert (
            np.hypot(*(centre - expected)) < 0.05
        )  # more than a disc's: corners are sharper than a pixel
        assert weight == pytest.approx(area, rel=0.015)


def test_pieces_side_by_side_have_no_seam():
    """A bracket is two convex pieces; drawn as a disc less nothing it would be as dark all over."""
    camera, position = Camera(load_rig(), 0.0), np.array([[0.013, 0.021]])
    corner = np.array([[0, 0], [0.03, 0], [0.03, 0.012], [0.012, 0.012], [0.012, 0.03], [0, 0.03]])
    corner = corner - moments(corner)[1]
    bracket = PartType("bracket", outline=tuple(map(tuple, corner)))
    image = shoot(camera, position, angle=np.zeros(1), types=[bracket])
    inner = np.array([[0.006, t] for t in np.linspace(0.004, 0.026, 12)])  # across the seam
    inner = (
        inner
        - moments(
            np.array([[0, 0], [0.03, 0], [0.03, 0.012], [0.012, 0.012], [0.012, 0.03], [0, 0.03]])
        )[1]
        + position
    )
    u, v = np.round(to_image(load_rig(), inner)).astype(int).T
    assert np.ptp(image[v, u]) <= 2


def test_the_plate_is_visible_through_a_hole():
    camera, position = Camera(load_rig(), 0.0), np.array([[0.013, 0.021]])
    turn = 2 * np.pi * np.arange(12) / 12
    hole = tuple(zip(0.006 * np.cos(turn), 0.006 * np.sin(turn), strict=True))
    full = PartType("washer", radius_m=0.012, symmetry=0)
    u, v = np.round(to_image(load_rig(), position)).astype(int)[0]
    bare, whole, ring = (
        shoot(camera, places, angle=np.zeros(len(places)), types=[kind] * len(places))
        for places, kind in (
            (np.zeros((0, 2)), full), (position, full), (position, replace(full, holes=(hole,)))
        )
    )  # fmt: skip
    assert whole[v, u] < bare[v, u] - 50
    assert ring[v, u] == bare[v, u]
    assert np.array_equal(ring[v, u + 9 : u + 30], whole[v, u + 9 : u + 30])


@pytest.mark.parametrize("lens", LENSES)
def test_a_mark_shows_a_discs_angle(lens):
    rig = rig_with(lens)
    camera = Camera(rig, 0.0)
    angle = np.linspace(-3, 3, len(PLACES))
    bare, marked = shoot(camera, PLACES), shoot(camera, PLACES, angle=angle)
    for position, turn in zip(PLACES, angle, strict=True):
        u, v = np.round(seen(lens, position[None])[0]).astype(int)
        window = np.s_[v - 14 : v + 15, u - 14 : u + 15]
        weight = ((marked - bare) / light_of(camera))[window]
        y, x = np.mgrid[window]
        point = np.array([[np.sum(weight * x), np.sum(weight * y)]]) / weight.sum()
        straight = lens.straighten(point)
        toward = project(np.linalg.inv(homography(rig)), straight)[0] - position
        assert np.hypot(*toward) == pytest.approx(0.5 * rig.parts.radius_m, rel=0.02)
        assert abs(np.angle(np.exp(1j * (np.arctan2(toward[1], toward[0]) - turn)))) < 0.02


def test_frames_agree_with_the_camera():
    lens = LENSES[0]
    assert np.allclose(to_image(rig_with(lens), PLACES), seen(lens, PLACES), atol=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": [[0, 0], [np.nan, 0]]}, "position: .*finite"),
        ({"velocity": [[0, 0], [np.inf, 0]]}, "velocity: value of part 1 is .*finite"),
        ({"velocity": [[0, 0]]}, r"velocity: shape is \(1, 2\), allowed: \(2, 2\)"),
        ({"grey": [40]}, r"grey: shape is \(1,\), allowed: \(2,\)"),
        ({"pose": [0, np.nan, 0]}, "pose: .*finite"),
        ({"pose": [0, 1]}, r"pose: shape is \(2,\)"),
        ({"angle": [0, np.nan]}, "angle: value of part 1"),
        ({"types": [SQUARE_TYPE]}, "types: 1 for 2 parts"),
        (
            {"position": np.zeros((3, 2, 2)), "velocity": np.zeros((2, 2))},
            "velocity is given with pos",
        ),
    ],
)
def test_bad_scenes_are_refused(change, message):
    scene = {"position": np.zeros((2, 2)), "grey": [BLACK] * 2, "rng": np.random.default_rng(0)}
    with pytest.raises(PlateError, match=message):
        Camera(load_rig()).render(**{**scene, **change})
