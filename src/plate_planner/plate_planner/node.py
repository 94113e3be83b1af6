"""The planner node: `parts` in, `part_forces` out, and a task that is started and stopped.

It listens to `plate_cycle` too: what the plate does carries the parts from image to image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from plate_core import PlateError, load_rig
from plate_core.ros.convert import msg_to_cycle, msg_to_parts, parts_to_msg, seconds
from plate_core.ros.main import run_node
from plate_core.ros.markers import forces_to_msg
from plate_core.ros.params import declare, follow, parameter
from plate_core.ros.qos import DATA, LATCHED, NEWEST
from plate_core.scenario import load_scenario

from .assembling import AssembleOptions
from .pd import FollowOptions
from .planner import NOTHING, Planner, PlannerOptions
from .progress import Progress
from .sorting import SortOptions
from .task import Phase
from .watch import warm_up

DIAGNOSTICS_PERIOD_S = 0.5
"""Time between diagnostics while nothing changes [s]: quick enough to watch, slow enough to log."""

DRIVER_PATIENCE_S = 5.0
"""A task whose motors do not obey for longer is ended [s]."""

WARN_PERIOD_S = 2.0
"""Least time between two equal warnings [s]."""

SAME_CLOCK_S = 1.0
"""A stamp further than this from our time is of a clock that is not ours [s]."""

LEVELS = {
    Phase.IDLE.value: DiagnosticStatus.OK,
    Phase.RUNNING.value: DiagnosticStatus.OK,
    Phase.DONE.value: DiagnosticStatus.OK,
    Phase.STUCK.value: DiagnosticStatus.ERROR,
    Phase.LOST.value: DiagnosticStatus.ERROR,
    Phase.ABORTED.value: DiagnosticStatus.WARN,
}


@dataclass(frozen=True)
class PlannerParameters:
    """Parameters of the node."""

    rig_file: str = parameter("", "Rig file; empty: the default rig")
    scenario: str = parameter(
        "sort_10", "Name of a scenario of config/scenarios, or path of a .yaml file"
    )
    autostart: bool = parameter(False, "Start the task without waiting for the service `start`")
    default_period: float = parameter(
        PlannerOptions.default_period, "Cycle length until two images tell it [s]", 0.005, 1.0
    )
    wait_s: float = parameter(
        PlannerOptions.wait_s, "Longest wait for all parts after start [s]", 0.0, 3600.0
    )
    patience_s: float = parameter(
        PlannerOptions.patience_s, "A part unseen for longer is lost [s]", 0.0, 60.0
    )
    stuck_s: float = parameter(
        PlannerOptions.stuck_s, "A task no nearer to its goal for longer is stuck [s]", 1.0, 3600.0
    )
    image_age_s: float = parameter(
        -1.0, "How old an image is at its stamp [s]; negative: found out", -1.0, 0.5
    )
    drift_max: float = parameter(
        SortOptions.drift_max,
        "Sorting and assembling: drift asked of a part [m/s]",
        0.0005,
        0.2,
        live=True,
    )
    wander: float = parameter(
        SortOptions.wander,
        "Sorting: drift allowed where none is asked [drift_max]",
        0.0,
        5.0,
        live=True,
    )
    dodge: float = parameter(
        SortOptions.dodge,
        "Sorting: drift apart of parts that meet [drift_max]",
        0.0,
        2.0,
        live=True,
    )
    kp: float = parameter(
        FollowOptions.kp, "Following: share of the error corrected a cycle [-]", 0.0, 2.0, live=True
    )
    observer_gain: float = parameter(
        FollowOptions.observer_gain,
        "Following: share of a cycle's surprise expected of the next one",
        0.0,
        1.0,
        live=True,
    )

    def options(self) -> PlannerOptions:
        """Return the core's options."""
        return PlannerOptions(
            sort=SortOptions(drift_max=self.drift_max, wander=self.wander, dodge=self.dodge),
            follow=FollowOptions(kp=self.kp, observer_gain=self.observer_gain),
            assemble=AssembleOptions(drift_max=self.drift_max),
            default_period=self.default_period,
            wait_s=self.wait_s,
            patience_s=self.patience_s,
            stuck_s=self.stuck_s,
            image_age_s=None if self.image_age_s < 0 else self.image_age_s,
        )


class PlannerNode(Node):
    """Subscribes `parts`; publishes `part_forces`, `task_state` and `diagnostics`."""

    def __init__(self) -> None:
        super().__init__("planner")
        values = declare(self, PlannerParameters)
        self._rig = rig = load_rig(values.rig_file)
        self._planner = Planner(rig, load_scenario(values.scenario), values.options())
        self._state = self._planner.initial()
        warm_up()
        self._reported = ""
        self._fault, self._fault_at = "", 0.0
        self._diagnosed_at = 0.0
        follow(self, values, self._retune)

        self._forces = self.create_publisher(MultiDOFJointState, "part_forces", DATA)
        self._markers = self.create_publisher(MarkerArray, "markers", DATA)
        self._task_state = self.create_publisher(String, "task_state", LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "diagnostics", DATA)
        self.create_subscription(MultiDOFJointState, "parts", self._on_parts, NEWEST)
        self.create_subscription(JointTrajectory, "plate_cycle", self._on_cycle, DATA)
        self.create_subscription(String, "driver_state", self._on_driver, LATCHED)
        self.create_service(Trigger, "start", self._on_start)
        self.create_service(Trigger, "stop", self._on_stop)

        if values.autostart:
            self._state = self._planner.start(self._state)
        self._report()
        self.get_logger().info(f"scenario {values.scenario}: {self._planner.scenario.description}")

    def _on_parts(self, msg: MultiDOFJointState) -> None:
        self._watch_driver()
        try:
            parts = msg_to_parts(msg)
        except PlateError as error:
            # Still answered, so that the loop goes on; the plate rests meanwhile.
            self.get_logger().warning(str(error), throttle_duration_sec=WARN_PERIOD_S)
            self._forces.publish(parts_to_msg(NOTHING, msg.header.stamp))
            return
        self._state, asked, progress = self._planner.plan(
            self._state, parts, seconds(msg.header.stamp)
        )
        self._forces.publish(parts_to_msg(asked, msg.header.stamp))
        if self._markers.get_subscription_count():
            self._markers.publish(forces_to_msg(self._rig, asked, msg.header.stamp))
        changed = self._report()
        self._diagnose(progress, msg, changed)

    def _on_cycle(self, msg: JointTrajectory) -> None:
        stamp = seconds(msg.header.stamp)
        try:
            cycle = msg_to_cycle(msg)
        except PlateError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=WARN_PERIOD_S)
            return
        now = 1e-9 * self.get_clock().now().nanoseconds
        arrival = now if abs(now - stamp) < SAME_CLOCK_S else stamp
        self._state = self._planner.hear(self._state, cycle, arrival)

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        name = self._planner.scenario.name
        if self._state.task.phase is Phase.RUNNING:
            response.success, response.message = False, f"{name} is running; call stop first"
            return response
        self._state = self._planner.start(self._state)
        self._report()
        response.success = True
        response.message = (
            f"{name} starts as soon as all {self._planner.scenario.count} parts are seen"
        )
        return response

    def _on_driver(self, msg: String) -> None:
        """Hear whether the motors obey. A line that fails may come back, a stop is meant."""
        self._fault = msg.data if msg.data.startswith("error") else ""
        self._fault_at = self.get_clock().now().nanoseconds * 1e-9
        if msg.data.startswith(("stopped", "disabled")):
            self._abort(msg.data)

    def _watch_driver(self) -> None:
        """End a task whose motors have not obeyed for long."""
        since = self.get_clock().now().nanoseconds * 1e-9 - self._fault_at
        if self._fault and since > DRIVER_PATIENCE_S:
            self._abort(self._fault)

    def _abort(self, why: str) -> None:
        if self._state.task.phase is Phase.RUNNING:
            self._state = self._planner.stop(self._state, f"driver: {why}")
            self._report()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        was = self._state.task.text
        self._state = self._planner.stop(self._state)
        self._report()
        response.success, response.message = (
            True,
            f"{self._planner.scenario.name} stopped, was {was}",
        )
        return response

    def _retune(self, values: PlannerParameters) -> None:
        self._planner = replace(self._planner, options=values.options())

    def _report(self) -> bool:
        """Publish the task's state if it has changed, and tell whether it has."""
        text = self._state.task.text
        if text == self._reported:
            return False
        self._reported = text
        self._task_state.publish(String(data=text))
        line = f"task {self._planner.scenario.name}: {text}"
        # Two lines of code: rclpy refuses two severities from one.
        if self._state.task.phase.is_failure:
            self.get_logger().error(line)
        else:
            self.get_logger().info(line)
        return True

    def _diagnose(self, progress: Progress, msg: MultiDOFJointState, changed: bool) -> None:
        now = seconds(msg.header.stamp)
        if not changed and 0 <= now - self._diagnosed_at < DIAGNOSTICS_PERIOD_S:
            return
        self._diagnosed_at = now
        array = DiagnosticArray()
        array.header.stamp = msg.header.stamp
        status = DiagnosticStatus(
            level=LEVELS[progress.phase],
            name=f"{self.get_name()}: task",
            message=progress.text,
            hardware_id=self._planner.scenario.name,
            values=[KeyValue(key=k, value=v) for k, v in progress.values().items()],
        )
        array.status = [status]
        self._diagnostics.publish(array)


def main() -> None:
    """Run the node."""
    run_node(PlannerNode)
