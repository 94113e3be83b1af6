"""The aiming view: the detector's topic, and its services for home and lens."""

import cv2
import numpy as np
import pytest

pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, called, image, plan

from plate_core import config_path, load_rig
from plate_core.ros import DATA, msg_to_parts, to_time
from plate_interfaces.msg import Aim, AimCheck, LensPictures
from plate_interfaces.srv import TakeLensPictures
from plate_vision.camera import Board, Lens, LensFit
from plate_vision.ros.aiming import LensJob

pytestmark = pytest.mark.usefixtures("detector_time")

LENS_KEYS = ("  focal_px", "  centre_px", "  distortion")

LONG_S = 60.0
"""Maximum duration of an operation of the view's thread that takes less than a second [s]."""


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


def test_without_subscribers_the_aiming_view_measures_nothing(graph, draw, rng):
    for k in range(3):
        graph.answer(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0 + k))
        graph.executor.spin_for(1.0)
    assert graph.detector._aiming._job is None


def test_the_aiming_view_reports_all_checks(graph, draw, rng):
    aimed = Aimed(graph)
    graph.until(lambda: aimed.aims)
    assert aimed.aims[0].width == 0
    assert aimed.aims[0].checks[0].text == "no image has arrived; check that the camera runs"
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


def test_home_is_found_by_markers_or_outline(make_plate, marked_rig, draw, corners_px, rng):
    graph = Graph(rig_file=marked_rig)
    try:
        aimed, plate = Aimed(graph), make_plate()
        assert called(graph, "find_home").success
        msg, _ = aimed.show(image(draw(CENTRE_PX, LABEL, rng, radius=7.9), 1.0))
        assert msg.home.startswith("not found: fiducials: markers 0, 1, 2, 3 are not")
        assert called(graph, "find_home").success
        msg, _ = aimed.show(image(plate.take([0, 0, 0], rng), 2.0))
        assert msg.home.startswith("found, error of the markers' corners is 0.")
        found = graph.detector._aiming._corners
        assert msg.home.endswith(f"; corners_px: {[list(corner) for corner in found]}")
        written = called(graph, "save_home")
        assert written.success
        assert written.message.startswith(f"written: {marked_rig}; ")
        assert load_rig(marked_rig).camera.corners_px == found
        assert np.abs(np.array(found) - corners_px).max() < 0.3
        again = called(graph, "save_home")
        assert (again.success, again.message) == (
            False, "home has not been found; call ~/find_home first",
        )  # fmt: skip
    finally:
        graph.close()
    graph = Graph()
    try:
        aimed = Aimed(graph)
        moved = corners_px + [6.0, -9.0]
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
        assert called(graph, "save_home").message.startswith("home has not been found")
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


def test_a_failed_lens_fit_is_reported_and_more_pictures_can_be_taken(graph):
    aiming = graph.detector._aiming
    aiming._lens = LensJob(Kept(), Board(9, 7, 0.03, 0.022), "plumb_bob")
    assert called(graph, "fit_lens").success
    graph.until(lambda: aiming._lens.state == LensPictures.TAKING)
    assert aiming._lens.text == "no lens: matrices do not fit"
    assert called(graph, "fit_lens").success


LENS = Lens(np.diag([600.0, 600.0, 1.0]), np.zeros(5), "plumb_bob")


@pytest.mark.parametrize(
    "fitted", [None, LensFit(LENS, (640, 480), 0.1, (), (), np.zeros(9), (1.0, 1.0))]
)
def test_pictures_that_are_discarded_while_they_are_fitted_stay_discarded(graph, fitted):
    aiming = graph.detector._aiming
    pictures = Kept(fitted, lambda: setattr(aiming, "_lens", None))
    aiming._lens = job = LensJob(pictures, Board(9, 7, 0.03, 0.022), "plumb_bob")
    aiming._fit_lens(job)
    assert aiming._lens is None


def test_the_lens_services_refuse_wrong_calls(graph):
    assert called(graph, "fit_lens").message == "0 pictures were taken, allowed: at least 5"
    assert "call ~/find_home" in called(graph, "save_home").message
    assert "call ~/fit_lens" in called(graph, "save_lens").message
    client = graph.probe.create_client(TakeLensPictures, "detector/take_lens_pictures")
    graph.until(client.service_is_ready)

    def take(**values):
        future = client.call_async(TakeLensPictures.Request(**values))
        graph.until(future.done)
        return future.result()

    good = {"on": True, "columns": 9, "rows": 7, "square_m": 0.03, "marker_m": 0.022}
    assert "board: size is 2 x 7 squares, allowed" in take(**{**good, "columns": 2}).message
    assert "model is 'fish', allowed: plumb_bob" in take(**good, model="fish").message
    assert take(**good).success
    assert graph.detector._aiming.needed  # also without a subscriber
    assert take(on=False).success
    assert not graph.detector._aiming.needed
