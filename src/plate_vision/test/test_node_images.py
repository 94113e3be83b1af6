"""Images that the detector uses and refuses, over real topics in one process."""

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from detector_graph import CENTRE_PX, LABEL, Graph, compressed, image, names  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image  # noqa: E402

from plate_core.ros import IMAGE, msg_to_parts  # noqa: E402

pytestmark = pytest.mark.usefixtures("detector_time")


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
    """Return a grey frame in another encoding. Its Bayer mosaic is the frame itself."""
    if encoding in ("bgr8", "rgb8"):
        return np.dstack([frame] * 3)
    if encoding in ("mono16", "bayer_rggb16"):
        return frame.astype("<u2") << 8
    if encoding.startswith("yuv422"):
        grey = np.rint(16 + frame * (219 / 255)).astype(np.uint8)
        pair = [np.full_like(grey, 128), grey]
        return np.dstack(pair if encoding == "yuv422" else pair[::-1])
    if encoding == "nv21":
        grey = np.rint(16 + frame * (219 / 255)).astype(np.uint8)
        return np.vstack([grey, np.full_like(grey[::2], 128)])
    return frame


@pytest.mark.parametrize(
    "encoding",
    ["bgr8", "rgb8", "mono16", "yuv422", "yuv422_yuy2", "nv21", "bayer_rggb16"]
    + [f"bayer_{first}8" for first in ("rggb", "bggr", "gbrg", "grbg")],
)
def test_images_of_all_encodings_are_detected(graph, draw, rng, encoding):
    frame = draw(CENTRE_PX, LABEL, rng, radius=7.9)
    data = packed(frame, encoding)
    msg = image(frame, 1.0)
    msg.encoding, msg.step, msg.data = encoding, data.strides[0], data.tobytes()
    answer = graph.answer(msg)
    assert names(answer) == ["black_1", "grey_1"]
    seen = graph.detector._vision.calibration.to_image(msg_to_parts(answer).position)
    assert np.abs(seen - CENTRE_PX).max() < 0.1
    assert graph.warnings == []


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


@pytest.mark.parametrize("kind", ["raw", "compressed"])
@pytest.mark.parametrize("bits", [10, 12])
def test_images_of_fewer_bits_than_declared_name_the_parameter(draw, rng, kind, bits):
    """If a camera sends 12 bits in 16-bit numbers, the warning names `bits`, not only the light."""
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
        assert "the light is on" in text
        assert text.endswith(f"uses only {bits} of the 16 bits, set the parameter bits to {bits}")
        graph.detector.set_parameters([Parameter("bits", value=bits)])
        for second in (2, 3, 4):  # a new part must be seen more than once
            msg.header.stamp.sec = second
            seen = graph.answer(msg)
        assert names(seen) == ["black_1", "grey_1"]
    finally:
        graph.close()


def test_wrong_images_are_refused_and_the_node_continues(graph, draw, rng):
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
    assert "stamp is 0.000 s, equal to that of the last image, allowed: " in graph.warnings[-1]


def test_one_late_image_ends_no_ids_but_time_may_restart(graph, draw, rng):
    both = draw(CENTRE_PX, ["grey", "grey"], rng, radius=7.9)
    second = draw(CENTRE_PX[1:], ["grey"], rng, radius=7.9)
    graph.answer(image(both, 5.0))
    assert names(graph.answer(image(second, 5.1))) == ["grey_2"]
    assert graph.answer(image(both, 5.05)) is None
    assert "stamp is 5.050 s, 0.050 s before that of the last image" in graph.warnings[-1]
    assert names(graph.answer(image(second, 5.2))) == ["grey_2"]
    assert graph.answer(image(second, 0.0)) is None
    assert names(graph.answer(image(second, 0.1))) == ["grey_1"]


def test_two_cameras_on_one_topic_are_reported(graph):
    assert "image_raw (" not in graph.detector._diagnose(0.0).message
    second = rclpy.create_node("camera_2", namespace="/detector_test")
    try:
        second.create_publisher(Image, "image_raw", IMAGE)
        graph.until(
            lambda: (
                "2 nodes publish image_raw (camera_2, probe), allowed: one"
                in graph.detector._diagnose(0.0).message
            )
        )
    finally:
        second.destroy_node()
