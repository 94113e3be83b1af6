"""A plate that moves under a camera that is not where the rig file has it."""

import dataclasses

import numpy as np
import pytest

from plate_core.rig import to_home
from plate_vision import CalibrationError, Tracker, TrackerOptions, look, make_vision
from plate_vision.watching import Watch, watch

ON_PLATE = np.array([[-0.22, 0.11], [0.0, 0.0], [0.1, -0.136], [0.28, 0.05]])
LABEL = ["black", "grey", "black", "grey"]
LEAN = (0.02, -0.015, 0.01)
"""The camera's turn [rad]: what it sees is then up to 2 cm from where it was."""


@pytest.fixture
def plate(make_plate):
    discs = [
        (x, y, 40 if name == "black" else 130) for (x, y), name in zip(ON_PLATE, LABEL, strict=True)
    ]
    return make_plate(discs=discs, lean=LEAN)


def test_parts_are_in_plate_home_wherever_camera_and_plate_are(plate, rng):
    vision, state = make_vision(plate.rig), Watch(plate.rig)
    tracker = Tracker(TrackerOptions(gate_m=0.1))  # here parts ride with the plate, to and fro
    poses = np.vstack([np.zeros((2, 3)), rng.uniform(-1, 1, (6, 3)) * [0.01, 0.01, 0.03]])
    for k, pose in enumerate(poses):
        image = plate.take(pose, rng)
        state, vision, clean = watch(state, image, vision, vision.options)
        tracker = look(vision, tracker, clean, 0.2 * k)
        assert np.abs(state.plate.pose - pose).max() < 3e-4
        assert (state.problem is None) == (np.hypot(*state.plate.pose[:2]) <= 2e-3)
        parts = tracker.parts
        assert sorted(name.split("_")[0] for name in parts.ids) == sorted(LABEL)
        true = to_home(pose, ON_PLATE)
        gap = np.linalg.norm(parts.position[:, None] - true, axis=2)
        assert gap.min(axis=0).max() < 3e-4


def test_without_markers_the_rig_file_would_be_wrong(plate, rng):
    """The same picture by the corners of the rig file: parts are not where they are."""
    found = look(make_vision(plate.rig), Tracker(), plate.take(np.zeros(3), rng), 0.0).parts
    gap = np.linalg.norm(found.position[:, None] - ON_PLATE, axis=2)
    assert gap.min(axis=0).max() > 5e-3


def test_until_home_is_found_there_is_no_answer(plate, rng):
    vision, state = make_vision(plate.rig), Watch(plate.rig)
    dark = np.zeros((480, 640), np.uint8)
    with pytest.raises(CalibrationError, match="0, 1, 2, 3 not seen"):
        watch(state, dark, vision, vision.options)
    state, vision, _ = watch(state, plate.take(np.zeros(3), rng), vision, vision.options)
    home = state.home
    away, vision, _ = watch(state, plate.take([0.008, 0, 0], rng), vision, vision.options)
    region = vision.region_px
    assert "8.0 mm from home" in away.problem
    lost, vision, _ = watch(away, dark, vision, vision.options)
    assert "markers are not seen" in lost.problem
    assert lost.plate is None
    assert lost.home is home
    assert vision.region_px is region  # the plate is taken to be where it was
    back, vision, _ = watch(lost, plate.take(np.zeros(3), rng), vision, vision.options)
    assert back.problem is None
    assert np.abs(vision.region_px - region).max() > 5


def test_a_plate_that_trembles_keeps_its_region(plate, rng):
    """Regions are kept by their corners: another one for every image would cost time."""
    vision, state = make_vision(plate.rig), Watch(plate.rig)
    state, first, _ = watch(state, plate.take(np.zeros(3), rng), vision, vision.options)
    vision = first
    for _ in range(4):
        pose = 1e-4 * rng.standard_normal(3)
        state, vision, _ = watch(state, plate.take(pose, rng), vision, vision.options)
        assert vision is first


def test_rigs_without_markers_are_refused(plate):
    with pytest.raises(CalibrationError, match="has no fiducials"):
        _ = Watch(dataclasses.replace(plate.rig, fiducials=None)).fiducials
