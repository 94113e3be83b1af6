"""Markers for RViz, compared with the numbers from which they are drawn."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from plate_core import CycleRequest, Parts, PlateCycle, load_rig
from plate_core.ros import centres_to_msg, forces_to_msg, scene_to_msg, to_time

STAMP = to_time(7)


def test_scene_over_the_wire():
    rig = load_rig()
    position, velocity = [[0.1, -0.05], [0.0, 0.02]], [[0.01, 0.0], [0.0, -0.02]]
    parts = Parts.make(("black_1", "bolt_2"), np.array(position), np.array(velocity))
    trails = {"black_1": [(0.09, -0.05), (0.1, -0.05)], "bolt_2": [(0.0, 0.02)]}
    msg = scene_to_msg(rig, parts, trails, np.array([0.001, 0.0, 0.1]), STAMP)
    msg = deserialize_message(serialize_message(msg), MarkerArray)
    names = [(m.ns, m.id) for m in msg.markers]
    assert len(set(names)) == len(names)
    assert all(m.header.stamp == STAMP and m.lifetime.sec == 1 for m in msg.markers)
    assert all(m.color.a == 1 and m.action == Marker.ADD for m in msg.markers)
    plate = msg.markers[0]
    assert (plate.scale.x, plate.scale.y) == (0.6, 0.3)
    assert plate.pose.position.x == 0.001
    assert 2 * np.arcsin(plate.pose.orientation.z) == pytest.approx(0.1)
    assert ("trails", 0) in names
    assert ("trails", 1) not in names  # one point is no line
    discs = [m for m in msg.markers if m.ns == "parts"]
    assert [m.scale.x for m in discs] == [0.016, 0.016]
    assert discs[0].color.r != discs[1].color.r
    arrow = next(m for m in msg.markers if (m.ns, m.id) == ("velocities", 1))
    assert arrow.points[1].y == pytest.approx(0.0)


def test_without_parts_only_the_plate_is_drawn():
    rig, nothing = load_rig(), Parts.make((), np.empty((0, 2)))
    assert len(scene_to_msg(rig, nothing, {}, np.zeros(3), STAMP).markers) == 1
    assert forces_to_msg(rig, CycleRequest.make(nothing), STAMP).markers == []


def test_centres_of_a_plate_that_swings_about_a_point():
    """Poses turned about a point by hand: wherever it turns, it turns about that point."""
    middle, time = np.array([0.12, -0.05]), np.linspace(0, 1, 64, endpoint=False)
    theta = 0.02 * np.sin(2 * np.pi * time)
    arm = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    x = middle[0] - arm[:, 0] * middle[0] + arm[:, 1] * middle[1]
    y = middle[1] - arm[:, 1] * middle[0] - arm[:, 0] * middle[1]
    cycle = PlateCycle.from_samples(0.1, np.column_stack([x, y, theta]))
    (marker,) = centres_to_msg(load_rig(), cycle, STAMP).markers
    seen = np.array([(p.x, p.y) for p in marker.points])
    assert len(seen) > 150
    assert np.median(np.abs(seen - middle), axis=0).max() < 1e-4
    blue = sum(c.b > c.r for c in marker.colors)
    assert abs(blue - len(seen) / 2) < 10  # as long one way as the other
    still = centres_to_msg(load_rig(), PlateCycle.rest(0.1), STAMP).markers
    assert still[0].points == []
