"""The detector node: `image_raw` in, `parts` out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, MultiDOFJointState

from plate_core import PlateError, load_rig
from plate_core.ros.convert import image_to_array, parts_to_msg, seconds
from plate_core.ros.main import run_node
from plate_core.ros.params import declare, follow, parameter
from plate_core.ros.qos import CAMERA, DATA

from .calibration import Lens
from .detection import DetectorOptions
from .errors import CalibrationError, ImageError
from .tracking import Tracker, TrackerOptions
from .vision import look, make_vision

WARN_PERIOD_S = 2.0
"""Least time between two warnings of a kind [s]."""

LENS_MODELS = ("plumb_bob", "rational_polynomial")
"""Distortion models of sensor_msgs/CameraInfo that the core understands."""


@dataclass(frozen=True)
class DetectorParameters:
    """Parameters of the node."""

    rig_file: str = parameter("", "Rig file; empty: the default rig")
    threshold: float = parameter(
        DetectorOptions.threshold,
        "Share of the bare plate's brightness below which a pixel belongs to a part [-]",
        0.1,
        0.95,
        live=True,
    )
    class_threshold: float = parameter(
        DetectorOptions.class_threshold,
        "Share of the bare plate's brightness below which a part is black, above grey [-]",
        0.05,
        0.95,
        live=True,
    )
    radius_tolerance: float = parameter(
        DetectorOptions.radius_tolerance,
        "Greatest deviation from the rig's part radius [radii]",
        0.05,
        0.6,
        live=True,
    )
    min_plate_grey: float = parameter(
        DetectorOptions.min_plate_grey,
        "Darkest plate that is believed [grey levels]",
        1.0,
        255.0,
        live=True,
    )
    margin_px: float = parameter(
        DetectorOptions.margin_px,
        "How far outside the plate a part's centre may be [px]",
        0.0,
        10.0,
        live=True,
    )
    gate_m: float = parameter(
        TrackerOptions.gate_m,
        "Greatest distance between where a part is expected and found, per image [m]",
        0.001,
        1.0,
        live=True,
    )
    max_missed: int = parameter(
        TrackerOptions.max_missed,
        "Images in a row that a part may be missed before its id is given up",
        0,
        1000,
        live=True,
    )
    velocity_frames: int = parameter(
        TrackerOptions.velocity_frames,
        "Images over which the drift is taken",
        1,
        100,
        live=True,
    )

    def detector(self) -> DetectorOptions:
        """Return the options of the detection."""
        return DetectorOptions(
            threshold=self.threshold,
            class_threshold=self.class_threshold,
            radius_tolerance=self.radius_tolerance,
            min_plate_grey=self.min_plate_grey,
            margin_px=self.margin_px,
        )

    def tracker(self) -> TrackerOptions:
        """Return the options of the tracking."""
        return TrackerOptions(
            gate_m=self.gate_m, max_missed=self.max_missed, velocity_frames=self.velocity_frames
        )


class DetectorNode(Node):
    """Node `detector`: subscribes image_raw and camera_info, publishes parts.

    Every image that can be used is answered, also if no part is seen; the answer carries the
    image's stamp. Of camera_info only the lens is used, in place of the rig file's: where the plate
    is in the image says the rig file.
    """

    def __init__(self) -> None:
        super().__init__("detector")
        values = declare(self, DetectorParameters)
        self._rig = load_rig(values.rig_file)
        self._lens_message: tuple[object, ...] | None = None
        self._vision = make_vision(self._rig, values.detector())
        self._tracker = Tracker(values.tracker())
        self._follow = follow(self, values, self._retune)
        self._parts = self.create_publisher(MultiDOFJointState, "parts", DATA)
        self.create_subscription(CameraInfo, "camera_info", self._on_camera_info, CAMERA)
        self.create_subscription(Image, "image_raw", self._on_image, CAMERA)

    def _on_image(self, msg: Image) -> None:
        try:
            image = image_to_array(msg)
            self._tracker = look(self._vision, self._tracker, image, seconds(msg.header.stamp))
        except PlateError as error:
            text = f"image_raw ignored: {error}"
            self.get_logger().warning(text, throttle_duration_sec=WARN_PERIOD_S)
            return
        self._parts.publish(parts_to_msg(self._tracker.parts, msg.header.stamp))

    def _on_camera_info(self, msg: CameraInfo) -> None:
        content = (msg.width, msg.height, msg.distortion_model, tuple(msg.k), tuple(msg.d))
        if content == self._lens_message:
            return
        self._lens_message = content  # judged once, not with every image
        try:
            lens = lens_of(msg, self._vision.size_px)
            self._vision = make_vision(self._rig, self._vision.options, lens)
        except PlateError as error:
            self.get_logger().warning(f"camera_info ignored: {error}")

    def _retune(self, values: DetectorParameters) -> None:
        options = replace(values.detector(), radius_px=self._vision.options.radius_px)
        self._vision = replace(self._vision, options=options)
        self._tracker = replace(self._tracker, options=values.tracker())


def lens_of(msg: CameraInfo, size_px: tuple[int, int]) -> Lens | None:
    """Return the lens of a camera; None if it is not calibrated: K[0] is 0.

    Raises
    ------
    PlateError
        If the camera is not that of the rig, or its lens is not understood.
    """
    if (msg.width, msg.height) != size_px:
        raise ImageError(
            f"size is {msg.width} x {msg.height} px, allowed: {size_px[0]} x {size_px[1]} px"
        )
    if msg.k[0] == 0:
        return None
    if any(msg.d) and msg.distortion_model not in LENS_MODELS:
        raise CalibrationError(
            f"distortion_model is {msg.distortion_model!r}, allowed: {', '.join(LENS_MODELS)}"
        )
    distortion = np.array(msg.d, dtype=float) if len(msg.d) else np.zeros(5)
    return Lens(np.array(msg.k, dtype=float).reshape(3, 3), distortion)


def main() -> None:
    """Run the node."""
    run_node(DetectorNode)
