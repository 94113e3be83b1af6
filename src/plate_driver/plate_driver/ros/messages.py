"""Conversion between the driver's ROS messages and its own types."""

from __future__ import annotations

from collections.abc import Sequence

from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateCycle, Rig
from plate_core.ros import deserialized, msg_to_cycle, nanoseconds, to_time, trajectory_to_msg

from ..setpoints import MotorTable


def bytes_to_cycle(data: bytes) -> tuple[PlateCycle, int]:
    """Return the cycle of a serialized plate_cycle, and its stamp [ns].

    Raises
    ------
    PlateError
        If the message or the cycle is invalid.
    """
    msg = deserialized(data, JointTrajectory)
    return msg_to_cycle(msg), nanoseconds(msg.header.stamp)


def table_to_msg(rig: Rig, table: MotorTable) -> JointTrajectory:
    """Convert a motor table to a message of motor_setpoints."""
    joints = [motor.name for motor in rig.motors]
    stamp = to_time(table.stamp_ns)
    return trajectory_to_msg(joints, table.times, table.q, table.qd, table.qdd, stamp)


def motor_state_to_msg(
    rig: Rig,
    stamp_ns: int,
    position: Sequence[float],
    velocity: Sequence[float] = (),
    acceleration: Sequence[float] = (),
) -> JointState:
    """Convert the state of the motors to a message of motor_states. Each argument has one value per
    motor (4,) or is empty. The travel is in [m] and the speed in [m/s]. The message contains the
    acceleration [m/s2] in its field `effort`, because JointState has no field for accelerations.
    """
    msg = JointState(name=[motor.name for motor in rig.motors])
    msg.header.stamp = to_time(stamp_ns)
    msg.position, msg.velocity, msg.effort = list(position), list(velocity), list(acceleration)
    return msg
