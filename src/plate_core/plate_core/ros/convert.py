"""Conversion between ROS messages and this project's types.

Only this module converts and checks the values of messages.
"""

from __future__ import annotations

import array
import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from plate_interfaces.msg import DriverStatus as DriverStatusMsg
from plate_interfaces.msg import OverlookedThing as OverlookedThingMsg
from plate_interfaces.msg import Part, PartForce, PartForces
from plate_interfaces.msg import Parts as PartsMsg
from plate_interfaces.msg import Target as TargetMsg
from plate_interfaces.msg import Targets as TargetsMsg

from ..cycle_request import AngleTargets, CycleRequest, Targets
from ..driver_status import DriverReason, DriverState, DriverStatus
from ..errors import CycleError, PlateError
from ..motion import PlateCycle, motor_state, plate_state
from ..parts import MAX_PARTS, OverlookedThing, Parts, part_class
from ..rig import Camera, Rig
from ..tasks import PartTarget
from .frames import CAMERA_FRAME, FRAME

PLATE_JOINTS = ["x", "y", "theta"]
CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3}

STATE = ("x", "y", "angle", "vx", "vy", "spin")
"""Fields of Part that contain the state of the part."""

START = ("x", "y", "angle", "vx", "vy", "drift_x", "drift_y", "drift_spin", "friction_limit")
"""Fields of PartForce that contain the state of the part."""

INTERVALS = (
    "force_x_min", "force_x_max", "force_y_min", "force_y_max", "torque_min", "torque_max",
)  # fmt: skip
"""Fields of PartForce that contain the requested intervals of force and torque."""

TARGETS = (
    "target_x_min", "target_x_max", "target_y_min", "target_y_max", "target_angle_min",
    "target_angle_max",
)  # fmt: skip
WEIGHTS = ("weight_x", "weight_y", "weight_angle")
"""Fields of PartForce that contain the weights of the targets."""

UNKNOWN = -1.0
NO_COVARIANCE = np.array([UNKNOWN, *np.zeros(8)])

MAX_MAGNITUDE = 1e9
"""Maximum magnitude of any value of a part, in SI units. Real values are smaller, and computations
with this value do not overflow."""


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds. The error is below one microsecond until the year 2100."""
    return stamp.sec + 1e-9 * stamp.nanosec


def nanoseconds(stamp: Time) -> int:
    """Return a stamp as a whole number of nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def to_time(nanosec: int) -> Time:
    """Convert a whole number of nanoseconds to a stamp."""
    return Time(sec=int(nanosec // 1_000_000_000), nanosec=int(nanosec % 1_000_000_000))


def driver_status_to_msg(status: DriverStatus, stamp: Time) -> DriverStatusMsg:
    """Convert the driver's status to a message."""
    return DriverStatusMsg(
        header=Header(stamp=stamp), state=int(status.state), reason=int(status.reason),
        text=status.text, enabled_at=to_time(status.enabled_ns),
    )  # fmt: skip


def msg_to_driver_status(msg: DriverStatusMsg) -> DriverStatus:
    """Convert a message to the driver's status.

    Raises
    ------
    PlateError
        If the state or the reason is unknown.
    """
    for name, kind in (("state", DriverState), ("reason", DriverReason)):
        if getattr(msg, name) not in set(kind):
            value = getattr(msg, name)
            raise PlateError(f"driver_status: {name} is {value}, allowed: 0 to {max(kind):d}")
    return DriverStatus(
        DriverState(msg.state), DriverReason(msg.reason), msg.text, nanoseconds(msg.enabled_at)
    )


def parts_to_msg(
    parts: Parts,
    stamp: Time,
    source: int = Part.SEEN,
    quality: np.ndarray | None = None,
    overlooked: Sequence[OverlookedThing] = (),
) -> PartsMsg:
    """Convert parts to a message.

    Parameters
    ----------
    parts : Parts
    stamp : Time
        Stamp of the image.
    source : int
        Measurement method of all parts, a constant of the message Part.
    quality : (M, 3), optional
        Columns: standard deviation of the position along each axis [m], standard deviation of the
        angle [rad], and confidence that the object is a part [-]. Unknown values are NaN.
    overlooked : sequence of OverlookedThing
        Objects in the image that vision does not recognise as parts.
    """
    msg = PartsMsg(header=Header(stamp=stamp, frame_id=FRAME))
    if quality is None:
        quality = np.full((len(parts), 3), np.nan)
    covariance = np.zeros((len(parts), 9))
    covariance[:, [0, 4, 8]] = quality[:, [0, 0, 1]] ** 2
    covariance[~np.all(np.isfinite(covariance), axis=1)] = NO_COVARIANCE
    confidence = np.nan_to_num(quality[:, 2], nan=UNKNOWN).tolist()
    msg.parts = [
        Part(
            **dict(zip(STATE, row, strict=True)), id=name, type=part_class(name),
            confidence=sure, covariance=spread, source=source,
        )
        for name, row, sure, spread in zip(
            parts.ids, _part_states(parts), confidence, covariance, strict=True
        )
    ]  # fmt: skip
    msg.overlooked = [
        OverlookedThingMsg(x=float(x), y=float(y), radius=float(radius), reason=str(reason))
        for x, y, radius, reason in overlooked
    ]
    return msg


def msg_to_parts(msg: PartsMsg) -> Parts:
    """Convert a message to parts.

    Raises
    ------
    PlateError
        If the frame is wrong, an id occurs twice, the type of a part differs from its id, or a
        value is not finite or its magnitude exceeds `MAX_MAGNITUDE`.
    """
    _check_frame("parts", msg.header)
    ids = tuple(part.id for part in msg.parts)
    for part in msg.parts:
        if part.type and part.type != part_class(part.id):
            raise PlateError(
                f"parts: type of {part.id[:50]} is {part.type[:50]!r}, allowed: "
                f"{part_class(part.id)[:50]!r}, because an id is the type, _ and a number"
            )
    rows = _check_parts("parts", ids, msg.parts, STATE)
    x, y, angle, vx, vy, spin = rows.T
    return Parts.make(ids, np.column_stack([x, y]), np.column_stack([vx, vy]), angle, spin)


def msg_to_overlooked(msg: PartsMsg) -> tuple[OverlookedThing, ...]:
    """Return the objects of a message that vision does not recognise as parts. Objects with
    non-finite values are skipped."""
    things = (OverlookedThing(item.x, item.y, item.radius, item.reason) for item in msg.overlooked)
    return tuple(thing for thing in things if np.all(np.isfinite(thing[:3])))


def request_to_msg(request: CycleRequest, stamp: Time, start: Time | None = None) -> PartForces:
    """Convert the planner's request to a message.

    Parameters
    ----------
    request : CycleRequest
    stamp : Time
        Stamp of the image, or start time of the cycle, on which the request is based.
    start : Time, optional
        Start of the requested cycle, if it is known.
    """
    parts, forces, at_start = request.parts, request.forces, request.start is not None
    msg = PartForces(
        header=Header(stamp=stamp, frame_id=FRAME), start=start or Time(), at_start=at_start,
        period_s=float(forces.period),
    )  # fmt: skip
    if request.plate is not None:
        msg.plate_known, msg.plate = True, request.plate.ravel()
    state = request.start
    if state is None:
        state = np.hstack([parts.position, np.zeros((len(parts), 2))])
    low, high = forces.force - forces.tolerance, forces.force + forces.tolerance
    to = request.targets
    if to is None:
        sought = np.zeros((len(parts), 9))
    else:
        msg.to_targets, msg.gap_m = True, float(to.gap_m)
        angles = to.angles or AngleTargets(*np.zeros((3, len(parts))))
        sought = np.column_stack(
            [to.low[:, 0], to.high[:, 0], to.low[:, 1], to.high[:, 1], angles.low, angles.high,
             to.weight, angles.weight]
        )  # fmt: skip
    # The interval of the torque is unlimited if no torque is requested.
    free = np.where(forces.torque == 0, np.inf, 0.0)
    rows = np.column_stack(
        [state[:, :2], parts.angle, state[:, 2:], parts.velocity, parts.spin, parts.friction_limit,
         low[:, 0], high[:, 0], low[:, 1], high[:, 1], forces.torque - free,
         forces.torque + free, sought]
    ).tolist()  # fmt: skip
    msg.forces = [
        PartForce(
            **dict(zip((*START, *INTERVALS, *TARGETS, *WEIGHTS), row, strict=True)),
            id=name, friction_limit_stddev=UNKNOWN,
        )
        for name, row in zip(parts.ids, rows, strict=True)
    ]  # fmt: skip
    return msg


def msg_to_request(msg: PartForces) -> CycleRequest:
    """Convert a message to the planner's request.

    Raises
    ------
    PlateError
        If the frame is wrong, there are more than `MAX_PARTS` parts, an id occurs twice, a value is
        not finite or its magnitude exceeds `MAX_MAGNITUDE`, a lower bound exceeds its upper bound,
        or the period is not positive. Bounds of intervals may be infinite.
    """
    _check_frame("part_forces", msg.header)
    if msg.plate_known and not np.all(np.abs(msg.plate) <= MAX_MAGNITUDE):
        raise PlateError(
            f"part_forces: plate is {list(msg.plate)}, allowed: -{MAX_MAGNITUDE:g} to "
            f"{MAX_MAGNITUDE:g}"
        )
    if len(msg.forces) > MAX_PARTS:
        raise PlateError(f"part_forces: {len(msg.forces)} parts, allowed: at most {MAX_PARTS}")
    ids = tuple(force.id for force in msg.forces)
    if ids and not 0 < msg.period_s <= MAX_MAGNITUDE:
        raise PlateError(
            f"part_forces: period_s is {msg.period_s:g}, allowed: above 0, at most "
            f"{MAX_MAGNITUDE:g}"
        )
    rows = _check_parts("part_forces", ids, msg.forces, START)
    ends = _to_intervals(ids, msg.forces, INTERVALS)
    has_torque = np.all(np.isfinite(ends[:, 4:]), axis=1)
    low = np.clip(ends[:, 0::2], -MAX_MAGNITUDE, MAX_MAGNITUDE)
    high = np.clip(ends[:, 1::2], -MAX_MAGNITUDE, MAX_MAGNITUDE)
    middle, tolerance = (low + high) / 2, (high - low) / 2
    parts = Parts.make(ids, rows[:, :2], rows[:, 5:7], rows[:, 2], rows[:, 7], rows[:, 8])
    return CycleRequest.make(
        parts,
        middle[:, :2],
        tolerance[:, :2],
        np.where(has_torque, middle[:, 2], 0.0),
        float(msg.period_s),
        rows[:, [0, 1, 3, 4]] if msg.at_start else None,
        _to_targets(ids, msg) if msg.to_targets else None,
        np.reshape(msg.plate, (3, 3)) if msg.plate_known else None,
    )


def target_to_msg(target: PartTarget) -> TargetMsg:
    """Convert the target of a part to a message."""
    x, y = target.place
    angle = math.nan if target.angle is None else target.angle
    return TargetMsg(id=target.id, x=float(x), y=float(y), angle=float(angle))


def targets_to_msg(targets: Sequence[PartTarget], stamp: Time) -> TargetsMsg:
    """Convert the targets of parts to a message."""
    header = Header(stamp=stamp, frame_id=FRAME)
    return TargetsMsg(header=header, targets=[target_to_msg(target) for target in targets])


def msg_to_targets(msg: TargetsMsg) -> tuple[PartTarget, ...]:
    """Convert a message to targets of parts. `target_problem` checks whether each target is
    possible.

    Raises
    ------
    PlateError
        If there are more than `MAX_PARTS` targets, an id occurs twice, or the frame is wrong.
    """
    _check_frame("targets", msg.header)
    ids = [target.id for target in msg.targets]
    if len(ids) > MAX_PARTS:
        raise PlateError(f"targets: {len(ids)} targets, allowed: at most {MAX_PARTS}")
    if len(set(ids)) < len(ids):
        double = next(name for name in ids if ids.count(name) > 1)
        raise PlateError(f"targets: {double[:50]} occurs twice, allowed: each part at most once")
    return tuple(
        PartTarget(item.id, (item.x, item.y), None if math.isnan(item.angle) else item.angle)
        for item in msg.targets
    )


def _check_frame(what: str, header: Header, error: type[PlateError] = PlateError) -> None:
    """Refuse data of another frame than plate_home. The name can have a prefix, or be empty."""
    frame = header.frame_id
    if frame and frame.rpartition("/")[2] != FRAME:
        raise error(f"{what}: frame is {frame[:50]!r}, allowed: {FRAME}")


def _to_targets(ids: tuple[str, ...], msg: PartForces) -> Targets:
    """Return the targets of a message.

    Raises
    ------
    PlateError
        If a lower bound exceeds its upper bound, or a weight or `gap_m` is outside the range 0 to
        `MAX_MAGNITUDE`.
    """
    ends = np.clip(_to_intervals(ids, msg.forces, TARGETS), -MAX_MAGNITUDE, MAX_MAGNITUDE)
    weight = _check_parts("part_forces", ids, msg.forces, WEIGHTS)
    if not 0 <= msg.gap_m <= MAX_MAGNITUDE:
        raise PlateError(f"part_forces: gap_m is {msg.gap_m:g}, allowed: 0 to {MAX_MAGNITUDE:g}")
    if np.any(weight < 0):
        row, column = np.argwhere(weight < 0)[0]
        raise PlateError(
            f"part_forces: {WEIGHTS[column]} of {ids[row]} is {weight[row, column]:g}, allowed: 0 "
            f"to {MAX_MAGNITUDE:g}"
        )
    angles = None
    if np.any(weight[:, 2]):
        angles = AngleTargets(ends[:, 4], ends[:, 5], weight[:, 2])
    return Targets(ends[:, 0:4:2], ends[:, 1:4:2], weight[:, :2], float(msg.gap_m), angles)


def _to_intervals(
    ids: tuple[str, ...], forces: Sequence[PartForce], keys: tuple[str, ...]
) -> np.ndarray:
    """Return the fields `keys` (M, n) of the parts. These fields are lower and upper bounds of
    intervals, in turn. Raise an error if a lower bound exceeds its upper bound."""
    ends = np.array([[getattr(force, key) for key in keys] for force in forces], dtype=float)
    ends = ends.reshape(-1, len(keys))
    wrong = ~(ends[:, 0::2] <= ends[:, 1::2])  # NaN also counts as wrong
    if np.any(wrong):
        row, column = np.argwhere(wrong)[0]
        low, high = ends[row, 2 * column : 2 * column + 2]
        raise PlateError(
            f"part_forces: {keys[2 * column]} of {ids[row]} is {low:g} and {keys[2 * column + 1]} "
            f"is {high:g}, allowed: minimum <= maximum"
        )
    return ends


def _part_states(parts: Parts) -> list[list[float]]:
    """Return the values of the fields `STATE` for each part."""
    columns = [parts.position, parts.angle[:, None], parts.velocity, parts.spin[:, None]]
    rows: list[list[float]] = np.hstack(columns).tolist()
    return rows


def _check_parts(
    what: str, ids: tuple[str, ...], items: Sequence[Part | PartForce], keys: tuple[str, ...]
) -> np.ndarray:
    """Return the fields `keys` (M, n) of the parts in a message. Raise an error if an id occurs
    twice or a value is not allowed."""
    if len(set(ids)) < len(ids):
        raise PlateError(f"{what}: ids are {list(ids)}, allowed: each part at most once")
    rows = [[getattr(item, key) for key in keys] for item in items]
    array = np.array(rows, dtype=float).reshape(len(ids), len(keys))
    sane = np.abs(array) <= MAX_MAGNITUDE  # NaN also fails this check
    if not np.all(sane):
        row, column = np.argwhere(~sane)[0]
        raise PlateError(
            f"{what}: {keys[column]} of {ids[row]} is {array[row, column]:g}, allowed: "
            f"-{MAX_MAGNITUDE:g} to {MAX_MAGNITUDE:g}"
        )
    return array


def cycle_to_msg(cycle: PlateCycle, stamp: Time) -> JointTrajectory:
    """Convert a plate cycle to a message with its knots. A knot that occurs twice marks the end of
    the cycle. The following knots are its tail."""
    return trajectory_to_msg(PLATE_JOINTS, *cycle.knots, stamp)


def msg_to_cycle(msg: JointTrajectory) -> PlateCycle:
    """Convert a message to a plate cycle.

    Raises
    ------
    CycleError
        If frame, joints, lengths or times are wrong, a value is not finite, or the motion ends
        neither in its initial state nor at rest.
    """
    _check_frame("plate_cycle", msg.header, CycleError)
    return PlateCycle.from_knots(*msg_to_knots(msg, PLATE_JOINTS))


def motors_to_msg(rig: Rig, cycle: PlateCycle, stamp: Time) -> JointTrajectory:
    """Convert a plate cycle to a message with the corresponding motion of the motors."""
    times, *states = cycle.knots
    joints = [motor.name for motor in rig.motors]
    return trajectory_to_msg(joints, times, *motor_state(rig, *states), stamp)


def msg_to_motors(rig: Rig, msg: JointTrajectory) -> PlateCycle:
    """Convert a message with a motion of the motors to the corresponding plate cycle.

    Raises
    ------
    CycleError
        For the same errors as `msg_to_cycle`, or if the motor positions are inconsistent.
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
    """Convert knots to a message. `times` is (k + 1,) [s]. All other arrays have the shape (k + 1,
    len(joints))."""
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
                f"trajectory: numbers of values in point {i} are {sorted(sizes)}, allowed: "
                f"{len(joints)} positions, velocities and accelerations each"
            )
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in msg.points])
    return (
        times,
        np.array([p.positions for p in msg.points]),
        np.array([p.velocities for p in msg.points]),
        np.array([p.accelerations for p in msg.points]),
    )


def array_to_image(image: np.ndarray, stamp: Time, encoding: str = "mono8") -> Image:
    """Convert an image (H, W) or (H, W, n), uint8 or uint16, to a message. `encoding` is the name
    of the image's encoding in ROS."""
    msg = Image(header=Header(stamp=stamp, frame_id=CAMERA_FRAME))
    msg.height, msg.width = int(image.shape[0]), int(image.shape[1])
    msg.encoding = encoding
    flat = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
    msg.step = flat.size // msg.height
    data = array.array("B")
    # use an array.array, because rclpy copies any other type byte by byte
    data.frombytes(flat.data)
    msg.data = data
    return msg


def image_to_array(msg: Image) -> np.ndarray:
    """Return the image of a message as uint8 (H, W) or (H, W, 3). The array shares the memory of
    the message.

    Raises
    ------
    PlateError
        If the encoding is not mono8, bgr8 or rgb8, or the step or the data length is inconsistent
        with the size of the image.
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
        raise PlateError(f"image: data has {len(msg.data)} bytes, allowed: {msg.step * msg.height}")
    pixels = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.step)[:, :row]
    return pixels if channels == 1 else pixels.reshape(msg.height, msg.width, 3)


def camera_to_info(camera: Camera, header: Header) -> CameraInfo:
    """Convert a rig's camera to a message. K, D and P are zero if the lens is not calibrated."""
    info = CameraInfo(header=header, width=camera.width_px, height=camera.height_px)
    info.distortion_model = "plumb_bob"
    if camera.lens is not None:
        info.distortion_model = camera.lens.model
        matrix = camera.lens.matrix
        info.d = list(camera.lens.distortion)
        info.k = matrix.ravel().tolist()
        info.r = np.eye(3).ravel().tolist()
        info.p = np.column_stack([matrix, np.zeros(3)]).ravel().tolist()
    return info
