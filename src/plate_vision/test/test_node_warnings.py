"""Warnings and diagnostics of the detector: light, silence, unknown things, the plate's outline."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, image, names
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CompressedImage, Image
from shown_text import says
from std_srvs.srv import Trigger
from stepped_clock import STEP_S

from plate_core.ros import DATA, IMAGE
from plate_core.status import Level
from plate_vision import OVERLOOKED, observe
from plate_vision.tracking import update

pytestmark = pytest.mark.usefixtures("detector_time")


@pytest.mark.parametrize(("grey", "words"), [(0, "the light is on"), (255, "overexposed")])
def test_without_light_or_with_too_much_nothing_is_found(graph, grey, words):
    graph.images.publish(image(np.full((480, 640), grey, np.uint8), 1.0))
    graph.until(lambda: graph.parts)
    assert names(graph.parts[-1]) == []
    assert words in graph.warnings[-1]
    assert "allowed: " in graph.warnings[-1]


def test_diagnostics_report_silence_refusals_and_bad_light(draw, rng):
    graph = Graph(input_timeout_s=0.5)
    try:
        reports = []
        graph.probe.create_subscription(DiagnosticArray, "diagnostics", reports.append, DATA)

        def reported(level, *words, play=None):
            """Publish an image until diagnostics report a level with words; return their values."""

            for _ in range(200):
                if play is not None:
                    graph.images.publish(play)
                graph.executor.spin_for(STEP_S)
                status = reports[-1].status[0] if reports else DiagnosticStatus()
                if status.level == level and all(w in status.message for w in words):
                    return {item.key: item.value for item in status.values}
            raise AssertionError(f"not reported: {level} {words}, but {reports[-1:]}")

        reported(DiagnosticStatus.STALE, "no image yet on", "image_raw; check that the camera runs")
        good = image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)
        values = reported(DiagnosticStatus.OK, "all images used", play=good)
        assert (values["refused"], values["parts_seen"]) == ("0", "2")
        assert int(values["images"]) > 0
        assert float(values["rate_hz"]) > 0
        assert 0 < float(values["detection_ms_median"]) <= float(values["detection_ms_max"])
        wrong = image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0)
        wrong.encoding = "32FC1"
        values = reported(DiagnosticStatus.ERROR, "images refused: ", "'32FC1'", play=wrong)
        assert int(values["refused"]) > 0
        dark = image(np.zeros((480, 640), np.uint8), 2.0)
        reported(DiagnosticStatus.WARN, "the light is on", play=dark)
        reported(DiagnosticStatus.STALE, "no image for ", "check that the camera runs")
    finally:
        graph.close()


@pytest.mark.parametrize(
    ("transport", "other", "words"),
    [
        ("raw", "image_raw/compressed", ("test/image_raw/compressed exists", "to compressed")),
        ("compressed", "image_raw", ("/detector_test/image_raw exists", "transport to raw")),
        ("raw", "my_camera/image", ("remap image_raw", "images: /detector_test/my_camera/image)")),
        ("compressed", "my_camera/compressed", ("remap image_raw/compressed and camera_info",)),
        ("raw", "", ("no node publishes this topic or other images",)),
    ],
)
def test_diagnostics_name_the_topics_that_have_images(transport, other, words):
    """The camera's node publishes raw or compressed images, or has another name."""
    graph = Graph(input_timeout_s=0.2, image_transport=transport)
    try:
        graph.probe.destroy_publisher(graph.images)
        kind = CompressedImage if other.endswith("compressed") else Image
        if other:
            graph.probe.create_publisher(kind, other, IMAGE)
        reports = []
        graph.probe.create_subscription(DiagnosticArray, "diagnostics", reports.append, DATA)
        graph.until(lambda: reports and all(w in reports[-1].status[0].message for w in words))
        assert reports[-1].status[0].level == DiagnosticStatus.STALE
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
    assert says(status.message, "no part", "2 other objects", "2 too large", "9.8")
    assert {item.key: item.value for item in status.values}["overlooked_too_large"] == "2"


def test_an_outline_that_is_not_where_corners_px_have_it_is_reported_until_reset(
    graph, draw, corners_px, rng
):
    def status(play, first):
        """Return the diagnostics after these images."""
        for k in range(5):
            graph.answer(image(play(), first + 0.1 * k))
        status = graph.detector._diagnose(0.0)
        return status, graph.detector._diagnostic_values()["plate_outline"]

    moved = corners_px + [5, -4]
    found, text = status(lambda: draw(CENTRE_PX, LABEL, rng, corners=corners_px), 1.0)
    assert (found.message, text[:12]) == ("all images used", "as predicted")
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    found, text = status(lambda: draw(CENTRE_PX, LABEL, rng, corners=moved), 2.0)
    assert found.level == Level.WARN
    assert says(found.message, "the plate's outline", "corners_px", "shifted")
    assert text.startswith("it is shifted by (5.")
    assert any("the plate's outline" in warning for warning in graph.warnings)
    done = graph.resets.call_async(Trigger.Request())
    graph.until(done.done)
    assert graph.detector._diagnose(0.0).message == "all images used"


@pytest.mark.parametrize(("k1", "text"), [(0.0, "straight"), (-0.2, "bend outwards")])
def test_markers_do_not_hide_a_wrong_lens(make_plate, marked_rig, rng, k1, text):
    plate = make_plate((k1, 0.0, 0.0, 0.0, 0.0))
    graph = Graph(rig_file=marked_rig)
    try:
        for k in range(5):
            graph.answer(image(plate.take(np.zeros(3), rng), 1.0 + 0.1 * k))
        found = graph.detector._diagnose(0.0)
        assert text in graph.detector._diagnostic_values()["plate_outline"]
    finally:
        graph.close()
    if k1 == 0:
        assert found.message == "all images used"
    else:
        assert found.level == Level.WARN
        assert says(found.message, "the plate's outline", "the markers and the lens", text, "wrong")


def test_faint_patches_are_reported(graph, draw, rng):
    def faint(image):
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        for cx in (150.0, 250.0, 350.0):
            image[np.hypot(x - cx, y - 240) <= 8] -= 4

    for k in range(3):
        assert names(graph.answer(image(draw([], [], rng, extra=faint), 1.0 + 2.1 * k))) == []
    found = graph.detector._diagnose(0.0)
    assert found.level == Level.WARN
    assert says(found.message, "3 faint patches", "contrast")
    assert graph.detector._diagnostic_values()["faint_patches"] == 3


def test_noise_alone_is_no_part(graph, rng):
    for k, low in enumerate((0, 100, 200)):
        frame = rng.integers(low, 256, (480, 640), dtype=np.uint8)
        assert names(graph.answer(image(frame, 1.0 + k))) == []
