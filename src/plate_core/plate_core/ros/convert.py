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
from ..parts import Parts, Wanted
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


def parts_to_msg(parts: Parts, stamp: Time) -> MultiDOFJointState:
    """Return parts as a message, with nothing wanted of them; see `wanted_to_msg`."""
    return wanted_to_msg(Wanted.make(parts), stamp)


def wanted_to_msg(wanted: Wanted, stamp: Time) -> MultiDOFJointState:
    """Return parts and what is wanted of them as a message.

    wrench.force.x and .y are the wanted mean force [N], torque.z the wanted torque [N m]. A planar
    part feels no torque about x or y: torque.x and torque.y carry the tolerance of force.x and
    force.y [N]. Nor is it lifted: force.z is the greatest friction on it [N].
    """
    parts = wanted.parts
    msg = MultiDOFJointState(header=Header(stamp=stamp, frame_id=FRAME))
    msg.joint_names = list(parts.ids)
    for i in range(len(parts)):
        transform, twist, wrench = Transform(), Twist(), Wrench()
        transform.translation.x, transform.translation.y = parts.position[i].tolist()
        transform.rotation.z = float(np.sin(parts.angle[i] / 2))
        transform.rotation.w = float(np.cos(parts.angle[i] / 2))
        twist.linear.x, twist.linear.y = parts.velocity[i].tolist()
        twist.angular.z = float(parts.spin[i])
        wrench.force.x, wrench.force.y = wanted.force[i].tolist()
        wrench.force.z = float(parts.friction_limit[i])
        wrench.torque.x, wrench.torque.y = wanted.tolerance[i].tolist()
        wrench.torque.z = float(wanted.torque[i])
        msg.transforms.append(transform)
        msg.twist.append(twist)
        msg.wrench.append(wrench)
    return msg


def msg_to_parts(msg: MultiDOFJointState) -> Parts:
    """Return the parts of a message, whatever is wanted of them; errors as `msg_to_wanted`."""
    return msg_to_wanted(msg).parts


def msg_to_wanted(msg: MultiDOFJointState) -> Wanted:
    """Return the parts of a message and what is wanted of them; twist and wrench may be left out.

    Raises
    ------
    PlateError
        If lengths disagree, a name is given twice, or a value is not finite or beyond `MOST`.
    """
    count = len(msg.joint_names)
    for name in ("transforms", "twist", "wrench"):
        items = getattr(msg, name)
        if len(items) != count and (items or name == "transforms"):
            raise PlateError(f"parts: {len(items)} {name} for {count} names, allowed: as many")
    if len(set(msg.joint_names)) != count:
        raise PlateError(f"parts: a name is given twice in {list(msg.joint_names)}")
    rows = [
        (
            *(at.translation.x, at.translation.y),
            2 * np.arctan2(at.rotation.z, at.rotation.w),
            *(twist.linear.x, twist.linear.y, twist.angular.z),
            *(wrench.force.x, wrench.force.y, wrench.force.z),
            *(wrench.torque.x, wrench.torque.y, wrench.torque.z),
        )
        for at, twist, wrench in zip(
            msg.transforms, msg.twist or count * [Twist()], msg.wrench or count * [Wrench()],
            strict=True,
        )
    ]  # fmt: skip
    columns = np.array(rows, dtype=float).reshape(count, 12)
    sane = np.abs(columns) <= MOST  # not so where it is NaN
    if not np.all(sane):
        row, column = np.argwhere(~sane)[0]
        raise PlateError(
            f"parts: {msg.joint_names[row]} has a value of {columns[row, column]:g}, "
            f"allowed: up to {MOST:g}"
        )
    position, angle, velocity, spin, force, friction, tolerance, torque = np.split(
        columns, [2, 3, 5, 6, 8, 9, 11], axis=1
    )
    parts = Parts.make(tuple(msg.joint_names), position, velocity, angle, spin, friction)
    return Wanted.make(parts, force, tolerance, torque)


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
