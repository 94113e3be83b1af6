"""From an unmounted camera to one that is ready, on the page alone: a rendered camera that is
moved, defocused and covered, the detector and the page behind a browser."""

import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
from drawn_plate import View, board_picture, disc, draw, rectangle
from needs import program

rclpy = pytest.importorskip("rclpy")

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from plate_core import config_path, load_rig  # noqa: E402
from plate_core.ros import IMAGE, array_to_image, start_nodes  # noqa: E402
from plate_view.node import PageNode  # noqa: E402
from plate_vision.camera import Board, draw_board  # noqa: E402
from plate_vision.node import DetectorNode  # noqa: E402

pytestmark = pytest.mark.needs("chromium", "playwright")

TIMEOUT_MS = 60_000
RATE_HZ = 3.0
PLATE, ROOM = 200.0, 60.0
PARTS = [(0.1, 0.05), (-0.15, -0.06), (0.2, -0.1), (-0.05, 0.08)]
SMALL = (0.0, -0.05)
MOUNTED = View()
FOCAL, BEND = 800.0, np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
MATRIX = np.array([[FOCAL, 0, 319.5], [0, FOCAL, 239.5], [0, 0, 1]])
BOARD = Board(9, 7, 0.03, 0.022)
POSES = [
    ((0, 0, 0), (0, 0, 0.5)),
    ((0, 25, 0), (0, 0, 0.55)),
    ((0, -25, 0), (0, 0, 0.55)),
    ((25, 0, 0), (0, 0, 0.55)),
    ((-25, 0, 0), (0, 0, 0.55)),
    ((0, 0, 10), (-0.12, -0.08, 0.6)),
    ((0, 0, 0), (0.12, -0.08, 0.6)),
    ((0, 0, 0), (-0.12, 0.08, 0.6)),
    ((0, 0, -10), (0.12, 0.08, 0.6)),
    ((0, 0, 30), (0, 0, 0.8)),
]
SHOTS = os.environ.get("AIMING_SHOTS", "")
"""Folder for a picture of the page at each step, to look at; empty: none."""


def picture(view=MOUNTED, parts=PARTS, small=True, **more):
    rig = load_rig()
    shapes = [(rectangle(rig.plate.length_m, rig.plate.width_m), PLATE)]
    shapes += [(disc(x, y, 0.008), 40.0) for x, y in parts]
    shapes += [(disc(*SMALL, 0.004), 40.0)] if small else []
    return draw(view, shapes, ROOM, **more)


class Camera:
    """Publishes one picture again and again, as a real camera does."""

    def __init__(self, node):
        self._node = node
        self._images = node.create_publisher(Image, "image_raw", IMAGE)
        self.picture = None
        self.random = np.random.default_rng(5)
        node.create_timer(1 / RATE_HZ, self._publish)

    def show(self, image):
        self.picture = image

    def _publish(self):
        image = self.picture
        if image is not None:
            shade = self.random.normal(0, 1, image.shape)  # no picture is like another
            seen = np.where(image == 0, 0, np.clip(image + shade, 0, 255)).astype(np.uint8)
            self._images.publish(array_to_image(seen, self._node.get_clock().now().to_msg()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("aiming")


@pytest.fixture(scope="module")
def graph(folder):
    """The camera and the page's address; the detector and the page run on a thread."""
    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    for key in ("focal_px", "centre_px", "distortion"):
        del data["camera"][key]
    data["camera"]["corners_px"] = MOUNTED.see(load_rig().plate.corners).tolist()
    for name in ("rig.yaml", "rig_before.yaml"):
        (folder / name).write_text(yaml.safe_dump(data), encoding="utf-8")
    arguments = ["--ros-args", "-p", f"rig_file:={folder / 'rig.yaml'}"]
    arguments += ["-p", "page:port:=8390"]
    rclpy.init(args=arguments)
    try:
        camera_node = rclpy.create_node("camera")
        nodes = [DetectorNode(), PageNode()]
        start_nodes(*nodes)
        camera = Camera(camera_node)
        executors = [SingleThreadedExecutor() for _ in range(3)]  # as in processes of their own
        threads = [threading.Thread(target=each.spin) for each in executors]
        for executor, node, thread in zip(executors, (camera_node, *nodes), threads, strict=True):
            executor.add_node(node)
            thread.start()
        yield camera, nodes[1]._server.url
        for executor, thread in zip(executors, threads, strict=True):
            executor.shutdown()
            thread.join()
        for node in (camera_node, *nodes):
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.fixture(scope="module")
def page(graph):
    """The page with its panel Camera; at the end it has no complaint."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program("chromium"), args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.set_default_timeout(TIMEOUT_MS)
        complaints = []
        page.on("console", lambda one: complaints.append(one.text) if one.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(graph[1])
        page.get_by_role("tab", name="Camera").click()
        yield page
        assert complaints == []
        browser.close()


@pytest.fixture
def shows(page, request):
    """Waits until a step of the page says something of this pattern, and takes a picture."""

    def wait(step, pattern, name=""):
        await_text(page, f"#camera-checks [data-check={step}] span", pattern)
        shoot(page, name)

    return wait


def await_text(page, place, pattern):
    try:
        page.locator(place).filter(has_text=re.compile(pattern)).wait_for()
    except Exception as error:  # of playwright, which is not imported where it is missing
        pytest.fail(f"{error}\nThe page shows:\n{page.inner_text('#panel-Camera')}")


def shoot(page, name):
    if SHOTS and name:
        page.screenshot(path=str(Path(SHOTS) / f"{name}.png"))


def level(page, step):
    return page.locator(f"#camera-checks [data-check={step}]").get_attribute("data-grade")


def test_a_missing_rotated_or_shifted_camera_is_reported(graph, page, shows):
    shows("picture", "no image", "0_nothing")
    assert page.inner_text("#camera-state") == "Next: picture."
    graph[0].show(picture(View(distance=1.25, roll=12.0, at=(0.1, 0.05))))
    shows("outline", "not seen|not where corners_px", "1_moved")
    assert level(page, "outline") in ("warn", "bad")
    shows("lens", "take pictures of a board")
    graph[0].show(picture(View(at=(0.012, 0.0))))
    shows("outline", r"shifted by \(-12\.\d, -?0\.\d\) mm", "2_shifted")


def test_home_is_found_where_the_camera_is_mounted(graph, page, shows, folder):
    view = View(distance=1.1, roll=8.0, tilt_x=10.0)
    graph[0].show(picture(view, small=False))
    shows("outline", "not seen|not where corners_px")
    page.get_by_role("button", name="Find home").click()
    await_text(page, "#camera-home", "corners_px.*Write them to the rig file")
    shows("outline", "as predicted, within 0", "7_home")
    shows("parts", "number of detected parts is 4")
    before = (folder / "rig.yaml").read_text(encoding="utf-8")
    assert before == (folder / "rig_before.yaml").read_text(encoding="utf-8")  # it asks first
    page.get_by_role("button", name="Write to the rig file").click()
    await_text(page, "#camera-home", "written: .*rig.yaml")
    rig = load_rig(folder / "rig.yaml")
    assert np.abs(np.array(rig.camera.corners_px) - view.see(rig.plate.corners)).max() < 0.3


def test_pictures_for_the_lens_are_taken_fitted_and_written_after_asking(
    graph, page, shows, folder
):
    print_px = draw_board(BOARD, 40)
    graph[0].show(np.full((480, 640), 150, np.uint8))
    page.get_by_role("button", name="Take pictures for the lens").click()
    await_text(page, "#lens-missing", "hold it in the top left corner")
    for k, pose in enumerate(POSES):
        graph[0].show(board_picture(print_px, BOARD, MATRIX, BEND, *pose))
        await_text(page, "#lens-text", f"^{k + 1} taken")
        if k == 4:
            shoot(page, "8_lens")
            assert "tilt it" not in page.inner_text("#lens-missing")
    await_text(page, "#lens-missing", "enough pictures")
    assert page.inner_text("#camera-state") == "Next: lens."
    before = (folder / "rig.yaml").read_text(encoding="utf-8")
    page.get_by_role("button", name="Fit the lens").click()
    await_text(page, "#lens-text", "Write it to .*rig.yaml")
    shoot(page, "9_fitted")
    error = float(re.search(r"Error (\S+) px", page.inner_text("#lens-text"))[1])
    assert error < 0.3
    assert (folder / "rig.yaml").read_text(encoding="utf-8") == before  # it asks first
    page.get_by_role("button", name="Write the lens to the rig file").click()
    page.get_by_role("button", name="Take pictures for the lens").wait_for()
    assert page.locator("#lens-text").text_content() == ""
    lens = load_rig(folder / "rig.yaml").camera.lens
    assert lens.focal_px[0] == pytest.approx(FOCAL, rel=0.01)
    shows("lens", "plumb_bob, focal length")
    shows("home", "found before the lens")


def test_the_page_reports_that_the_camera_is_ready(graph, page, shows):
    """By the lens that was written, and home found anew with it."""
    view = View(focal=FOCAL, distance=0.9, lens=(BEND[0], BEND[1], 0.0))
    graph[0].show(picture(view, small=False))
    # The board is gone, which is a quadrilateral too.
    shows("light", "at most 1% of its pixels are clipped")
    page.get_by_role("button", name="Find home").click()
    await_text(page, "#camera-state", "Ready")
    assert page.locator("#camera-checks [data-check=home]").count() == 0
    shoot(page, "10_ready")
