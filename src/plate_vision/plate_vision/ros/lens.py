"""The lens of a camera_info message."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from ..camera import Lens, Region
from ..errors import check_size


def lens_of(msg: CameraInfo, size_px: tuple[int, int]) -> Lens | None:
    """Return the lens of a camera_info message. Return None if the camera is not calibrated: K[0]
    is 0, or 1 from the node image_publisher.

    Raises
    ------
    PlateError
        If the image size differs from the rig's image size, or if the lens model is not supported.
    """
    roi = msg.roi
    region = Region(
        (msg.width, msg.height),
        (roi.x_offset, roi.y_offset),
        (roi.width, roi.height),
        (msg.binning_x, msg.binning_y),
    )
    # drivers of cameras that are not calibrated also publish the size 0 x 0
    if msg.k[0] in (0, 1):
        return None
    check_size("size is", region.size_px, size_px, why=region.reason)
    matrix = region.matrix(np.array(msg.k, dtype=float).reshape(3, 3))
    return Lens(matrix, np.array(msg.d), msg.distortion_model)
