"""The planner node: `parts` in, `part_forces` out, and tasks: goals of five actions.

It listens to `plate_cycle` and `cycle_started` too: what the plate does carries the parts from
image to image, and the next cycle goes on from it. And it sees to it that a task ends, with the
reason, when what it needs is gone: parts, the solver's answers, the driver, or what another node of
the loop says in its `diagnostics` that it misses.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionServer, CancelResponse
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from plate_core import Parts as CoreParts
from plate_core import PlateCycle, PlateError, Wanted, load_rig
from plate_core.driver_status import DriverState
from plate_core.ros import (
    ACTIONS,
    CALLS,
    DATA,
    LATCHED,
    NEWEST,
    RESULT_S,
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
    run_node,
    seconds,
    targets_to_msg,
    to_time,
    wanted_to_msg,
)
from plate_core.standstill import Standstill
from plate_core.status import INPUT_TIMEOUT_S, Finding, Level, age_limit, worst
from plate_core.tasks import FeedTask, MoveTask, PartTarget
from plate_interfaces.msg import (
    DriverStatus,
    FeedOrder,
    FeedStatus,
    Part,
    PartForces,
    Parts,
    Targets,
    TaskStatus,
)
from plate_interfaces.srv import MeasureFriction

from .estimation import SNAP, Estimator, check_start, warm_up
from .planner import NOTHING, Planner, PlannerOptions, PlannerState
from .ros import STATES, feed_to_msg, progress_to_msg
from .supervision import STOP, Failure, Inputs, Overlooked, Phase, Progress, Reason
from .tasks import FollowOptions

WATCH_PERIOD_S = 0.1
"""Time between looks whether a running task can go on [s]."""

IDLE_S = 1.0
"""Period of the alarm while no answer is due [s]."""

SAME_CLOCK_S = 1.0
"""A stamp further than this from our time is of a clock that is not ours [s]."""

STARTS_KEPT = 64
"""Starts of cycles that are kept until there is an image, in lockstep."""

STILL_S = 1.0
"""A planner that stood still for longer [s] begins no goal that was sent meanwhile."""

SINGLE = ("parts", "part_forces", "plate_cycle", "driver_status", "cycle_started", "feed_orders")
"""Topics that only one node may publish."""

BY_PERSON = (Reason.STOPPED, Reason.CANCELED, Reason.PREEMPTED)
"""Ends that are no failures: somebody asked for them."""

CANCELED = Failure(Reason.CANCELED, "canceled")
PREEMPTED = Failure(Reason.PREEMPTED, "preempted by another goal")


@dataclass(frozen=True)
class PlannerParameters(NodeOptions):
    """Parameters of the node."""

    preempt: bool = parameter(
        False, "A goal that comes while a task runs: true ends that task, false is refused.",
        live=True,
    )  # fmt: skip
    camera_triggered: bool = parameter(
        True, "Whether images are taken at the starts of cycles; false: at any time, and "
        "cycle_started says when cycles begin.",
    )  # fmt: skip
    answer_s: float = parameter(
        PlannerOptions.answer_s, "Unless the camera is triggered: time from an answer to the next "
        "cycle [s], for solver, driver and line; a serial line needs 0.14", 0.01, 1.0,
    )  # fmt: skip
    lockstep: bool = parameter(
        False, "For a simulator in lockstep: an image is planned when plate_cycle has answered the "
        "one before and cycle_started has told of its cycle, the second one when there is a goal; "
        "so a seed repeats a run",
    )  # fmt: skip
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S,
        "A running task ends when parts, plate_cycle or driver_status fail for longer [s, wall]",
        0.1,
        3600.0,
    )
    start_timeout_s: float = parameter(
        PlannerOptions.start_timeout_s, "Longest wait for all parts after a goal [s]", 0.0, 3600.0
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
    kp: float = parameter(
        FollowOptions.kp,
        "Following: fraction of the error corrected a cycle [-]",
        *FollowOptions.RANGES["kp"],
        live=True,
    )

    def planner(self) -> PlannerOptions:
        """Return the core's options."""
        return PlannerOptions(
            follow=FollowOptions(kp=self.kp),
            answer_s=self.answer_s,
            start_timeout_s=self.start_timeout_s,
            unseen_timeout_s=self.unseen_timeout_s,
            stuck_timeout_s=self.stuck_timeout_s,
            image_age_s=None if self.image_age_s < 0 else self.image_age_s,
        )


@dataclass
class Run:
    """The task that runs, or ran last: the goal, how it gets on, and who waits for its end."""

    planner: Planner
    state: PlannerState
    began: float  # when the goal came [s, steady clock]
    goal: Any  # its handle
    finished: bool = False  # whether it has its result
    progress: Progress | None = None

    @property
    def name(self) -> str:
        """Kind of the task."""
        return self.planner.scenario.name


class PlannerNode(SafeLifecycleNode[PlannerParameters]):
    """Node `planner`: does tasks; says for each image which mean force it wants on each part.

    Actions sort_parts, follow_paths, assemble_parts, pose_parts, move_parts, feed_parts. Service
    stop ends the task.
    Subscribes parts, plate_cycle, cycle_started, driver_status, diagnostics, targets (of a running
    move_parts), feed_orders (of a running feed_parts). Where images are taken at the starts of
    cycles each image is answered, else each cycle a while before its end. As long as cycle_started
    tells what the plate does, the next cycle is asked to go on from there, else from rest.
    Publishes part_forces, task_status, part_targets, feed_status, markers, diagnostics.
    """

    def __init__(self) -> None:
        super().__init__("planner", PlannerParameters)
        self._run: Run | None = None
        self._ends: dict[bytes, TaskStatus] = {}  # results on their way, by goal
        self._stamp = self.get_clock().now().to_msg()  # of the last image
        self._diagnostics = self.report(
            self._find, self._values, reported=self._begin_report, stamp=lambda: self._stamp
        )

    def configure(self) -> None:
        """Read the rig, and offer the actions."""
        options = self.options
        self._rig = load_rig(options.rig_file)
        warm_up(self._rig)
        self._forces = self.managed_publisher(PartForces, "part_forces", DATA)
        self._markers = self.managed_publisher(MarkerArray, "markers", DATA)
        self._statuses = self.managed_publisher(TaskStatus, "task_status", LATCHED)
        self._targets = self.managed_publisher(Targets, "part_targets", LATCHED)
        self._feed = self.managed_publisher(FeedStatus, "feed_status", DATA)
        # Of a triggered camera the newest image is answered; of others each one tells something.
        newest = NEWEST if options.camera_triggered else DATA
        self.managed_subscription(Parts, "parts", self._on_parts, newest)
        self.managed_subscription(JointTrajectory, "plate_cycle", self._on_cycle, DATA)
        # Its own: `rivals` sees by them that a second planner asks, too.
        self.managed_subscription(PartForces, "part_forces", lambda msg: None, DATA)
        self.managed_subscription(JointTrajectory, "cycle_started", self._on_started, DATA)
        if not options.camera_triggered:
            self._alarm = self.managed_timer(IDLE_S, self._on_due, self.get_clock())
        self.managed_subscription(DriverStatus, "driver_status", self._on_driver, LATCHED)
        self.managed_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, DATA)
        self.managed_subscription(Targets, "targets", self._on_targets, DATA)
        self.managed_subscription(FeedOrder, "feed_orders", self._on_order, DATA, in_turn=True)
        self.managed_service(Trigger, "stop", self._on_stop)
        self._friction = self.create_client(MeasureFriction, "measure_friction", qos_profile=CALLS)
        self.keep(self.destroy_client, self._friction)
        self.managed_timer(WATCH_PERIOD_S, self._watch)
        for name, action in ACTIONS.items():
            server = ActionServer(
                self, action, name, self._result, handle_accepted_callback=self._on_goal,
                cancel_callback=self._on_cancel, result_timeout=RESULT_S,
            )  # fmt: skip
            self.keep(ActionServer.destroy, server)

    def begin(self) -> None:
        """Know nothing of what was before."""
        options = self.options
        self._standstill = Standstill(STILL_S, time.monotonic())
        core = options.planner()
        self._idle = Estimator.of(self._rig, core.default_period, core.image_age_s)
        self._run = None
        self._start_timeout_s = max(options.start_timeout_s, options.input_timeout_s)
        self._answer_s = core.answer_s
        self._asked_ns: int | None = None  # stamp of the last part_forces
        self._open = False  # whether plate_cycle has not answered them yet
        self._asked = False  # whether a goal has come
        self._before_ns: int | None = None  # stamp of the last part_forces before the task
        self._early: Parts | None = None  # parts that came too early, in lockstep
        self._early_at = 0.0  # when they came [s, steady clock]
        self._told: deque[JointTrajectory] = deque(maxlen=STARTS_KEPT)  # in lockstep: not used yet
        self._told_ns = -1  # stamp of the last of them
        self._waits = True  # in lockstep: whether an image waits for them
        self._refused = self._reported = ""
        self._inputs = Inputs.none_yet(
            time.monotonic(), options.input_timeout_s, options.camera_triggered
        )
        self._start = -np.inf, PlateCycle.rest(core.default_period)  # of the last cycle
        self._due = False  # whether an answer is due at the alarm
        self._in_force: tuple[PartTarget, ...] | None = None  # targets as published
        self._shown: dict[str, Part] = {}  # parts of the last image, by id
        self._overlooked = Overlooked(self._rig)
        self._others_told = False  # whether the running task has reported what else is there
        self._publish_status()
        self._publish_targets()

    def rest(self) -> None:
        """End the task: nothing is asked any more."""
        self._end(Failure(Reason.STOPPED, "the planner was deactivated"))

    def retune(self) -> None:
        """Take over gains."""
        if self._run is not None:
            self._run.planner = replace(self._run.planner, options=self.options.planner())

    # Inputs

    def _on_parts(self, msg: Parts) -> None:
        now = self._wake()
        self._stamp = stamp = msg.header.stamp
        self._inputs = self._inputs.heard_parts(now, nanoseconds(stamp))
        if self.options.camera_triggered:
            if self._early is None or self._early.header.stamp != stamp:
                self._early_at = now
            self._early = msg
            self._go_on()
        else:
            self._see(msg)

    def _go_on(self) -> None:
        """Plan what came, unless it is too early.

        In lockstep driver and simulator may have heard a cycle, and gone on to the next image,
        before we hear it, or a goal, or that this cycle has begun: that is chance, and must not
        matter.
        """
        msg = self._early
        if msg is None:
            return
        if self.options.lockstep:
            stamp_ns = nanoseconds(msg.header.stamp)
            next_one = self._asked_ns is not None and stamp_ns > self._asked_ns
            if (next_one and (self._open or not self._asked)) or self._unreported(stamp_ns):
                return
            while self._told:
                self._begun(self._told.popleft())
        self._early = None
        self._plan(msg)

    def _unreported(self, stamp_ns: int) -> bool:
        """Whether the start of the cycle is still to be waited for at which an image was taken."""
        self._waits = self._waits or self._told_ns == stamp_ns
        return self._waits and self._told_ns != stamp_ns

    def _see(self, msg: Parts) -> None:
        """Take in the parts of an image that a camera took at any time."""
        run, stamp = self._run, seconds(msg.header.stamp)
        try:
            parts = msg_to_parts(msg)
        except PlateError as error:
            self._warn(str(error))
            return
        self._note(msg, parts)
        if run is None:
            self._idle = self._idle.update(parts, stamp)
            if self._inputs.starts_problem(time.monotonic()):  # the loop goes on without the motors
                self._ask(wanted_to_msg(NOTHING, msg.header.stamp))
        else:
            run.state = run.planner.see(run.state, parts, stamp)

    def _on_started(self, msg: JointTrajectory) -> None:
        """Take in that the plate has begun a cycle; in lockstep when its image is planned."""
        self._wake()
        if self.options.lockstep and self.options.camera_triggered:
            self._told.append(msg)
            self._told_ns = nanoseconds(msg.header.stamp)
            self._go_on()
        else:
            self._begun(msg)

    def _begun(self, msg: JointTrajectory) -> None:
        """Note what the plate does; unless images see to it, have the next cycle answered."""
        begin, run, triggered = seconds(msg.header.stamp), self._run, self.options.camera_triggered
        try:
            cycle = msg_to_cycle(msg)
            check_start(cycle, begin, self._estimator.clock.stamp)
        except PlateError as error:
            self._warn(str(error))
            return
        last, was = self._start
        same = 0 <= begin - last < SNAP * cycle.period
        if same and np.array_equal(cycle.knot_pose, was.knot_pose):
            return  # told once more: it must not put off the answer
        self._start = begin, cycle
        self._inputs = self._inputs.heard_start(self._inputs.ran)
        if run is None:
            self._idle = self._idle.started(cycle, begin, triggered)
        else:
            run.state = run.planner.started(run.state, cycle, begin, triggered)
        if triggered:
            return
        self._began = msg.header.stamp
        wait = max(cycle.period - self._answer_s, 0.0) - max(self._arrival(begin) - begin, 0.0)
        self._alarm.timer_period_ns = max(1, round(1e9 * wait))
        self._alarm.reset()
        self._due = True

    def _on_due(self) -> None:
        """Answer the cycle that runs."""
        self._alarm.timer_period_ns = round(1e9 * IDLE_S)
        due, self._due = self._due, False
        if not due:
            return
        self._wake()
        if self._run is None:
            self._ask(wanted_to_msg(NOTHING, self._began))
        else:
            self._answer(self._run, self._began, lambda run: run.planner.answer(run.state))

    def _plan(self, msg: Parts) -> None:
        """Answer the parts of an image."""
        stamp, run = msg.header.stamp, self._run
        try:
            parts = msg_to_parts(msg)
        except PlateError as error:
            # Still answered, so that the loop goes on; the plate rests meanwhile.
            self._warn(str(error))
            self._ask(wanted_to_msg(NOTHING, stamp))
            return
        self._note(msg, parts)
        # In lockstep an image may come again, also after a goal: the task begins with the next one,
        # because the driver lets nothing but rest answer an image of the task before.
        before = seconds(stamp) == self._idle.stamp or nanoseconds(stamp) == self._before_ns
        again = self.options.lockstep and before
        if run is None or again:
            if not again:
                self._idle = self._idle.update(parts, seconds(stamp))
            self._ask(wanted_to_msg(NOTHING, stamp))
            return
        self._answer(run, stamp, lambda run: run.planner.plan(run.state, parts, seconds(stamp)))

    def _note(self, msg: Parts, parts: CoreParts) -> None:
        """Note the parts and the other things of an image; a task that begins reports these."""
        self._shown = {part.id: part for part in msg.parts}
        self._overlooked.add(msg_to_overlooked(msg), parts)
        text = self._others()
        if text and not self._others_told:
            self._others_told = True
            self.get_logger().warning(text)

    def _others(self) -> str:
        """Say what else is on the plate while a task runs; empty if nothing is."""
        run = self._run
        if run is None or not run.state.task.active:
            return ""
        count, parts = run.planner.scenario.count, run.state.estimator.seen
        texts = [run.planner.others(parts), self._overlooked.text]
        text = "; ".join(filter(None, texts))
        moves = f"{run.name} moves {count} parts" if count else run.name
        return f"{moves}: {text}" if text else ""

    def _answer(
        self, run: Run, stamp: Time, plan: Callable[[Run], tuple[PlannerState, Wanted, Progress]]
    ) -> None:
        """Ask for what the task wants in the next cycle."""
        sorted_before = -1 if run.progress is None else run.progress.parts_sorted
        run.state, wanted, run.progress = plan(run)
        age = seconds(stamp) - seconds(self._stamp)  # cycles may begin without new images
        if self._stood_still() or self._rivals() or age > age_limit(self._estimator.period):
            wanted = NOTHING  # these parts are long gone, or of another plate
        start = to_time(round(1e9 * run.state.estimator.next_start))
        self._ask(wanted_to_msg(wanted, stamp, start))
        self._publish_feed(run, bool(wanted.parts.ids))
        if self._markers.get_subscription_count():
            self._markers.publish(forces_to_msg(self._rig, wanted, stamp))
        self._follow_up()
        if run.progress.parts_sorted != sorted_before:
            self._diagnostics.publish()  # in lockstep a task may be over within a report's period

    def _ask(self, msg: PartForces) -> None:
        self._asked_ns, self._open = nanoseconds(msg.header.stamp), True
        self._forces.publish(msg)
        self._inputs = self._inputs.asked(time.monotonic())

    def _on_cycle(self, msg: JointTrajectory) -> None:
        self._wake()
        self._inputs = self._inputs.heard_cycle()
        try:
            cycle = msg_to_cycle(msg)
        except PlateError as error:
            self._warn(str(error))
        else:
            asked, run = seconds(msg.header.stamp), self._run
            arrival = self._arrival(asked)
            if run is None:
                self._idle = self._idle.hear(cycle, arrival, asked)
            else:
                run.state = run.planner.hear(run.state, cycle, arrival, asked)
        if nanoseconds(msg.header.stamp) == self._asked_ns:
            self._open = False
            self._go_on()

    def _arrival(self, stamp: float) -> float:
        """Return when the cycle came that answers an image [s, the time of the stamps]."""
        now = 1e-9 * self.get_clock().now().nanoseconds
        # In lockstep it is never late, whatever our clock has already heard.
        same = abs(now - stamp) < SAME_CLOCK_S and not self.options.lockstep
        return now if same else stamp

    def _on_driver(self, msg: DriverStatus) -> None:
        now = self._wake()
        try:
            self._inputs = self._inputs.heard_driver(now, msg_to_driver_status(msg))
        except PlateError as error:
            self._warn(str(error))
        self._judge(now)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = self._wake()
        for report in msg_to_reports(msg):
            self._inputs = self._inputs.heard_node(now, report.node, report.level, report.message)

    # Whether the task can go on

    def _watch(self) -> None:
        now = self._wake()
        self._judge(now)
        run = self._run
        if run is not None and run.state.task.phase is Phase.RUNNING:
            self._feed_back(run, self._status(run))  # also where no images come: it lives
        if self._early is None:
            return
        period = self._estimator.period
        if self._inputs.answer_overdue(now, period):
            self._open = False
        if now - self._early_at > self._inputs.timeout(period):
            self._waits = False  # nobody reports starts
        self._go_on()

    def _wake(self) -> float:
        """Return the time, and end the task if this process has stood still."""
        self._stood_still()
        return self._inputs.ran

    def _stood_still(self) -> bool:
        now = time.monotonic()
        self._standstill.is_late(now)
        why = self._inputs.stood_still(now, self._estimator.period)
        self._inputs = self._inputs.woken(now) if why else replace(self._inputs, ran=now)
        if why:
            self._end(why)
        return bool(why)

    def _judge(self, now: float) -> None:
        """End a running task that cannot go on."""
        run = self._run
        if run is None or run.state.task.phase is not Phase.RUNNING:
            return
        period = self._estimator.period
        why = self._inputs.problem(now, run.began, period, self._publisher_count)
        waited = now - run.began > self._start_timeout_s + WATCH_PERIOD_S
        if why is None and run.state.task.began is None and waited:
            # Where stamps stand still, the planner's own wait for all parts never ends.
            text = f"not all parts seen within {self._start_timeout_s:g} s of the goal"
            why = Failure(Reason.PARTS_MISSING, text)
        rivals = self._rivals()
        if rivals:
            text = "; ".join(filter(None, (why and why.text, rivals)))
            why = Failure(why.reason if why else Reason.RIVAL, text)
        if why is not None:
            self._end(why)

    def _end(self, why: Failure) -> None:
        """End the running task, if there is one."""
        run = self._run
        if run is not None and run.state.task.phase is Phase.RUNNING:
            run.state = run.planner.stop(run.state, why)
            self._follow_up()

    @property
    def _estimator(self) -> Estimator:
        return self._idle if self._run is None else self._run.state.estimator

    def _publisher_count(self, topic: str) -> int:
        """How many publish a topic, by the name that it has for us."""
        return self.count_publishers(self.resolve_topic_name(topic))

    def _rivals(self) -> str:
        """Say that several nodes publish what only one may; empty if none do."""
        return next(filter(None, map(self.rivals, SINGLE)), "")

    # Goals

    def _on_goal(self, goal: Any) -> None:
        """Begin a task, which goes on until `_finish`; rclpy polls a coroutine that waits.

        A goal that cannot be done is accepted and aborted at once: a refused one has no room for
        the reason.
        """
        why = self._begin(goal, self._wake() if self.active else 0.0)
        if why is not None:
            self.get_logger().warning(f"goal refused: {why.text}")
            status = TaskStatus(state=TaskStatus.ABORTED, reason=int(why.reason), text=why.text)
            status.header = Header(stamp=self._stamp)
            self._finish(goal, status)

    def _finish(self, goal: Any, status: TaskStatus) -> None:
        """Give a goal its result, by `_result`."""
        self._ends[bytes(goal.goal_id.uuid)] = status
        goal.execute()

    def _result(self, goal: Any) -> Any:
        status = self._ends.pop(bytes(goal.goal_id.uuid))
        if status.state == TaskStatus.DONE:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        result = ACTIONS[self._action(goal.request)].Result()
        result.status = status
        return result

    def _begin(self, goal: Any, now: float) -> Failure | None:
        """Begin a task; returns the reason if it cannot be begun."""
        if not self.active:
            return Failure(Reason.NOT_READY, "the planner is not active")
        if self._standstill.is_late(time.monotonic()):
            return Failure(Reason.NOT_READY, "the planner itself stood still: send the goal again")
        try:
            scenario = goal_to_scenario(goal.request)
            planner = Planner(self._rig, scenario, self.options.planner())
        except PlateError as error:
            return Failure(Reason.INVALID_GOAL, str(error))
        running = self._run if self._run and self._run.state.task.phase is Phase.RUNNING else None
        if running is not None and not self.options.preempt:
            text = f"{running.name} is running: cancel it first, or set the parameter preempt"
            return Failure(Reason.BUSY, text)
        problem = (
            self._rivals()
            or self._inputs.driver_problem(now)
            or self._inputs.parts_problem(now, self._publisher_count)
            or self._inputs.starts_problem(now)
        )
        if problem:
            return Failure(Reason.NOT_READY, f"{scenario.name} is not started: {problem}")
        self._end(PREEMPTED)
        for doubt in planner.doubts():
            self.get_logger().warning(doubt)
        state = planner.start(planner.initial(self._estimator))
        self._run = Run(planner, state, now, goal)
        self._asked, self._before_ns = True, self._asked_ns
        self._others_told = False
        self._follow_up()
        self._go_on()
        return None

    def _on_cancel(self, goal: Any) -> CancelResponse:
        """End the task of a goal."""
        run = self._run
        if run is None or run.goal is not goal or run.finished:
            return CancelResponse.REJECT
        self._wake()
        self._end(CANCELED)
        return CancelResponse.ACCEPT

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._wake()
        run = self._run
        was = "" if run is None else run.state.task.text
        self._end(STOP)
        response.message = f"stopped, was {was}"
        if run is None or run.state.task.text == was:  # nothing ran: an end is acknowledged
            self._idle, self._run, self._reported = self._estimator, None, ""
            self._statuses.publish(self._idle_status(Reason.STOPPED))
            response.message = f"no task runs; the last one: {was}" if was else "no task runs"
        # A measurement of friction is no task of the planner, but a stop must end it too.
        if self._friction.service_is_ready():
            self._friction.call_async(MeasureFriction.Request(start=False))
        driver = self._inputs.driver_status
        if driver is not None and driver.state is DriverState.CALIBRATING:
            response.message += "; a measurement of friction ends, calibrate continues"
        self._go_on()
        response.success = True
        return response

    @staticmethod
    def _action(request: Any) -> str:
        return next(name for name, kind in ACTIONS.items() if isinstance(request, kind.Goal))

    def _on_targets(self, msg: Targets) -> None:
        """Replace the targets of parts; what cannot be asked is refused, the rest counts."""
        self._wake()
        run = self._run
        try:
            if run is None:
                raise PlateError("targets: no task of move runs, allowed: while one does")
            run.planner, run.state, refused = run.planner.retarget(run.state, msg_to_targets(msg))
        except PlateError as error:
            self._warn(str(error))
            return
        if refused:
            self._warn("; ".join(refused))
        self._publish_targets()

    def _on_order(self, msg: FeedOrder) -> None:
        """Take in what a running feed is to do from now on."""
        self._inputs = self._inputs.heard_order(self._wake())
        run = self._run
        try:
            if run is None:
                raise PlateError("feed_orders: no task of feed runs, allowed: while one does")
            run.planner = run.planner.order(run.state, msg_to_order(msg))
        except PlateError as error:
            self._warn(str(error))

    # What it reports

    def _publish_feed(self, run: Run, moves: bool) -> None:
        """Publish what a feed has ready; `moves`: the plate is asked to move after this image."""
        if not isinstance(run.planner.scenario.task, FeedTask) or run.state.memory is None:
            return
        report = run.state.memory.report
        report = replace(report, at_rest=report.at_rest and not moves)
        self._feed.publish(feed_to_msg(report, self._shown, self._stamp))

    def _publish_targets(self) -> None:
        """Publish the targets in force, if they are others."""
        run = self._run
        targets: tuple[PartTarget, ...] = ()
        if run is not None and run.state.task.phase is Phase.RUNNING:
            task = run.planner.scenario.task
            targets = task.targets if isinstance(task, MoveTask) else ()
        if targets != self._in_force:
            self._in_force = targets
            self._targets.publish(targets_to_msg(targets, self._stamp))

    def _follow_up(self) -> None:
        """Say how the task gets on, and that it has ended."""
        run = self._run
        if run is None:
            return
        task = run.state.task
        status = self._publish_status()
        self._publish_targets()
        if task.text != self._reported:
            self._reported = task.text
            line = f"task {run.name}: {task.text}"
            # Two lines of code: rclpy refuses two severities from one.
            if task.phase.is_failure and task.reason not in BY_PERSON:
                self.get_logger().error(line)
            else:
                self.get_logger().info(line)
            self._diagnostics.publish()
        if task.phase is Phase.RUNNING:
            self._feed_back(run, status)
        elif not run.finished:
            run.finished = True
            self._finish(run.goal, status)

    def _feed_back(self, run: Run, status: TaskStatus) -> None:
        feedback = ACTIONS[self._action(run.goal.request)].Feedback()
        feedback.progress = status.progress
        run.goal.publish_feedback(feedback)

    def _publish_status(self) -> TaskStatus:
        status = self._idle_status() if self._run is None else self._status(self._run)
        self._statuses.publish(status)
        return status

    def _answered(self) -> Header:
        """Stamp of the last image, or cycle's start, that was answered."""
        return Header(stamp=self._stamp if self._asked_ns is None else to_time(self._asked_ns))

    def _idle_status(self, reason: Reason = Reason.NONE) -> TaskStatus:
        return TaskStatus(header=self._answered(), text="idle", reason=int(reason))

    def _status(self, run: Run) -> TaskStatus:
        task = run.state.task
        status = TaskStatus(
            header=self._answered(), task=run.name, state=STATES[task.phase],
            reason=int(task.reason), text=task.text,
        )  # fmt: skip
        if run.progress is None:
            status.progress.parts_total = run.planner.scenario.count
        else:
            status.progress = progress_to_msg(run.progress)
            if run.progress.phase is task.phase:
                status.text = run.progress.text
        return status

    def _find(self, now: float) -> Finding:
        """Judge the task, and what it needs; see `plate_core.status`."""
        findings = self._inputs.findings(now, self._publisher_count)
        if self._refused:
            findings.append(Finding(Level.WARN, self._refused))
        if rivals := self._rivals():
            findings.append(Finding(Level.WARN, rivals))
        problem = self._estimator.image_problem
        if problem:
            way = "; set camera_triggered false" if self.options.camera_triggered else ""
            findings.append(Finding(Level.WARN, problem + way))
        if late := self._estimator.answer_problem:
            findings.append(Finding(Level.WARN, late))
        if others := self._others():
            findings.append(Finding(Level.WARN, others))
        found = worst(findings, "")
        if self._run is None:
            return Finding(found.level, "; ".join(filter(None, ("idle", found.message))))
        task, level = self._run.state.task, found.level
        if task.phase.is_failure:
            failure = Level.WARN if task.reason in BY_PERSON else Level.ERROR
            level = max(level, failure, key=lambda each: each.rank)
        new = [each for each in findings if each is not None and each.message not in task.text]
        return Finding(level, "; ".join(filter(None, (task.text, worst(new, "").message))))

    def _values(self) -> Mapping[str, str]:
        run = self._run
        progress = {} if run is None or run.progress is None else run.progress.values()
        driver = self._inputs.driver_status
        return {
            **progress,
            "task": "" if run is None else run.name,
            "task_state": "idle" if run is None else run.state.task.text,
            "driver_status": "" if driver is None else driver.text,
            "parts_silent_s": f"{self._inputs.parts.silence(time.monotonic()):.2f}",
            "overlooked": str(self._overlooked.count),
            "image_rate_hz": f"{self._estimator.image_rate:.1f}",
        }

    def _begin_report(self) -> None:
        self._refused = ""

    def _warn(self, text: str) -> None:
        self._refused = text
        self.get_logger().warning(text, throttle_duration_sec=WARN_S)


def main() -> None:
    """Run the node."""
    run_node(PlannerNode, PlannerParameters)
