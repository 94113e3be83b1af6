"""ROS node that publishes the images of a camera, a pipe, a film or a folder as `image_raw`. A
separate thread reads the images. The diagnostics report faults of the stream (`watch`)."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, Image

from plate_core import PlateError, load_rig
from plate_core.ros import (
    IMAGE,
    WARN_S,
    NodeOptions,
    SafeLifecycleNode,
    array_to_image,
    camera_to_info,
    parameter,
    run_node,
    to_time,
)
from plate_core.status import Finding, Level, combined, used

from ..camera import load_lens
from ..errors import ImageError
from .source import FORMATS, AbsentError, Frame, Settings, Source, Warn
from .sources import is_played, listing, make_source, video_devices
from .watch import Watch

RETRY_S = 0.5
"""Delay before the next attempt to open a camera that has failed [s]."""

TIMEOUT_S, TIMEOUT_IMAGES = 0.8, 5
"""Time without an image after which the diagnostics report an error: the larger one of `TIMEOUT_S`
[s] and `TIMEOUT_IMAGES` image intervals."""

POLL_S = 0.05
"""Interval between two checks for a subscriber before a film starts [s]."""

END_S = 2.0
"""Maximum time to wait for the end of the reader's thread [s]. The thread may end later, because
OpenCV waits up to 10 s for an image."""

AUTO = "auto"
"""Value of the parameter `format` with which the node chooses the format."""

CLOCK_READS, CLOCKS_APART_NS = 5, 100_000
"""`CLOCK_READS` is the maximum number of attempts to read the steady clock and the node's clock at
the same time. If an attempt takes less than `CLOCKS_APART_NS` [ns], there is no further attempt."""


@dataclass(frozen=True)
class CameraParameters(NodeOptions):
    """Parameters of the camera node."""

    device: str = parameter(
        "/dev/video0",
        "Path of a video device (preferably in /dev/v4l/by-id), genicam:FILE.cti, a pipe, a "
        "video, a picture or a folder of pictures",
    )
    width: int = parameter(
        0, "Width of the images [px]. 0 means the width in the rig file.", 0, 16384
    )
    height: int = parameter(
        0, "Height of the images [px]. 0 means the height in the rig file.", 0, 16384
    )
    rate: float = parameter(
        0.0,
        "Images per second. 0 means 30 for a camera, the file's rate for a video, and 2 for a "
        "picture or a folder.",
        0.0, 1000.0,
    )  # fmt: skip
    format: str = parameter(
        AUTO,
        "Pixel format. auto means the first format that has this size and rate.",
        choices=(AUTO, *FORMATS),
    )
    camera_file: str = parameter(
        "",
        "File of the lens that the node publishes in camera_info, such as camera.yaml. If it is "
        "empty, the lens is unknown.",
    )
    exposure_us: float = parameter(
        0.0, "Exposure time [us]. 0 means the device's setting.", 0.0, 1e6, live=True
    )
    readout_us: float = parameter(
        0.0,
        "Time from the end of the exposure to the stamp [us]. It is not used if stamps mark the "
        "start of the exposure.",
        0.0, 1e6, live=True,
    )  # fmt: skip
    gain: int = parameter(
        -1, "Gain in the device's units. -1 means the device's setting.", -1, 100000, live=True
    )
    white_balance_k: int = parameter(
        0, "White balance [K]. 0 means the device's setting.", 0, 20000, live=True
    )
    focus: int = parameter(
        -1, "Focus in the device's units. -1 means the device's setting.", -1, 100000, live=True
    )
    auto_exposure: bool = parameter(False, "Whether the device chooses the exposure.", live=True)
    auto_gain: bool = parameter(False, "Whether the device chooses the gain.", live=True)
    auto_white_balance: bool = parameter(
        False, "Whether the device chooses the white balance.", live=True
    )
    auto_focus: bool = parameter(False, "Whether the device chooses the focus.", live=True)

    trigger: bool = parameter(
        False, "Whether a GenICam camera takes one image for each pulse at its trigger input."
    )

    def settings(self, size_px: tuple[int, int]) -> Settings:
        """Return the settings of the source. `size_px` is the rig's width and height."""
        names = {item.name for item in fields(Settings)}
        values = {name: getattr(self, name) for name in names}
        width, height = self.width or size_px[0], self.height or size_px[1]
        form = "" if self.format == AUTO else self.format
        return replace(Settings(**values), width=width, height=height, format=form)


class CameraNode(SafeLifecycleNode[CameraParameters]):
    """Lifecycle node `camera`: publishes the images of a camera, a film or a folder of pictures.

    Publishes image_raw, camera_info, diagnostics. Each image is stamped with the start of its
    exposure. Automatic exposure, gain, white balance and focus of the device are off unless the
    respective parameter auto_... is true.

    `device` may be a V4L2 camera (/dev/videoN, or preferably its path in /dev/v4l/by-id), a GenICam
    camera (genicam:FILE.cti, the GenTL file of its manufacturer), a named pipe of raw frames, a
    video, a picture, or a folder of pictures. A video, picture or folder starts to play when
    image_raw has a subscriber. `camera --list` prints devices, formats, rates and controls.

    If a camera is unplugged, the diagnostics report an ERROR within 1 s. When the camera is plugged
    in again, the images continue.
    """

    def __init__(self) -> None:
        super().__init__("camera", CameraParameters)
        self._thread: threading.Thread | None = None
        self._open = False
        self._stop_event = threading.Event()
        self.report(self._diagnose, self._diagnostic_values, "camera", self._begin_report)

    def source(self, settings: Settings, warn: Warn) -> Source:
        """Return the source of images. Tests override this method."""
        return make_source(settings, warn)

    def configure(self) -> None:
        """Open the device when the node is configured, so that faults of the device are reported
        before the activation."""
        values = self.options
        camera = load_rig(values.rig_file).camera
        self._size_px = (camera.width_px, camera.height_px)
        settings = values.settings(self._size_px)
        self._played = is_played(values.device)
        self._source = self.source(settings, self._warn_once)
        self._source.open()
        self._open = True
        size = None if self._played else settings.size_px
        lens = load_lens(values.camera_file, size) if values.camera_file else None
        self._lens, self._lens_px = lens, size
        self._rig_camera = replace(camera, lens=None)
        self._image_raw = self.managed_publisher(Image, "image_raw", IMAGE)
        self._camera_info = self.managed_publisher(CameraInfo, "camera_info", IMAGE)

    def begin(self) -> None:
        """Start the thread that reads the images."""
        self._watch = Watch()
        # The thread that reads images and the functions that report its state share the attributes
        # below.
        self._lock = threading.Lock()
        self._fault = ""
        self._refused, self._refused_total, self._refusal = 0, 0, ""
        self._ended = False
        self._waits_for_subscriber = self._played
        self._last_at = self._reported_at = time.monotonic()
        self._warned_at = -WARN_S
        self._stop_event = threading.Event()
        self._thread = threading.Thread(
            target=self._read_images,
            args=(self._source, self._stop_event, self._thread),
            name="camera",
            daemon=True,
        )
        self._thread.start()

    def rest(self) -> None:
        """Stop the thread that reads the images."""
        self._stop_event.set()
        if self._thread is not None:
            self._thread.join(END_S)

    def release(self) -> None:
        """Close the device. If the reader's thread still waits for an image, this thread closes the
        device later."""
        self.rest()  # during a shutdown of ROS, no other function calls `rest`
        if not self._open or (self._thread is not None and self._thread.is_alive()):
            return
        self._open = False
        self._source.close()

    def retune(self) -> None:
        """Apply the settings that can be changed while the node runs."""
        self._source.change(self.options.settings(self._size_px))

    # Functions of the thread that reads images

    def _read_images(
        self, source: Source, stop: threading.Event, before: threading.Thread | None
    ) -> None:
        """Read and publish images until the source ends or `stop` is set.

        `before` is the thread of the previous reader. This method waits until `before` has ended
        and has closed the source.
        """
        if before is not None:
            before.join()
        while self._waits_for_subscriber and not stop.wait(POLL_S):
            self._waits_for_subscriber = not self._image_raw.get_subscription_count()
        while not stop.is_set():
            try:
                if not self._open:
                    source.open()
                    self._open = True
                frame = source.read(stop)
                if frame is not None and not stop.is_set():
                    self._publish_frame(frame)
                    continue
            except ImageError as error:
                self._report_refused_image(str(error))
                continue
            except Exception as error:
                # Also catch errors of the cameras' libraries. An error that is not caught would end
                # the thread without a message.
                if not self.context.ok():  # the shutdown of ROS has caused the error
                    break
                self._report_fault(error)
                # A source that reads files is not opened again, because it would start from the
                # first picture.
                if not source.live:
                    break
                self._close_source(source)
                stop.wait(RETRY_S)
                continue
            if not stop.is_set():
                self._report_end()
            break
        self._close_source(source)

    def _close_source(self, source: Source) -> None:
        self._open = False
        try:
            source.close()
        except Exception as error:  # the cameras' libraries raise errors of different types
            self._report_fault(error)

    def _publish_frame(self, frame: Frame) -> None:
        stamp = self._to_node_time(frame.instant)
        height, width = frame.pixels.shape[:2]
        if self._fault:
            self.get_logger().info(f"{self.options.device}: images continue")
        with self._lock:
            self._fault, self._last_at = "", time.monotonic()
            self._watch.add(frame.pixels, frame.instant, frame.arrival)
            number = self._watch.total
        image = array_to_image(frame.pixels, stamp, frame.encoding)
        self._camera_info.publish(self._make_camera_info(image, (width, height)))
        self._image_raw.publish(image)
        if frame.name and not self._is_film:
            self.get_logger().info(f"image {number} is {frame.name}")

    @property
    def _is_film(self) -> bool:
        return self._source.state().get("format") == "film"

    def _to_node_time(self, instant: float) -> Time:
        """Convert a time of the steady clock [s] to the node's clock."""
        for _ in range(CLOCK_READS):
            before_ns = time.monotonic_ns()
            now_ns = self.get_clock().now().nanoseconds
            apart_ns = time.monotonic_ns() - before_ns
            # both clocks were read within a short time: no other process ran in between
            if apart_ns < CLOCKS_APART_NS:
                break
        return to_time(now_ns - (before_ns + apart_ns // 2 - round(1e9 * instant)))

    def _make_camera_info(self, image: Image, size_px: tuple[int, int]) -> CameraInfo:
        camera = replace(self._rig_camera, width_px=size_px[0], height_px=size_px[1])
        info = camera_to_info(camera, image.header)
        # If the size of the pictures has changed, read the lens file again. `load_lens` checks that
        # the lens was calibrated for this size.
        if self._lens is not None and size_px != self._lens_px:
            self._lens, self._lens_px = load_lens(self.options.camera_file, size_px), size_px
        lens = self._lens
        if lens is not None:
            (fx, _, cx), (_, fy, cy) = lens.matrix[:2].tolist()
            info.distortion_model, info.d = lens.model, lens.distortion.tolist()
            info.k = lens.matrix.ravel().tolist()
            info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
            info.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        return info

    def _report_refused_image(self, why: str) -> None:
        with self._lock:
            self._refused += 1
            self._refused_total += 1
            self._refusal = why
            self._last_at = now = time.monotonic()
        if now - self._warned_at >= WARN_S:
            self._warned_at = now
            self.get_logger().warning(why)

    def _report_fault(self, error: Exception) -> None:
        """Record and log why no images arrive. If the device is still absent or the fault is the
        same as before, do not log it again."""
        text = str(error)
        if not isinstance(error, PlateError):
            text = f"{self.options.device}: {type(error).__name__}: {error}"
        if self._fault and (isinstance(error, AbsentError) or text == self._fault):
            return
        with self._lock:
            self._fault = text
        self.get_logger().error(self._fault)

    def _report_end(self) -> None:
        with self._lock:
            self._ended = True
        self.get_logger().info(f"the last of {self._watch.total} images was played")

    def _warn_once(self, text: str) -> None:
        self.get_logger().warning(text)

    # Diagnostics

    def _diagnose(self, now: float) -> Finding:
        with self._lock:
            findings: list[Finding | None] = [*self._watch.findings(self._source.live)]
            findings.append(
                used("images", self._watch.images + self._refused, self._refused, self._refusal)
            )
            if self._fault:
                findings.append(Finding(Level.ERROR, self._fault))
            elif self._source.live and self._is_timed_out(now):
                findings.append(
                    Finding(
                        Level.ERROR,
                        f"{self.options.device}: no image for {now - self._last_at:.1f} s; "
                        f"{self._source.advice}",
                    )
                )
            if self._waits_for_subscriber:
                return combined(findings, "waiting for a subscriber of image_raw")
            if self._ended:
                return combined(findings, f"the last of {self._watch.total} images was played")
        if second_publisher := self.second_publisher("image_raw"):
            findings.append(Finding(Level.WARN, second_publisher))
        return combined(findings, f"images from {self.options.device}")

    def _is_timed_out(self, now: float) -> bool:
        allowed = TIMEOUT_IMAGES / self.options.rate if self.options.rate else 0.0
        return now - self._last_at > max(TIMEOUT_S, allowed)

    def _diagnostic_values(self) -> Mapping[str, object]:
        now, watch = time.monotonic(), self._watch
        return {
            "device": self.options.device,
            "images": watch.total,
            "rate_hz": f"{watch.images / max(now - self._reported_at, 1e-3):.1f}",
            "lost": watch.lost,
            "late": watch.late,
            "refused": self._refused_total,
            **self._source.state(),
        }

    def _begin_report(self) -> None:
        with self._lock:
            self._watch.begin_report()
            self._refused, self._reported_at = 0, time.monotonic()


def main() -> None:
    """Run the node. With the argument --list, print the devices instead."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["--list"]:
        for line in listing(arguments[1:] or video_devices()):
            print(line)
        return
    run_node(CameraNode, CameraParameters)
