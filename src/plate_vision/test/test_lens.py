"""The stage behind a lens that bends: frames drawn here through OpenCV's projection, parts in
metres. No code is shared with the simulated camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core import load_rig
from plate_core.rig import Lens
from plate_vision import ImageError, Tracker, detect, make_region, make_vision, observe
from plate_vision import Lens as SeenLens

TURN = np.array([3.09, 0.006, 0.003])
"""Of plate_home in the camera's frame: rotation vector [rad]."""

BARREL = Lens((600.0, 600.0), (319.5, 239.5), (-0.3, 0.09, 0.0, 0.0, 0.0))
PINCUSHION = Lens((600.0, 605.0), (310.0, 245.0), (0.25, 0.0, 2e-3, -1e-3, 0.0))
MILD = Lens((900.0, 900.0), (319.5, 239.5), (-0.3, 0.1, 1e-3, -1e-3, 0.0))
LENSES = {"barrel": (BARREL, 0.62), "pincushion": (PINCUSHION, 0.72), "mild": (MILD, 0.91)}
"""With the height of the camera [m]: the plate fills the image."""

GREY_OF = {"black": 40, "grey": 130}
SUB = 8
"""Sub-pixels along each side of a pixel."""


def to_pixel(name, point):
    lens, height = LENSES[name]
    there = np.column_stack([point, np.zeros(len(point))])
    place = np.array([0.0, 0.0, height])
    return cv2.projectPoints(there, TURN, place, lens.matrix, np.array(lens.distortion))[0][:, 0]


def rig_of(name):
    rig = load_rig()
    corners_px = tuple(map(tuple, to_pixel(name, rig.plate.corners).tolist()))
    return replace(rig, camera=replace(rig.camera, lens=LENSES[name][0], corners_px=corners_px))


def frame_of(name, position, label, rng, noise=2.0):
    """Return a frame (480, 640) uint8 of parts at `position` (M, 2) [m]."""
    rig = rig_of(name)
    image = np.full((480 * SUB, 640 * SUB), 60, np.uint8)
    fraction = np.linspace(0, 1, 100)[:, None]
    corners = rig.plate.corners
    edges = [
        a + fraction * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    fill(image, to_pixel(name, np.concatenate(edges)), 220)
    turn = np.linspace(0, 2 * np.pi, 200)
    ring = rig.parts.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for point, kind in zip(position, label, strict=True):
        fill(image, to_pixel(name, point + ring), GREY_OF[kind])
    image = image.reshape(480, SUB, 640, SUB).mean(axis=(1, 3))
    return np.clip(np.rint(image + noise * rng.standard_normal(image.shape)), 0, 255).astype("u1")


def fill(image, outline_px, grey):
    fixed = np.rint(((outline_px + 0.5) * SUB - 0.5) * 256).astype(np.int32)
    cv2.fillPoly(image, [fixed], grey, shift=8)


def places():
    """Parts all over the plate, some of them near its edges and in its corners."""
    x, y = np.meshgrid(np.linspace(-0.288, 0.288, 8), np.linspace(-0.138, 0.138, 5))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def errors(rig, image, position, label):
    parts = observe(make_vision(rig), Tracker(), image, 0.0).parts
    assert len(parts.ids) == len(position)
    nearest = np.argmin(np.linalg.norm(parts.position[:, None] - position, axis=2), axis=0)
    assert sorted(nearest.tolist()) == list(range(len(position)))
    classes = [parts.ids[k].rsplit("_", 1)[0] for k in nearest]
    assert classes == list(label)
    return np.linalg.norm(parts.position[nearest] - position, axis=1)


@pytest.mark.parametrize("name", LENSES)
def test_centres_on_the_plate(name, rng):
    """0.03 mm rms, as without a lens (of which 0.011 mm are these frames' sub-pixels). Beside the
    plate's edges, where part of a disc is fitted by a circle, 0.1 mm at worst."""
    rig = rig_of(name)
    position = places() + rng.uniform(-1e-3, 1e-3, (40, 2))
    label = ["black", "grey"] * 20
    error = errors(rig, frame_of(name, position, label, rng), position, label)
    assert np.sqrt(np.mean(error**2)) < 3.5e-5
    assert error.max() < 1.2e-4
    inner = np.all(rig.plate.half - np.abs(places()) > 0.03, axis=1)
    assert np.count_nonzero(inner) >= 18
    assert error[inner].max() < 4e-5


def test_a_detector_without_the_lens_has_large_errors(rng):
    """A detector that does not know the lens is wrong by centimetres, or sees less."""
    rig = rig_of("barrel")
    image = frame_of("barrel", places(), ["black"] * 40, rng)
    without = make_vision(replace(rig, camera=replace(rig.camera, lens=None)))
    parts = observe(without, Tracker(), image, 0.0).parts
    gap = np.linalg.norm(parts.position[:, None] - places(), axis=2).min(axis=1)
    assert gap.max() > 2e-3


def test_touching_parts(rng):
    rig = rig_of("barrel")
    pair = np.array([[0.0, 0.0], [0.016, 0.0]])
    position = np.concatenate([pair + [-0.27, 0.1], pair + [0.05, -0.13], pair + [0.2, 0.05]])
    label = ["black", "grey"] * 3
    assert errors(rig, frame_of("barrel", position, label, rng), position, label).max() < 3e-4


@pytest.mark.parametrize("name", LENSES)
def test_expected_size_holds_everywhere(name, rng):
    """Measured against expected radius over the whole plate."""
    rig = rig_of(name)
    vision = make_vision(rig)
    image = frame_of(name, places(), ["black"] * 40, rng, noise=0)
    found = detect(image, vision.options, vision.region, vision.view)
    centre = np.stack([found["x_px"], found["y_px"]], axis=1)
    assert len(found) == 40
    assert np.allclose(found["radius_px"], vision.radius_px(centre), rtol=0.02)
    narrow = replace(vision.options, radius_tolerance=0.05)
    assert len(detect(image, narrow, vision.region, vision.view)) == 40


@pytest.mark.parametrize("name", LENSES)
def test_the_region_follows_the_bent_edges(name):
    rig = rig_of(name)
    region = make_vision(rig).region
    t = np.linspace(-0.999, 0.999, 101)[:, None]
    corners = rig.plate.corners
    bulge = 0.0
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = to_pixel(name, (a + b) / 2 + t * (b - a) / 2)
        assert np.abs(region.depth(*edge.T)).max() < 0.05
        inside = to_pixel(name, 0.95 * ((a + b) / 2 + t * (b - a) / 2))
        assert region.depth(*inside.T).min() > 5
        outside = to_pixel(name, 1.05 * ((a + b) / 2 + t * (b - a) / 2))
        assert region.depth(*outside.T).max() < -5
        chord = edge[0] + (edge[-1] - edge[0]) * (t + 1) / 2
        bulge = max(bulge, np.abs(edge - chord).max())
    assert bulge > 3  # otherwise this test would prove nothing


def test_camera_info_goes_before_the_rig_file():
    rig = rig_of("barrel")
    other = SeenLens(np.array(BARREL.matrix), np.array([0.1, 0, 0, 0, 0]))
    assert make_vision(rig).calibration.lens.distortion.tolist() == list(BARREL.distortion)
    assert make_vision(rig, lens=other).calibration.lens is other
    none = SeenLens(np.array(BARREL.matrix), np.zeros(5))
    assert make_vision(rig, lens=none).calibration.lens is None


def test_wrong_edges_are_refused():
    edges = make_vision(rig_of("mild")).region.outline_px.reshape(4, -1, 2).copy()
    edges[2, 3] = np.nan
    with pytest.raises(ImageError, match="region: not all points are finite"):
        make_region((640, 480), edges)
    with pytest.raises(ImageError, match="region: got"):
        make_region((640, 480), edges[:3])


MODELS = [
    ("plumb_bob", 350.0, [1.0, 0.0, 0.0, 0.0, 0.0], 0.45),  # OpenCV's straightening: 0.28 mm off
    ("plumb_bob", 600.0, [-0.3, 0.09, 1e-3, -2e-3], 0.65),
    ("rational_polynomial", 600.0, [-0.3, 0.09, 1e-3, -2e-3, 0.01], 0.65),
    ("rational_polynomial", 305.0, [4.3, 2.6, -3e-4, 1e-4, 0.12, 4.6, 4.1, 0.8], 0.33),
    ("rational_polynomial", 500.0, [0.5, -0.2, 0, 0, 0, 0.8, 0, 0, 0.01, -0.02, 0.03, 0.01], 0.55),
    ("rational_polynomial", 500.0, [0.1, 0, 0, 0, 0, 0.2, *[0.0] * 6, 0.03, -0.02], 0.55),
    ("equidistant", 330.0, [], 0.38),
    ("equidistant", 330.0, [0.0] * 5, 0.38),
    ("equidistant", 330.0, [0.05, -0.02, 0.01, -0.003], 0.38),
]
"""Model, focal length [px], D, height of the camera [m]."""


@pytest.mark.parametrize(("model", "focal", "values", "height"), MODELS)
def test_all_models_are_those_of_opencv(model, focal, values, height):
    """Points all over the plate, to a nanometre, from nothing but a camera_info and the corners."""
    matrix = np.array([[focal, 0, 322.0], [0, 1.01 * focal, 241.0], [0, 0, 1]])
    place = np.array([0.0, 0.0, height])

    def seen(points):
        there = np.column_stack([points, np.zeros(len(points))])
        if model == "equidistant":
            known = np.array(values) if np.any(values) else np.zeros(4)
            return cv2.fisheye.projectPoints(there[:, None], TURN, place, matrix, known)[0][:, 0]
        return cv2.projectPoints(there, TURN, place, matrix, np.array(values))[0][:, 0]

    rig = load_rig()
    corners_px = tuple(map(tuple, seen(rig.plate.corners).tolist()))
    rig = replace(rig, camera=replace(rig.camera, corners_px=corners_px, lens=None))
    lens = SeenLens(matrix, np.array(values, dtype=float), model)
    calibration = make_vision(rig, lens=lens).calibration
    points = np.random.default_rng(5).uniform(-1, 1, (200, 2)) * rig.plate.half
    assert np.allclose(calibration.to_image(points), seen(points), atol=1e-6)
    assert np.allclose(calibration.to_home(seen(points)), points, atol=1e-9)
    pinhole = make_vision(rig, lens=SeenLens(matrix, np.zeros(5))).calibration
    assert np.abs(pinhole.to_home(seen(points)) - points).max() > 2e-3
