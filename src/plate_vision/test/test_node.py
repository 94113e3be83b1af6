"""The node over real topics, in one process."""

import re

import cv2
import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import PoseStamped  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from stepped_clock import STEP_S, SteppedExecutor  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from plate_core import Parts, PlateError, Wanted, config_path, load_rig  # noqa: E402
from plate_core.rig import load_part_types  # noqa: E402
from plate_core.ros import (  # noqa: E402
    DATA,
    IMAGE,
    LATCHED,
    TRANSFORMS,
    array_to_image,
    msg_to_parts,
    start_nodes,
    to_time,
    wanted_to_msg,
)
from plate_core.status import Level  # noqa: E402
from plate_interfaces.msg import Aim, AimCheck, LensPictures, PartForces  # noqa: E402
from plate_interfaces.msg import Parts as PartsMsg  # noqa: E402
from plate_interfaces.srv import TakeLensPictures  # noqa: E402
from plate_vision import OVERLOOKED, observe  # noqa: E402
from plate_vision.camera import Board, Lens, LensFit  # noqa: E402
from plate_vision.node import DetectorNode, lens_of  # noqa: E402
from plate_vision.ros.aiming import LensJob  # noqa: E402
from plate_vision.tracking import update  # noqa: E402

CORNERS_PX = np.array([[21.01, 387.25], [617.82, 389.5], [614.33, 93.94], [26.86, 91.35]])
CENTRE_PX = np.array([[150.0, 200.0], [400.0, 300.0]])
LABEL = ["black", "grey"]
MARKER_CENTRES = ((-0.27, -0.12), (0.27, -0.12), (0.27, 0.12), (-0.27, 0.12))


class Graph:
    """The detector and a probe that plays the camera."""

    clock = None
    """Of the test."""

    def __init__(self, **parameters):
        args = ["--ros-args", "-r", "__ns:=/detector_test"]
        for name, value in parameters.items():
            args += ["-p", f"{name}:={value}"]
        rclpy.init(args=args)
        self.warnings, self.notes = warnings, notes = [], []

        class Heard(DetectorNode):
            def get_logger(self):
                logger = super().get_logger()
                logger.warning = lambda text, **_: warnings.append(text)
                logger.info = lambda text, **_: notes.append(text)
                return logger

        try:
            self.detector = Heard()
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
        """Publish an image and return the answer; None if it was refused."""
        answers, warnings = len(self.parts), len(self.warnings)
        self.images.publish(msg)
        self.until(lambda: len(self.parts) > answers or len(self.warnings) > warnings)
        return self.parts[-1] if len(self.parts) > answers else None

    def close(self):
        self.executor.shutdown()
        self.detector.destroy_node()
        self.probe.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture(autouse=True)
def _time(clock, monkeypatch):
    monkeypatch.setattr(Graph, "clock", clock)


@pytest.fixture
def graph():
    graph = Graph()
    yield graph
    graph.close()


def image(frame, stamp_s, encoding="mono8"):
    return array_to_image(frame, to_time(round(stamp_s * 1e9)), encoding)


def names(parts):
    return [part.id for part in parts.parts]


def test_every_image_is_answered_with_its_stamp(graph, draw, rng):
    for k in range(3):
        frame = draw(CENTRE_PX + [k, 0], LABEL, rng, radius=7.9)
        msg = image(frame, 7.0 + 0.05 * k)
        answer = graph.answer(msg)
        assert answer.header.stamp == msg.header.stamp
        assert answer.header.frame_id == "plate_home"
        parts = msg_to_parts(answer)
        assert parts.ids == ("black_1", "grey_1")
        seen = graph.detector._vision.calibration.to_image(parts.position)
        assert np.abs(seen - CENTRE_PX - [k, 0]).max() < 0.06
        assert k == 0 or np.allclose(parts.velocity[:, 0], 0.0202, atol=2e-3)
    assert graph.answer(msg) == answer  # lockstep publishes an image again until it is answered
    empty = graph.answer(image(draw([], [], rng), 7.2))
    assert names(empty) == []
    assert graph.warnings == []


def packed(frame, encoding):
    """Grey levels in another encoding, packed by hand: a grey mosaic is the grey image itself."""
    if encoding in ("bgr8", "rgb8"):
        return np.dstack([frame] * 3)
    if encoding in ("mono16", "bayer_rggb16"):
        return frame.astype("<u2") << 8
    if encoding.startswith("yuv422"):
        grey = np.rint(16 + frame * (219 / 255)).astype(np.uint8)
        pair = [np.full_like(grey, 128), grey]
        return np.dstack(pair if encoding == "yuv422" else pair[::-1])
    return frame


@pytest.mark.parametrize(
    "encoding",
    ["bgr8", "rgb8", "mono16", "yuv422", "yuv422_yuy2", "bayer_rggb16"]
    + [f"bayer_{first}8" for first in ("rggb", "bggr", "gbrg", "grbg")],
)
def test_encodings(graph, draw, rng, encoding):
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)
    data = packed(frame, encoding)
    msg = image(frame, 1.0)
    msg.encoding, msg.step, msg.data = encoding, data.nbytes // 480, data.tobytes()
    answer = graph.answer(msg)
    assert names(answer) == ["black_1", "grey_1"]
    seen = graph.detector._vision.calibration.to_image(msg_to_parts(answer).position)
    assert np.abs(seen - CENTRE_PX).max() < 0.1
    assert graph.warnings == []


def compressed(frame, stamp_s, extension=".jpg", form="mono8; jpeg compressed mono8"):
    msg = CompressedImage(format=form)
    msg.header.stamp = to_time(round(stamp_s * 1e9))
    msg.data = cv2.imencode(extension, frame)[1].tobytes()
    return msg


def test_compressed_images(draw, rng):
    graph = Graph(image_transport="compressed")
    try:
        frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)
        msg = compressed(frame, 3.0)
        answer = graph.answer(msg)
        assert answer.header.stamp == msg.header.stamp
        assert names(answer) == ["black_1", "grey_1"]
        seen = graph.detector._vision.calibration.to_image(msg_to_parts(answer).position)
        assert np.abs(seen - CENTRE_PX).max() < 0.1
        colour = compressed(np.dstack([frame] * 3), 4.0, ".png", "bgr8; png compressed bgr8")
        assert names(graph.answer(colour)) == ["black_1", "grey_1"]
        for content in (b"", b"no picture", bytes(msg.data)[:-100], bytes(msg.data)[:2000]):
            assert graph.answer(CompressedImage(format="jpeg", data=content)) is None
            assert "image_raw/compressed ignored: image: " in graph.warnings[-1]
        assert graph.answer(compressed(frame[:1, :1], 5.0)) is None
        assert "size is 1 x 1 px, allowed: 640 x 480" in graph.warnings[-1]
        assert len(graph.parts) == 2
    finally:
        graph.close()


@pytest.mark.parametrize(("grey", "words"), [(0, "is the light on"), (255, "burnt out")])
def test_without_light_or_with_too_much_nothing_is_found(graph, grey, words):
    graph.images.publish(image(np.full((480, 640), grey, np.uint8), 1.0))
    graph.until(lambda: graph.parts)
    assert names(graph.parts[-1]) == []
    assert words in graph.warnings[-1]
    assert "allowed: " in graph.warnings[-1]


def test_diagnostics_tell_silence_refusals_and_bad_light(draw, rng):
    graph = Graph(input_timeout_s=0.5)
    try:
        reports = []
        graph.probe.create_subscription(DiagnosticArray, "diagnostics", reports.append, DATA)

        def told(level, *words, play=None):
            """Play an image again and again until diagnostics say what they should."""

            for _ in range(200):
                if play is not None:
                    graph.images.publish(play)
                graph.executor.spin_for(STEP_S)
                status = reports[-1].status[0] if reports else DiagnosticStatus()
                if status.level == level and all(w in status.message for w in words):
                    return {item.key: item.value for item in status.values}
            raise AssertionError(f"not told: {level} {words}, but {reports[-1:]}")

        told(DiagnosticStatus.STALE, "no image yet on", "image_raw: does the camera run?")
        good = image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)
        values = told(DiagnosticStatus.OK, "all images used", play=good)
        assert (values["refused"], values["parts_seen"]) == ("0", "2")
        assert int(values["images"]) > 0
        assert float(values["rate_hz"]) > 0
        assert 0 < float(values["detection_ms_median"]) <= float(values["detection_ms_max"])
        wrong = image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)
        wrong.encoding = "32FC1"
        values = told(DiagnosticStatus.ERROR, "images refused: ", "'32FC1'", play=wrong)
        assert int(values["refused"]) > 0
        dark = image(np.zeros((480, 640), np.uint8), 2.0)
        told(DiagnosticStatus.WARN, "is the light on", play=dark)
        told(DiagnosticStatus.STALE, "no image for ", "does the camera run?")
    finally:
        graph.close()


def test_things_that_are_no_parts_are_published_and_counted(graph, draw, rng, monkeypatch):
    def observe_less(vision, tracker, image, stamp, expected=None):
        """See two parts, and take neither for one."""
        seen = observe(vision, tracker, image, stamp, expected).found
        place = np.array([track.position for track in seen])
        things = np.zeros(len(place), OVERLOOKED)
        things["x_px"], things["y_px"] = vision.calibration.to_image(place).T
        things["x"], things["y"] = place.T
        things["radius_px"], things["reason"] = 9.7, "too large"
        return update(tracker, stamp, np.zeros((0, 2)), [], overlooked=things)

    monkeypatch.setattr("plate_vision.node.observe", observe_less)
    reports = []
    graph.probe.create_subscription(DiagnosticArray, "diagnostics", reports.append, DATA)
    msg = graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0))
    assert names(msg) == []
    scale = graph.detector._vision.calibration.scale(np.zeros((1, 2)))[0]
    assert [thing.reason for thing in msg.overlooked] == ["too large"] * 2
    assert msg.overlooked[0].radius == pytest.approx(9.7 / scale, rel=0.01)
    assert (msg.overlooked[0].x, msg.overlooked[0].y) == pytest.approx((-0.17, 0.04), abs=0.01)
    graph.until(lambda: reports and reports[-1].status[0].level == b"\x01")
    status = reports[-1].status[0]
    assert "no part is detected, but 2 things are seen: 2 too large (radius 9.8" in (status.message)
    assert {item.key: item.value for item in status.values}["overlooked_too_large"] == "2"


def test_an_outline_that_is_not_where_corners_px_have_it_is_reported_until_reset(graph, draw, rng):
    def status(play, first):
        """Return the diagnostics after these images."""
        for k in range(5):
            graph.answer(image(play(), first + 0.1 * k))
        status = graph.detector._find(0.0)
        return status, graph.detector._values()["plate_outline"]

    moved = CORNERS_PX + [5, -4]
    found, text = status(lambda: draw(CENTRE_PX, LABEL, rng, corners=CORNERS_PX), 1.0)
    assert (found.message, text[:12]) == ("all images used", "as predicted")
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    found, text = status(lambda: draw(CENTRE_PX, LABEL, rng, corners=moved), 2.0)
    assert found.level == Level.WARN
    assert "the plate's outline is not where corners_px and the lens have it: it is shifted" in (
        found.message
    )
    assert text.startswith("it is shifted by (5.")
    assert any("the plate's outline" in warning for warning in graph.warnings)
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert graph.detector._find(0.0).message == "all images used"


@pytest.mark.parametrize("kind", ["raw", "compressed"])
@pytest.mark.parametrize("bits", [10, 12])
def test_images_of_fewer_bits_than_are_said_name_the_parameter(draw, rng, kind, bits):
    """A camera with 12 bits in numbers of 16: not only more light is asked for."""
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9).astype("<u2") << (bits - 8)
    graph = Graph(image_transport=kind)
    try:
        if kind == "raw":
            msg = image(np.zeros((480, 640), np.uint8), 1.0)
            msg.encoding, msg.step, msg.data = "mono16", 1280, frame.tobytes()
        else:
            msg = compressed(frame, 1.0, ".png", "mono16; png compressed")
        graph.answer(msg)
        text = graph.warnings[0]
        assert "is the light on" in text
        assert text.endswith(f"uses only {bits} of the 16 bits, set the parameter bits to {bits}")
        graph.detector.set_parameters([Parameter("bits", value=bits)])
        for second in (2, 3, 4):  # a new part must be seen more than once
            msg.header.stamp.sec = second
            seen = graph.answer(msg)
        assert names(seen) == ["black_1", "grey_1"]
    finally:
        graph.close()


def test_faint_patches_are_reported(graph, draw, rng):
    def faint(image):
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        for cx in (150.0, 250.0, 350.0):
            image[np.hypot(x - cx, y - 240) <= 8] -= 4

    for k in range(3):
        assert names(graph.answer(image(draw([], [], rng, extra=faint), 1.0 + 2.1 * k))) == []
    found = graph.detector._find(0.0)
    assert found.level == Level.WARN
    assert "3 faint patches as large as parts are not detected (contrast to" in found.message
    assert graph.detector._values()["faint_patches"] == 3


def test_noise_alone_is_no_part(graph, rng):
    for k, low in enumerate((0, 100, 200)):
        frame = rng.integers(low, 256, (480, 640), dtype=np.uint8)
        assert names(graph.answer(image(frame, 1.0 + k))) == []


def test_reset_forgets_all_parts(graph, draw, rng):
    two = image(draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9), 1.0)
    one = [draw(CENTRE_PX[1:], ["grey"], rng, radius=7.9) for _ in range(2)]
    assert names(graph.answer(two)) == ["grey_1", "grey_2"]
    assert names(graph.answer(image(one[0], 1.1))) == ["grey_2"]
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert done.result().success
    assert done.result().message == "2 parts forgotten"
    assert names(graph.answer(image(one[1], 1.2))) == ["grey_1"]


def test_part_forces_tell_which_part_is_which(graph, draw, rng):
    """A row moves on by its own spacing; without the prediction it seems to rest, and one to be
    gone at one end and another new at the other."""
    row = np.array([[150.0, 240.0], [185.0, 240.0], [220.0, 240.0]])
    forces = graph.probe.create_publisher(PartForces, "part_forces", DATA)
    graph.until(forces.get_subscription_count)

    def seen(places, stamp):
        frame = draw(places, ["grey"] * len(places), rng, radius=7.9)
        return msg_to_parts(graph.answer(image(frame, stamp)))

    def expect(parts, stamp):
        known = graph.detector._expected
        start = np.hstack([parts.position, np.zeros((len(parts), 2))])
        wanted = Wanted.make(parts, start=start)
        forces.publish(wanted_to_msg(wanted, to_time(0), to_time(round(1e9 * stamp))))
        graph.until(lambda: graph.detector._expected is not known)

    seen(row, 1.0)
    before = seen(row, 1.2)
    calibration = graph.detector._vision.calibration
    moved = Parts.make(before.ids, calibration.to_home(row + [35.0, 0.0]))
    expect(moved, 1.4)
    after = seen(row + [35.0, 0.0], 1.4)
    assert after.ids == before.ids == ("grey_1", "grey_2", "grey_3")
    assert np.abs(after.position - moved.position).max() < 1e-4
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert graph.detector._expected is None


def test_ids_that_end_are_told(draw, rng):
    graph = Graph(max_missed=1)
    try:
        both = draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9)
        one = draw(CENTRE_PX[:1], ["grey"], rng, radius=7.9)
        for k, frame in enumerate((both, one, one)):
            graph.answer(image(frame, 1.0 + 0.1 * k))
        assert "given up after 2 images: grey_2" in graph.notes
        assert graph.detector._values()["ids_given_up"] == 1
        black = draw(CENTRE_PX[:1], ["black"], rng, radius=7.9)
        for k in range(8):
            graph.answer(image(black, 2.0 + 0.1 * k))
        assert "grey_1 has been seen as another class since: it is black_1" in graph.notes
        assert graph.detector._values()["ids_renamed"] == 1
    finally:
        graph.close()


def test_wrong_images_are_refused_and_the_node_goes_on(graph, draw, rng):
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)

    def wrong(words, **fields):
        msg = image(frame, 1.0)
        for name, value in fields.items():
            setattr(msg, name, value)
        assert graph.answer(msg) is None
        for word in ("image_raw ignored", "allowed", *words):
            assert word in graph.warnings[-1]

    wrong(["encoding", "32FC1", "mono8, bgr8, rgb8"], encoding="32FC1")
    wrong(["step", "600", "640"], step=600)
    wrong(["bytes", "307199", "307200"], data=image(frame, 1.0).data[:-1])
    wrong(["size", "320 x 480", "640 x 480"], width=320)
    wrong(["size", "0 x 0"], width=0, height=0, step=0, data=[])
    wrong(["size", "1 x 1"], width=1, height=1, step=1, data=[0])
    wrong(["bytes", "0 bytes"], data=[])
    wrong(["size", "4000000000"], width=4_000_000_000, height=4_000_000_000, step=4_000_000_000)
    wrong(["size", "even"], width=639, encoding="bayer_rggb8", data=bytes(640 * 480))
    assert len(graph.warnings) == 9
    assert graph.parts == []
    padded = np.zeros((480, 704), np.uint8)
    padded[:, :640] = frame
    msg = image(padded, 2.0)
    msg.width = 640  # rows may be longer than the image is wide
    assert names(graph.answer(msg)) == ["black_1", "grey_1"]


def test_each_image_needs_a_stamp_of_its_own(graph, draw, rng):
    """A camera that fills in none had the parts of its first image answered for ever."""
    one, other = (draw(CENTRE_PX + [shift, 0], LABEL, rng, radius=7.9) for shift in (0, 30))
    for again in (one, one):
        assert names(graph.answer(image(again, 0.0))) == ["black_1", "grey_1"]
    assert graph.answer(image(other, 0.0)) is None
    assert "stamp is 0.000 s, that of another image before, allowed: a stamp" in graph.warnings[-1]


def test_one_image_that_comes_late_ends_no_ids_but_time_may_begin_anew(graph, draw, rng):
    both = draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9)
    second = draw(CENTRE_PX[1:], ["grey"], rng, radius=7.9)
    graph.answer(image(both, 5.0))
    assert names(graph.answer(image(second, 5.1))) == ["grey_2"]
    assert graph.answer(image(both, 5.05)) is None
    assert "stamp is 5.050 s, 0.050 s before that of the image before" in graph.warnings[-1]
    assert names(graph.answer(image(second, 5.2))) == ["grey_2"]
    assert graph.answer(image(second, 0.0)) is None
    assert names(graph.answer(image(second, 0.1))) == ["grey_1"]


def test_two_cameras_on_one_topic_are_told(graph):
    assert "image_raw (" not in graph.detector._find(0.0).message
    second = rclpy.create_node("camera_2", namespace="/detector_test")
    try:
        second.create_publisher(Image, "image_raw", IMAGE)
        graph.until(
            lambda: (
                "2 nodes publish image_raw (camera_2, probe), allowed: one"
                in graph.detector._find(0.0).message
            )
        )
    finally:
        second.destroy_node()


def test_live_parameters(graph, draw, rng):
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)
    radius_px = graph.detector._vision.options.radius_px
    (result,) = graph.detector.set_parameters([Parameter("threshold", value=0.5)])
    assert result.successful
    assert names(graph.answer(image(frame, 1.0))) == ["black_1"]
    assert graph.detector._vision.options.radius_px == radius_px
    (result,) = graph.detector.set_parameters([Parameter("max_missed", value=-1)])
    assert not result.successful
    assert result.reason == "Parameter max_missed out of range. Min: 0, Max: 1000, value: -1"
    (result,) = graph.detector.set_parameters([Parameter("rig_file", value="other.yaml")])
    assert not result.successful


@pytest.mark.parametrize(("name", "value"), [("threshold", 1.5), ("gate_m", 0.0)])
def test_wrong_parameters_are_refused_at_start(name, value):
    with pytest.raises(PlateError, match=f"parameter {name} is {value}, allowed: "):
        Graph(**{name: value})


def camera_info(d=(), model="plumb_bob", width=640):
    msg = CameraInfo(width=width, height=480, distortion_model=model)
    msg.k = [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]
    msg.d = [float(value) for value in d]
    return msg


def test_lens_of_camera_info():
    size = (640, 480)
    for none in (camera_info(), camera_info([0.0] * 5), camera_info(model="")):
        assert not np.any(lens_of(none, size).distortion)
    assert lens_of(CameraInfo(width=640, height=480, d=[0.1] * 5), size) is None  # not calibrated
    lens = lens_of(camera_info([-0.2, 0.0, 0.0, 0.0, 0.0]), size)
    assert lens.matrix[0].tolist() == [600, 0, 320]
    assert lens.distortion[0] == -0.2
    for msg in (
        camera_info(width=320),
        camera_info([0.1] * 5, model="equidistant"),
        camera_info([0.1] * 4, model="fisheye"),
        camera_info([0.1] * 4, model=""),
        camera_info([0.1] * 3),
    ):
        with pytest.raises(PlateError, match="allowed: "):
            lens_of(msg, size)


def test_distortion_of_camera_info_is_used(graph):
    graph.infos.publish(camera_info([-0.2, 0.0, 0.0, 0.0, 0.0]))
    graph.until(lambda: graph.detector._vision.calibration.lens is not None)
    graph.infos.publish(camera_info([0.1] * 4, model="fisheye"))
    graph.until(lambda: graph.warnings)
    assert "camera_info ignored: lens: distortion_model is 'fisheye'" in graph.warnings[0]
    assert graph.detector._vision.calibration.lens is not None


def test_zeros_are_a_pinhole_but_of_an_equidistant_lens():
    size = (640, 480)
    for count in (0, 4, 5, 8, 12, 14):
        for model in ("plumb_bob", "rational_polynomial"):
            assert not lens_of(camera_info([0.0] * count, model), size).bends
        lens = lens_of(camera_info([0.0] * count, "equidistant"), size)
        assert np.allclose(lens.bend([[920.0, 240.0]]), [320 + 150 * np.pi, 240])  # 45 degrees
    for values in ([0.1, 0.1, 0, 0, 0], [0.1] * 8, [0.1] * 8 + [0.0] * 4, [0.1] * 8 + [0.0] * 6):
        assert lens_of(camera_info(values, "rational_polynomial"), size).bends


@pytest.mark.parametrize(
    ("values", "model", "words"),
    [
        ([0.1] * 4, "fisheye", "lens: distortion_model is 'fisheye', allowed: plumb_bob, "),
        ([0.1] * 6, "plumb_bob", "lens: distortion has 6 values, allowed: 4 or 5 for plumb_bob"),
        ([-1.5, 0, 0, 0], "plumb_bob", "which folds the image of the plate, 189 px from"),
    ],
)
def test_a_refused_camera_info_stays_in_diagnostics(graph, draw, rng, values, model, words):
    """Until another is accepted."""
    reports = []
    graph.probe.create_subscription(DiagnosticArray, "diagnostics", reports.append, DATA)
    frame = image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)

    def told(level):
        reports.clear()
        for _ in range(400):
            graph.images.publish(frame)
            graph.executor.spin_for(STEP_S)
            if len(reports) == 4:
                break
        assert [report.status[0].level for report in reports[1:]] == 3 * [level]
        return reports[-1].status[0].message

    assert told(DiagnosticStatus.OK) == "all images used"
    graph.infos.publish(camera_info(values, model))
    graph.until(lambda: graph.warnings)
    text = told(DiagnosticStatus.ERROR)
    assert text.startswith("camera_info ignored: lens: distortion")
    assert words in text
    graph.infos.publish(camera_info([1e-3, 0.0, 0.0, 0.0], "plumb_bob"))  # edges stay straight
    graph.until(lambda: graph.detector._lens is not None)
    assert told(DiagnosticStatus.OK) == "all images used"


@pytest.mark.parametrize("wrong", ["no scale", "far"])
def test_a_camera_info_of_no_lens_is_refused_and_the_node_goes_on(graph, draw, rng, wrong):
    msg = camera_info([-0.2, 0.0, 0.0, 0.0, 0.0])
    if wrong == "no scale":
        msg.k[8] = 0.0
    else:
        msg.k[2], msg.d = 1e15, [0.01, 0.0, 0.0, 0.0, 0.0]
    graph.infos.publish(msg)
    graph.until(lambda: graph.warnings)
    assert "camera_info ignored: " in graph.warnings[0]
    assert "allowed: " in graph.warnings[0]
    assert names(graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0))) == [
        "black_1", "grey_1",
    ]  # fmt: skip


@pytest.fixture
def marked_rig(tmp_path):
    """The default rig file with markers."""
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    places = {f"marker_{k}": list(xy) for k, xy in enumerate(MARKER_CENTRES)}
    data["fiducials"] = {"dictionary": "4X4_50", "side_m": 0.03, "centre_m": places}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_plate_with_markers(make_plate, marked_rig, draw, rng):
    plate = make_plate(discs=[(0.1, 0.02, 40), (-0.1, -0.05, 130)])
    graph = Graph(rig_file=marked_rig)
    try:
        poses = []
        graph.probe.create_subscription(PoseStamped, "plate_pose", poses.append, DATA)
        graph.until(lambda: graph.detector.count_subscribers("plate_pose"))
        assert graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)) is None
        assert "not seen, allowed: all of 0, 1, 2, 3" in graph.warnings[-1]
        graph.warnings.clear()
        for k, x in enumerate([0.0, 0.001]):
            answer = graph.answer(image(plate.take([x, 0, 0], rng), 2.0 + 0.2 * k))
            assert names(answer) == ["black_1", "grey_1"]
            seen = msg_to_parts(answer).position
            assert np.abs(seen - [[0.1 + x, 0.02], [-0.1 + x, -0.05]]).max() < 2e-4
            graph.until(lambda k=k: len(poses) > k)
            assert poses[-1].header.frame_id == "plate_home"
            assert abs(poses[-1].pose.position.x - x) < 1e-4
        assert graph.warnings == []
        graph.images.publish(image(plate.take([0.008, 0, 0], rng), 3.0))
        graph.until(lambda: len(poses) > 2)
        assert "8.0 mm from home" in graph.warnings[-1]
        done = graph.resets.call_async(Trigger.Request())
        graph.until(done.done)
        graph.images.publish(image(plate.take([0.008, 0, 0], rng), 3.2))
        graph.until(lambda: len(poses) > 3)
        assert abs(poses[-1].pose.position.x) < 1e-4  # home is found anew
    finally:
        graph.close()


def heard_transforms(graph, qos, topic, count):
    """The newest of `count` transforms, to be called before they are published."""
    heard = []
    graph.probe.create_subscription(TFMessage, topic, heard.append, qos)
    graph.until(lambda: graph.detector.count_subscribers(topic))

    def newest():
        graph.until(lambda: len(heard) >= count)
        (transform,) = heard[-1].transforms
        return transform

    return newest


def test_frames_without_markers(draw, rng):
    """The camera where the default rig's corners and lens have it, for those who come later; where
    the plate is nobody knows. All names with the prefix."""
    graph = Graph(frame_prefix="left/")
    try:
        camera = heard_transforms(graph, LATCHED, "/tf_static", 1)()
        answer = graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 7.0))
        assert graph.detector.count_publishers("/tf") == 0
        assert answer.header.frame_id == camera.header.frame_id == "left/plate_home"
        assert camera.child_frame_id == "left/camera_optical_frame"
        rotation, translation = inverse(camera.transform)
        rig = load_rig()
        corners, lens = np.column_stack([rig.plate.corners, np.zeros(4)]), rig.camera.lens
        seen = cv2.projectPoints(
            corners, cv2.Rodrigues(rotation)[0], translation, lens.matrix, np.array(lens.distortion)
        )[0][:, 0]
        assert np.abs(seen - rig.camera.corners_px).max() < 0.02
    finally:
        graph.close()


def inverse(transform):
    """Rotation and translation of the parent in the child's frame."""
    q, t = transform.rotation, transform.translation
    rotation = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix().T
    return rotation, -rotation @ [t.x, t.y, t.z]


def test_frames_with_markers(make_plate, marked_rig, rng):
    """Camera and plate are found in the image: the plate as turned as it is, the camera leaning as
    it does, though the rig file knows neither."""
    plate = make_plate(lean=(0.02, -0.03, 0.01))
    graph = Graph(rig_file=marked_rig, frame_prefix="left/")
    try:
        camera = heard_transforms(graph, LATCHED, "/tf_static", 1)
        moving = heard_transforms(graph, TRANSFORMS, "/tf", 2)
        for k, pose in enumerate([(0.0, 0.0, 0.0), (0.001, -0.0015, 0.01)]):
            answer = graph.answer(image(plate.take(pose, rng), 2.0 + 0.2 * k))
        assert (moving().header.frame_id, moving().child_frame_id) == (
            "left/plate_home", "left/plate",
        )  # fmt: skip
        assert moving().header.stamp == answer.header.stamp
        rotation, translation = inverse(camera().transform)
        assert np.abs(rotation - plate.rotation).max() < 3e-3
        assert np.abs(translation - plate.translation).max() < 3e-3
        found = moving().transform
        assert np.allclose(
            [found.translation.x, found.translation.y, 2 * found.rotation.z],
            [0.001, -0.0015, 0.01], atol=2e-4,
        )  # fmt: skip
    finally:
        graph.close()


def test_pictures_for_people_only_for_those_who_look(graph, draw, rng):
    drawings, scenes = [], []
    frames = [draw(CENTRE_PX + [k, 0], LABEL, rng, radius=7.9) for k in range(3)]
    graph.answer(image(frames[0], 1.0))
    assert graph.detector._trails == {}
    graph.probe.create_subscription(Image, "detections_image", drawings.append, IMAGE)
    graph.probe.create_subscription(MarkerArray, "markers", scenes.append, DATA)
    graph.until(lambda: graph.detector._drawings.get_subscription_count())
    graph.until(lambda: graph.detector._markers.get_subscription_count())
    for k in (1, 2):
        parts = msg_to_parts(graph.answer(image(frames[k], 1.0 + 0.05 * k)))
        graph.until(lambda k=k: len(drawings) == k and len(scenes) == k)
    drawn = np.frombuffer(drawings[-1].data, np.uint8).reshape(480, 640, 3).astype(int)
    assert drawings[-1].encoding == "bgr8"
    changed = np.abs(drawn - frames[2][:, :, None]).max(axis=2) > 30
    for x, y in CENTRE_PX + [2, 0]:
        angle = np.linspace(0, 2 * np.pi, 24)
        rim = np.rint([y + 7.9 * np.sin(angle), x + 7.9 * np.cos(angle)]).astype(int)
        assert np.mean(changed[rim[0], rim[1]]) > 0.7  # outlined
    assert np.mean(changed) < 0.05
    by_kind = {}
    for marker in scenes[-1].markers:
        assert marker.header.frame_id == "plate_home"
        by_kind.setdefault(marker.ns, []).append(marker)
    assert {kind: len(all_) for kind, all_ in by_kind.items()} == {
        "plate": 1, "parts": 2, "names": 2, "velocities": 2, "trails": 2,
    }  # fmt: skip
    assert by_kind["plate"][0].scale.x == 0.6
    assert [m.text for m in by_kind["names"]] == list(parts.ids)
    disc, arrow = by_kind["parts"][0], by_kind["velocities"][0]
    assert (disc.pose.position.x, disc.pose.position.y) == tuple(parts.position[0])
    ahead = parts.position[0] + parts.velocity[0]
    assert np.allclose([arrow.points[1].x, arrow.points[1].y], ahead)
    assert len(by_kind["trails"][0].points) == 2


def told(graph):
    """What the log says of photographs, and no more of the parts of the last."""
    return [text for text in graph.notes if text.startswith("image ")]


def test_photographs_are_taken_each_by_itself(draw, rng):
    labels = [LABEL, LABEL, LABEL[::-1]]
    graph = Graph(photographs=True)
    try:
        found = [
            msg_to_parts(
                graph.answer(image(draw(CENTRE_PX, label, rng, radius=7.9), 1 + k, "mono8"))
            )
            for k, label in enumerate(labels)
        ]
        assert [parts.ids for parts in found] == [("black_1", "grey_1")] * 3
        places = [dict(zip(parts.ids, parts.position, strict=True)) for parts in found]
        assert places[1]["black_1"] == pytest.approx(places[0]["black_1"], abs=1e-3)
        assert places[2]["black_1"] == pytest.approx(places[0]["grey_1"], abs=1e-3)
        assert told(graph) == [f"image {k}: 2 parts: 1 black, 1 grey" for k in (1, 2, 3)]
        assert graph.warnings == []
    finally:
        graph.close()


def test_photographs_of_another_size_show_the_whole_plate():
    """Of a plate 0.6 m long on 480 px a part of 8 mm radius has 6.4 px."""
    picture = np.full((300, 480), 220, np.uint8)
    for x, y in CENTRE_PX - 50:
        cv2.circle(picture, (int(x), int(y)), 6, 40, -1, cv2.LINE_AA)
    graph = Graph(photographs=True)
    try:
        graph.images.publish(image(picture, 1.0))
        graph.until(lambda: graph.parts)
        parts = msg_to_parts(graph.parts[0])
        assert parts.ids == ("black_1", "black_2")
        expected = (CENTRE_PX - 50 - [239.5, 149.5]) * [1, -1] * 0.6 / 480
        assert np.abs(parts.position - expected).max() < 2e-4
        (warning,) = graph.warnings
        assert warning.startswith("480 x 300 px, not 640 x 480 px as the rig's camera: ")
        assert "a plate of 0.6 x 0.375 m that fills it; the rig's is 0.6 x 0.3 m. " in warning
    finally:
        graph.close()


def test_parts_of_another_size_than_the_rig_says(draw, rng):
    place = np.array([[200.0, 200], [300, 220], [400, 240], [450, 300]])
    large = draw(place, ["black"] * 3 + ["grey"], rng, radius=12.0)
    empty = draw(np.zeros((0, 2)), [], rng)
    other = np.full((100, 200), 220, np.uint8)
    graph = Graph(photographs=True)
    try:
        for k, picture in enumerate((large, empty, other)):
            graph.images.publish(image(picture, 1.0 + k))
            graph.until(lambda k=k: graph.detector._images == k + 1)
        assert told(graph) == ["image 1: no parts; 4 unknown", "image 2: no parts"]
        size, refused = graph.warnings
        found = re.match(
            r"image 1: no part is detected, but 4 things are seen: 4 too large "
            r"\(radius ([0-9.]+) mm, parts: radius_m is 8 mm\)",
            size,
        )
        assert found, size
        assert float(found[1]) == pytest.approx(12.0, rel=0.03)
        assert refused.startswith("image 3 ignored: image: size is 200 x 100 px, allowed: 640 x")
    finally:
        graph.close()


def test_a_photograph_that_shows_parts_too_small_is_refused():
    graph = Graph(photographs=True)
    try:
        assert graph.answer(image(np.full((90, 180), 220, np.uint8), 1.0)) is None
        assert "radius_m is 0.008, in the image 2.4 px, allowed: 3 to" in graph.warnings[0]
    finally:
        graph.close()


@pytest.mark.parametrize("name", ["source", "path", "rate"])
def test_parameters_of_earlier_versions_say_where_pictures_come_from_now(name):
    with pytest.raises(PlateError, match=rf"{name} of detector is gone: .* plate_vision camera "):
        Graph(**{name: "file"})


TYPES = load_part_types(config_path("parts.yaml"))
LYING = [("nut", -0.1, 0.05, 0.3), ("screw", 0.1, -0.05, 2.0), ("coin_large", 0.0, 0.0, 0.0)]


@pytest.fixture
def rig_with_types(tmp_path):
    """The default rig file with part types."""
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    data["types"] = str(config_path("parts.yaml").resolve())
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def called(graph, service):
    client = graph.probe.create_client(Trigger, f"detector/{service}")
    graph.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    graph.until(future.done)
    return future.result()


def test_parts_of_taught_types(rig_with_types, draw_types, rng):
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image
        drawings = []
        graph.probe.create_subscription(Image, "detections_image", drawings.append, IMAGE)
        graph.until(lambda: graph.detector.count_subscribers("detections_image"))

        def shown(poses, stamp_s):
            return image(draw_types(TYPES, poses, rng, to_image=to_image), stamp_s, "bgr8")

        graph.images.publish(shown(LYING, 1.0))
        graph.until(lambda: graph.parts)
        parts = msg_to_parts(graph.parts[-1])
        assert parts.ids == ("coin_large_1", "nut_1", "screw_1")
        for name, x, y, angle in LYING:
            i = parts.ids.index(f"{name}_1")
            assert np.abs(parts.position[i] - (x, y)).max() < 1e-4
            period = 2 * np.pi / max(TYPES[name].symmetry, 1)
            off = (parts.angle[i] - angle + period / 2) % period - period / 2
            assert name == "coin_large" or abs(off) < np.radians(1.5)
        (warning,) = graph.warnings
        assert "the bare plate is modelled from an image with parts: call ~/learn_plate" in warning
        graph.until(lambda: drawings)
        answer = called(graph, "learn_plate")
        assert answer.success
        assert (
            "next 5 images are taken for the bare plate; 3 things lie on it now" in answer.message
        )
        for k in range(5):
            graph.answer(shown([], 1.2 + 0.2 * k))
        assert graph.notes[-1] == "bare plate learned from 5 images"
        assert graph.detector._find(0.0).level == 0
        found = msg_to_parts(graph.answer(shown(LYING, 3.0)))
        assert np.abs(found.position - parts.position).max() < 1e-4
    finally:
        graph.close()


def test_a_modelled_plate_is_not_learned_by_a_rest(rig_with_types, draw_types, rng):
    """And images in grey levels among those in colours are not learned as one plate."""
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(poses, stamp_s, encoding="bgr8"):
            frame = draw_types(TYPES, poses, rng, to_image=to_image)
            return image(frame if encoding == "bgr8" else frame[:, :, 1], stamp_s, encoding)

        def warned():
            return "modelled" in graph.detector._find(0.0).message

        graph.images.publish(shown(LYING, 1.0))
        graph.until(lambda: graph.parts)
        graph.detector.trigger_deactivate()
        graph.detector.trigger_activate()
        graph.images.publish(shown(LYING, 1.2))
        graph.until(lambda: len(graph.parts) > 1)
        assert warned()
        called(graph, "learn_plate")
        for k in range(8):
            graph.images.publish(shown([], 2.0 + k, "mono8" if k == 2 else "bgr8"))
            graph.until(lambda k=k: len(graph.parts) > 2 + k)
        assert not warned()
        graph.detector.trigger_deactivate()
        graph.detector.trigger_activate()
        assert not warned()
        assert len(graph.answer(shown(LYING, 20.0)).parts) == 3
        assert len(graph.answer(shown(LYING, 20.1, "mono8")).parts) == 3
    finally:
        graph.close()


def test_a_type_is_taught_live(draw_types, rng, tmp_path):
    graph = Graph(teach_file=tmp_path / "parts.yaml")
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(poses, stamp_s):
            return image(draw_types(TYPES, poses, rng, to_image=to_image), stamp_s, "bgr8")

        refused = called(graph, "teach")
        assert not refused.success
        assert refused.message == "no image came yet, allowed: a part before the camera"
        graph.answer(shown(LYING[:1], 1.0))
        assert (
            "teach_name is empty, allowed: the name of the type" in called(graph, "teach").message
        )
        graph.detector.set_parameters([Parameter("teach_name", value="nut")])
        assert re.match(r"nut: 6 corners, 1 hole, .* 1 example", called(graph, "teach").message)
        graph.answer(shown([("nut", 0.1, 0.02, 1.0)], 2.0))
        assert "from 2 examples; written to" in called(graph, "teach").message
        assert load_part_types(tmp_path / "parts.yaml")["nut"].symmetry == 6
        graph.answer(shown(LYING[:2], 3.0))
        assert names(graph.answer(shown(LYING[:2], 3.2))) == ["nut_2", "unknown_1"]
    finally:
        graph.close()


LENS_KEYS = ("  focal_px", "  centre_px", "  distortion")
LONG_S = 60.0
"""A bound on what the thread of the view does in less than a second [s]."""


class Aimed:
    """The view to aim by, as a subscriber sees it."""

    def __init__(self, graph):
        self.graph, self.aims = graph, []
        graph.probe.create_subscription(Aim, "aim", self.aims.append, DATA)
        graph.until(lambda: graph.detector.count_subscribers("aim"))
        self.before = None

    def show(self, msg):
        """The view of an image; steps of it by name."""
        aiming, count = self.graph.detector._aiming, len(self.aims)
        self.graph.executor.spin_for(0.5)
        self.graph.images.publish(msg)
        self.graph.until(lambda: aiming._job not in (None, self.before))
        self.before = aiming._job
        self.before.result(LONG_S)
        self.graph.until(lambda: len(self.aims) > count and self.aims[-1].width)
        return self.aims[-1], {check.name: check for check in self.aims[-1].checks}


def test_nothing_is_measured_while_nobody_aims(graph, draw, rng):
    for k in range(3):
        graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0 + k))
        graph.executor.spin_for(1.0)
    assert graph.detector._aiming._job is None


def test_the_view_to_aim_by(graph, draw, rng):
    aimed = Aimed(graph)
    graph.until(lambda: aimed.aims)
    assert aimed.aims[0].width == 0
    assert aimed.aims[0].checks[0].text == "no image comes: does the camera run?"
    for k in range(3):  # an id takes two images
        msg, checks = aimed.show(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0 + k))
    assert (msg.width, msg.height) == (640, 480)
    assert msg.header.stamp == to_time(3 * 10**9)
    assert {name for name, check in checks.items() if check.level != AimCheck.OK} == set()
    assert [one.id for one in msg.things] == ["black_1", "grey_1"]
    seen = np.array([[one.x_px, one.y_px, one.radius_px] for one in msg.things])
    assert np.abs(seen - np.column_stack([CENTRE_PX, [7.9, 7.9]])).max() < 0.3
    assert len(msg.seen) == 36
    assert sum(map(int, msg.histogram)) == pytest.approx(593 * 295, rel=0.02)
    assert msg.lens.state == LensPictures.IDLE
    msg, checks = aimed.show(image(np.zeros((200, 300), np.uint8), 9.0))
    assert checks["picture"].level == AimCheck.ERROR
    assert "size is 300 x 200 px, allowed: 640 x 480" in checks["picture"].text
    assert len(msg.things) == 0


def test_home_is_found_by_markers_or_outline(make_plate, marked_rig, draw, rng):
    graph = Graph(rig_file=marked_rig)
    try:
        aimed, plate = Aimed(graph), make_plate()
        assert called(graph, "find_home").success
        msg, _ = aimed.show(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0))
        assert msg.home.startswith("not found: fiducials: 0, 1, 2, 3 not seen")
        assert called(graph, "find_home").success
        msg, _ = aimed.show(image(plate.take([0, 0, 0], rng), 2.0))
        assert msg.home.startswith("found, corners of the markers fit within 0.")
    finally:
        graph.close()
    graph = Graph()
    try:
        aimed = Aimed(graph)
        moved = CORNERS_PX + [6.0, -9.0]
        frame = draw(CENTRE_PX + [6.0, -9.0], LABEL, rng, radius=7.9, corners=moved)
        _, checks = aimed.show(image(frame, 1.0))
        assert checks["outline"].level != AimCheck.OK
        assert called(graph, "find_home").success
        aimed.show(image(frame, 2.0))
        _, checks = aimed.show(image(frame, 3.0))
        assert checks["outline"].level == AimCheck.OK
        assert np.abs(np.array(graph.detector._rig.camera.corners_px) - moved).max() < 0.3
    finally:
        graph.close()


def test_a_lens_is_written_into_the_rig_file_and_home_is_to_be_found_again(draw, rng, tmp_path):
    path, seen = tmp_path / "rig.yaml", draw(CENTRE_PX, LABEL, rng, radius=7.9)
    text = config_path("rig.yaml").read_text(encoding="utf-8")
    lines = [one for one in text.splitlines() if not one.startswith(LENS_KEYS)]
    path.write_text("\n".join(lines), encoding="utf-8")
    matrix = np.array([[850.1234, 0, 320.0], [0, 851.0, 240.0], [0, 0, 1]])
    lens = Lens(matrix, np.array([-0.0123456789, 1e-5, 0.0, -0.0, 0.0]))

    def fitted(size_px):
        fit = LensFit(lens, size_px, 0.1, (), (), np.zeros(9), (1.0, 1.0))
        return LensJob(None, Board(9, 7, 0.03), "plumb_bob", LensPictures.FITTED, "", fit=fit)

    graph = Graph(rig_file=path)
    try:
        aimed, view = Aimed(graph), graph.detector._aiming
        assert called(graph, "find_home").success
        msg, checks = aimed.show(image(seen, 1.0))
        assert msg.home_found
        assert "home" not in checks
        view._lens = fitted((320, 240))
        refused = called(graph, "save_lens").message
        assert refused == "size of the pictures is 320 x 240 px, allowed: 640 x 480 px"
        assert path.read_text(encoding="utf-8") == "\n".join(lines)
        view._lens = fitted((640, 480))
        assert called(graph, "save_lens").success
        assert called(graph, "save_home").message.startswith("home was not found")
        msg, checks = aimed.show(image(seen, 2.0))
        assert (msg.home, msg.lens.state) == ("", LensPictures.IDLE)
        assert checks["home"].level == AimCheck.WARN
        assert called(graph, "find_home").success
        aimed.show(image(seen, 3.0))
        assert "home" not in aimed.show(image(seen, 4.0))[1]
    finally:
        graph.close()
    changed = path.read_text(encoding="utf-8").splitlines()
    added = [one for one in changed if one.startswith(LENS_KEYS)]
    assert [one for one in changed if one not in added] == lines
    graph = Graph(rig_file=path)  # the next start
    try:
        used = graph.detector._vision.calibration.lens
        assert np.allclose(used.matrix, matrix, atol=1e-3)
        assert np.allclose(used.distortion, lens.distortion, atol=1e-6)
    finally:
        graph.close()


def plan(graph, part, stamp):
    """Have the planner expect a part where it was seen, at this stamp [s]."""
    forces = graph.probe.create_publisher(PartForces, "part_forces", DATA)
    graph.until(forces.get_subscription_count)
    known = graph.detector._expected
    wanted = Wanted.make(part, start=np.hstack([part.position, np.zeros((len(part), 2))]))
    forces.publish(wanted_to_msg(wanted, to_time(0), to_time(round(1e9 * stamp))))
    graph.until(lambda: graph.detector._expected is not known)


def test_home_is_not_taken_from_a_picture_of_another_size(graph):
    aimed = Aimed(graph)
    assert called(graph, "find_home").success
    msg, _ = aimed.show(image(np.full((240, 320), 90, np.uint8), 1.0))
    assert msg.home == "not found: image: size is 320 x 240 px, allowed: 640 x 480 px"
    assert not msg.home_found


def test_home_is_not_taken_while_a_task_moves_the_plate(graph, draw, rng):
    aimed = Aimed(graph)

    def shown(stamp):
        return aimed.show(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), stamp))[0]

    shown(1.0)
    shown(1.6)
    plan(graph, msg_to_parts(graph.parts[-1]), 2.4)
    assert called(graph, "find_home").success
    assert shown(2.2).home.startswith("not found: a task moves the plate")
    assert called(graph, "find_home").success
    assert shown(9.0).home.startswith("found, ")  # the planner has ended without a word


def test_the_plate_is_not_learned_while_a_task_moves_it(rig_with_types, draw_types, rng):
    graph = Graph(rig_file=rig_with_types)
    try:
        to_image = graph.detector._vision.calibration.to_image

        def shown(stamp):
            return image(draw_types(TYPES, LYING, rng, to_image=to_image), stamp, "bgr8")

        graph.images.publish(shown(1.0))
        graph.until(lambda: graph.parts)
        plan(graph, msg_to_parts(graph.parts[-1]), 1.2)
        refused = called(graph, "learn_plate")
        assert not refused.success
        assert refused.message.startswith("a task moves the plate, allowed: ")
        graph.answer(shown(9.0))  # the planner has ended without a word
        assert called(graph, "learn_plate").success
    finally:
        graph.close()


class Kept:
    """Five pictures of a board, to which a lens is fitted; OpenCV fails where there is none."""

    kept, size_px, missing, cover = (None,) * 5, (640, 480), (), np.zeros((1, 1), bool)

    def __init__(self, fitted=None, meanwhile=lambda: None):
        self.fitted, self.meanwhile = fitted, meanwhile

    def fit(self, model):
        self.meanwhile()
        if self.fitted is None:
            raise cv2.error("matrices do not fit")
        return self.fitted


def test_a_lens_that_opencv_cannot_fit_is_told_and_pictures_go_on(graph):
    aiming = graph.detector._aiming
    aiming._lens = LensJob(Kept(), Board(9, 7, 0.03, 0.022), "plumb_bob")
    assert called(graph, "fit_lens").success
    graph.until(lambda: aiming._lens.state == LensPictures.TAKING)
    assert aiming._lens.text == "no lens: matrices do not fit"
    assert called(graph, "fit_lens").success


LENS = Lens(np.eye(3), np.zeros(5), "plumb_bob")


@pytest.mark.parametrize(
    "fitted", [None, LensFit(LENS, (640, 480), 0.1, (), (), np.zeros(9), (1.0, 1.0))]
)
def test_pictures_that_are_discarded_while_they_are_fitted_stay_discarded(graph, fitted):
    aiming = graph.detector._aiming
    pictures = Kept(fitted, lambda: setattr(aiming, "_lens", None))
    aiming._lens = job = LensJob(pictures, Board(9, 7, 0.03, 0.022), "plumb_bob")
    aiming._fit(job)
    assert aiming._lens is None


def test_what_the_lens_services_refuse(graph):
    assert called(graph, "fit_lens").message == "0 pictures are taken, allowed: at least 5"
    assert called(graph, "save_home").message == "home was not found, allowed: after ~/find_home"
    assert called(graph, "save_lens").message == "no lens is fitted, allowed: after ~/fit_lens"
    client = graph.probe.create_client(TakeLensPictures, "detector/take_lens_pictures")
    graph.until(client.service_is_ready)

    def take(**values):
        future = client.call_async(TakeLensPictures.Request(**values))
        graph.until(future.done)
        return future.result()

    good = {"on": True, "columns": 9, "rows": 7, "square_m": 0.03, "marker_m": 0.022}
    assert "board: 2 x 7 squares, allowed" in take(**{**good, "columns": 2}).message
    assert "model is 'fish', allowed: plumb_bob" in take(**good, model="fish").message
    assert take(**good).success
    assert graph.detector._aiming.wanted  # also without a subscriber
    assert take(on=False).success
    assert not graph.detector._aiming.wanted
