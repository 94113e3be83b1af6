"""The planner node: `parts` in, `part_forces` out, and a task that is started and stopped.

It listens to `plate_cycle` too: what the plate does carries the parts from image to image. And it
sees to it that a task ends, with the reason, when what it needs is gone: parts, the solver's
answers, the driver, or what another node of the loop says in its `diagnostics` that it misses.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import MultiDOFJointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from plate_core import PlateError, load_rig
from plate_core.ros import (
    DATA,
    LATCHED,
    NEWEST,
    Diagnostics,
    compiling,
    declare,
    follow,
    forces_to_msg,
    msg_to_cycle,
    msg_to_parts,
    msg_to_reports,
    nanoseconds,
    parameter,
    run_node,
    seconds,
    wanted_to_msg,
)
from plate_core.status import INPUT_TIMEOUT_S, Finding, Level, worst
from plate_core.tasks import load_scenario

from .estimation import warm_up
from .planner import NOTHING, Planner, PlannerOptions
from .supervision import Inputs, Phase, Progress
from .tasks import AssembleOptions, FollowOptions, SortOptions

WATCH_PERIOD_S = 0.1
"""Time between looks whether a running task can go on [s]."""

WARN_PERIOD_S = 2.0
"""Least time between two equal warnings [s]."""

SAME_CLOCK_S = 1.0
"""A stamp further than this from our time is of a clock that is not ours [s]."""


@dataclass(frozen=True)
class PlannerParameters:
    """Parameters of the node."""

    rig_file: str = parameter("", "Rig file; empty: the default rig")
    scenario: str = parameter(
        "sort_10", "Name of a scenario of config/scenarios, or path of a .yaml file"
    )
    autostart: bool = parameter(
        False, "Start the task once, as soon as the driver is ready, without the service `start`"
    )
    lockstep: bool = parameter(
        False, "For a simulator in lockstep: an image is planned when plate_cycle has answered the "
        "one before, with autostart the second one when the task runs; so a seed repeats a run",
    )  # fmt: skip
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S,
        "A running task ends when parts, plate_cycle or driver_state fail for longer [s, wall]",
        0.1,
        3600.0,
    )
    default_period: float = parameter(
        PlannerOptions.default_period, "Cycle length until two images tell it [s]", 0.005, 1.0
    )
    start_timeout_s: float = parameter(
        PlannerOptions.start_timeout_s, "Longest wait for all parts after start [s]", 0.0, 3600.0
    )
    unseen_timeout_s: float = parameter(
        PlannerOptions.unseen_timeout_s, "A part unseen for longer is lost [s]", 0.0, 60.0
    )
    stuck_timeout_s: float = parameter(
        PlannerOptions.stuck_timeout_s,
        "A task no nearer to its goal for longer is stuck [s]",
        1.0,
        3600.0,
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
        FollowOptions.kp,
        "Following: fraction of the error corrected a cycle [-]",
        0.0,
        2.0,
        live=True,
    )
    observer_gain: float = parameter(
        FollowOptions.observer_gain,
        "Following: fraction of what a cycle does otherwise than predicted, expected of the next",
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
            start_timeout_s=self.start_timeout_s,
            unseen_timeout_s=self.unseen_timeout_s,
            stuck_timeout_s=self.stuck_timeout_s,
            image_age_s=None if self.image_age_s < 0 else self.image_age_s,
        )


class PlannerNode(Node):
    """Node `planner`: runs a task; says for each image which mean force it wants on each part.

    Subscribes parts, plate_cycle, driver_state, diagnostics.
    Publishes part_forces, task_state, markers, diagnostics.
    Services start and stop: begin and end the task.
    """

    def __init__(self) -> None:
        super().__init__("planner")
        values = declare(self, PlannerParameters)
        self._rig = rig = load_rig(values.rig_file)
        self._planner = Planner(rig, load_scenario(values.scenario), values.options())
        self._state = self._planner.initial()
        self._progress: Progress | None = None
        self._start_timeout_s = max(values.start_timeout_s, values.input_timeout_s)
        self._autostart, self._lockstep = values.autostart, values.lockstep
        self._asked_ns: int | None = None  # stamp of the last part_forces
        self._open = False  # whether plate_cycle has not answered them yet
        self._early: MultiDOFJointState | None = None  # parts that came too early, in lockstep
        self._began = 0.0  # when the task was started, by the steady clock
        self._stopped = False  # by a person, which is no failure
        self._refused = ""
        with compiling(self):
            warm_up(rig)
        self._reported = ""
        follow(self, values, self._retune)

        self._forces = self.create_publisher(MultiDOFJointState, "part_forces", DATA)
        self._markers = self.create_publisher(MarkerArray, "markers", DATA)
        self._task_state = self.create_publisher(String, "task_state", LATCHED)
        self._inputs = Inputs.none_yet(time.monotonic(), values.input_timeout_s)
        self._stamp = self.get_clock().now().to_msg()  # of the last image
        self._diagnostics = Diagnostics(
            self, self._find, self._values, self._planner.scenario.name, self._begin_report,
            lambda: self._stamp,
        )  # fmt: skip
        self.create_subscription(MultiDOFJointState, "parts", self._on_parts, NEWEST)
        self.create_subscription(JointTrajectory, "plate_cycle", self._on_cycle, DATA)
        self.create_subscription(String, "driver_state", self._on_driver, LATCHED)
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, DATA)
        self.create_service(Trigger, "start", self._on_start)
        self.create_service(Trigger, "stop", self._on_stop)
        # Simulated time may stand still, and images may not come: the steady clock goes on.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=steady)

        self._report()
        self.get_logger().info(f"scenario {values.scenario}: {self._planner.scenario.description}")
        for doubt in self._planner.doubts():
            self.get_logger().warning(doubt)

    # Inputs

    def _on_parts(self, msg: MultiDOFJointState) -> None:
        now = self._wake()
        self._stamp = stamp = msg.header.stamp
        self._inputs = self._inputs.heard_parts(now, nanoseconds(stamp))
        self._start_by_itself(now)
        self._early = msg
        self._go_on()

    def _go_on(self) -> None:
        """Plan what came, unless it is too early.

        In lockstep driver and simulator may have heard a cycle, or the driver that it is ready,
        and gone on to the next image before we hear it: that is chance, and must not matter.
        """
        msg = self._early
        if msg is None:
            return
        next_one = self._asked_ns is not None and nanoseconds(msg.header.stamp) > self._asked_ns
        if not (self._lockstep and next_one and (self._open or self._autostart)):
            self._early = None
            self._plan(msg)

    def _plan(self, msg: MultiDOFJointState) -> None:
        """Answer the parts of an image."""
        stamp = msg.header.stamp
        try:
            parts = msg_to_parts(msg)
        except PlateError as error:
            # Still answered, so that the loop goes on; the plate rests meanwhile.
            self._warn(str(error))
            self._ask(wanted_to_msg(NOTHING, stamp))
            return
        sorted_before = -1 if self._progress is None else self._progress.parts_sorted
        self._state, wanted, self._progress = self._planner.plan(self._state, parts, seconds(stamp))
        if self._stood_still():
            wanted = NOTHING  # these parts are long gone from where they were
        self._ask(wanted_to_msg(wanted, stamp))
        if self._markers.get_subscription_count():
            self._markers.publish(forces_to_msg(self._rig, wanted, stamp))
        self._report()
        if self._progress.parts_sorted != sorted_before:
            self._diagnostics.publish()  # in lockstep a task may be over within a report's period

    def _ask(self, msg: MultiDOFJointState) -> None:
        self._asked_ns, self._open = nanoseconds(msg.header.stamp), True
        self._forces.publish(msg)
        self._inputs = self._inputs.asked(time.monotonic())

    def _on_cycle(self, msg: JointTrajectory) -> None:
        self._wake()
        self._inputs = self._inputs.heard_cycle()
        stamp = seconds(msg.header.stamp)
        try:
            cycle = msg_to_cycle(msg)
        except PlateError as error:
            self._warn(str(error))
        else:
            self._state = self._planner.hear(self._state, cycle, self._arrival(stamp))
        if nanoseconds(msg.header.stamp) == self._asked_ns:
            self._open = False
            self._go_on()

    def _arrival(self, stamp: float) -> float:
        """Return when the cycle came that answers an image [s, the time of the stamps]."""
        now = 1e-9 * self.get_clock().now().nanoseconds
        # In lockstep it is never late, whatever our clock has already heard.
        return now if abs(now - stamp) < SAME_CLOCK_S and not self._lockstep else stamp

    def _on_driver(self, msg: String) -> None:
        now = self._wake()
        self._inputs = self._inputs.heard_driver(now, msg.data)
        self._start_by_itself(now)
        self._judge(now)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = self._wake()
        for node, level, message, _ in msg_to_reports(msg):
            self._inputs = self._inputs.heard_node(now, node, level, message)

    # Whether the task can go on

    def _watch(self) -> None:
        now = self._wake()
        self._start_by_itself(now)
        self._judge(now)
        if self._early is not None and self._inputs.answer_overdue(now, self._period):
            self._open = False
            self._go_on()

    def _wake(self) -> float:
        """Return the time, and end the task if this process has stood still."""
        self._stood_still()
        return self._inputs.ran

    def _stood_still(self) -> bool:
        now = time.monotonic()
        why = self._inputs.stood_still(now, self._period)
        self._inputs = self._inputs.woken(now) if why else replace(self._inputs, ran=now)
        if why:
            self._abort(why)
        return bool(why)

    def _judge(self, now: float) -> None:
        """End a running task that cannot go on."""
        task = self._state.task
        if task.phase is not Phase.RUNNING:
            return
        why = self._inputs.problem(now, self._began, self._period, self._publisher_count)
        if (
            not why
            and task.began is None
            and now - self._began > self._start_timeout_s + WATCH_PERIOD_S
        ):
            # Where stamps stand still, the planner's own wait for all parts never ends.
            why = f"not all parts seen within {self._start_timeout_s:g} s of start"
        if why:
            self._abort(why)

    def _abort(self, why: str) -> None:
        if self._state.task.phase is Phase.RUNNING:
            self._state = self._planner.stop(self._state, why)
            self._report()

    @property
    def _period(self) -> float:
        return self._state.estimator.period

    def _publisher_count(self, topic: str) -> int:
        """How many publish a topic, by the name that it has for us."""
        return self.count_publishers(self.resolve_topic_name(topic))

    # Services

    def _start_by_itself(self, now: float) -> None:
        """Start the task, if that was asked for by a parameter; only once."""
        if self._autostart and not self._not_ready(now):
            self._start(now)

    def _not_ready(self, now: float) -> str:
        """Say why no task can be started; empty if one can."""
        return (
            self._inputs.compiling(now)
            or self._inputs.driver_problem(now)
            or self._inputs.parts_problem(now, self._publisher_count)
        )

    def _start(self, now: float) -> None:
        self._autostart, self._stopped, self._began = False, False, now
        self._state = self._planner.start(self._state)
        self._report()
        self._go_on()

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        now, scenario = self._wake(), self._planner.scenario
        response.success = False
        if self._state.task.phase is Phase.RUNNING:
            response.message = f"{scenario.name} is running; call stop first"
            return response
        problem = self._not_ready(now)
        if problem:
            response.message = f"{scenario.name} is not started: {problem}"
            return response
        self._start(now)
        response.success = True
        response.message = "; ".join(
            (
                f"{scenario.name} starts as soon as all {scenario.count} parts are seen",
                *self._planner.doubts(),
            )
        )
        return response

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._wake()
        was = self._state.task.text
        self._autostart, self._stopped = False, True
        self._state = self._planner.stop(self._state)
        self._report()
        self._go_on()
        response.success = True
        response.message = f"{self._planner.scenario.name} stopped, was {was}"
        return response

    def _retune(self, values: PlannerParameters) -> None:
        self._planner = replace(self._planner, options=values.options())

    # What it reports

    def _report(self) -> None:
        """Publish the task's state if it has changed."""
        text = self._state.task.text
        if text == self._reported:
            return
        self._reported = text
        self._task_state.publish(String(data=text))
        line = f"task {self._planner.scenario.name}: {text}"
        # Two lines of code: rclpy refuses two severities from one.
        if self._state.task.phase.is_failure:
            self.get_logger().error(line)
        else:
            self.get_logger().info(line)
        self._diagnostics.publish()

    def _find(self, now: float) -> Finding:
        """Judge the task, and what it needs; see `plate_core.status`."""
        task = self._state.task
        findings = self._inputs.findings(now, self._publisher_count)
        if self._refused:
            findings.append(Finding(Level.WARN, self._refused))
        found = worst(findings, "")
        message = f"{task.text}; {found.message}" if found.message else task.text
        level = found.level
        if task.phase.is_failure:
            failure = Level.WARN if self._stopped else Level.ERROR
            level = max(level, failure, key=lambda each: each.rank)
        return Finding(level, message)

    def _values(self) -> Mapping[str, str]:
        progress = {} if self._progress is None else self._progress.values()
        return {
            **progress,
            "task_state": self._state.task.text,
            "driver_state": self._inputs.driver_state.text,
            "parts_silent_s": f"{self._inputs.parts.silence(time.monotonic()):.2f}",
        }

    def _begin_report(self) -> None:
        self._refused = ""

    def _warn(self, text: str) -> None:
        self._refused = text
        self.get_logger().warning(text, throttle_duration_sec=WARN_PERIOD_S)


def main() -> None:
    """Run the node."""
    run_node(PlannerNode, PlannerParameters)
