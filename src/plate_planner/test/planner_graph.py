"""The planner node and a probe that speaks to it, in one process."""

import numpy as np
import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from std_srvs.srv import Trigger
from stepped_clock import STEP_S, SteppedExecutor
from trajectory_msgs.msg import JointTrajectory

from plate_core import Parts, PlateCycle
from plate_core.ros import (
    ACTIONS,
    DATA,
    LATCHED,
    cycle_to_msg,
    msg_to_request,
    parts_to_msg,
    scenario_to_goal,
    start_nodes,
    to_time,
)
from plate_core.tasks import load_scenario
from plate_interfaces.msg import DriverStatus, PartForces, TaskStatus
from plate_interfaces.msg import Parts as PartsMsg
from plate_planner.node import PlannerNode

IDS = ("black_1", "black_2", "grey_1", "grey_2")
APART = np.array([[-0.05, -0.05], [-0.05, 0.05], [0.05, -0.05], [0.05, 0.05]])
SORTED = APART * [4.5, 1.0]
SORT_4 = load_scenario("sort_4")
READY = DriverStatus(state=DriverStatus.READY, text="ready")
NOT_READY = [
    DriverStatus(state=DriverStatus.STOPPED, text="stopped: emergency stop; look at the rig"),
    DriverStatus(state=DriverStatus.DISABLED, text="disabled"),
    DriverStatus(state=DriverStatus.BRAKING, text="braking: heat"),
    DriverStatus(state=DriverStatus.INACTIVE, text="inactive"),
    DriverStatus(state=DriverStatus.CALIBRATING, text="calibrating"),
]
ERROR = DriverStatus(state=DriverStatus.ERROR, text="error: the device does not answer")


class Graph:
    """The planner and a probe that speaks to it: also as the driver, whose status is said again and
    again while there is one, as the solver, while `answering`, and in lockstep as the plate, which
    reports its cycles while `reporting`; and as a client."""

    def __init__(self, clock, driver=READY, **parameters):
        self.clock = clock
        args = ["--ros-args", "-r", "__ns:=/planner_test"]
        for name, value in parameters.items():
            args += ["-p", f"{name}:={value}"]
        rclpy.init(args=args)
        self.probe = rclpy.create_node("probe")
        self.executor = SteppedExecutor(clock)
        self.until = self.executor.until
        self.executor.add_node(self.probe)
        self.forces, self.states, self.diagnostics = [], [], []
        self.driver, self.answering, self.cycle = driver, True, PlateCycle.rest(0.1)
        self.parts = self.probe.create_publisher(PartsMsg, "parts", DATA)
        listen = self.probe.create_subscription
        self.reporting = bool(parameters.get("lockstep"))
        if self.reporting:
            self.starts = self.probe.create_publisher(JointTrajectory, "cycle_started", DATA)
        self.drivers = self.probe.create_publisher(DriverStatus, "driver_status", LATCHED)
        self.cycles = self.probe.create_publisher(JointTrajectory, "plate_cycle", DATA)
        self.others = self.probe.create_publisher(DiagnosticArray, "diagnostics", DATA)
        self.probe.create_timer(0.2, self.say, clock=clock.clock)
        listen(PartForces, "part_forces", self.on_forces, DATA)
        self.statuses = []
        listen(TaskStatus, "task_status", self.on_status, LATCHED)
        listen(DiagnosticArray, "diagnostics", self.on_diagnostics, DATA)
        self.stopper = self.probe.create_client(Trigger, "stop")
        self.actions = {}
        self.feedback, self.planner = [], None
        try:
            self.planner = PlannerNode()
            clock.lead(self.planner.get_clock())
            self.executor.add_node(self.planner)
            start_nodes(self.planner)
        except BaseException:
            self.close()
            raise
        self.until(
            lambda: self.states and (not driver or self.planner._monitor.inputs.driver_status)
        )
        if self.reporting:
            self.until(self.starts.get_subscription_count)

    def say(self):
        if self.driver:
            self.drivers.publish(self.driver)

    def driver_text(self):
        """The planner's received messages of the driver."""
        status = self.planner._monitor.inputs.driver_status
        return None if status is None else status.text

    def on_status(self, msg):
        self.statuses.append(msg)
        if not self.states or msg.text != self.states[-1]:
            self.states.append(msg.text)

    def send(self, scenario=SORT_4, action=None):
        """Send a goal; returns its handle once it is accepted."""
        name, goal = scenario_to_goal(scenario) if action is None else action
        if name not in self.actions:
            self.actions[name] = ActionClient(self.probe, ACTIONS[name], name)
        future = self.actions[name].send_goal_async(
            goal, feedback_callback=lambda msg: self.feedback.append(msg.feedback.progress)
        )
        self.until(future.done)
        assert future.result().accepted
        return future.result()

    def result(self, handle):
        """The end of a goal: status of the action, and the planner's status of the task."""
        future = handle.get_result_async()
        self.until(future.done)
        return future.result().status, future.result().result.status

    def refused(self, *goal):
        """Send a goal that does not begin; returns the reason, in a word and in a sentence."""
        status, task = self.result(self.send(*goal))
        assert (status, task.state) == (GoalStatus.STATUS_ABORTED, TaskStatus.ABORTED)
        return task.reason, task.text

    def on_forces(self, msg):
        self.forces.append(msg)
        if self.answering:
            self.answer()

    def answer(self):
        """As the solver does."""
        self.cycles.publish(cycle_to_msg(self.cycle, self.forces[-1].header.stamp))

    def on_diagnostics(self, msg):
        if msg.status[0].name.endswith("planner"):
            self.diagnostics.append(msg)

    def report(self):
        """The next diagnostics: level and message."""
        count = len(self.diagnostics)
        self.until(lambda: len(self.diagnostics) > count)
        status = self.diagnostics[-1].status[0]
        return status.level, status.message

    def begin(self, stamp_s=0.0, scenario=SORT_4):
        """Start, and show all parts until the task has begun."""
        self.image(stamp_s, APART)
        handle = self.send(scenario)
        self.until(lambda: self.states[-1] == "running")
        for k in (1, 2):
            self.image(stamp_s + 0.1 * k, APART)
        return handle

    def until_ended(self, handle, step):
        """Go on until a goal has its result, step 3 first; returns its last status."""
        future = handle.get_result_async()
        for k in range(3, 200):
            if future.done():
                return future.result().result.status
            step(k)
        raise AssertionError(f"it did not end: {self.states}")

    def image_and_pause(self, k):
        """Show the parts of image k, and wait a little."""
        self.image(0.1 * k, APART)
        self.executor.spin_for(STEP_S)

    def image_alone(self, k):
        """Show the parts of an image that is not answered, and wait a little."""
        stamp = to_time(round(1e9 * (101.0 + 0.1 * k)))
        self.parts.publish(parts_to_msg(Parts.make(IDS, APART), stamp))
        self.executor.spin_for(STEP_S)

    def stop(self):
        self.until(self.stopper.service_is_ready)
        future = self.stopper.call_async(Trigger.Request())
        self.until(future.done)
        return future.result()

    def image(self, stamp_s, position, ids=IDS):
        """Publish parts, and return the planner's request once it has received the result."""
        count = len(self.forces)
        stamp = to_time(round(stamp_s * 1e9))
        if self.reporting:
            self.starts.publish(cycle_to_msg(self.cycle, stamp))
        self.parts.publish(parts_to_msg(Parts.make(ids, position), stamp))
        self.until(lambda: len(self.forces) > count)
        self.until(lambda: not (self.answering and self.planner._lockstep.unanswered))
        assert self.forces[-1].header.stamp == stamp
        return msg_to_request(self.forces[-1])

    def close(self):
        if self.planner is not None and self.planner.active:
            self.planner.trigger_deactivate()
        self.executor.settle()  # the result of a goal that ends with it
        for each in self.actions.values():
            each.destroy()
        for node in self.executor.get_nodes():
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()


def stale(name, message, namespace="/planner_test/"):
    name = f"{namespace}{name}"
    status = DiagnosticStatus(level=DiagnosticStatus.STALE, name=name, message=message)
    return DiagnosticArray(status=[status])
