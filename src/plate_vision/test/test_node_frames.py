"""The plate's pose and the transforms that the detector publishes."""

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, image, names
from geometry_msgs.msg import PoseStamped
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from plate_core import load_rig
from plate_core.ros import DATA, LATCHED, TRANSFORMS, msg_to_parts

pytestmark = pytest.mark.usefixtures("detector_time")


def test_plate_with_markers(make_plate, marked_rig, draw, rng):
    plate = make_plate(discs=[(0.1, 0.02, 40), (-0.1, -0.05, 130)])
    graph = Graph(rig_file=marked_rig)
    try:
        poses = []
        graph.probe.create_subscription(PoseStamped, "plate_pose", poses.append, DATA)
        graph.until(lambda: graph.detector.count_subscribers("plate_pose"))
        assert graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)) is None
        assert "not detected; all markers (0, 1, 2, 3) must be" in graph.warnings[-1]
        graph.warnings.clear()
        for k, x in enumerate([0.0, 0.001]):
            answer = graph.answer(image(plate.take([x, 0, 0], rng), 2.0 + 0.2 * k))
            assert names(answer) == ["black_1", "grey_1"]
            seen = msg_to_parts(answer).position
            assert np.abs(seen - [[0.1 + x, 0.02], [-0.1 + x, -0.05]]).max() < 2e-4
            graph.until(lambda k=k: len(poses) > k)
            assert poses[-1].header.frame_id == "plate_home"
            assert abs(poses[-1].pose.position.x - x) < 1e-4
        assert graph.warnings == []
        graph.images.publish(image(plate.take([0.008, 0, 0], rng), 3.0))
        graph.until(lambda: len(poses) > 2)
        assert "from home is 8.0 mm" in graph.warnings[-1]
        done = graph.resets.call_async(Trigger.Request())
        graph.until(done.done)
        graph.images.publish(image(plate.take([0.008, 0, 0], rng), 3.2))
        graph.until(lambda: len(poses) > 3)
        assert abs(poses[-1].pose.position.x) < 1e-4  # home is found again
    finally:
        graph.close()


def received_transforms(graph, qos, topic, count):
    """The newest of `count` transforms, to be called before they are published."""
    received = []
    graph.probe.create_subscription(TFMessage, topic, received.append, qos)
    graph.until(lambda: graph.detector.count_subscribers(topic))

    def newest():
        graph.until(lambda: len(received) >= count)
        (transform,) = received[-1].transforms
        return transform

    return newest


def test_frames_without_markers(draw, rng):
    """The camera's pose is that of the default rig's corners and lens, latched; the plate's pose is
    unknown. All names have the prefix."""
    graph = Graph(frame_prefix="left/")
    try:
        camera = received_transforms(graph, LATCHED, "/tf_static", 1)()
        answer = graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 7.0))
        assert graph.detector.count_publishers("/tf") == 0
        assert answer.header.frame_id == camera.header.frame_id == "left/plate_home"
        assert camera.child_frame_id == "left/camera_optical_frame"
        rotation, translation = inverse(camera.transform)
        rig = load_rig()
        corners, lens = np.column_stack([rig.plate.corners, np.zeros(4)]), rig.camera.lens
        seen = cv2.projectPoints(
            corners, cv2.Rodrigues(rotation)[0], translation, lens.matrix, np.array(lens.distortion)
        )[0][:, 0]
        assert np.abs(seen - rig.camera.corners_px).max() < 0.02
    finally:
        graph.close()


def inverse(transform):
    """Rotation and translation of the parent in the child's frame."""
    q, t = transform.rotation, transform.translation
    rotation = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix().T
    return rotation, -rotation @ [t.x, t.y, t.z]


def test_frames_with_markers(make_plate, marked_rig, rng):
    """Camera and plate are found in the image: the plate as turned as it is, the camera leaning as
    it does, though the rig file knows neither."""
    plate = make_plate(lean=(0.02, -0.03, 0.01))
    graph = Graph(rig_file=marked_rig, frame_prefix="left/")
    try:
        camera = received_transforms(graph, LATCHED, "/tf_static", 1)
        moving = received_transforms(graph, TRANSFORMS, "/tf", 2)
        for k, pose in enumerate([(0.0, 0.0, 0.0), (0.001, -0.0015, 0.01)]):
            answer = graph.answer(image(plate.take(pose, rng), 2.0 + 0.2 * k))
        assert (moving().header.frame_id, moving().child_frame_id) == (
            "left/plate_home", "left/plate",
        )  # fmt: skip
        assert moving().header.stamp == answer.header.stamp
        rotation, translation = inverse(camera().transform)
        assert np.abs(rotation - plate.rotation).max() < 3e-3
        assert np.abs(translation - plate.translation).max() < 3e-3
        found = moving().transform
        assert np.allclose(
            [found.translation.x, found.translation.y, 2 * found.rotation.z],
            [0.001, -0.0015, 0.01], atol=2e-4,
        )  # fmt: skip
    finally:
        graph.close()
