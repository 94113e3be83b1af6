"""The page's data fit into JSON, and agree with the scene."""

import base64
import json

import cv2
import numpy as np
import pytest

from plate_core import AngleTargets, CycleRequest, Parts, PlateCycle, PlateError, Targets, load_rig
from plate_core.rig import homography
from plate_view.scene import (
    CAMERA_PX,
    camera_scene,
    cycle_scene,
    motors_scene,
    nodes_scene,
    parts_scene,
    request_scene,
    rig_scene,
    type_scene,
)
from plate_view.top_view import TopView

RIG = load_rig()
SHAPES = load_rig("shapes")
PARTS = Parts.make(("black_1", "grey_2"), np.array([[0.1, 0.02], [-0.2, 0.0]]))


def cycle():
    t = 2 * np.pi * np.arange(32) / 32
    pose = np.column_stack([2e-3 * np.sin(t), 1e-3 * np.sin(2 * t), 5e-3 * np.sin(t)])
    return PlateCycle.from_samples(0.1, pose)


def strict(scene):
    return json.loads(json.dumps(scene, allow_nan=False))


@pytest.mark.parametrize("size", [(80, 120, 3), (80, 120), (1000, 1920, 3), (3, 6000)])
def test_a_camera_image_is_reduced_to_the_width_of_the_page(size):
    image = np.full(size, 200, np.uint8)
    image[: size[0] // 2] = (30, 90, 150) if len(size) == 3 else 60
    scene = strict(camera_scene(1.5, image))
    assert (scene["stamp"], scene["height"], scene["width"]) == (1.5, *size[:2])
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(scene["jpeg"]), np.uint8), -1)
    scale = min(1, CAMERA_PX / size[1])
    assert shown.shape[:2] == (max(1, round(scale * size[0])), round(scale * size[1]))
    if len(shown) > 1:
        assert shown[[4, -4], 4] == pytest.approx(image[[4, -4], 4], abs=4)


def test_parts_and_how_sure_they_are():
    spread = np.array([[1e-5, 1e-5, 0.1], [np.nan] * 3])
    scene = strict(parts_scene(RIG, 1.5, PARTS, spread, [True, False]))
    first, second = scene["parts"]
    assert (first["id"], first["type"], first["x"]) == ("black_1", "black", 0.1)
    assert first["sd"] == [1e-5, 1e-5, 0.1]
    assert second["sd"] is None
    assert (first["seen"], second["seen"]) == (True, False)
    assert not first["turns"]


def test_requests_for_parts_are_shown():
    targets = Targets(
        np.array([[0.0, -1], [0.1, 0.1]]), np.array([[0.01, 1], [0.2, 0.2]]),
        np.array([[1.0, 0], [1, 1]]), 0.004,
        AngleTargets(np.array([0.0, 0.5]), np.array([0.1, 0.6]), np.array([0.0, 0.01])),
    )  # fmt: skip
    force = np.full((2, 2), RIG.force_unit)
    request = CycleRequest.make(PARTS, force, targets=targets)
    first, second = strict(request_scene(RIG, 0.0, request))["parts"]
    assert (first["x"], first["y"], first["angle"]) == ([0.0, 0.01], None, None)
    assert (second["y"], second["angle"]) == ([0.1, 0.2], [0.5, 0.6])
    assert first["force"] == [1.0, 1.0]
    assert strict(request_scene(RIG, 0.0, CycleRequest.make(PARTS)))["parts"][0]["x"] is None


def test_a_cycle_and_its_motors():
    scene = strict(cycle_scene(RIG, 0.0, cycle(), field=True))
    assert scene["pose"][0] == scene["pose"][-1]
    assert len(scene["field"]["drift"]) == len(scene["field"]["x"]) * len(scene["field"]["y"])
    assert {sense for _, _, sense in scene["centres"]} <= {-1, 1}
    assert strict(cycle_scene(RIG, 0.0, cycle(), field=False))["field"] is None
    motors = strict(motors_scene(RIG, cycle()))
    assert len(motors["names"]) == len(motors["lo"]) == 4
    assert 0 < motors["used"]["stroke"] < 1
    resting = strict(cycle_scene(RIG, 0.0, PlateCycle.rest(0.1), field=True))
    assert resting["centres"] == []


def test_a_cycle_that_ends_in_motion_and_the_tail_that_stops_it_are_shown_each_for_itself():
    home, away = np.zeros((3, 3)), np.array([[1e-3, 0, 1e-3], [0.02, 0, 0], [0, 0, 0]])
    knots = np.stack([home, away, away, home], axis=1)
    leaves = PlateCycle.from_knots(np.array([0.0, 0.1, 0.1, 0.15]), *knots)
    for one, period, first, last in ((leaves, 0.1, 0, 1e-3), (leaves.tail, 0.05, 1e-3, 0)):
        scene = strict(cycle_scene(RIG, 0.0, one, field=True))
        assert scene["period"] == pytest.approx(period)
        assert [scene["pose"][k][0] for k in (0, -1)] == pytest.approx([first, last])
        assert len(scene["field"]["drift"]) == len(scene["field"]["force"])
        assert 0 < strict(motors_scene(RIG, one))["used"]["acceleration"] < 1


def test_rig_types_and_nodes():
    strict(rig_scene(RIG, "a"))
    for kind in SHAPES.types.values():
        scene = strict(type_scene(kind))
        assert scene["colour"].startswith("#")
        assert len(scene["colour"]) == 7
        assert len(scene["outline"]) >= 3
    nodes = strict(nodes_scene({"solver": (0.42, "OK", "fine", {"a": "1"})}))
    assert nodes["nodes"][0]["age"] == 0.4


@pytest.mark.parametrize("rig", [RIG, SHAPES], ids=["default", "shapes"])
def test_the_top_view_shows_a_disc_at_its_position(rig):
    """A disc drawn where the camera sees (0.1, -0.05) m is at the picture's place of that point."""
    at = np.array([0.1, -0.05])
    seen = homography(rig) @ [*at, 1]
    pixel = seen[:2] / seen[2]
    if rig.camera.lens is not None:
        pixel = rig.camera.lens.bend(pixel)
    image = np.full((rig.camera.height_px, rig.camera.width_px), 255, np.uint8)
    cv2.circle(image, tuple(int(v) for v in np.round(pixel)), 6, 0, -1)
    view = TopView(rig)
    data = np.frombuffer(view.jpeg(image), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    dark = np.argwhere(picture < 64)
    row, column = dark.mean(axis=0)
    x = view.x[0] + (column + 0.5) / picture.shape[1] * (view.x[1] - view.x[0])
    y = view.y[1] - (row + 0.5) / picture.shape[0] * (view.y[1] - view.y[0])
    assert np.hypot(*(np.array([x, y]) - at)) < 1.5e-3


def test_an_image_of_another_size_is_refused():
    with pytest.raises(PlateError, match="allowed: 640 x 480"):
        TopView(RIG).jpeg(np.zeros((10, 10), np.uint8))
