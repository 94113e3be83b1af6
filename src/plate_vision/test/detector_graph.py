"""The detector and a probe that plays the camera, in one process."""

import cv2
import numpy as np
import rclpy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import Trigger
from stepped_clock import SteppedExecutor

from plate_core import CycleRequest
from plate_core.ros import DATA, IMAGE, array_to_image, request_to_msg, start_nodes, to_time
from plate_interfaces.msg import PartForces
from plate_interfaces.msg import Parts as PartsMsg
from plate_vision.node import DetectorNode

CENTRE_PX = np.array([[150.0, 200.0], [400.0, 300.0]])
LABEL = ["black", "grey"]


class Graph:
    """The detector and a probe that plays the camera."""

    clock = None
    """Clock of the test: see `detector_time`."""

    def __init__(self, **parameters):
        args = ["--ros-args", "-r", "__ns:=/detector_test"]
        for name, value in parameters.items():
            args += ["-p", f"{name}:={value}"]
        rclpy.init(args=args)
        self.warnings, self.notes = warnings, notes = [], []

        class Recorded(DetectorNode):
            def get_logger(self):
                logger = super().get_logger()
                logger.warning = lambda text, **_: warnings.append(text)
                logger.info = lambda text, **_: notes.append(text)
                return logger

        try:
            self.detector = Recorded()
            start_nodes(self.detector)
        except BaseException:
            rclpy.try_shutdown()
            raise
        self.probe = rclpy.create_node("probe")
        self.executor = SteppedExecutor(self.clock)
        self.until = self.executor.until
        self.executor.add_node(self.detector)
        self.executor.add_node(self.probe)
        self.parts = []
        raw = parameters.get("image_transport", "raw") == "raw"
        kind, topic = (Image, "image_raw") if raw else (CompressedImage, "image_raw/compressed")
        self.images = self.probe.create_publisher(kind, topic, IMAGE)
        self.resets = self.probe.create_client(Trigger, "detector/reset")
        self.infos = self.probe.create_publisher(CameraInfo, "camera_info", IMAGE)
        self.probe.create_subscription(PartsMsg, "parts", self.parts.append, DATA)

    def answer(self, msg):
        """Publish an image and return the message with its parts; None if the image was refused."""
        answers, warnings = len(self.parts), len(self.warnings)
        self.images.publish(msg)
        self.until(lambda: len(self.parts) > answers or len(self.warnings) > warnings)
        return self.parts[-1] if len(self.parts) > answers else None

    def close(self):
        self.executor.shutdown()
        self.detector.destroy_node()
        self.probe.destroy_node()
        rclpy.try_shutdown()


def image(frame, stamp_s, encoding="mono8"):
    return array_to_image(frame, to_time(round(stamp_s * 1e9)), encoding)


def compressed(frame, stamp_s, extension=".jpg", form="mono8; jpeg compressed mono8"):
    msg = CompressedImage(format=form)
    msg.header.stamp = to_time(round(stamp_s * 1e9))
    msg.data = cv2.imencode(extension, frame)[1].tobytes()
    return msg


def names(parts):
    return [part.id for part in parts.parts]


def called(graph, service):
    client = graph.probe.create_client(Trigger, f"detector/{service}")
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    return future.result()


def plan(graph, parts, stamp):
    """Publish the planner's prediction: these `Parts` at rest in the image of this stamp [s]."""
    forces = graph.probe.create_publisher(PartForces, "part_forces", DATA)
    graph.until(forces.get_subscription_count)
    known = graph.detector._expected
    request = CycleRequest.make(parts, start=np.hstack([parts.position, np.zeros((len(parts), 2))]))
    forces.publish(request_to_msg(request, to_time(0), to_time(round(1e9 * stamp))))
    graph.until(lambda: graph.detector._expected is not known)
