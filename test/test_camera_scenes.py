"""The bench's scenes with real cameras' effects: the true positions agree with the images."""

import cv2
import numpy as np
import pytest

from harness.result import TEXTS
from plate_bringup.loop import Setup, with_settings, with_setup_camera
from plate_core import load_rig
from plate_core.rig import camera_pose, camera_position, to_image
from plate_core.tasks import load_scenario
from stages.cameras import BY_NAME, DISCS, KINDS, TYPED, draw_scene, row_of, scene
from tasks.views import SCENARIOS, SCENES


def test_every_scene_has_its_own_name():
    assert len(BY_NAME) == len(KINDS)


def test_a_seed_gives_one_scene():
    one, two, other = (scene("plain", seed) for seed in (1, 1, 2))
    assert np.array_equal(one.image, two.image)
    assert not np.array_equal(one.position, other.position)


@pytest.mark.parametrize(
    "name", ["plain", "tilt 30 sideways", "strong lens", "bright on 70", "sizes 0.8, 1 and 1.2"]
)
def test_discs_are_at_the_places_of_the_scene(name):
    """Each disc differs from the plate beside it, by OpenCV's projection of its place."""
    one = scene(name, 3)
    assert len(one.position) == DISCS
    lens = one.rig.camera.lens
    rotation, translation = camera_pose(one.rig)
    position = np.column_stack([one.position, np.zeros(DISCS)])
    seen = cv2.projectPoints(
        position,
        cv2.Rodrigues(rotation)[0],
        translation,
        lens.matrix,
        np.array(lens.distortion[:5]),
    )[0][:, 0]
    u, v = np.round(seen).astype(int).T
    image = one.image.astype(float)
    inside = cv2.blur(image, (3, 3))[v, u]
    plate = np.median(image[np.round(to_image(one.rig, np.zeros((1, 2))))[0, 1].astype(int)])
    assert np.all(np.abs(inside - plate) > 40)


def test_high_parts_are_seen_farther_out():
    one = scene("20 mm high, 0.43 m", 3)
    x, y, above = camera_position(one.rig)
    assert above == pytest.approx(0.43, abs=1e-6)
    assert one.rig.parts.height_m == 0.02
    middle = np.array([x, y])
    top = middle + (one.position - middle) * above / (above - 0.02)
    u, v = np.round(to_image(one.rig, top)).astype(int).T
    assert np.all(one.image[v, u] < 150)
    far = np.hypot(*(one.position - middle).T) > 0.2  # the top is 10 mm from the foot there
    foot = one.position[far] - 0.007 * _out(one.position[far], middle)
    u, v = np.round(to_image(one.rig, foot)).astype(int).T
    assert np.mean(one.image[v, u] < 110) > 0.9  # side faces


def _out(position, middle):
    way = position - middle
    return way / np.linalg.norm(way, axis=1)[:, None]


def test_typed_scenes_have_a_bare_plate_and_light_that_changes():
    one = scene("typed, light 20 % down", 3)
    assert len(one.types) == TYPED
    assert {part.name for part in one.types} == set(load_rig("shapes").types)
    assert len(one.bare) == 5
    first, last = (image.mean() for image in (one.images[0], one.images[-1]))
    assert last / first == pytest.approx(0.8, abs=0.01)
    apart = np.linalg.norm(one.position[:, None] - one.position, axis=2)
    reach = np.array([part.reach_m for part in one.types])
    np.fill_diagonal(apart, np.inf)
    assert np.all(apart > reach[:, None] + reach)


def test_a_row_counts_what_is_found():
    row = row_of(BY_NAME["plain"], 1)
    assert row["detected_percent"] == 100
    assert row["false"] == 0
    assert row["worst_mm"] < 0.1
    assert row["reported"] is None
    assert set(TEXTS["views"]["columns"]) == set(row)
    assert all(isinstance(key, str) for key in TEXTS["views"]["columns"])


def test_unknown_heights_are_in_the_image_alone():
    one = draw_scene(BY_NAME["10 mm high, 0.43 m, not in the rig file"], 3)
    known = draw_scene(BY_NAME["10 mm high, 0.43 m"], 3)
    assert one.rig.parts.height_m == 0
    assert known.rig.parts.height_m == 0.01
    assert np.array_equal(one.image, known.image)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("view", SCENES)
def test_settings_of_the_tasks_are_allowed(name, view):
    rig = load_rig(load_scenario(name).rig)
    with_setup_camera(with_settings(Setup(name, 1), SCENES[view]), rig)
