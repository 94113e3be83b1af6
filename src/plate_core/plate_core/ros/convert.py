"""Messages to our types and back. Every value is coerced and checked here, nowhere else."""

from __future__ import annotations

import array

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped, Transform, Twist, Wrench
from sensor_msgs.msg import CameraInfo, Image, MultiDOFJointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..errors import CycleError, PlateError
from ..motion import PlateCycle, motor_state, plate_state
from ..parts import PartSet
from ..rig import Camera, Rig

FRAME = "plate_home"
PLATE_JOINTS = ["x", "y", "theta"]
CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3}

MOST = 1e9
"""Of a part nothing is larger than this, in SI units: enough for all, and computable with."""


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds; exact to better than a microsecond until the year 2100."""
    return stamp.sec + 1e-9 * stamp.nanosec


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as a whole number of nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def to_time(nanosec: int) -> Time:
    """Return the stamp of a whole number of nanoseconds."""
    return Time(sec=int(nanosec // 1_000_000_000), nanosec=int(nanosec % 1_000_000_000))


def parts_to_msg(parts: PartSet, stamp: Time) -> MultiDOFJointState:
    """Return parts as a message.

    wrench.force.x and .y are the wanted mean force [N], torque.z the wanted torque [N m]. A planar
    part feels no torque about x or y: torque.x and torque.y carry the tolerance of force.x and
    force.y [N]. Nor is it lifted: force.z is its grip, the greatest friction on it [N].
    """
    msg = MultiDOFJointState(header=Header(stamp=stamp, frame_id=FRAME))
    msg.joint_names = list(parts.ids)
    for i in range(len(parts)):
        transform, twist, wrench = Transform(), Twist(), Wrench()
        transform.translation.x = float(parts.position[i, 0])
        transform.translation.y = float(parts.position[i, 1])
        transform.rotation.z = float(np.sin(parts.angle[i] / 2))
        transform.rotation.w = float(np.cos(parts.angle[i] / 2))
        twist.linear.x = float(parts.velocity[i, 0])
        twist.linear.y = float(parts.velocity[i, 1])
        twist.angular.z = float(parts.spin[i])
        wrench.force.x = float(parts.force[i, 0])
        wrench.force.y = float(parts.force[i, 1])
        wrench.force.z = float(parts.grip[i])
        wrench.torque.x = float(parts.tolerance[i, 0])
        wrench.torque.y = float(parts.tolerance[i, 1])
        wrench.torque.z = float(parts.torque[i])
        msg.transforms.append(transform)
        msg.twist.append(twist)
        msg.wrench.append(wrench)
    return msg


def msg_to_parts(msg: MultiDOFJointState) -> PartSet:
    """Return the parts of a message; twist and wrench may be left out.

    Raises
    ------
    PlateError
        If lengths disagree, a name is given twice, or a value is not finite or beyond `MOST`.
    """
    count = len(msg.joint_names)
    for name, items in (
        ("transforms", msg.transforms),
        ("twist", msg.twist),
        ("wrench", msg.wrench),
    ):
        if len(items) != count and (items or name == "transforms"):
            raise PlateError(f"parts: {len(items)} {name} for {count} names, allowed: as many")
    if len(set(msg.joint_names)) != count:
        raise PlateError(f"parts: a name is given twice in {list(msg.joint_names)}")
    parts = PartSet.make(
        tuple(msg.joint_names),
        position=np.array([(t.translation.x, t.translation.y) for t in msg.transforms]),
        angle=np.array([2 * np.arctan2(t.rotation.z, t.rotation.w) for t in msg.transforms]),
        velocity=np.array([(t.linear.x, t.linear.y) for t in msg.twist]) if msg.twist else None,
        force=np.array([(w.force.x, w.force.y) for w in msg.wrench]) if msg.wrench else None,
        tolerance=np.array([(w.torque.x, w.torque.y) for w in msg.wrench]) if msg.wrench else None,
        torque=np.array([w.torque.z for w in msg.wrench]) if msg.wrench else None,
        grip=np.array([w.force.z for w in msg.wrench]) if msg.wrench else None,
        spin=np.array([t.angular.z for t in msg.twist]) if msg.twist else None,
    )
    columns = np.column_stack(
        [
            parts.position, parts.angle, parts.velocity, parts.spin, parts.force, parts.tolerance,
            parts.torque, parts.grip,
        ]
    )  # fmt: skip
    sane = np.max(np.abs(columns), axis=1, initial=0.0) <= MOST  # not so where one is NaN
    if not np.all(sane):
        row = int(np.argmin(sane))
        value = columns[row][int(np.argmin(np.abs(columns[row]) <= MOST))]
        raise PlateError(
            f"parts: {parts.ids[row]} has a value of {value:g}, allowed: up to {MOST:g}"
        )
    return parts


def cycle_to_msg(cycle: PlateCycle, stamp: Time) -> JointTrajectory:
    """Return a plate cycle as a message: its knots, the last of which is the first again."""
    return trajectory_to_msg(
        PLATE_JOINTS, cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel, stamp
    )


def msg_to_cycle(msg: JointTrajectory) -> PlateCycle:
    """Return the plate cycle of a message.

    Raises
    ------
    CycleError
        If joints, lengths or times are wrong, a value is not finite, or it does not close.
    """
    return PlateCycle.from_knots(*msg_to_knots(msg, PLATE_JOINTS))


def motors_to_msg(rig: Rig, cycle: PlateCycle, stamp: Time) -> JointTrajectory:
    """Return the motors' motion that gives a plate cycle."""
    q, qd, qdd = motor_state(rig, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel)
    return trajectory_to_msg([motor.name for motor in rig.motors], cycle.times, q, qd, qdd, stamp)


def msg_to_motors(rig: Rig, msg: JointTrajectory) -> PlateCycle:
    """Return the plate cycle that the motors' motion gives.

    Raises
    ------
    CycleError
        As `msg_to_cycle`, or if the motors disagree with each other.
    """
    times, q, qd, qdd = msg_to_knots(msg, [motor.name for motor in rig.motors])
    return PlateCycle.from_knots(times, *plate_state(rig, q, qd, qdd))


def trajectory_to_msg(
    joints: list[str],
    times: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    accel: np.ndarray,
    stamp: Time,
) -> JointTrajectory:
    """Return knots as a message: times (k + 1,) [s], the others (k + 1, len(joints))."""
    msg = JointTrajectory(header=Header(stamp=stamp, frame_id=FRAME), joint_names=joints)
    rows = zip(times.tolist(), position.tolist(), velocity.tolist(), accel.tolist(), strict=True)
    for t, q, qd, qdd in rows:
        point = JointTrajectoryPoint(positions=q, velocities=qd, accelerations=qdd)
        nanosec = round(t * 1e9)
        point.time_from_start = Duration(
            sec=nanosec // 1_000_000_000, nanosec=nanosec % 1_000_000_000
        )
        msg.points.append(point)
    return msg


def pose_to_msg(pose: np.ndarray, stamp: Time) -> PoseStamped:
    """Return the plate's pose (3,) [m, m, rad] as a message."""
    msg = PoseStamped(header=Header(stamp=stamp, frame_id=FRAME))
    msg.pose.position.x, msg.pose.position.y = float(pose[0]), float(pose[1])
    msg.pose.orientation.z = float(np.sin(pose[2] / 2))
    msg.pose.orientation.w = float(np.cos(pose[2] / 2))
    return msg


def msg_to_knots(
    msg: JointTrajectory, joints: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return times (k,) [s] and position, velocity, acceleration (k, joints) of a trajectory.

    Raises
    ------
    CycleError
        If joints or lengths are wrong.
    """
    if list(msg.joint_names) != joints:
        raise CycleError(f"trajectory: joints are {list(msg.joint_names)}, allowed: {joints}")
    if len(msg.points) < 2:
        raise CycleError(f"trajectory: {len(msg.points)} points, allowed: at least 2")
    for i, point in enumerate(msg.points):
        sizes = {len(point.positions), len(point.velocities), len(point.accelerations)}
        if sizes != {len(joints)}:
            raise CycleError(
                f"trajectory: point {i} has {sorted(sizes)} values, allowed: {len(joints)} "
                "positions, velocities and accelerations"
            )
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in msg.points])
    return (
        times,
        np.array([p.positions for p in msg.points]),
        np.array([p.velocities for p in msg.points]),
        np.array([p.accelerations for p in msg.points]),
    )


def array_to_image(image: np.ndarray, stamp: Time, encoding: str = "mono8") -> Image:
    """Return a uint8 image (H, W) or (H, W, 3) as a message."""
    msg = Image(header=Header(stamp=stamp, frame_id="camera"))
    msg.height, msg.width = int(image.shape[0]), int(image.shape[1])
    msg.encoding = encoding
    msg.step = msg.width * CHANNELS[encoding]
    data = array.array("B")
    data.frombytes(np.ascontiguousarray(image).tobytes())
    msg.data = data
    return msg


def image_to_array(msg: Image) -> np.ndarray:
    """Return an image message as uint8 (H, W) or (H, W, 3), sharing its memory.

    Raises
    ------
    PlateError
        If the encoding is not mono8, bgr8 or rgb8, or step and data length do not fit.
    """
    channels = CHANNELS.get(msg.encoding)
    if channels is None:
        raise PlateError(f"image: encoding is {msg.encoding!r}, allowed: {', '.join(CHANNELS)}")
    row = msg.width * channels
    if msg.width == 0 or msg.height == 0:
        raise PlateError(f"image: size is {msg.width} x {msg.height}, allowed: at least 1 x 1")
    if msg.step < row:
        raise PlateError(f"image: step is {msg.step} bytes, allowed: at least {row}")
    if len(msg.data) != msg.step * msg.height:
        raise PlateError(f"image: {len(msg.data)} bytes of data, allowed: {msg.step * msg.height}")
    pixels = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.step)[:, :row]
    return pixels if channels == 1 else pixels.reshape(msg.height, msg.width, 3)


def camera_to_info(camera: Camera, header: Header) -> CameraInfo:
    """Return a rig's camera as a message: K, D and P zero if its lens is not known."""
    info = CameraInfo(header=header, width=camera.width_px, height=camera.height_px)
    info.distortion_model = "plumb_bob"
    if camera.lens is not None:
        matrix = camera.lens.matrix
        info.d = list(camera.lens.distortion)
        info.k = matrix.ravel().tolist()
        info.r = np.eye(3).ravel().tolist()
        info.p = np.column_stack([matrix, np.zeros(3)]).ravel().tolist()
    return info
