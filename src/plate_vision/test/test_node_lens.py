"""The lens that the detector reads from camera_info."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, image, names
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CameraInfo
from stepped_clock import STEP_S

from plate_core import PlateError
from plate_core.ros import DATA
from plate_vision.ros import lens_of

pytestmark = pytest.mark.usefixtures("detector_time")


def camera_info(d=(), model="plumb_bob", width=640):
    msg = CameraInfo(width=width, height=480, distortion_model=model)
    msg.k = [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0]
    msg.d = [float(value) for value in d]
    return msg


def test_lens_of_camera_info():
    size = (640, 480)
    for none in (camera_info(), camera_info([0.0] * 5), camera_info(model="")):
        assert not np.any(lens_of(none, size).distortion)
    placeholder = camera_info([0.0] * 5)  # of the node image_publisher
    placeholder.k[0] = placeholder.k[4] = 1.0
    for not_calibrated in (
        CameraInfo(width=640, height=480, d=[0.1] * 5),
        CameraInfo(),
        placeholder,
    ):
        assert lens_of(not_calibrated, size) is None
    placeholder.k[0] = placeholder.k[4] = 1.2  # focal lengths in widths of the image
    with pytest.raises(PlateError, match=r"focal lengths are 1\.2 and 1\.2 px, allowed: 10 px"):
        lens_of(placeholder, size)
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


def test_region_and_binning_of_camera_info():
    """A message describes the full image. These images are a half of the columns, each second."""
    msg = camera_info([-0.2, 0.0, 0.0, 0.0, 0.0], width=1280)
    msg.binning_x, msg.roi.x_offset, msg.roi.width, msg.roi.height = 2, 40, 1200, 480
    lens = lens_of(msg, (600, 480))
    assert lens.matrix[0].tolist() == [300, 0, (320 - 40 + 0.5) / 2 - 0.5]
    assert lens.matrix[1].tolist() == [0, 600, 240]
    with pytest.raises(PlateError, match=r"size is 600 x 480 px, allowed: 640 .*binning 2 x 0\)"):
        lens_of(msg, (640, 480))
    msg.roi.x_offset = 100  # beyond the image: a driver whose K is that of the region
    with pytest.raises(PlateError, match=r"roi is 1200 x 480 px at \(100, 0\), allowed: .*1280 x"):
        lens_of(msg, (600, 480))


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

    def reported(level):
        reports.clear()
        for _ in range(400):
            graph.images.publish(frame)
            graph.executor.spin_for(STEP_S)
            if len(reports) == 4:
                break
        assert [report.status[0].level for report in reports[1:]] == 3 * [level]
        return reports[-1].status[0].message

    assert reported(DiagnosticStatus.OK) == "all images used"
    graph.infos.publish(camera_info(values, model))
    graph.until(lambda: graph.warnings)
    text = reported(DiagnosticStatus.ERROR)
    assert text.startswith("camera_info ignored: lens: distortion")
    assert words in text
    graph.infos.publish(camera_info([1e-3, 0.0, 0.0, 0.0], "plumb_bob"))  # edges stay straight
    graph.until(lambda: graph.detector._lens is not None)
    assert reported(DiagnosticStatus.OK) == "all images used"


@pytest.mark.parametrize("wrong", ["no scale", "far"])
def test_an_invalid_camera_info_is_refused_and_the_node_continues(graph, draw, rng, wrong):
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
