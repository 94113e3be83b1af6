"""The lens of a camera_info message."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from ..camera import Lens
from ..errors import check_size


def lens_of(msg: CameraInfo, size_px: tuple[int, int]) -> Lens | None:
    """Return the lens of a camera_info message. Return None if the camera is not calibrated (K[0]
    is 0).

    Raises
    ------
    PlateError
        If the image size differs from the rig's image size, or if the lens model is not supported.
    """
    check_size("size is", (msg.width, msg.height), size_px)
    if msg.k[0] == 0:
        return None
    return Lens(np.array(msg.k, dtype=float).reshape(3, 3), np.array(msg.d), msg.distortion_model)
