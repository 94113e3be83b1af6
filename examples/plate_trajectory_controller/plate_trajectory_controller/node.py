"""ROS topics of the relay. The relay publishes joint_trajectory for the controller, and subscribes
to joint_states."""

from __future__ import annotations

import contextlib
import threading

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import DATA, trajectory_to_msg
from plate_driver.transports import TransportContext

from .relay import Relay, Trajectory

TOPIC = "joint_trajectory_controller/joint_trajectory"


def make(context: TransportContext) -> Relay:
    """Return the transport. The package's entry point names this function. The joints are motor_1
    to motor_4."""
    node = rclpy.create_node("trajectory_controller_relay")
    trajectories = node.create_publisher(JointTrajectory, TOPIC, DATA)
    names = [motor.name for motor in context.rig.motors]

    def command(trajectory: Trajectory) -> None:
        now = Time()  # the controller starts a trajectory whose stamp is zero immediately
        states = (trajectory.position, trajectory.velocity, trajectory.acceleration)
        trajectories.publish(trajectory_to_msg(names, trajectory.times, *states, now))

    relay = Relay(context.rig, command, context.publish, context.clock)

    def on_states(msg: JointState) -> None:
        places = dict(zip(msg.name, msg.position, strict=False))
        if all(name in places for name in names):
            relay.receive(np.array([places[name] for name in names]))

    node.create_subscription(JointState, "joint_states", on_states, DATA)

    def spin() -> None:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    threading.Thread(target=spin, daemon=True).start()
    return relay
