"""The frames' names, and their poses for tf2."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

FRAME, PLATE_FRAME, CAMERA_FRAME = FRAMES = ("plate_home", "plate", "camera_optical_frame")
"""Fixed in the room; the moving plate; the camera (x to the right, y down, z ahead: REP 103)."""


def transform_to_msg(
    child: str, rotation: np.ndarray, translation: np.ndarray, stamp: Time
) -> TFMessage:
    """Return where a frame is in plate_home: columns of rotation (3, 3) are its axes, translation
    (3,) [m] is its origin."""
    from scipy.spatial.transform import Rotation  # here: programs that publish none need no scipy

    msg = TransformStamped(header=Header(stamp=stamp, frame_id=FRAME), child_frame_id=child)
    place, turn = msg.transform.translation, msg.transform.rotation
    place.x, place.y, place.z = np.asarray(translation, dtype=float).tolist()
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(rotation).as_quat().tolist()
    return TFMessage(transforms=[msg])


def plate_to_msg(pose: np.ndarray, stamp: Time) -> TFMessage:
    """Return where the plate is, pose (3,) [m, m, rad] in plate_home."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return transform_to_msg(PLATE_FRAME, turn, np.append(pose[:2], 0.0), stamp)


def camera_to_msg(rotation: np.ndarray, translation: np.ndarray, stamp: Time) -> TFMessage:
    """Return where the camera is, from where plate_home is in its frame (`rig.home_pose`)."""
    return transform_to_msg(CAMERA_FRAME, rotation.T, -rotation.T @ translation, stamp)


def add_prefix(msg: Any, prefix: str) -> None:
    """Put a prefix before the names of our frames in a message, where it is not there yet."""
    for part in (msg, *getattr(msg, "markers", ()), *getattr(msg, "transforms", ())):
        header = getattr(part, "header", None)
        if header is not None and header.frame_id in FRAMES:
            header.frame_id = prefix + header.frame_id
        if getattr(part, "child_frame_id", None) in FRAMES:
            part.child_frame_id = prefix + part.child_frame_id
