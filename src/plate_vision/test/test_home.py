"""The plate's pose by its markers, against pictures traced through camera and lens."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core.rig import Fiducials, to_home
from plate_vision import (
    CalibrationError,
    TeachError,
    Tracker,
    TrackerOptions,
    detect,
    make_vision,
    observe,
)
from plate_vision.camera import draw_marker, find_markers
from plate_vision.camera.markers import DICTIONARIES
from plate_vision.plate.home import (
    PlateLocation,
    find_home,
    find_pose,
    fit_pose,
    hide_markers,
    locate_plate,
)
from plate_vision.shapes.part_files import load_bare
from plate_vision.vision import follow_plate

BENT = [-0.25, 0.08, 0.001, -0.0005, 0.0]
STROKE_M, TURN_RAD = 0.01, 0.03
HOME = np.zeros(3)


@pytest.fixture(params=[None, BENT], ids=["straight", "bent"])
def plate(request, make_plate):
    return make_plate(request.param)


def test_home_by_markers(plate, rng):
    calibration, error = find_home(plate.take(HOME, rng), plate.fiducials, plate.lens)
    assert error < 2e-4
    point = np.stack(np.meshgrid([-0.28, 0, 0.28], [-0.13, 0, 0.13]), axis=2).reshape(-1, 2)
    assert np.abs(calibration.to_home(plate.seen_at(point)) - point).max() < 1e-4
    assert (calibration.lens is None) == (plate.lens is None)


def test_poses_over_the_stroke(plate, rng):
    """Within 0.1 mm and 0.05 degrees, in noise and blur, followed and from scratch."""
    calibration, _ = find_home(plate.take(HOME, rng), plate.fiducials, plate.lens)
    grid = np.array([(x, y, t) for x in (-1, 0, 1) for y in (-1, 1) for t in (-1, 1)])
    random = rng.uniform(-1, 1, (8, 3))
    last, errors = HOME, []
    for k, fraction in enumerate(np.concatenate([grid, random])):
        pose = fraction * [STROKE_M, STROKE_M, TURN_RAD]
        image = plate.take(pose, rng, blur=(0.5, 1.0, 1.5)[k % 3], noise=(1.0, 3.0)[k % 2])
        near = pose + rng.uniform(-1, 1, 3) * [1e-3, 1e-3, 1e-3]
        for guess in (None, near, last):  # from scratch, followed, followed from too far
            found = find_pose(image, plate.fiducials, calibration, guess)
            errors.append(found - pose)
        last = found
    errors = np.abs(errors)
    assert np.linalg.norm(errors[:, :2], axis=1).max() < 1e-4
    assert errors[:, 2].max() < np.deg2rad(0.05)


@pytest.fixture
def straight(make_plate):
    return make_plate()


def test_covered_markers(straight, rng):
    """Two that are seen are enough; one is not."""
    calibration, _ = find_home(straight.take(HOME, rng), straight.fiducials)
    pose = np.array([0.004, -0.003, 0.01])
    image = straight.take(pose, rng)
    for count, number in enumerate((2, 0, 3)):
        middle = straight.seen_at(to_home(pose, np.array([straight.fiducials.centres[number]])))[0]
        cv2.circle(image, np.rint(middle).astype(int).tolist(), 25, 130, -1)
        for last in (None, pose):
            found = find_pose(image, straight.fiducials, calibration, last)
            if count == 2:
                assert found is None
                continue
            assert np.linalg.norm(found[:2] - pose[:2]) < 1.5e-4
            assert abs(found[2] - pose[2]) < 1e-3
        with pytest.raises(CalibrationError, match=f"{number}.* not detected; all markers \\(0, 1"):
            find_home(image, straight.fiducials)


def test_mirrored_pictures_are_called_mirrored(straight, rng):
    image = straight.take(HOME, rng)
    for mirrored in (image[:, ::-1], image[::-1], np.rot90(image)[:, ::-1]):
        with pytest.raises(CalibrationError, match="not detected, because the image is mirrored"):
            find_home(mirrored, straight.fiducials)
    find_home(np.rot90(image), straight.fiducials)  # a rotation is no mirror


def test_other_pictures_have_no_pose(straight, rng, draw):
    calibration, _ = find_home(straight.take(HOME, rng), straight.fiducials)
    others = [
        np.zeros((480, 640), np.uint8),
        np.full((480, 640), 255, np.uint8),
        rng.integers(0, 256, (480, 640), dtype=np.uint8),
        draw(rng.uniform([40, 110], [600, 370], (30, 2)), ["black"] * 30, rng),
    ]
    for image in others:
        for last in (None, HOME):
            assert find_pose(image, straight.fiducials, calibration, last) is None


def test_markers_that_are_not_where_they_should_be(straight, rng):
    image = straight.take(HOME, rng)
    swapped = Fiducials("4X4_50", 0.03, (0, 1, 3, 2), straight.fiducials.centres)
    with pytest.raises(CalibrationError, match="mm from their places in the rig file, allowed: 1"):
        find_home(image, swapped)
    with pytest.raises(CalibrationError, match="mm from their places in the rig file"):
        find_home(image, Fiducials("4X4_50", 0.04, (0, 1, 2, 3), straight.fiducials.centres))
    with pytest.raises(CalibrationError, match=r"dictionary is '4X4', allowed: .*4X4_50"):
        find_home(image, Fiducials("4X4", 0.03, (0, 1, 2, 3), straight.fiducials.centres))


def test_markers_are_no_parts(make_plate, rng):
    """Hidden, they leave the parts between them as they are."""
    place = np.array([[0.1, 0.05], [-0.2, -0.04], [-0.235, -0.12]])  # the last beside a marker
    plate = make_plate(discs=[(x, y, 40) for x, y in place])
    pose = np.array([0.003, 0.002, 0.01])
    calibration, _ = find_home(plate.take(HOME, rng), plate.fiducials)
    image = plate.take(pose, rng)
    before = image.copy()
    vision = make_vision(plate.rig)
    clean = hide_markers(image, plate.fiducials, calibration, pose)
    assert np.array_equal(image, before)
    found = detect(clean, vision.options)
    seen = calibration.to_home(np.stack([found["x_px"], found["y_px"]], axis=1))
    assert len(seen) == 3
    gap = np.linalg.norm(seen[:, None] - to_home(pose, place), axis=2)
    assert gap.min(axis=0).max() < 3e-4
    colour = hide_markers(np.dstack([image] * 3), plate.fiducials, calibration, pose)
    assert np.array_equal(colour[:, :, 0], clean)


def test_markers_are_no_part_of_the_bare_plate(make_plate, rng, tmp_path):
    plate = make_plate()
    for k in range(3):
        image = plate.take(HOME, rng)
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.dstack([image] * 3))
    size_px = (image.shape[1], image.shape[0])
    found = load_bare(tmp_path, size_px, PlateLocation(plate.rig, plate.lens))
    with_markers = load_bare(tmp_path, size_px)
    home, _ = find_home(image, plate.fiducials, plate.lens)
    for x, y in home.to_image(plate.fiducials.centres).round().astype(int):
        here = np.s_[y - 8 : y + 9, x - 8 : x + 9]
        assert np.ptp(found.grey[here]) < 0.3 * np.ptp(with_markers.grey[here])
    cv2.imwrite(str(tmp_path / "9.png"), np.full((*image.shape, 3), 200, np.uint8))
    with pytest.raises(TeachError, match=r"bare plate: 9\.png: "):
        load_bare(tmp_path, size_px, PlateLocation(plate.rig, plate.lens))


def test_the_rigid_fit_has_the_smallest_error(rng):
    """Against scipy, which knows nothing of rotations in closed form."""
    from scipy.optimize import least_squares

    point = rng.uniform(-0.3, 0.3, (16, 2))
    seen = to_home(np.array([0.004, -0.007, 0.3]), point) + 1e-4 * rng.standard_normal((16, 2))
    pose, error = fit_pose(point, seen)
    best = least_squares(
        lambda p: (to_home(p, point) - seen).ravel(),
        np.zeros(3),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert np.allclose(pose, best.x, atol=1e-8)
    assert error == pytest.approx(np.sqrt(2 * best.cost / 16), rel=1e-9)


def test_markers_are_distinguished(rng):
    image = np.full((300, 400), 200, np.uint8)
    for k, (x, y) in enumerate([(30, 40), (150, 40), (270, 40), (30, 180), (150, 180)]):
        image[y : y + 72, x : x + 72] = draw_marker("5X5_100", 10 + k // 2 * 2, 72)
    noisy = np.clip(image + 5 * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)
    found = find_markers(noisy, "5X5_100")
    assert sorted(found) == [14]  # 10 and 12 are there twice
    assert (
        np.abs(found[14] - [[149.5, 179.5], [221.5, 179.5], [221.5, 251.5], [149.5, 251.5]]).max()
        < 0.1
    )
    assert "5X5_100" in DICTIONARIES
    with pytest.raises(CalibrationError, match="marker is 100, allowed in 5X5_100: 0 to 99"):
        draw_marker("5X5_100", 100, 72)


ON_PLATE = np.array([[-0.22, 0.11], [0.0, 0.0], [0.1, -0.136], [0.28, 0.05]])
LABEL = ["black", "grey", "black", "grey"]
LEAN = (0.02, -0.015, 0.01)
"""The camera's rotation [rad]: its view is then up to 2 cm from the former one."""


@pytest.fixture
def leaning(make_plate):
    discs = [
        (x, y, 40 if name == "black" else 130) for (x, y), name in zip(ON_PLATE, LABEL, strict=True)
    ]
    return make_plate(discs=discs, lean=LEAN)


def test_parts_are_in_plate_home_for_any_position_of_camera_and_plate(leaning, rng):
    vision, where = make_vision(leaning.rig), PlateLocation(leaning.rig)
    tracker = Tracker(TrackerOptions(gate_m=0.1))  # here parts ride with the plate, to and fro
    poses = np.vstack([np.zeros((2, 3)), rng.uniform(-1, 1, (6, 3)) * [0.01, 0.01, 0.03]])
    for k, pose in enumerate(poses):
        image = leaning.take(pose, rng)
        where, vision, clean = follow_plate(where, vision, image)
        tracker = observe(vision, tracker, clean, 0.2 * k)
        assert np.abs(where.pose - pose).max() < 3e-4
        assert (where.problem is None) == (np.hypot(*where.pose[:2]) <= 2e-3)
        parts = tracker.parts
        assert sorted(name.split("_")[0] for name in parts.ids) == sorted(LABEL)
        true = to_home(pose, ON_PLATE)
        gap = np.linalg.norm(parts.position[:, None] - true, axis=2)
        assert gap.min(axis=0).max() < 3e-4


def test_without_markers_the_rig_file_would_be_wrong(leaning, rng):
    """The same picture by the corners of the rig file: parts are not where they are."""
    found = observe(make_vision(leaning.rig), Tracker(), leaning.take(HOME, rng), 0.0).parts
    gap = np.linalg.norm(found.position[:, None] - ON_PLATE, axis=2)
    assert gap.min(axis=0).max() > 5e-3


def test_until_home_is_found_there_is_no_answer(leaning, rng):
    vision, where = make_vision(leaning.rig), PlateLocation(leaning.rig)
    dark = np.zeros((480, 640), np.uint8)
    with pytest.raises(CalibrationError, match="markers 0, 1, 2, 3 are not detected"):
        follow_plate(where, vision, dark)
    where, vision, _ = follow_plate(where, vision, leaning.take(HOME, rng))
    home = where.home
    away, vision, _ = follow_plate(where, vision, leaning.take([0.008, 0, 0], rng))
    region = vision.region
    assert "from home is 8.0 mm" in away.problem
    lost, vision, _ = follow_plate(away, vision, dark)
    assert "markers are not detected" in lost.problem
    assert lost.pose is None
    assert lost.home is home
    assert vision.region is region  # the plate is taken to be where it was
    back, vision, _ = follow_plate(lost, vision, leaning.take(HOME, rng))
    assert back.problem is None
    assert np.abs(vision.region.outline_px - region.outline_px).max() > 5


def test_small_motions_of_the_plate_do_not_change_the_region(leaning, rng):
    """Another region for every image would cost time."""
    vision, where = make_vision(leaning.rig), PlateLocation(leaning.rig)
    where, first, _ = follow_plate(where, vision, leaning.take(HOME, rng))
    vision = first
    for _ in range(4):
        pose = 1e-4 * rng.standard_normal(3)
        where, vision, _ = follow_plate(where, vision, leaning.take(pose, rng))
        assert vision is first


def test_rigs_without_markers_are_refused(leaning, rng):
    rig = replace(leaning.rig, fiducials=None)
    with pytest.raises(CalibrationError, match="section fiducials is missing"):
        locate_plate(PlateLocation(rig), leaning.take(HOME, rng))
