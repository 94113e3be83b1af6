"""Poses of the frames as tf2 takes them, against OpenCV and complex numbers."""

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy")

from plate_core.ros import camera_to_msg, plate_to_msg, to_time
from plate_core.ros.frames import add_prefix

STAMP = to_time(1_500_000_000)


def moved(transform, points):
    """Points (n, 3) of the child's frame in the parent's: v + 2 w (q x v) + 2 q x (q x v)."""
    q, t = transform.rotation, transform.translation
    axis = np.array([q.x, q.y, q.z])
    once = np.cross(axis, points)
    return points + 2 * q.w * once + 2 * np.cross(axis, once) + [t.x, t.y, t.z]


@pytest.mark.parametrize("turn", [(3.05, 0.04, -0.03), (0.0, 3.1, 0.2), (0.1, -0.2, 2.9)])
def test_the_camera_sees_along_its_z_axis(turn):
    rotation, translation = cv2.Rodrigues(np.array(turn))[0], np.array([0.01, -0.005, 0.65])
    (msg,) = camera_to_msg(rotation, translation, STAMP).transforms
    assert (msg.header.frame_id, msg.child_frame_id) == ("plate_home", "camera_optical_frame")
    assert msg.header.stamp == STAMP
    points = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    assert np.allclose(moved(msg.transform, points @ rotation.T + translation), points)


@pytest.mark.parametrize("theta", [0.0, 0.01, -0.4, 3.0])
def test_the_plate_turns_counter_clockwise(theta):
    (msg,) = plate_to_msg(np.array([0.002, -0.001, theta]), STAMP).transforms
    assert (msg.header.frame_id, msg.child_frame_id) == ("plate_home", "plate")
    x, y, z = moved(msg.transform, np.array([[0.3, 0.1, 0.02]]))[0]
    assert np.isclose(x + 1j * y, 0.002 - 0.001j + np.exp(1j * theta) * (0.3 + 0.1j))
    assert np.isclose(z, 0.02)


def test_the_prefix_of_frames_is_added_once():
    msg = plate_to_msg(np.zeros(3), STAMP)
    for _ in range(2):
        add_prefix(msg, "left/")
        (transform,) = msg.transforms
        assert transform.header.frame_id == "left/plate_home"
        assert transform.child_frame_id == "left/plate"
