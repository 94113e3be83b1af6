"""A planner of your own in 40 lines: it draws every part to the middle line of the plate.

Start `simulator`, `detector`, `solver` and `driver` (ros2 run, see README), and this in place of
`planner`: python examples/own_planner.py
"""

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState

from plate_core import Wanted, load_rig
from plate_core.ros import DATA, msg_to_parts, run_node, seconds, wanted_to_msg

RATE, FASTEST = 1.0, 0.012
"""Asked drift for each metre to go [1/s], and at most [m/s]."""


class OwnPlanner(Node):
    """Subscribes `parts`, publishes `part_forces`."""

    def __init__(self) -> None:
        super().__init__("planner")
        self._rig, self._seen_at = load_rig(), None
        self._forces = self.create_publisher(MultiDOFJointState, "part_forces", DATA)
        self.create_subscription(MultiDOFJointState, "parts", self._on_parts, DATA)

    def _on_parts(self, msg: MultiDOFJointState) -> None:
        parts, now = msg_to_parts(msg), seconds(msg.header.stamp)
        period = now - self._seen_at if self._seen_at is not None else 0.1  # one image a cycle
        self._seen_at = now

        drift = np.zeros((len(parts), 2))
        drift[:, 1] = np.clip(-RATE * parts.position[:, 1], -FASTEST, FASTEST)
        force = self._rig.parts.mass_kg * (drift - parts.velocity) / max(period, 1e-3)  # F = m dv/T
        tolerance = np.zeros_like(force)
        tolerance[:, 0] = self._rig.force_unit  # along x it may do what it likes
        wanted = Wanted.make(parts, force, tolerance)
        self._forces.publish(wanted_to_msg(wanted, msg.header.stamp))


if __name__ == "__main__":
    run_node(OwnPlanner)
