"""ROS node of the planner.

The node receives the detected parts, and publishes the mean force that the next cycle should exert
on each part. An action goal starts a task. The node also subscribes to the topics plate_cycle and
cycle_started, which contain the motion of the plate. This motion moves the parts between images,
and the next cycle continues it. `TaskRunner` runs a task. `InputMonitor` ends the task if an input
is missing. `Lockstep` and `RequestSchedule` decide when the next request is computed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import CancelResponse
from rclpy.timer import Timer
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from plate_core import CycleRequest, PlateError, load_rig
from plate_core import Parts as CoreParts
from plate_core.clock_steps import KEPT_S, ClockSteps, read_together
from plate_core.driver_status import DriverState
from plate_core.ros import (
    CALLS,
    DATA,
    LATCHED,
    NEWEST,
    WARN_S,
    NodeOptions,
    SafeLifecycleNode,
    forces_to_msg,
    goal_to_scenario,
    msg_to_cycle,
    msg_to_driver_status,
    msg_to_order,
    msg_to_overlooked,
    msg_to_parts,
    msg_to_reports,
    msg_to_targets,
    nanoseconds,
    parameter,
    request_to_msg,
    run_node,
    seconds,
    to_time,
)
from plate_core.status import INPUT_TIMEOUT_S, age_limit
from plate_interfaces.msg import DriverStatus, FeedOrder, PartForces, Parts, Targets, TaskStatus
from plate_interfaces.srv import MeasureFriction

from .diagnostics import PlannerDiagnostics
from .estimation import check_start, warm_up
from .lockstep import Lockstep
from .planner import NOTHING, Planner, PlannerOptions
from .request_schedule import RequestSchedule
from .ros import GoalServers, TaskReports, run_to_msg
from .supervision import STOP, Failure, InputMonitor, Inputs, Reason, check_positions
from .task_run import Run, TaskRunner
from .tasks import FollowOptions

WATCH_PERIOD_S = 0.1
"""Period at which the inputs of a running task are checked [s]."""

IDLE_S = 1.0
"""Period of the timer for requests while no request is pending [s]."""

SAME_CLOCK_S = 1.0
"""If a stamp differs from the time of this node by more than this value [s], the stamp is assumed
to be from another clock."""

CANCELED = Failure(Reason.CANCELED, "canceled")
PREEMPTED = Failure(Reason.PREEMPTED, "preempted by another goal")


@dataclass(frozen=True)
class PlannerParameters(NodeOptions):
    """Parameters of the node."""

    preempt: bool = parameter(
        False, "Whether a goal that arrives while a task runs cancels this task. If false, it is "
        "refused.",
        live=True,
    )  # fmt: skip
    camera_triggered: bool = parameter(
        True, "Whether images are taken at the starts of cycles. If false, images are taken at "
        "any time, and cycle_started reports the starts of the cycles.",
    )  # fmt: skip
    answer_s: float = parameter(
        PlannerOptions.answer_s, "Time from a request to the start of the next cycle if the "
        "camera is not triggered [s]. The solver, the driver and the line need this time. Set 0.14 "
        "for a serial line.", 0.01, 1.0,
    )  # fmt: skip
    lockstep: bool = parameter(
        False, "Whether the simulator runs in lockstep. If true, the planner waits for the "
        "plate_cycle of the last image and for the cycle_started of this cycle. At the second "
        "image, it also waits for a goal. Then runs with the same seed are equal.",
    )  # fmt: skip
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S,
        "Maximum time without parts, plate_cycle or driver_status during a task [s, wall]",
        0.1,
        3600.0,
    )
    start_timeout_s: float = parameter(
        PlannerOptions.start_timeout_s,
        "Maximum time until all parts are detected after a goal [s]",
        0.0,
        3600.0,
    )
    unseen_timeout_s: float = parameter(
        PlannerOptions.unseen_timeout_s,
        "Time without a detection after which a part counts as lost [s]",
        0.0,
        60.0,
    )
    stuck_timeout_s: float = parameter(
        PlannerOptions.stuck_timeout_s,
        "Time without progress after which a task counts as stuck [s]",
        1.0,
        3600.0,
    )
    image_age_s: float = parameter(
        -1.0,
        "Age of an image at the time of its stamp [s]. If it is negative, the age is estimated.",
        -1.0,
        0.5,
    )
    kp: float = parameter(
        FollowOptions.kp,
        "Fraction of the tracking error on paths that is corrected per cycle [-]",
        *FollowOptions.RANGES["kp"],
        live=True,
    )

    def planner(self) -> PlannerOptions:
        """Convert the node's parameters to options of `Planner`."""
        return PlannerOptions(
            follow=FollowOptions(kp=self.kp),
            answer_s=self.answer_s,
            start_timeout_s=self.start_timeout_s,
            unseen_timeout_s=self.unseen_timeout_s,
            stuck_timeout_s=self.stuck_timeout_s,
            image_age_s=None if self.image_age_s < 0 else self.image_age_s,
        )


class PlannerNode(SafeLifecycleNode[PlannerParameters]):
    """Node `planner`. The node runs tasks. For each cycle, it requests a mean force on each part
    from the solver.

    Actions: sort_parts, follow_paths, assemble_parts, pose_parts, move_parts, feed_parts. The
    service `stop` ends the running task. The node subscribes to parts, plate_cycle, cycle_started,
    driver_status, diagnostics, targets (for move_parts) and feed_orders (for feed_parts). If images
    are taken at cycle starts, the node sends one request per image. Otherwise, it sends one request
    per cycle, shortly before the cycle ends.

    The next cycle continues the motion of the plate only under three conditions. First, the motion
    of the plate is certain. Second, images are taken at cycle starts, or `answer_s` is below 0.1 s.
    Third, there are at most 40 parts. Otherwise, the next cycle starts with the plate at rest. The
    motion is certain if cycle_started has reported the running or the previous cycle, and the
    solver's last results were not delayed.

    The node publishes part_forces, task_status, part_targets, feed_status, markers and diagnostics.
    """

    def __init__(self) -> None:
        super().__init__("planner", PlannerParameters)
        self._stamp = self.get_clock().now().to_msg()  # stamp of the last image
        self._clock_steps = ClockSteps()
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._diagnostics = self.report(
            lambda now: self._health.finding(now),
            lambda: self._health.values(time.monotonic()),
            reported=lambda: self._health.reported(),
            stamp=lambda: self._stamp,
        )

    # Transitions

    def configure(self) -> None:
        """Read the rig file. Create publishers, subscriptions, services, actions and timers."""
        options = self.options
        self._rig = load_rig(options.rig_file)
        warm_up(self._rig)
        self._forces = self.managed_publisher(PartForces, "part_forces", DATA)
        self._markers = self.managed_publisher(MarkerArray, "markers", DATA)
        self._reports = TaskReports(self)
        # If several messages wait, the executor processes the subscriptions in the order of their
        # creation. The subscription of images is the last, because a request must consider all
        # cycles that were sent or began before its image.
        self.managed_subscription(JointTrajectory, "plate_cycle", self._on_cycle, DATA)
        self.managed_subscription(JointTrajectory, "cycle_started", self._on_started, DATA)
        # If the camera is triggered, the planner uses only the newest image. Otherwise the
        # estimator uses all images.
        newest = NEWEST if options.camera_triggered else DATA
        self.managed_subscription(Parts, "parts", self._on_parts, newest)
        # The node subscribes to part_forces, although it publishes this topic itself:
        # `second_publisher` detects a second planner by its messages.
        self.managed_subscription(PartForces, "part_forces", lambda msg: None, DATA)
        self._alarm: Timer | None = None
        if not options.camera_triggered:
            self._alarm = self.managed_timer(IDLE_S, self._on_request_due, self.get_clock())
        self.managed_subscription(DriverStatus, "driver_status", self._on_driver, LATCHED)
        self.managed_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, DATA)
        self.managed_subscription(Targets, "targets", self._on_targets, DATA)
        self.managed_subscription(
            FeedOrder, "feed_orders", self._on_order, DATA, one_publisher=True
        )
        self.managed_service(Trigger, "stop", self._on_stop)
        self._friction = self.create_client(MeasureFriction, "measure_friction", qos_profile=CALLS)
        self.keep(self.destroy_client, self._friction)
        self.managed_timer(WATCH_PERIOD_S, self._on_watch_timer)
        self._goals = GoalServers(self, self._on_goal, self._on_cancel)
        self.keep(GoalServers.destroy, self._goals)

    def begin(self) -> None:
        """Create new objects for the task and the inputs, so that no state of an earlier activation
        remains."""
        options, now = self.options, time.monotonic()
        core = options.planner()
        self._tasks = TaskRunner(self._rig, core)
        self._lockstep: Lockstep[Parts, JointTrajectory] = Lockstep(options.lockstep)
        self._schedule = RequestSchedule(core.answer_s, core.default_period)
        self._monitor = InputMonitor(
            Inputs.none_yet(now, options.input_timeout_s, options.camera_triggered),
            max(options.start_timeout_s, options.input_timeout_s),
            now,
            lambda topic: self.count_publishers(self.resolve_topic_name(topic)),
            self.second_publisher,
            self.second_clock,
        )
        self._health = PlannerDiagnostics(self._tasks, self._monitor, options.camera_triggered)
        self._reports.begin()
        self._publish_status()
        self._reports.publish_targets(self._tasks, self._stamp)

    def rest(self) -> None:
        """End the task."""
        self._end_task(Failure(Reason.STOPPED, "the planner was deactivated"))
        self._reports.await_delivery()

    def retune(self) -> None:
        """Apply the new value of the parameter `kp`."""
        if self.active:
            self._tasks.set_options(self.options.planner())

    # Images

    def _on_parts(self, msg: Parts) -> None:
        now = self._record_activity()
        self._stamp = msg.header.stamp
        stamp_ns = nanoseconds(self._stamp)
        self._monitor.inputs = self._monitor.inputs.parts_received(now, stamp_ns)
        if self.options.camera_triggered:
            self._lockstep.add_image(msg, stamp_ns, now)
            self._plan_waiting_image()
        else:
            self._track_free_running_image(msg)

    def _plan_waiting_image(self) -> None:
        """Process the waiting image and publish a request, unless the image must still wait in
        `Lockstep`."""
        following = self._lockstep.next_image()
        if following is not None:
            msg, starts = following
            for start in starts:
                self._record_start(start)
            self._plan_triggered_image(msg)

    def _plan_triggered_image(self, msg: Parts) -> None:
        """Process an image that was taken at the start of a cycle, and publish the request for the
        next cycle."""
        stamp, run = msg.header.stamp, self._tasks.run
        parts = self._record_image(msg)
        # the image is invalid: request a cycle at rest, so that the control loop continues
        if parts is None:
            self._publish_request(NOTHING, stamp)
            return
        # In lockstep, the same image may arrive twice: before and after a goal. For an image before
        # the goal, the driver accepts only a cycle at rest. Therefore the task begins with the next
        # image.
        answers_again = self._lockstep.enabled and (
            self._tasks.seen_without_task(seconds(stamp))
            or self._lockstep.precedes_goal(nanoseconds(stamp))
        )
        if run is not None and not answers_again:
            self._publish_task_request(
                run, stamp, lambda run: self._tasks.plan(run, parts, seconds(stamp))
            )
            return
        if not answers_again:
            self._tasks.see(parts, seconds(stamp))
        self._publish_request(NOTHING, stamp)

    def _track_free_running_image(self, msg: Parts) -> None:
        """Process an image of a free-running camera. The request is published later."""
        parts = self._record_image(msg)
        if parts is None:
            return
        self._tasks.see(parts, seconds(msg.header.stamp))
        idle = self._tasks.run is None
        if idle and self._monitor.inputs.starts_problem(time.monotonic()):
            # Without reports of cycle starts, `_on_request_due` publishes no request. A request for
            # rest keeps the control loop running.
            self._publish_request(NOTHING, msg.header.stamp)

    def _record_image(self, msg: Parts) -> CoreParts | None:
        """Record an image, including objects that are not parts. Return its parts, or None if the
        image is invalid."""
        try:
            parts = msg_to_parts(msg)
            check_positions(parts, self._rig)
        except PlateError as error:
            inputs = self._monitor.inputs.parts_refused(self._monitor.inputs.ran, str(error))
            self._monitor.inputs = inputs
            self._warn(str(error))
            return None
        self._monitor.inputs = self._monitor.inputs.parts_accepted()
        self._reports.record_image(msg)
        if text := self._tasks.record_image(msg_to_overlooked(msg), parts):
            self.get_logger().warning(text)
        return parts

    # Cycles

    def _on_started(self, msg: JointTrajectory) -> None:
        """Receive the report that the plate has begun a cycle. In lockstep, the report is stored
        until the image of this cycle is processed."""
        self._record_activity()
        if self.options.lockstep and self.options.camera_triggered:
            self._lockstep.add_start(msg, nanoseconds(msg.header.stamp))
            self._plan_waiting_image()
        else:
            self._record_start(msg)

    def _record_start(self, msg: JointTrajectory) -> None:
        """Record the cycle that the plate has begun. If the camera is free-running, also set the
        timer for the next request."""
        begin = seconds(msg.header.stamp)
        try:
            cycle = msg_to_cycle(msg)
            check_start(cycle, begin, self._tasks.estimator.clock.stamp)
        except PlateError as error:
            self._monitor.inputs = self._monitor.inputs.start_refused(str(error))
            self._warn(str(error))
            return
        if not self._schedule.record_start(cycle, begin):
            return
        self._monitor.inputs = self._monitor.inputs.start_received(self._monitor.inputs.ran)
        self._tasks.record_start(cycle, begin, self.options.camera_triggered)
        if self._alarm is not None:
            self._began = msg.header.stamp
            wait_s = self._schedule.wait_s(self._arrival_time(begin))
            self._alarm.timer_period_ns = max(1, round(1e9 * wait_s))
            self._alarm.reset()

    def _on_request_due(self) -> None:
        """Publish the pending request for the cycle after the running cycle. Do nothing if no
        request is pending."""
        assert self._alarm is not None
        self._alarm.timer_period_ns = round(1e9 * IDLE_S)
        if not self._schedule.take_due():
            return
        self._record_activity()
        if self._tasks.run is None:
            self._publish_request(NOTHING, self._began)
        else:
            self._publish_task_request(self._tasks.run, self._began, self._tasks.next_request)

    def _on_cycle(self, msg: JointTrajectory) -> None:
        self._record_activity()
        self._monitor.inputs = self._monitor.inputs.cycle_received()
        try:
            cycle = msg_to_cycle(msg)
        except PlateError as error:
            self._warn(str(error))
        else:
            requested = seconds(msg.header.stamp)
            self._tasks.record_cycle(cycle, self._arrival_time(requested), requested)
        if self._lockstep.cycle_received(nanoseconds(msg.header.stamp)):
            self._plan_waiting_image()

    def _arrival_time(self, stamp: float) -> float:
        """Return the arrival time of a message that has just arrived [s, in the time of the image
        stamps].

        In lockstep, or if the message's stamp `stamp` is from another clock, the result is the
        stamp.
        """
        now = 1e-9 * self.get_clock().now().nanoseconds
        # In lockstep, simulated time stops until the planner has replied to the message. Therefore
        # the message cannot be late, even if a new clock time arrives before the message.
        same = abs(now - stamp) < SAME_CLOCK_S and not self.options.lockstep
        return now if same else stamp

    # Requests

    def _publish_task_request(
        self, run: Run, stamp: Time, compute: Callable[[Run], CycleRequest]
    ) -> None:
        """Compute and publish the request of the running task for the next cycle. Then report the
        progress of the task."""
        sorted_before = -1 if run.progress is None else run.progress.parts_sorted
        request = compute(run)
        stalled = self._check_stall()  # also updates the record of clock steps
        # The cycle may have begun without a new image. Therefore check whether the last image is
        # too old.
        seen_ns = nanoseconds(self._stamp)
        earliest_ns = self._clock_steps.earliest_ns(seen_ns)
        old = 1e-9 * (nanoseconds(stamp) - earliest_ns) > age_limit(self._tasks.estimator.period)
        if old and earliest_ns < seen_ns:
            self._report_clock_step(1e-9 * (seen_ns - earliest_ns))
        if stalled or self._monitor.second_publishers() or old:
            request = NOTHING  # request no motion, because the positions may be wrong or outdated
        self._publish_request(request, stamp, to_time(round(1e9 * run.state.estimator.next_start)))
        self._reports.publish_feed(run, bool(request.parts.ids), self._stamp)
        if self._markers.get_subscription_count():
            self._markers.publish(forces_to_msg(self._rig, request, stamp))
        self._report_progress()
        assert run.progress is not None
        if run.progress.parts_sorted != sorted_before:
            # In lockstep, the task may end before the next periodic diagnostics, so publish the
            # progress now.
            self._diagnostics.publish()

    def _report_clock_step(self, set_back_s: float) -> None:
        """Warn that the plate rests because the clock was set back by `set_back_s` [s]. If the rest
        is longer than the input timeout, end the task."""
        rest_s = min(set_back_s, KEPT_S)
        text = f"the computer's clock was set back, so the plate rests for about {rest_s:.1f} s"
        self._warn(text)
        if rest_s > self.options.input_timeout_s:
            self._end_task(Failure(Reason.NO_PARTS, f"{text}; then start the task again"))

    def _publish_request(
        self, request: CycleRequest, stamp: Time, start: Time | None = None
    ) -> None:
        msg = request_to_msg(request, stamp, start)
        self._lockstep.request_sent(nanoseconds(stamp))
        self._forces.publish(msg)
        self._monitor.inputs = self._monitor.inputs.request_sent(time.monotonic())

    # Supervision

    def _on_driver(self, msg: DriverStatus) -> None:
        now = self._record_activity()
        try:
            status = msg_to_driver_status(msg)
            self._monitor.inputs = self._monitor.inputs.driver_received(now, status)
        except PlateError as error:
            self._warn(str(error))
        self._check_task(now)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = self._record_activity()
        for report in msg_to_reports(msg, self.get_namespace()):
            if report.own:
                self._monitor.inputs = self._monitor.inputs.report_received(
                    now, report.node, report.level, report.message
                )

    def _on_watch_timer(self) -> None:
        now = self._record_activity()
        self._check_task(now)
        run = self._tasks.running
        # the feedback shows clients that the planner runs, even if no images arrive
        if run is not None:
            self._goals.feed_back(run.goal, run_to_msg(run, self._last_request_stamp()).progress)
        if self._lockstep.image_waits:
            inputs, period = self._monitor.inputs, self._tasks.estimator.period
            overdue = inputs.answer_overdue(now, period)
            self._lockstep.stop_waiting(now, inputs.timeout(period), overdue)
            self._plan_waiting_image()

    def _record_activity(self) -> float:
        """Record that the planner is running, and return the time [s, steady clock]. If the
        planner's process had stalled before, end the task. Each callback must call this method
        first."""
        self._check_stall()
        return self._monitor.inputs.ran

    def _check_stall(self) -> bool:
        now = time.monotonic()
        if not self._simulated:  # simulated time has no relation to the steady clock
            now, clock_ns = read_together(
                time.monotonic, lambda: self.get_clock().now().nanoseconds
            )
            self._clock_steps = self._clock_steps.with_reading(now, clock_ns)
        failure = self._monitor.wake(now, self._tasks.estimator.period)
        if failure is not None:
            self._end_task(failure)
        return failure is not None

    def _check_task(self, now: float) -> None:
        """End the running task if it cannot continue."""
        run = self._tasks.running
        if run is not None:
            period = self._tasks.estimator.period
            failure = self._monitor.task_problem(now, run.began, run.task, period)
            if failure is not None:
                self._end_task(failure)

    def _end_task(self, why: Failure) -> None:
        """End the running task with the reason `why`. Do nothing if no task runs."""
        if self._tasks.end(why):
            self._report_progress()

    # Goals

    def _on_goal(self, goal: Any) -> None:
        """Begin the task of an action goal. If the task cannot begin, the goal is accepted and
        aborted at once, because ROS has no field for the reason of a rejection."""
        failure = self._begin_task(goal, self._record_activity() if self.active else 0.0)
        if failure is not None:
            self.get_logger().warning(f"goal refused: {failure.text}")
            status = TaskStatus(
                state=TaskStatus.ABORTED, reason=int(failure.reason), text=failure.text
            )
            status.header = Header(stamp=self._stamp)
            self._goals.finish(goal, status)

    def _begin_task(self, goal: Any, now: float) -> Failure | None:
        """Begin the task of an action goal. Return None, or the reason why the task cannot
        begin."""
        if not self.active:
            return Failure(Reason.NOT_READY, "the planner is not active")
        if self._monitor.goal_may_be_old(time.monotonic()):
            return Failure(Reason.NOT_READY, "the planner was stalled: send the goal again")
        try:
            scenario = goal_to_scenario(goal.request)
            planner = Planner(self._rig, scenario, self.options.planner())
        except PlateError as error:
            return Failure(Reason.INVALID_GOAL, str(error))
        running = self._tasks.running
        if running is not None and not self.options.preempt:
            text = (
                f"the task {running.name} is running: cancel it first, or set the parameter preempt"
            )
            return Failure(Reason.BUSY, text)
        if problem := self._monitor.start_problem(now):
            return Failure(Reason.NOT_READY, f"the task {scenario.name} was not started: {problem}")
        self._end_task(PREEMPTED)
        for warning in planner.warnings():
            self.get_logger().warning(warning)
        self._tasks.begin(planner, goal, now)
        self._lockstep.goal_accepted()
        self._report_progress()
        self._plan_waiting_image()
        return None

    def _on_cancel(self, goal: Any) -> CancelResponse:
        """End the task of an action goal that a client cancels. Reject the cancellation if the task
        is not running."""
        run = self._tasks.run if self.active else None
        if run is None or run.goal is not goal or run.finished:
            return CancelResponse.REJECT
        self._record_activity()
        self._end_task(CANCELED)
        return CancelResponse.ACCEPT

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._record_activity()
        before = "" if self._tasks.run is None else self._tasks.run.task.text
        response.message = f"stopped; state before: {before}"
        if self._tasks.running is not None:
            self._end_task(STOP)
        else:  # if no task runs, acknowledge the end of the last task
            self._tasks.forget()
            self._reports.forget_text()
            self._publish_status(Reason.STOPPED)
            response.message = "no task runs"
            if before:
                response.message += f"; the last task: {before}"
        # A stop must also end a friction measurement, which the driver runs.
        if self._friction.service_is_ready():
            self._friction.call_async(MeasureFriction.Request(start=False))
        driver = self._monitor.inputs.driver_status
        if driver is not None and driver.state is DriverState.CALIBRATING:
            response.message += "; a friction measurement is canceled, a calibration continues"
        self._plan_waiting_image()
        response.success = True
        return response

    def _on_targets(self, msg: Targets) -> None:
        """Replace targets of parts in the running move task. Invalid targets are refused."""
        self._record_activity()
        try:
            refused = self._tasks.retarget(msg_to_targets(msg))
        except PlateError as error:
            self._warn(f"targets: {error}")
            return
        if refused:
            self._warn(f"targets: {'; '.join(refused)}")
        self._reports.publish_targets(self._tasks, self._stamp)

    def _on_order(self, msg: FeedOrder) -> None:
        """Pass an order of the feeder (mode and picks) to the running feed task."""
        self._monitor.inputs = self._monitor.inputs.order_received(self._record_activity())
        try:
            self._tasks.order(msg_to_order(msg))
        except PlateError as error:
            self._warn(str(error))

    # Reports

    def _report_progress(self) -> None:
        """Publish the progress or the end of the task, and log it."""
        run = self._tasks.run
        if run is None:
            return
        status = self._publish_status()
        self._reports.publish_targets(self._tasks, self._stamp)
        if self._reports.is_new(run.task.text):
            line = f"task {run.name}: {run.task.text}"
            # rclpy permits only one severity per call in the code, so there are two calls
            if run.failed:
                self.get_logger().error(line)
            else:
                self.get_logger().info(line)
            self._diagnostics.publish()
        if run.running:
            self._goals.feed_back(run.goal, status.progress)
        elif not run.finished:
            run.finished = True
            self._goals.finish(run.goal, status)

    def _publish_status(self, reason: Reason = Reason.NONE) -> TaskStatus:
        return self._reports.publish_status(self._tasks.run, self._last_request_stamp(), reason)

    def _last_request_stamp(self) -> Time:
        """Return the stamp of the last published request. If no request was published, return the
        stamp of the last image."""
        request_ns = self._lockstep.request_ns
        return self._stamp if request_ns is None else to_time(request_ns)

    def _warn(self, text: str) -> None:
        self._health.refusal = text
        self.get_logger().warning(text, throttle_duration_sec=WARN_S)


def main() -> None:
    """Run the node."""
    run_node(PlannerNode, PlannerParameters)
