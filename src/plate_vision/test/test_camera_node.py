"""The camera node in real time: its images over topics, its faults in diagnostics."""

import os
import threading
import time
from collections import deque

import cv2
import numpy as np
import pytest
from fake_camera import FakeCamera

rclpy = pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402

from plate_core import PlateError  # noqa: E402
from plate_core.ros import (  # noqa: E402
    CAMERA,
    DATA,
    NodeExecutor,
    array_to_image,
    msg_to_reports,
    nanoseconds,
    start_nodes,
)
from plate_core.status import Level  # noqa: E402
from plate_interfaces.msg import Parts  # noqa: E402
from plate_vision.camera import Lens, save_lens  # noqa: E402
from plate_vision.image_sources import Watch  # noqa: E402
from plate_vision.image_sources import node as camera_node  # noqa: E402
from plate_vision.image_sources.node import CameraNode  # noqa: E402
from plate_vision.node import DetectorNode  # noqa: E402

MAX_S = 60.0
"""Maximum duration of an operation that takes a moment [s]."""

MAX_COPIES = 12
"""Cost of an image from its pixels to its message, over that of a copy."""

SIZE = {"width": 64, "height": 48}
GREY = {"GREY": {(64, 48): (30, 60)}}
NOISE = np.random.default_rng(0).integers(100, 120, (48, 64), np.uint8)
RNG = np.random.default_rng(0)


def noise():
    return np.roll(NOISE, int(RNG.integers(NOISE.size)))


class Graph:
    """The node, and a probe that receives its messages. `camera` replaces a device."""

    def __init__(self, camera=None, detector=None, listen=True, **parameters):
        words = ["--ros-args"]
        for name, value in parameters.items():
            words += ["-p", f"camera:{name}:={value}"]
        for name, value in (detector or {}).items():
            words += ["-p", f"detector:{name}:={value}"]
        rclpy.init(args=words)
        self.device, self.notes, self.reports = camera, [], deque(maxlen=1000)
        notes = self.notes

        class Heard(CameraNode):
            def source(self, settings, warn):
                return camera.source(settings, warn) if camera else super().source(settings, warn)

            def get_logger(self):
                logger = super().get_logger()
                for level in ("info", "warning", "error"):
                    setattr(logger, level, lambda text, **_: notes.append(text))
                return logger

        self.nodes = [Heard()]
        self.executor = NodeExecutor()
        try:
            self.nodes += [DetectorNode()] if detector is not None else []
            start_nodes(*self.nodes)
        except BaseException:
            self.close()
            raise
        self.camera = self.nodes[0]
        self.probe = rclpy.create_node("probe")
        self.nodes.append(self.probe)
        for node in self.nodes:
            self.executor.add_node(node)
        self.images, self.infos = [], []
        self.probe.create_subscription(DiagnosticArray, "diagnostics", self._on_report, DATA)
        self.probe.create_subscription(CameraInfo, "camera_info", self.infos.append, CAMERA)
        if listen:
            self.listen()

    def listen(self):
        self.probe.create_subscription(Image, "image_raw", self.images.append, CAMERA)
        self.until(lambda: self.camera.count_subscribers("image_raw"))

    def _on_report(self, msg):
        self.reports.extend(
            each
            for each in msg_to_reports(msg, self.probe.get_namespace())
            if each.node == "camera"
        )

    def until(self, condition):
        end = time.monotonic() + MAX_S
        while not condition():
            assert time.monotonic() < end, self.notes + [each.message for each in self.reports][-1:]
            self.executor.spin_once(timeout_sec=0.02)

    def report(self, words, level=Level.ERROR, shows=None):
        """Wait for diagnostics with these words, while the camera shows this, and return them."""
        self.reports.clear()

        def reported():
            if shows is not None and self.device.given.empty():
                self.device.show(shows(), time.monotonic())
            return any(words in each.message for each in self.reports)

        self.until(reported)
        found = next(each for each in self.reports if words in each.message)
        assert found.level == level, found
        return found

    def close(self):
        if self.device is not None:
            self.device.stalled = True  # the reader need not wait 10 s
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def start():
    graphs = []

    def start(*words, **parameters):
        graphs.append(Graph(*words, **parameters))
        return graphs[-1]

    yield start
    for graph in graphs:
        graph.close()


@pytest.fixture
def camera(tmp_path):
    return FakeCamera(tmp_path / "video0", GREY)


def shown(graph, camera, count=1):
    """Let the camera take images until the node has published a given number of further ones."""
    before = len(graph.images)

    def enough():
        if camera.given.empty():
            camera.show(noise(), time.monotonic())
        return len(graph.images) >= before + count

    graph.until(enough)


def test_stamps_are_right_to_a_millisecond(start, camera):
    """An image of 20 ms ago by the kernel's clock is stamped 20 ms ago by the node's clock."""
    graph = start(camera, device=camera.path, **SIZE)
    wrong_ns = []
    for k in range(20):
        taken = time.monotonic() - 0.02
        camera.show(np.roll(NOISE, k), taken)
        graph.until(lambda k=k: len(graph.images) == k + 1)
        since_ns = time.monotonic_ns() - round(1e9 * taken)
        now_ns = graph.camera.get_clock().now().nanoseconds
        wrong_ns.append(nanoseconds(graph.images[-1].header.stamp) - (now_ns - since_ns))
    assert np.abs(np.median(wrong_ns)) < 1e5
    (image, *_) = graph.images
    assert (image.encoding, image.width, image.height, image.step) == ("mono8", 64, 48, 64)
    assert bytes(image.data) == NOISE.tobytes()
    assert image.header.frame_id == "camera_optical_frame"


def test_camera_info_is_the_file_s_or_not_calibrated(start, camera, tmp_path):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)
    graph.until(lambda: graph.infos)
    assert (graph.infos[0].width, graph.infos[0].k[0]) == (64, 0.0)
    assert graph.infos[0].header.stamp == graph.images[0].header.stamp
    graph.close()
    camera.stalled = False
    path = tmp_path / "camera.yaml"
    matrix = np.array([[80.0, 0, 31.5], [0, 81.0, 23.5], [0, 0, 1]])
    save_lens(path, "camera", (64, 48), Lens(matrix, np.array([0.1, 0, 0, 0, 0])))
    graph = start(camera, device=camera.path, camera_file=path, **SIZE)
    shown(graph, camera)
    graph.until(lambda: graph.infos)
    (info, *_) = graph.infos
    assert list(info.k) == matrix.ravel().tolist()
    assert list(info.d) == [0.1, 0, 0, 0, 0]
    assert info.p[5] == 81.0


def test_an_unplugged_camera_is_named_and_continues_when_it_is_back(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)
    camera.unplug()
    graph.report("is unplugged; images continue when it is back")
    camera.plug()
    shown(graph, camera)
    assert "unplugged" not in graph.camera._diagnose(time.monotonic()).message
    assert [text for text in graph.notes if "video0" in text] == [
        f"{camera.path}: the camera is unplugged; images continue when it is back",
        f"{camera.path}: images continue",
    ]


def test_a_silent_camera_is_named(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    graph.report("s; check that the camera is plugged in and does not wait for a trigger")


def test_a_silent_pipe_is_named(start, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    start(device=tmp_path / "pipe", **SIZE).report("s; check that a program writes frames")


def test_an_error_of_a_library_is_reported_and_images_continue(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)

    def fail(*_):
        raise cv2.error("no memory")

    graph.camera._source._capture.retrieve = fail
    camera.show(noise(), time.monotonic())
    text = f"{camera.path}: error: no memory"
    graph.report(text)
    assert graph.notes.count(text) == 1
    shown(graph, camera)
    graph.camera._source._capture.release = fail  # a device that cannot even be closed
    camera.stalled = True
    graph.until(lambda: graph.notes.count(text) == 2)
    camera.stalled = False
    shown(graph, camera)


def test_frames_of_another_size_are_refused_and_the_others_used(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    camera.show(NOISE[:-1], time.monotonic())
    graph.until(
        lambda: any("3008 bytes, allowed: 3072 (64 x 48 px of GREY)" in t for t in graph.notes)
    )
    shown(graph, camera)
    assert graph.camera._refused_total == 1


def test_a_black_and_a_frozen_picture_are_errors(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    black = np.full((48, 64), 5, np.uint8)
    graph.report("the image is black; remove the lens cap", shows=lambda: black)
    graph.report("the image is frozen", shows=lambda: NOISE)


def test_gain_may_change_while_it_runs_within_what_the_device_can(start, camera):
    graph = start(camera, device=camera.path, gain=40, **SIZE)
    (done,) = graph.camera.set_parameters([Parameter("gain", value=10)])
    assert done.successful
    assert camera.controls[0x980913][-1] == 10
    (done,) = graph.camera.set_parameters([Parameter("gain", value=500)])
    assert "gain is 500, allowed by Fake camera: 0 to 100" in done.reason
    assert camera.controls[0x980913][-1] == 10


def test_a_device_that_cannot_be_used_ends_the_start(start, camera):
    camera.busy = True
    with pytest.raises(PlateError, match="used by another program"):
        start(camera, device=camera.path, **SIZE)


def test_after_a_rest_the_device_is_reopened(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)
    camera.stalled = True
    graph.camera.trigger_deactivate()
    camera.stalled = False
    graph.camera.trigger_activate()
    # Wait for the device first: an image from before the rest may still arrive.
    graph.until(lambda: camera.opened >= 2)  # a busy reader tries in between, too
    shown(graph, camera)


def test_a_reader_that_still_waits_ends_before_the_next_one_opens_the_device(start, camera):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)
    waits = threading.Event()  # for an image, longer than the node waits for its reader
    capture = graph.camera._source._capture
    grab, busy = capture.grab, []

    def slow():
        busy.append(1)
        waits.wait(MAX_S)
        return grab()

    capture.grab = slow
    graph.until(lambda: busy)
    graph.camera.trigger_deactivate()
    graph.camera.trigger_activate()
    assert camera.opened == 1
    camera.stalled = True
    waits.set()
    graph.until(lambda: camera.opened == 2)
    camera.stalled = False
    shown(graph, camera)
    assert len(busy) == 1


@pytest.mark.parametrize("age_s", [-1e6, -20.0, 5.0])
def test_an_image_whose_stamp_jumps_is_refused(start, camera, age_s):
    graph = start(camera, device=camera.path, **SIZE)
    shown(graph, camera)
    wrong_s = 1e-9 * graph.camera.get_clock().now().nanoseconds - age_s
    camera.show(noise(), time.monotonic() - age_s)
    graph.until(lambda: any("after its stamp, allowed: 0 to 2 s" in text for text in graph.notes))
    shown(graph, camera)
    assert all(abs(1e-9 * nanoseconds(one.header.stamp) - wrong_s) > 1 for one in graph.images)


def test_a_lens_of_another_size_than_a_folders_pictures_ends_it(start, tmp_path, draw, rng):
    path, file = tmp_path / "pictures", tmp_path / "camera.yaml"
    path.mkdir()
    matrix = np.array([[900.0, 0, 319.5], [0, 900.0, 239.5], [0, 0, 1]])
    save_lens(file, "camera", (1280, 960), Lens(matrix, np.zeros(5)))
    graph = start(device=folder(path, draw, rng), rate=50.0, camera_file=file)
    graph.report("camera.yaml: image size is 1280 x 960")
    assert not graph.images


def folder(path, draw, rng):
    for k in range(3):
        place = np.array([[150.0 + k, 200.0], [400.0, 300.0]])
        picture = draw(place, ["black", "grey"], rng, radius=7.9)
        cv2.imwrite(str(path / f"{k}.png"), picture)
    return path


def test_a_folder_starts_with_the_first_subscriber_and_ends_with_its_last_picture(
    start, tmp_path, draw, rng
):
    graph = start(device=folder(tmp_path, draw, rng), rate=50.0, listen=False)
    graph.report("waiting for a subscriber of image_raw", Level.OK)
    graph.listen()
    graph.report("the last of 3 images was played", Level.OK)
    assert graph.notes[1:4] == [f"image {k + 1} is {k}.png" for k in range(3)]
    assert [image.encoding for image in graph.images] == ["bgr8"] * 3


def test_a_damaged_picture_ends_a_folder(start, tmp_path, draw, rng):
    path = folder(tmp_path, draw, rng)
    (path / "1.png").write_bytes(b"no picture")
    graph = start(device=path, rate=50.0)
    graph.report("no more pictures: ")
    graph.until(lambda: graph.images)
    assert [text for text in graph.notes if " is " in text] == ["image 1 is 0.png"]


def test_the_detector_reports_the_content_of_each_photograph(start, tmp_path, draw, rng):
    path = folder(tmp_path, draw, rng)
    graph = start(device=path, rate=50.0, detector={"photographs": True}, listen=False)
    parts = []
    graph.probe.create_subscription(Parts, "parts", parts.append, DATA)
    graph.until(lambda: len(parts) == 3)
    assert [[part.id for part in msg.parts] for msg in parts] == [["black_1", "grey_1"]] * 3


def test_an_image_costs_no_more_than_a_few_copies_of_it():
    """Beyond decoding: 60 images a second of 1280 x 720 px. Numbers that are copied one by one cost
    hundreds of copies."""
    pictures = [RNG.integers(50, 255, (720, 1280, 3), np.uint8) for _ in range(2)]
    watch, times, copies = Watch(), [], []
    for k in range(21):
        began = time.thread_time()
        pictures[k % 2].copy()
        copied = time.thread_time()
        watch.add(pictures[k % 2], k / 60, k / 60)
        array_to_image(pictures[k % 2], Time(), "bgr8")
        times.append(time.thread_time() - copied)
        copies.append(copied - began)
    assert np.median(times) < MAX_COPIES * np.median(copies)


def test_devices_are_listed_without_a_node(monkeypatch, capsys, tmp_path):
    ran, none = [], tmp_path / "video9"
    monkeypatch.setattr(camera_node, "run_node", lambda *given: ran.append(given))
    monkeypatch.setattr("sys.argv", ["camera", "--list", str(none)])
    camera_node.main()
    assert (str(none) in capsys.readouterr().out, ran) == (True, [])
    monkeypatch.setattr("sys.argv", ["camera", "--ros-args"])
    camera_node.main()
    assert ran == [(CameraNode, camera_node.CameraParameters)]
    assert not capsys.readouterr().out
