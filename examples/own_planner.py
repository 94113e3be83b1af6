"""A planner of your own: it sorts the parts, black ones to the left, all others to the right.

Judged by the bench, over many seeds, without ROS:

    python bench/closed_loop.py --scenario sort_4 --planner examples/own_planner.py

As a node in place of `planner`, beside `simulator`, `detector`, `solver` and `driver`:

    python examples/own_planner.py
"""

import numpy as np

from plate_core import Parts, Rig, Wanted, load_rig, part_class

RATE, FASTEST = 0.5, 0.020
"""Wanted drift for each metre to go [1/s], and at most [m/s]."""

GOAL, LANE = 0.7, 0.6
"""Where parts are drawn to, in half lengths; how far aside they may be, in half widths."""


class OwnPlanner:
    """The control law: what is wanted of the parts at a cycle's start. Only this is yours to
    write."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._seen_at = rig, -np.inf

    def plan(self, parts: Parts, t: float) -> Wanted:
        """Return the mean force on each part [N]; `t` is when the cycle began [s]."""
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
        tolerance[in_lane, 1] = self._rig.force_unit  # there it may go as it likes
        return Wanted.make(parts, force, tolerance, period=period)


if __name__ == "__main__":
    from rclpy.node import Node
    from trajectory_msgs.msg import JointTrajectory

    from plate_core.ros import DATA, msg_to_parts, run_node, seconds, wanted_to_msg
    from plate_interfaces.msg import PartForces
    from plate_interfaces.msg import Parts as PartsMsg

    class OwnPlannerNode(Node):
        """The same in the graph: subscribes `parts`, `cycle_started`, publishes `part_forces`.

        Each cycle is answered once, by the image nearest to its start. That is the image at its
        start, if the camera is triggered there. Of one that runs free it is up to half an interval
        off, and older than its stamp says: at 30 images a second good enough to sort, not to follow
        a path. `at_start` stays false: the solver takes the parts to be there at the cycle's start.
        """

        def __init__(self) -> None:
            super().__init__("planner")
            self._planner = OwnPlanner(load_rig())
            self._start = self._answered = None  # of the cycle that runs, of the last one answered
            self._images = []  # the last two
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
            """Answer the cycle, as soon as there is an image from its start or later."""
            if not self._images:
                return
            newest = self._images[-1].header.stamp
            start = newest if self._start is None else self._start  # nobody has told one yet
            off = [seconds(msg.header.stamp) - seconds(start) for msg in self._images]
            # An image of the start itself comes again where it is to be answered again.
            if off[-1] == 0 or (off[-1] > 0 and start != self._answered):
                parts = msg_to_parts(self._images[int(np.argmin(np.abs(off)))])
                self._answered = start
                wanted = self._planner.plan(parts, seconds(start))
                self._forces.publish(wanted_to_msg(wanted, start))

    run_node(OwnPlannerNode)
