"""The whole stage without ROS: frames drawn here, parts in metres."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from plate_core import load_rig
from plate_vision import DetectorOptions, ImageError, Tracker, make_vision, observe
from plate_vision.vision import ANY_ANGLE

DT = 0.05


@pytest.fixture
def vision():
    return make_vision(load_rig())


def test_radius_and_region_come_from_the_rig(vision):
    rig = load_rig()
    assert vision.options.radius_px == pytest.approx(7.9, abs=0.1)  # 8 mm, 1 px is about 1 mm
    assert np.allclose(vision.region.outline_px, rig.camera.corners_px, rtol=0, atol=1e-9)
    assert make_vision(rig, DetectorOptions(threshold=0.7)).options.threshold == 0.7


def test_drifting_parts(vision, draw, rng):
    """Positions to 0.05 mm, drift to 2 mm/s from two images 50 ms apart, ids that stay."""
    start = np.array([[-0.25, 0.1], [-0.1, -0.05], [0.0, 0.0], [0.1, 0.1], [0.2, -0.1]])
    drift = rng.uniform(-0.04, 0.04, (5, 2))
    label = ["black", "grey", "black", "grey", "black"]
    ids = ("black_1", "black_2", "black_3", "grey_1", "grey_2")
    order = [0, 2, 4, 1, 3]
    tracker = Tracker()
    for k in range(6):
        position = start + drift * k * DT
        image = draw(vision.calibration.to_image(position), label, rng, radius=7.9)
        tracker = observe(vision, tracker, image, 100.0 + k * DT)
        parts = tracker.parts
        assert parts.ids == ids
        assert np.abs(parts.position - position[order]).max() < 5e-5
        if k:
            assert np.abs(parts.velocity - drift[order]).max() < 2e-3


def test_empty_and_dark_images_are_answered(vision, draw, rng):
    tracker = observe(vision, Tracker(), draw([], [], rng), 0.0)
    assert tracker.parts.ids == ()
    tracker = observe(vision, tracker, np.zeros((480, 640), np.uint8), DT)
    assert tracker.parts.ids == ()


def test_same_frames_give_the_same_bits(vision, draw, rng):
    frame = draw([[100.0, 200.0], [116.0, 200.0]], ["black", "grey"], rng)
    a, b = (observe(vision, Tracker(), frame, 0.0).parts for _ in range(2))
    assert a.ids == b.ids
    assert a.position.tobytes() == b.position.tobytes()


def test_an_image_on_its_side_is_called_rotated(vision):
    with pytest.raises(ImageError, match=r"480 x 640 px, allowed: 640 .*rotation of 90 degrees"):
        observe(vision, Tracker(), np.full((640, 480), 200, np.uint8), DT)


@pytest.mark.parametrize("shape", [(240, 320), (640, 480), (481, 640, 3), (1, 1), (640,)])
def test_another_size_is_refused(vision, draw, rng, shape):
    tracker = observe(vision, Tracker(), draw([], [], rng), 0.0)
    with pytest.raises(ImageError, match=r"size is .* allowed: 640 x 480 px"):
        observe(vision, tracker, np.full(shape, 200, np.uint8), DT)


@pytest.mark.parametrize("noise", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("gap_px", [0.0, 20.0])
def test_parts_have_the_stated_deviation(vision, draw, rng, noise, gap_px):
    """Within a factor of three, whatever the light: 48 parts, in pairs that touch or do not."""
    grid = np.stack(np.meshgrid(np.linspace(80, 560, 8), (150.0, 240.0, 330.0)), axis=-1)
    centre = grid.reshape(-1, 2) + rng.uniform(-3, 3, (24, 2))
    label = rng.choice(["black", "grey"], 24)
    turn = rng.uniform(-np.pi, np.pi, len(centre))
    half = (vision.options.radius_px + gap_px / 2) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    centre, label = np.concatenate([centre + half, centre - half]), np.concatenate([label] * 2)
    radius = vision.options.radius_px
    seen = [
        observe(vision, Tracker(), draw(centre, label, rng, radius=radius, noise=noise), 0.0)
        for _ in range(4)
    ]
    true = vision.calibration.to_home(centre)
    fractions = []
    for tracker in seen:
        gap = tracker.parts.position[:, None] - true
        nearest = np.argmin(np.hypot(*np.moveaxis(gap, 2, 0)), axis=1)
        error = gap[np.arange(len(nearest)), nearest]
        fractions.append(error / tracker.quality[:, :1])
    assert 1 / 3 < np.sqrt(np.mean(np.square(fractions))) < 3
    assert np.all(seen[0].quality[:, 1] == ANY_ANGLE)
    assert np.all((seen[0].quality[:, 2] > 0.5) & (seen[0].quality[:, 2] <= 1))


def test_the_noise_of_a_part_over_the_edge_is_unknown(vision, draw, rng):
    corner = vision.region.outline_px.reshape(-1, 2).mean(axis=0)
    edge = [corner[0], float(vision.region.outline_px[..., 1].max()) - 3.0]
    tracker = observe(vision, Tracker(), draw([edge], ["black"], rng), 0.0)
    assert len(tracker.parts) == 1
    assert np.isnan(tracker.quality[0, 0])


def test_the_noise_of_a_part_that_the_image_cuts_off_is_unknown(draw, rng):
    """Of a plate that reaches beyond the image."""
    corners = tuple(map(tuple, np.add(load_rig().camera.corners_px, [200.0, 0.0]).tolist()))
    rig = load_rig()
    vision = make_vision(replace(rig, camera=replace(rig.camera, corners_px=corners)))
    places = [[400.0, 240.0], [635.0, 240.0]]
    frame = draw(places, ["black"] * 2, rng, corners=corners, radius=7.9)
    tracker = observe(vision, Tracker(), frame, 0.0)
    assert np.isfinite(tracker.quality[:, 0]).tolist() == [True, False]


def test_drift_of_still_parts_is_small(draw, rng):
    """At 30 images a second a standard deviation of at most 1 mm/s, on the default rig."""
    vision, tracker, drift = make_vision(load_rig()), Tracker(), []
    place = rng.uniform([60, 120], [580, 360], (40, 2))
    apart = [p for i, p in enumerate(place) if all(np.hypot(*(p - q)) > 25 for q in place[:i])][:10]
    for k in range(40):
        frame = draw(apart, ["black", "grey"] * 5, rng, radius=7.9)
        tracker = observe(vision, tracker, frame, k / 30)
        drift.append(tracker.parts.velocity)
    drift = np.array(drift[1:])
    assert drift.shape == (39, 10, 2)
    assert drift.std() < 0.5e-3
    assert drift.std(axis=0).max() < 1e-3


def test_a_thing_that_may_be_a_part_is_published_as_unknown(draw, rng):
    """So that no part is driven into it: a bar is no disc, but of a disc's area."""

    def bar(image):
        image[196:205, 387:414] = 40.0

    vision = make_vision(load_rig())
    tracker = observe(vision, Tracker(), draw([[150.0, 200.0]], ["black"], rng, extra=bar), 0.0)
    assert tracker.parts.ids == ("black_1", "unknown_1")
    assert [track.label for track in tracker.tracks] == ["black", "unknown"]
    seen = vision.calibration.to_image(tracker.parts.position[1:])[0]
    assert seen == pytest.approx([400.0, 200.0], abs=2.0)
    assert len(tracker.overlooked) == 1
    spread, _, confidence = tracker.quality[1]
    assert (spread > 1e-4, confidence) == (True, 0.0)


def test_a_vision_is_sent_to_other_processes():
    vision = make_vision(load_rig())
    there = pickle.loads(pickle.dumps(vision))
    point_px = np.array([[100.0, 200.0], [400.0, 250.0]])
    assert np.array_equal(there.view.silhouettes(point_px), vision.view.silhouettes(point_px))
