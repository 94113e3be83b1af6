"""Messages: what goes out comes back, and what is wrong is named."""

import numpy as np
import pytest

from plate_core import CycleError, PartSet, PlateCycle, PlateError, load_rig

pytest.importorskip("rclpy")
from rclpy.serialization import deserialize_message, serialize_message

from plate_core.ros import convert

RIG = load_rig()
STAMP = convert.to_time(1_234_567_890_123_456_789)


def over_the_wire(msg):
    return deserialize_message(serialize_message(msg), type(msg))


def cycle() -> PlateCycle:
    rng = np.random.default_rng(0)
    knots = [rng.normal(size=(9, 3)) * size for size in (0.002, 0.2, 20)]
    for state in knots:
        state[-1] = state[0]
    return PlateCycle.from_knots(np.linspace(0, 0.1, 9), *knots)


def parts() -> PartSet:
    rng = np.random.default_rng(1)
    arrays = {
        name: rng.uniform(-0.2, 0.2, (3, 2))
        for name in ("position", "velocity", "force", "tolerance")
    }
    return PartSet.make(
        ("black_1", "white_1", "white_2"),
        **arrays,
        torque=rng.normal(size=3),
        angle=np.array([-3.0, 0, 3]),
    )


def test_stamps():
    assert convert.nanoseconds(STAMP) == 1_234_567_890_123_456_789
    assert convert.seconds(STAMP) == pytest.approx(1_234_567_890.123456789)
    assert convert.to_time(2_999_999_999).nanosec == 999_999_999


def test_cycle_there_and_back():
    msg = over_the_wire(convert.cycle_to_msg(cycle(), STAMP))
    assert convert.nanoseconds(msg.header.stamp) == convert.nanoseconds(STAMP)
    assert msg.joint_names == ["x", "y", "theta"]
    back = convert.msg_to_cycle(msg)
    np.testing.assert_allclose(back.times, cycle().times, atol=1e-9)
    np.testing.assert_array_equal(back.knot_pose, cycle().knot_pose)
    np.testing.assert_array_equal(back.knot_accel, cycle().knot_accel)


def test_motors_there_and_back():
    msg = over_the_wire(convert.motors_to_msg(RIG, cycle(), STAMP))
    assert msg.joint_names == ["motor_1", "motor_2", "motor_3", "motor_4"]
    back = convert.msg_to_motors(RIG, msg)
    np.testing.assert_allclose(back.knot_pose, cycle().knot_pose, atol=1e-14)
    np.testing.assert_allclose(back.knot_accel, cycle().knot_accel, atol=1e-9)


def test_parts_there_and_back():
    msg = over_the_wire(convert.parts_to_msg(parts(), STAMP))
    back = convert.msg_to_parts(msg)
    assert back.ids == parts().ids
    for name in ("position", "velocity", "force", "tolerance", "torque", "angle"):
        np.testing.assert_allclose(getattr(back, name), getattr(parts(), name), atol=1e-12)


def test_no_parts():
    nothing = PartSet.make((), np.zeros((0, 2)))
    back = convert.msg_to_parts(over_the_wire(convert.parts_to_msg(nothing, STAMP)))
    assert len(back) == 0
    assert back.position.shape == (0, 2)


def test_images_there_and_back():
    rng = np.random.default_rng(2)
    mono = rng.integers(0, 256, (7, 5), dtype=np.uint8)
    colour = rng.integers(0, 256, (7, 5, 3), dtype=np.uint8)
    back = convert.image_to_array(over_the_wire(convert.array_to_image(mono, STAMP)))
    np.testing.assert_array_equal(back, mono)
    msg = over_the_wire(convert.array_to_image(colour, STAMP, "bgr8"))
    np.testing.assert_array_equal(convert.image_to_array(msg), colour)


def test_padded_image_rows():
    msg = convert.array_to_image(np.arange(24, dtype=np.uint8).reshape(4, 6), STAMP)
    msg.width = 5
    np.testing.assert_array_equal(convert.image_to_array(msg)[1], [6, 7, 8, 9, 10])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("encoding", "mono16", "encoding is 'mono16', allowed: mono8, bgr8, rgb8"),
        ("width", 0, "size is 0 x 4, allowed: at least 1 x 1"),
        ("step", 3, "step is 3 bytes, allowed: at least 6"),
        ("height", 5, "24 bytes of data, allowed: 30"),
    ],
)
def test_wrong_images(field, value, message):
    msg = convert.array_to_image(np.zeros((4, 6), np.uint8), STAMP)
    setattr(msg, field, value)
    with pytest.raises(PlateError, match=message):
        convert.image_to_array(msg)


def spoilt(change):
    msg = convert.cycle_to_msg(cycle(), STAMP)
    change(msg)
    return msg


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: setattr(m, "joint_names", ["x", "y"]), r"joints are \['x', 'y'\], allowed: "),
        (lambda m: setattr(m, "points", m.points[:1]), "1 points, allowed: at least 2"),
        (lambda m: setattr(m.points[2], "velocities", [1.0]), "point 2 has "),
        (lambda m: setattr(m.points[2], "accelerations", []), "point 2 has "),
        (lambda m: m.points.pop(), "motion does not close"),
        (lambda m: m.points.reverse(), "knot times must be finite, start at 0 and rise"),
        (lambda m: setattr(m.points[2], "positions", [0.0, float("nan"), 0.0]), "not finite"),
    ],
)
def test_wrong_cycles(change, message):
    with pytest.raises(CycleError, match=message):
        convert.msg_to_cycle(spoilt(change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.transforms.pop(), "2 transforms for 3 names, allowed: as many"),
        (lambda m: m.twist.pop(), "2 twist for 3 names"),
        (lambda m: setattr(m, "joint_names", ["a", "b", "a"]), "a name is given twice"),
        (lambda m: setattr(m.wrench[1].force, "x", float("nan")), "white_1 has a value"),
        (lambda m: setattr(m.wrench[1].torque, "z", float("nan")), "white_1 has a value"),
        (lambda m: setattr(m.transforms[2].rotation, "z", float("nan")), "white_2 has a value"),
    ],
)
def test_wrong_parts(change, message):
    msg = convert.parts_to_msg(parts(), STAMP)
    change(msg)
    with pytest.raises(PlateError, match=message):
        convert.msg_to_parts(msg)
