"""Part types in the detector: recognition, learning the bare plate, live teaching."""

import re

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from detector_graph import Graph, called, image, names, plan
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image

from plate_core import config_path
from plate_core.rig import load_part_types
from plate_core.ros import IMAGE, msg_to_parts

pytestmark = pytest.mark.usefixtures("detector_time")

TYPES = load_part_types(config_path("parts.yaml"))
LYING = [("nut", -0.1, 0.05, 0.3), ("screw", 0.1, -0.05, 2.0), ("coin_large", 0.0, 0.0, 0.0)]


@pytest.fixture
def rig_with_types(tmp_path):
    """The default rig file with part types."""
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    data["types"] = str(config_path("parts.yaml").resolve())
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_parts_of_taught_types(rig_with_types, draw_types, rng):
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image
        drawings = []
        graph.probe.create_subscription(Image, "detections_image", drawings.append, IMAGE)
        graph.until(lambda: graph.detector.count_subscribers("detections_image"))

        def shown(poses, stamp_s):
            return image(draw_types(TYPES, poses, rng, to_image=to_image), stamp_s, "bgr8")

        graph.images.publish(shown(LYING, 1.0))
        graph.until(lambda: graph.parts)
        parts = msg_to_parts(graph.parts[-1])
        assert parts.ids == ("coin_large_1", "nut_1", "screw_1")
        for name, x, y, angle in LYING:
            i = parts.ids.index(f"{name}_1")
            assert np.abs(parts.position[i] - (x, y)).max() < 1e-4
            period = 2 * np.pi / max(TYPES[name].symmetry, 1)
            off = (parts.angle[i] - angle + period / 2) % period - period / 2
            assert name == "coin_large" or abs(off) < np.radians(1.5)
        (warning,) = graph.warnings
        assert (
            "the bare plate is estimated from an image; remove all parts, then call ~/learn_plate"
            in warning
        )
        graph.until(lambda: drawings)
        answer = called(graph, "learn_plate")
        assert answer.success
        assert (
            "next 5 images are used for the bare plate; now 3 objects are on the plate"
            in answer.message
        )
        for k in range(5):
            graph.answer(shown([], 1.2 + 0.2 * k))
        assert graph.notes[-1] == "bare plate learned from 5 images"
        assert graph.detector._diagnose(0.0).level == 0
        found = msg_to_parts(graph.answer(shown(LYING, 3.0)))
        assert np.abs(found.position - parts.position).max() < 1e-4
    finally:
        graph.close()


def test_a_modelled_plate_is_not_learned_by_a_rest(rig_with_types, draw_types, rng):
    """And images in grey levels among those in colours are not learned as one plate."""
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(poses, stamp_s, encoding="bgr8"):
            frame = draw_types(TYPES, poses, rng, to_image=to_image)
            return image(frame if encoding == "bgr8" else frame[:, :, 1], stamp_s, encoding)

        def warned():
            return "estimated" in graph.detector._diagnose(0.0).message

        graph.images.publish(shown(LYING, 1.0))
        graph.until(lambda: graph.parts)
        graph.detector.trigger_deactivate()
        graph.detector.trigger_activate()
        graph.images.publish(shown(LYING, 1.2))
        graph.until(lambda: len(graph.parts) > 1)
        assert warned()
        called(graph, "learn_plate")
        for k in range(8):
            graph.images.publish(shown([], 2.0 + k, "mono8" if k == 2 else "bgr8"))
            graph.until(lambda k=k: len(graph.parts) > 2 + k)
        assert not warned()
        graph.detector.trigger_deactivate()
        graph.detector.trigger_activate()
        assert not warned()
        assert len(graph.answer(shown(LYING, 20.0)).parts) == 3
        assert len(graph.answer(shown(LYING, 20.1, "mono8")).parts) == 3
    finally:
        graph.close()


def test_a_type_is_taught_live(draw_types, rng, tmp_path):
    graph = Graph(teach_file=tmp_path / "parts.yaml")
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(poses, stamp_s):
            return image(draw_types(TYPES, poses, rng, to_image=to_image), stamp_s, "bgr8")

        refused = called(graph, "teach")
        assert not refused.success
        assert refused.message.startswith("no image has arrived")
        graph.answer(shown(LYING[:1], 1.0))
        assert (
            "teach_name is empty, allowed: the name of the type" in called(graph, "teach").message
        )
        graph.detector.set_parameters([Parameter("teach_name", value="nut")])
        assert re.match(r"nut: 6 corners, 1 hole, .* 1 example", called(graph, "teach").message)
        graph.answer(shown([("nut", 0.1, 0.02, 1.0)], 2.0))
        assert "from 2 examples; written to" in called(graph, "teach").message
        assert load_part_types(tmp_path / "parts.yaml")["nut"].symmetry == 6
        graph.answer(shown(LYING[:2], 3.0))
        assert names(graph.answer(shown(LYING[:2], 3.2))) == ["nut_2", "unknown_1"]
    finally:
        graph.close()


def test_the_plate_is_not_learned_while_a_task_moves_it(rig_with_types, draw_types, rng):
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(stamp):
            return image(draw_types(TYPES, LYING, rng, to_image=to_image), stamp, "bgr8")

        graph.images.publish(shown(1.0))
        graph.until(lambda: graph.parts)
        plan(graph, msg_to_parts(graph.parts[-1]), 1.2)
        refused = called(graph, "learn_plate")
        assert not refused.success
        assert refused.message.startswith("a task moves the plate, allowed: ")
        graph.answer(shown(9.0))  # the planner has ended without a word
        assert called(graph, "learn_plate").success
    finally:
        graph.close()
