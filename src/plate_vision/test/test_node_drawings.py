"""Pictures and markers for people, which the detector draws."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, image
from sensor_msgs.msg import Image
from visualization_msgs.msg import MarkerArray

from plate_core.ros import DATA, IMAGE, msg_to_parts

pytestmark = pytest.mark.usefixtures("detector_time")


def test_drawings_are_published_only_if_there_are_subscribers(graph, draw, rng):
    drawings, scenes = [], []
    frames = [draw(CENTRE_PX + [k, 0], LABEL, rng, radius=7.9) for k in range(3)]
    graph.answer(image(frames[0], 1.0))
    assert graph.detector._trails == {}
    graph.probe.create_subscription(Image, "detections_image", drawings.append, IMAGE)
    graph.probe.create_subscription(MarkerArray, "markers", scenes.append, DATA)
    graph.until(lambda: graph.detector._drawings.get_subscription_count())
    graph.until(lambda: graph.detector._markers.get_subscription_count())
    for k in (1, 2):
        parts = msg_to_parts(graph.answer(image(frames[k], 1.0 + 0.05 * k)))
        graph.until(lambda k=k: len(drawings) == k and len(scenes) == k)
    drawn = np.frombuffer(drawings[-1].data, np.uint8).reshape(480, 640, 3).astype(int)
    assert drawings[-1].encoding == "bgr8"
    changed = np.abs(drawn - frames[2][:, :, None]).max(axis=2) > 30
    for x, y in CENTRE_PX + [2, 0]:
        angle = np.linspace(0, 2 * np.pi, 24)
        rim = np.rint([y + 7.9 * np.sin(angle), x + 7.9 * np.cos(angle)]).astype(int)
        assert np.mean(changed[rim[0], rim[1]]) > 0.7  # outlined
    assert np.mean(changed) < 0.05
    by_kind = {}
    for marker in scenes[-1].markers:
        assert marker.header.frame_id == "plate_home"
        by_kind.setdefault(marker.ns, []).append(marker)
    assert {kind: len(all_) for kind, all_ in by_kind.items()} == {
        "plate": 1, "parts": 2, "names": 2, "velocities": 2, "trails": 2,
    }  # fmt: skip
    assert by_kind["plate"][0].scale.x == 0.6
    assert [m.text for m in by_kind["names"]] == list(parts.ids)
    disc, arrow = by_kind["parts"][0], by_kind["velocities"][0]
    assert (disc.pose.position.x, disc.pose.position.y) == tuple(parts.position[0])
    ahead = parts.position[0] + parts.velocity[0]
    assert np.allclose([arrow.points[1].x, arrow.points[1].y], ahead)
    assert len(by_kind["trails"][0].points) == 2
