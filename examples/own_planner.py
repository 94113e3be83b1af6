"""Example of a planner of your own. This planner sorts black parts to the left, and all other parts
to the right.

To evaluate it in the bench, over many seeds and without ROS:

    python bench/closed_loop.py --scenario sort_4 --planner examples/own_planner.py

To run it as a node instead of `planner`, start `simulator`, `detector`, `solver` and `driver`,
then:

    python examples/own_planner.py
"""

import numpy as np

from plate_core import CycleRequest, Parts, Rig, load_rig, part_class

RATE, FASTEST = 0.5, 0.020
"""Requested drift velocity per metre of distance to the goal [1/s], and maximum drift velocity
[m/s]."""

GOAL, LANE = 0.7, 0.6
"""Distance of the goal from the plate's centre [half lengths], and half-width of the lane in which
parts can have any y [half widths]."""


class OwnPlanner:
    """Control law of the planner. The class returns the requested forces for the parts at the start
    of a cycle. The bench needs only this class."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._seen_at = rig, -np.inf

    def plan(self, parts: Parts, t: float) -> CycleRequest:
        """Return the requested mean force on each part [N] for a cycle that begins at `t` [s].

        Per axis, drift = clip(RATE (goal - position), -FASTEST, FASTEST), and
        force = m (drift - velocity) / period changes the velocity to this drift in one cycle.
        """
        period = np.clip(t - self._seen_at, 0.05, 0.2)
        self._seen_at = t

        length, width = self._rig.plate.half
        left = np.array([part_class(name) == "black" for name in parts.ids])
        goal = np.column_stack(
            [
                np.where(left, -GOAL, GOAL) * length,
                np.clip(parts.position[:, 1], -LANE * width, LANE * width),
            ]
        )
        drift = np.clip(RATE * (goal - parts.position), -FASTEST, FASTEST)
        force = self._rig.parts.mass_kg * (drift - parts.velocity) / period  # F = m dv/dt

        tolerance = np.zeros_like(force)
        in_lane = goal[:, 1] == parts.position[:, 1]
        # If the goal and the part have the same y, any force along y is accepted.
        tolerance[in_lane, 1] = self._rig.force_unit
        return CycleRequest.make(parts, force, tolerance, period=period)


if __name__ == "__main__":
    from rclpy.node import Node
    from trajectory_msgs.msg import JointTrajectory

    from plate_core.ros import DATA, msg_to_parts, request_to_msg, run_node, seconds
    from plate_interfaces.msg import PartForces
    from plate_interfaces.msg import Parts as PartsMsg

    class OwnPlannerNode(Node):
        """Node `planner` with this control law.

        Subscribes to parts and cycle_started. Publishes part_forces.

        The node publishes one request per cycle, from the image nearest to the cycle's start. If
        the camera is triggered, this image is taken at the start. If the camera is free-running,
        the time between image and start is up to half an image interval. The image is also older
        than its stamp. 30 images per second are sufficient for sorting, but not for following a
        path. `at_start` of the request is false. The solver therefore assumes that the parts have
        these positions at the start of the cycle.
        """

        def __init__(self) -> None:
            super().__init__("planner")
            self._planner = OwnPlanner(load_rig())
            # Start of the running cycle, and start of the last cycle for which a request was
            # published.
            self._start = self._answered = None
            self._images = []  # last two images
            self._forces = self.create_publisher(PartForces, "part_forces", DATA)
            self.create_subscription(JointTrajectory, "cycle_started", self._on_started, DATA)
            self.create_subscription(PartsMsg, "parts", self._on_parts, DATA)

        def _on_started(self, msg: JointTrajectory) -> None:
            self._start = msg.header.stamp
            self._answer()

        def _on_parts(self, msg: PartsMsg) -> None:
            self._images = [*self._images[-1:], msg]
            self._answer()

        def _answer(self) -> None:
            """Publish the request for the running cycle. Do nothing until an image from the start
            of this cycle or later has arrived."""
            if not self._images:
                return
            newest = self._images[-1].header.stamp
            # Before the first cycle_started message, the stamp of the image counts as the start of
            # a cycle.
            start = newest if self._start is None else self._start
            off = [seconds(msg.header.stamp) - seconds(start) for msg in self._images]
            # An image that is taken exactly at the start can arrive twice. When the image arrives
            # again, its request must be published again.
            if off[-1] == 0 or (off[-1] > 0 and start != self._answered):
                parts = msg_to_parts(self._images[int(np.argmin(np.abs(off)))])
                self._answered = start
                request = self._planner.plan(parts, seconds(start))
                self._forces.publish(request_to_msg(request, start))

    run_node(OwnPlannerNode)
