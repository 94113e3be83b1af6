"""Rectification of the camera's image to a view from straight above, in the frame plate_home."""

from __future__ import annotations

import cv2
import numpy as np

from plate_core import PlateError, Rig
from plate_core.rig import homography

MARGIN = 0.06
"""Width of the margin that is shown around the plate [fraction of the plate's length]."""

QUALITY = 75
"""Quality of the JPEG compression [%]."""

UNSEEN = (128, 128, 128)
"""Colour of areas outside the camera's image."""


class TopView:
    """Rectifies images of the camera of one rig to pictures of the plate.

    Parameters
    ----------
    rig : Rig
    width_px : int
        Width of the picture.

    Attributes
    ----------
    x, y : (float, float)
        Ranges that the picture covers [m, plate_home].
    """

    def __init__(self, rig: Rig, width_px: int = 640) -> None:
        margin = MARGIN * rig.plate.length_m
        across, up = rig.plate.half + margin
        self.x, self.y = (-float(across), float(across)), (-float(up), float(up))
        height_px = round(width_px * up / across)
        x = np.linspace(-across, across, 2 * width_px + 1)[1::2]
        y = np.linspace(up, -up, 2 * height_px + 1)[1::2]
        point = np.stack([*np.meshgrid(x, y), np.ones((height_px, width_px))], axis=-1)
        seen = point @ homography(rig).T
        pixel = seen[..., :2] / seen[..., 2:]
        if rig.camera.lens is not None:
            pixel = rig.camera.lens.bend(pixel)
        self._shape = rig.camera.height_px, rig.camera.width_px
        self._x, self._y = np.moveaxis(pixel.astype(np.float32), -1, 0)

    def jpeg(self, image: np.ndarray) -> bytes:
        """Return the picture of an image as JPEG. The image is (H, W) or (H, W, 3), in the order
        blue, green, red.

        Raises
        ------
        PlateError
            If the image does not have the size of the rig's camera.
        """
        if image.shape[:2] != self._shape:
            (height, width), (high, wide) = image.shape[:2], self._shape
            raise PlateError(f"size of the image is {width} x {height}, allowed: {wide} x {high}")
        top = cv2.remap(image, self._x, self._y, cv2.INTER_LINEAR, borderValue=UNSEEN)
        done, data = cv2.imencode(".jpg", top, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        assert done
        return data.tobytes()
