"""Messages: values survive a conversion in both directions, and wrong values are named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from plate_core import (
    AngleTargets,
    CycleError,
    CycleRequest,
    OverlookedThing,
    Parts,
    PlateCycle,
    PlateError,
    Targets,
    load_rig,
)
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.rig import Lens, to_image

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from plate_core.ros import convert
from plate_interfaces.msg import DriverStatus as DriverStatusMsg
from plate_interfaces.msg import Part

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


def some_request() -> CycleRequest:
    position, velocity, force, tolerance = np.random.default_rng(1).uniform(-0.2, 0.2, (4, 3, 2))
    spin, friction, torque = np.random.default_rng(2).uniform(0, 1, (3, 3))
    ids, angle = ("black_1", "white_1", "white_2"), np.array([-3.0, 0, 3])
    parts = Parts.make(ids, position, velocity, angle, spin, friction)
    return CycleRequest.make(parts, force, np.abs(tolerance), torque, 0.2)


def test_stamps_are_converted_to_nanoseconds_and_seconds():
    assert convert.nanoseconds(STAMP) == 1_234_567_890_123_456_789
    assert convert.seconds(STAMP) == pytest.approx(1_234_567_890.123456789)
    assert convert.to_time(2_999_999_999).nanosec == 999_999_999


def test_a_cycle_is_converted_to_a_message_and_back():
    msg = over_the_wire(convert.cycle_to_msg(cycle(), STAMP))
    assert convert.nanoseconds(msg.header.stamp) == convert.nanoseconds(STAMP)
    assert msg.joint_names == ["x", "y", "theta"]
    back = convert.msg_to_cycle(msg)
    np.testing.assert_allclose(back.times, cycle().times, atol=1e-9)
    np.testing.assert_array_equal(back.knot_pose, cycle().knot_pose)
    np.testing.assert_array_equal(back.knot_accel, cycle().knot_accel)


def test_data_of_another_frame_or_type_are_refused():
    """Such as a vision node of one's own that publishes parts in the frame of its camera."""
    request = convert.request_to_msg(some_request(), STAMP)
    parts = convert.parts_to_msg(some_request().parts, STAMP)
    read = (
        (parts, convert.msg_to_parts),
        (request, convert.msg_to_request),
        (convert.cycle_to_msg(cycle(), STAMP), convert.msg_to_cycle),
    )
    for msg, to_core in read:
        for frame in ("", "plate_home", "left/plate_home"):
            msg.header.frame_id = frame
            to_core(msg)
        for frame in ("camera_optical_frame", "plate", "plate_home/plate"):
            msg.header.frame_id = frame
            with pytest.raises(PlateError, match=f": frame is '{frame}', allowed: plate_home"):
                to_core(msg)
    parts.header.frame_id, parts.parts[1].type = "", ""
    assert convert.msg_to_parts(parts).ids == some_request().parts.ids
    parts.parts[1].type = "nut"
    with pytest.raises(PlateError, match="type of white_1 is 'nut', allowed: 'white'"):
        convert.msg_to_parts(parts)


def test_a_motor_table_is_converted_to_a_message_and_back():
    msg = over_the_wire(convert.motors_to_msg(RIG, cycle(), STAMP))
    assert msg.joint_names == ["motor_1", "motor_2", "motor_3", "motor_4"]
    back = convert.msg_to_motors(RIG, msg)
    np.testing.assert_allclose(back.knot_pose, cycle().knot_pose, atol=1e-14)
    np.testing.assert_allclose(back.knot_accel, cycle().knot_accel, atol=1e-9)


def test_parts_are_converted_to_a_message_and_back():
    sent = some_request()
    back = convert.msg_to_request(over_the_wire(convert.request_to_msg(sent, STAMP)))
    assert back.parts.ids == sent.parts.ids
    for name in ("position", "velocity", "angle", "spin", "friction_limit"):
        found, right = getattr(back.parts, name), getattr(sent.parts, name)
        np.testing.assert_allclose(found, right, atol=1e-12)
    for name in ("force", "tolerance", "torque"):
        found, right = getattr(back.forces, name), getattr(sent.forces, name)
        np.testing.assert_allclose(found, right, atol=1e-12)
    assert back.forces.period == sent.forces.period
    assert back.forces_or_targets is back.forces


def test_measurement_errors_of_parts_are_converted():
    parts = Parts.make(("black_1", "black_2"), np.zeros((2, 2)))
    quality = np.array([[1e-5, 0.02, 0.9], [np.nan, 0.02, np.nan]])
    known, unknown = over_the_wire(convert.parts_to_msg(parts, STAMP, quality=quality)).parts
    np.testing.assert_allclose(
        known.covariance.reshape(3, 3), np.diag([1e-10, 1e-10, 4e-4]), rtol=1e-12
    )
    assert (known.confidence, unknown.confidence, unknown.covariance[0]) == (0.9, -1, -1)
    untold = over_the_wire(convert.parts_to_msg(parts, STAMP)).parts[0]
    assert (untold.confidence, untold.covariance[0]) == (-1, -1)


def test_overlooked_objects_are_converted_to_a_message_and_back():
    parts = Parts.make(("black_1",), np.zeros((1, 2)))
    sent = (OverlookedThing(0.1, -0.2, 0.003, "too small"), OverlookedThing(0, 0, 0.02, "group"))
    back = over_the_wire(convert.parts_to_msg(parts, STAMP, overlooked=sent))
    assert convert.msg_to_overlooked(back) == sent
    back.overlooked[0].radius = np.nan
    assert convert.msg_to_overlooked(back) == sent[1:]
    assert convert.msg_to_overlooked(convert.parts_to_msg(parts, STAMP)) == ()


def test_forces_with_the_state_at_the_start():
    sent = some_request()
    state = np.arange(4.0 * len(sent.parts)).reshape(-1, 4)
    start = Time(sec=5)
    msg = over_the_wire(convert.request_to_msg(replace(sent, start=state), STAMP, start))
    assert (msg.at_start, msg.start) == (True, start)
    back = convert.msg_to_request(msg)
    np.testing.assert_array_equal(back.start, state)
    np.testing.assert_array_equal(back.parts.position, state[:, :2])
    np.testing.assert_allclose(back.parts.velocity, sent.parts.velocity, atol=1e-12)


def test_targets_are_converted_to_a_message_and_back():
    low, width, weight = np.random.default_rng(3).uniform(0, 0.2, (3, 3, 2))
    sent = replace(some_request(), targets=Targets(low, low + width, weight, 0.02))
    back = convert.msg_to_request(over_the_wire(convert.request_to_msg(sent, STAMP))).targets
    for name in ("low", "high", "weight"):
        np.testing.assert_array_equal(getattr(back, name), getattr(sent.targets, name))
    assert (back.gap_m, back.angles) == (0.02, None)
    assert convert.msg_to_request(convert.request_to_msg(some_request(), STAMP)).targets is None


def test_target_angles_are_converted_to_a_message_and_back():
    free, angles = (
        np.zeros((3, 2)),
        AngleTargets(*np.array([[-1.0, 0, 2], [-1, 0.1, 3], [0, 1, 2]])),
    )
    sent = replace(some_request(), targets=Targets(free, free, free, 0.004, angles))
    back = convert.msg_to_request(over_the_wire(convert.request_to_msg(sent, STAMP))).targets.angles
    for name in ("low", "high", "weight"):
        np.testing.assert_array_equal(getattr(back, name), getattr(angles, name))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("target_angle_max", -9.0, "target_angle_min of black_1 is .*, allowed: minimum"),
        ("target_x_min", np.nan, "target_x_min of black_1 is nan and .*, allowed: minimum"),
        ("target_y_max", -1.0, "target_y_min of black_1 is .* -1, allowed: minimum"),
        ("weight_x", -1.0, r"weight_x of black_1 is -1, allowed: 0 to 1e\+09"),
        ("weight_angle", -2.0, r"weight_angle of black_1 is -2, allowed: 0 to 1e\+09"),
        ("weight_y", np.inf, r"weight_y of black_1 is inf, allowed: -1e\+09 to 1e\+09"),
    ],
)
def test_wrong_targets(name, value, message):
    targets = Targets(np.zeros((3, 2)), np.ones((3, 2)), np.ones((3, 2)))
    msg = convert.request_to_msg(replace(some_request(), targets=targets), STAMP)
    setattr(msg.forces[0], name, value)
    with pytest.raises(PlateError, match=message):
        convert.msg_to_request(msg)
    msg = convert.request_to_msg(replace(some_request(), targets=targets), STAMP)
    msg.gap_m = -1.0
    with pytest.raises(PlateError, match=r"gap_m is -1, allowed: 0 to 1e\+09"):
        convert.msg_to_request(msg)


def test_the_driver_status_is_converted_to_a_message_and_back():
    for state in DriverState:
        for reason in DriverReason:
            status = DriverStatus(state, reason, "why", 1_234_567_890_123_456_789)
            msg = over_the_wire(convert.driver_status_to_msg(status, STAMP))
            assert msg.header.stamp == STAMP
            assert convert.msg_to_driver_status(msg) == status


@pytest.mark.parametrize("name", ["state", "reason"])
def test_a_wrong_driver_status_is_refused(name):
    maximum = {"state": 8, "reason": 19}[name]
    with pytest.raises(PlateError, match=f"driver_status: {name} is 200, allowed: 0 to {maximum}"):
        convert.msg_to_driver_status(DriverStatusMsg(**{name: 200}))


def test_codes_of_the_driver_are_those_of_the_message():
    names = [name for name in dir(DriverStatusMsg) if not name.startswith("_")]
    constants = {name: getattr(DriverStatusMsg, name) for name in names}
    codes = {name: code for name, code in constants.items() if type(code) is int}
    assert codes == {each.name: int(each) for each in (*DriverState, *DriverReason)}


def test_detected_parts_are_converted_to_a_message_and_back():
    sent = some_request().parts
    msg = over_the_wire(convert.parts_to_msg(sent, STAMP, Part.SIMULATED))
    assert [part.type for part in msg.parts] == ["black", "white", "white"]
    assert {part.source for part in msg.parts} == {Part.SIMULATED}
    back = convert.msg_to_parts(msg)
    for name in ("position", "velocity", "angle", "spin"):
        np.testing.assert_array_equal(getattr(back, name), getattr(sent, name))


def test_an_interval_without_an_end():
    msg = convert.request_to_msg(some_request(), STAMP)
    msg.forces[0].force_x_min, msg.forces[0].force_x_max = -float("inf"), 0.01
    msg.forces[1].torque_min = -float("inf")
    back = convert.msg_to_request(over_the_wire(msg)).forces
    assert back.force[0, 0] + back.tolerance[0, 0] == pytest.approx(0.01, abs=1e-6)
    assert back.force[0, 0] - back.tolerance[0, 0] < -1e8
    assert back.torque[1] == 0
    assert back.torque[0] == pytest.approx(some_request().forces.torque[0])


def test_no_parts():
    nothing = Parts.make((), np.zeros((0, 2)))
    back = convert.msg_to_parts(over_the_wire(convert.parts_to_msg(nothing, STAMP)))
    assert len(back) == 0
    assert back.position.shape == (0, 2)


def test_images_are_converted_to_messages_and_back():
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
        ("height", 5, "data has 24 bytes, allowed: 30"),
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
        (lambda m: setattr(m.points[2], "velocities", [1.0]), "point 2 are "),
        (lambda m: setattr(m.points[2], "accelerations", []), "point 2 are "),
        (lambda m: m.points.pop(), "motion is not closed"),
        (lambda m: m.points.reverse(), "knot times must be finite"),
        (lambda m: setattr(m.points[2], "positions", [0.0, float("nan"), 0.0]), "not finite"),
    ],
)
def test_wrong_cycles(change, message):
    with pytest.raises(CycleError, match=message):
        convert.msg_to_cycle(spoilt(change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda m: setattr(m.forces[2], "id", "black_1"),
            "ids are .*allowed: each part at most once",
        ),
        (lambda m: setattr(m.forces[1], "x", float("nan")), "x of white_1 is nan"),
        (lambda m: setattr(m.forces[1], "vy", float("inf")), "vy of white_1 is inf"),
        (
            lambda m: setattr(m.forces[1], "friction_limit", -1e200),
            r"friction_limit of white_1 is -1e.200, allowed: -1e.09 to 1e.09",
        ),
        (
            lambda m: setattr(m.forces[1], "force_y_min", float("nan")),
            "force_y_min of white_1 is nan and force_y_max is .*, allowed: minimum",
        ),
        (
            lambda m: setattr(m.forces[2], "torque_max", -9.0),
            "torque_min of white_2 is .*-9, al",
        ),
        (lambda m: setattr(m, "period_s", 0.0), "period_s is 0, allowed: above 0"),
        (
            lambda m: setattr(m, "forces", m.forces[:1] * 101),
            "part_forces: 101 parts, allowed: at most 100",
        ),
        (lambda m: setattr(m, "period_s", float("nan")), "period_s is nan, allowed: above 0"),
    ],
)
def test_wrong_parts(change, message):
    msg = convert.request_to_msg(some_request(), STAMP)
    change(msg)
    with pytest.raises(PlateError, match=message):
        convert.msg_to_request(msg)


def test_camera_info_projects_points_to_their_pixels():
    """Judged by OpenCV, from nothing but the message and the plate's corners in the image."""
    lens = Lens((900.0, 910.0), (315.0, 244.0), (-0.3, 0.1, 1e-3, -1e-3, 0.02))
    rotation, position = cv2.Rodrigues(np.array([3.09, 0.02, 0.01]))[0], np.array([0.01, 0.0, 0.92])
    rays = (np.column_stack([RIG.plate.corners, np.zeros(4)]) @ rotation.T) + position
    corners = lens.bend(lens.focal_px * (rays[:, :2] / rays[:, 2:]) + lens.centre_px)
    camera = replace(RIG.camera, lens=lens, corners_px=tuple(map(tuple, corners.tolist())))
    info = convert.camera_to_info(camera, Header(frame_id="camera"))
    info = deserialize_message(serialize_message(info), CameraInfo)
    assert (info.width, info.height, info.distortion_model) == (640, 480, "plumb_bob")
    k, d, p = np.reshape(info.k, (3, 3)), np.array(info.d), np.reshape(info.p, (3, 4))
    point = np.random.default_rng(0).uniform(-1, 1, (50, 2)) * RIG.plate.half
    there = np.column_stack([point, np.zeros(50)])
    seen = cv2.projectPoints(there, cv2.Rodrigues(rotation)[0], position, k, d)[0][:, 0]
    assert np.allclose(to_image(replace(RIG, camera=camera), point), seen, atol=1e-6)
    assert np.array_equal(np.reshape(info.r, (3, 3)), np.eye(3))
    straight = (there @ rotation.T + position) @ p[:, :3].T + p[:, 3]
    assert np.allclose(straight[:, :2] / straight[:, 2:], lens.straighten(seen), atol=1e-6)


def test_camera_info_has_the_lens_model():
    for model, values in (
        ("equidistant", (0.1, 0.0, 0.0, 0.0)),
        ("rational_polynomial", (0.1,) * 8),
        ("plumb_bob", (0.1,) * 4),
    ):
        lens = Lens((900.0, 910.0), (315.0, 244.0), values, model)
        info = convert.camera_to_info(replace(RIG.camera, lens=lens), Header())
        assert (info.distortion_model, tuple(info.d)) == (model, values)


def test_camera_info_of_a_camera_without_calibration():
    """K[0] = 0, as sensor_msgs/CameraInfo wants it."""
    info = convert.camera_to_info(replace(RIG.camera, lens=None), Header())
    assert (info.width, info.height) == (640, 480)
    assert not np.any(info.k)
    assert not np.any(info.p)
    assert len(info.d) == 0
