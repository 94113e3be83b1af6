"""Names of the frames, and their poses as messages for tf2."""

from __future__ import annotations

from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

FRAME, PLATE_FRAME, CAMERA_FRAME = FRAMES = ("plate_home", "plate", "camera_optical_frame")
"""Names of the world-fixed frame, of the frame of the moving plate, and of the camera frame (x
right, y down, z forward, as in REP 103)."""


def transform_to_msg(
    child: str, rotation: np.ndarray, translation: np.ndarray, stamp: Time
) -> TFMessage:
    """Return the pose of a frame in plate_home as a message. The columns of rotation (3, 3) are the
    frame's axes, translation (3,) [m] is its origin."""
    # SciPy is imported here, because most programs do not need it.
    from scipy.spatial.transform import Rotation

    msg = TransformStamped(header=Header(stamp=stamp, frame_id=FRAME), child_frame_id=child)
    position, quaternion = msg.transform.translation, msg.transform.rotation
    position.x, position.y, position.z = np.asarray(translation, dtype=float).tolist()
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = (
        Rotation.from_matrix(rotation).as_quat().tolist()
    )
    return TFMessage(transforms=[msg])


def plate_to_msg(pose: np.ndarray, stamp: Time) -> TFMessage:
    """Return the pose of the plate (3,) [m, m, rad] in plate_home as a message."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    matrix = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return transform_to_msg(PLATE_FRAME, matrix, np.append(pose[:2], 0.0), stamp)


def camera_to_msg(rotation: np.ndarray, translation: np.ndarray, stamp: Time) -> TFMessage:
    """Return the pose of the camera in plate_home as a message. The arguments are the pose of
    plate_home in the camera frame: the result of `rig.home_pose`."""
    return transform_to_msg(CAMERA_FRAME, rotation.T, -rotation.T @ translation, stamp)


def add_prefix(msg: Any, prefix: str) -> None:
    """Add a prefix to the names of this project's frames in a message. Names that already have the
    prefix stay unchanged."""
    for part in (msg, *getattr(msg, "markers", ()), *getattr(msg, "transforms", ())):
        header = getattr(part, "header", None)
        if header is not None and header.frame_id in FRAMES:
            header.frame_id = prefix + header.frame_id
        if getattr(part, "child_frame_id", None) in FRAMES:
            part.child_frame_id = prefix + part.child_frame_id
