"""Driver node. It receives plate cycles, converts them to motor tables within the rig's limits, and
sends the tables to a transport. If cycles are missing, invalid or too old, the plate comes to
rest."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import CycleError, PlateCycle, PlateError, Rig, load_rig
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.motion import motor_state
from plate_core.ros import (
    DATA,
    DIAGNOSTICS_PERIOD_S,
    LATCHED,
    WARN_S,
    Diagnostics,
    NodeOptions,
    SafeLifecycleNode,
    UnlockedSubscription,
    cycle_to_msg,
    deserialized,
    msg_to_cycle,
    nanoseconds,
    parameter,
    run_node,
    to_time,
    trajectory_to_msg,
)
from plate_core.status import INPUT_TIMEOUT_S, Finding
from plate_interfaces.msg import TaskStatus

from .calibration import Calibration, Experiment, check_writable, save_response, saved_response
from .cycle_starts import CycleStarts
from .freshness import Freshness
from .friction.node import FrictionServer
from .raw_cycle import HEAD_BYTES, POINT_BYTES, check_length
from .safety.node import FAREWELL_S, SafetyNode
from .setpoints import MAX_KNOTS, Guard, MotorTable
from .status import UNANSWERED, driver_status, health
from .transports import (
    ANSWER_S,
    BUSY_S,
    Condition,
    Latch,
    Measured,
    Order,
    TransportContext,
    TransportThread,
    check_transport,
    make_transport,
    urgent,
)

CYCLE_PERIOD_S = 0.002
"""Time between polls for a cycle [s]. A separate thread polls, see `UnlockedSubscription`."""

MOST_WAITING = 5
"""Maximum number of messages that wait for the executor, so that a flood leaves time for other
work."""

STATUS_BYTES = 100_000
"""Maximum size of a task_status [bytes]. A longer one is not from the planner."""

WATCH_PERIOD_S = 0.02
STALLED_S = 0.05
"""If the process does not run for longer than this, it counts as stalled [s]."""

SETTLE_S = 0.01
"""Time in which a stalled process receives waiting messages [s]. Otherwise the end of a task could
be processed after a later cycle."""

REST_S = 3.0
"""Maximum wait for motors to brake, go home and switch off [s]."""

UNPLAYED_S = 0.5
"""If the motors play no table for longer than this after a failed table, a problem is reported
[s]."""

NO_START = "starts of cycles are not told where the device's ticks cannot be"
"""Warning about a device that reports an impossible playing time of a table."""

CORRECTED = (
    "the plate is corrected by its calibration: cycles that begin in motion are refused, those "
    "from rest are played with their tails"
)
"""Message on activation with a calibration."""

REST_CYCLE_S = 0.1
"""Period of the reported cycle while the motors rest [s]."""

MOTIONS_KEPT = 8
"""Number of sent cycles that are kept, because they may play or wait."""

WORTH_A_WARNING = 0.99
"""If the scaling factor of a cycle is smaller than this, a warning is logged."""


Take = Callable[[bytes, int, bytes], None]
"""Callback for a serialized message, its length [bytes] and a key of its publisher."""


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the driver."""

    transport: str = parameter("sim", "What moves the plate: sim, serial, or one more installed.")
    port: str = parameter("", "Serial port of the motor controller, or bus of the transport.")
    baud: int = parameter(921_600, "Speed of the serial line [bit/s].", 9600, 4_000_000)
    longest_upload_s: float = parameter(
        0.5, "Longest time that a cycle of 64 pieces may take on the line [s].", 0.01, 60.0
    )
    streams: bool = parameter(False, "Whether to stream setpoints, not to send whole cycles ahead.")
    hold_cycles: int = parameter(
        2, "Periods that a cycle from rest to rest is played without a new one.", 1, 20
    )
    repeats: int = parameter(
        1, "Times that a cycle which does not start at rest is played.", 1, 100, live=True
    )
    state_rate: float = parameter(10.0, "Messages of motor_states [1/s]; 0: none.", 0.0, 200.0)
    calibration_file: str = parameter(
        "", "What `calibrate` has learned of the plate: written then, read at configure; or empty."
    )


class DriverNode(SafeLifecycleNode[Options]):
    """Lifecycle node `driver`: keeps plate cycles within the limits and sends them to the motors.

    Subscribes to plate_cycle and task_status. Cycles that a task requested are refused after its
    end. Publishes motor_setpoints, motor_states and, for motors that play whole cycles,
    cycle_started while active, driver_status and diagnostics always. Services enable (gives the
    motors current), emergency_stop, cut_power, home, calibrate; measure_friction and
    write_friction, which subscribe to parts and publish friction.

    emergency_stop, cut_power, enable, home and driver_status must work under any message load and
    in every lifecycle state. They have their own participant, node (`driver_safety`) and threads.
    Only `enable` switches on the motors' current.

    Measured motor_states have position [m] and, in `effort`, acceleration [m/s2], because
    JointState has no field for it."""

    def __init__(self) -> None:
        super().__init__("driver", Options)
        self._guard = Guard(load_rig())
        self._latch = Latch()
        self._transport: TransportThread | None = None
        self._lent: TransportThread | None = None  # opened for a stop while no other one is open
        self._making = threading.Lock()
        self._experiment: Experiment | None = None
        self._outcome, self._failed = "", False  # of the last calibration
        self._friction = FrictionServer(self)
        self.task_runs = False
        self._measured: Measured | None = None
        self._ready_since = 0.0
        self._unplayed: tuple[float, str] | None = None  # start [s, steady] and reason
        self._freshness, self._refusal = Freshness(), ""
        self.heard: tuple[tuple[UnlockedSubscription, Take], ...] = ()  # tasks, and cycles
        self._heard_at = 0.0  # last poll of task_status [s, steady]
        self._came: deque[tuple[bytes, int, bytes]] = deque()  # received cycles in order
        self._reported: dict[str, str] = {}  # values of the last diagnostics
        self._warned: dict[str, float] = {}  # time of the last log of each transport problem [s]
        self._again = 0  # messages repeated between the last two diagnostics
        # It also advances while simulated time stands still.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = Diagnostics(
            self, self._find, self._values, lambda: "plate", self._begin_report
        )
        with urgent():  # also for the threads of the DDS participant
            self._safety = SafetyNode(self)

    def close(self) -> None:
        """Stop the motors in any lifecycle state."""
        try:
            super().close()
        finally:
            self._safety.close()
            self._close_transport()  # a stop may have opened one

    def destroy_node(self) -> None:
        """Destroy this node and the safety node."""
        super().destroy_node()
        self._safety.destroy()

    def retune(self) -> None:
        """Apply the changed parameter `repeats`."""
        self._guard = replace(self._guard, repeats=self.options.repeats)

    # Transitions

    def configure(self) -> None:
        """Read the rig, open the transport, and create publishers, subscriptions and timers."""
        options, learned = self.options, None
        self._rig = rig = load_rig(options.rig_file)
        if options.calibration_file and Path(options.calibration_file).exists():
            learned = saved_response(options.calibration_file).command
        self._guard = Guard(rig, options.hold_cycles, options.repeats, learned)
        self._setpoints = self.managed_publisher(JointTrajectory, "motor_setpoints", DATA)
        self._states = self.managed_publisher(JointState, "motor_states", DATA)
        with self._making:
            self._return_lent()
            self._transport = self._start_transport()
        if self._transport.motors and self._transport.calibrates:
            self._starts = self.managed_publisher(JointTrajectory, "cycle_started", DATA)
        most = HEAD_BYTES + POINT_BYTES * MAX_KNOTS
        cycles = UnlockedSubscription(self, JointTrajectory, "plate_cycle", DATA, most)
        tasks = UnlockedSubscription(self, TaskStatus, "task_status", LATCHED, STATUS_BYTES)
        self.heard = (tasks, self.take_task), (cycles, self.take_cycle)
        self._came.clear()
        over = threading.Event()
        # A thread that polls every 2 ms needs a tenth of the CPU time of an executor timer.
        thread = threading.Thread(target=self._listen, args=(cycles, over), daemon=True)
        thread.start()
        self.keep(lambda event: event.set(), over)
        self.keep(threading.Thread.join, thread)
        self.keep(UnlockedSubscription.destroy, cycles, tasks)
        service = self.create_service(Trigger, "calibrate", self._on_calibrate)
        self.keep(self.destroy_service, service)
        self._friction.configure()
        timers = [(WATCH_PERIOD_S, self._watch)]
        if options.state_rate > 0:
            timers.append((1 / options.state_rate, self._publish_state))
        for t, tick in timers:
            self.keep(self.destroy_timer, self.create_timer(t, tick, clock=self._steady))

    def begin(self) -> None:
        """Accept cycles when the motors are ready. A transport without motors is ready at once,
        unless it was stopped."""
        self._ready_since = self._now()
        self._freshness, self._refusal = Freshness(), ""
        self._cycle_starts = CycleStarts(time.monotonic())
        self._motions: dict[int, PlateCycle] = {}  # motions of corrected tables by stamp
        if self._guard.correction is not None:
            self.get_logger().info(CORRECTED)
        transport = self._transport
        if transport is not None and not transport.motors:
            if self._latch.reason:
                transport.stop()
            else:
                transport.enable(self._latch.number)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the node, and publish driver_status before the first cycle."""
        result = super().on_activate(state)
        self._safety.publish_status()
        return result

    def rest(self) -> None:
        """Stop the motors and wait until they are off."""
        transport = self._transport
        if transport is None:
            return
        self._latch.close(DriverReason.SWITCHED_OFF if transport.motors else DriverReason.NONE)
        self._friction.fail("the driver was deactivated")
        self._halted()
        order, end = transport.stop(), time.monotonic() + ANSWER_S
        done = transport.stopped(order, cut=False, end=end)
        self._latch.late = order if transport.met and not done else None
        if not done and transport.met:  # if no device was ever met, there is no current
            self.get_logger().error(UNANSWERED)
        if done:
            end = time.monotonic() + REST_S
            while transport.report.condition not in (Condition.OFF, Condition.GONE):
                if time.monotonic() > end:
                    self.get_logger().error(f"the plate still moves after {REST_S:g} s")
                    break
                time.sleep(0.01)
        if not self._setpoints.wait_for_all_acked(Duration(seconds=FAREWELL_S)):
            self.get_logger().debug("not everyone has confirmed the last motor table")
        self._safety.publish_status()

    def release(self) -> None:
        """Close the transport."""
        self._close_transport()
        self._measured, self._experiment = None, None
        self._safety.publish_status()

    # The transport

    def _start_transport(self) -> TransportThread:
        """Open the transport and start its thread."""
        check_transport(self.options.transport, self.options.port)
        context = TransportContext(
            self._rig, self._play, time.monotonic, asdict(self.options), time.time_ns() % 2**32
        )
        made = make_transport(self.options.transport, context)
        made.open()
        thread = TransportThread(made, self._latch, self._on_defect)
        thread.start()
        return thread

    def _close_transport(self) -> None:
        """Stop and close the open transports. A concurrent stop still reaches them."""
        transport = getattr(self, "_transport", None)
        if transport is not None:
            transport.close()
            self._transport = None
        with getattr(self, "_making", contextlib.nullcontext()):
            self._return_lent()

    def _return_lent(self) -> None:
        """Close the transport that was opened for a stop."""
        lent, self._lent = getattr(self, "_lent", None), None
        if lent is not None:
            lent.close()

    def _keep_lent(self) -> None:
        """Keep the transport that was opened for a stop until the stop is settled."""
        while self._lent is not None:
            time.sleep(WATCH_PERIOD_S)
            with self._making:
                if self._lent is not None and not self._lent.stopping:
                    self._return_lent()

    def _stop_lent(self, cut: bool) -> tuple[TransportThread, Order]:
        """Stop by the open transport, or by one that is opened for this stop."""
        if not self._making.acquire(timeout=BUSY_S):
            raise PlateError("the driver opens or closes its transport")
        try:
            if self._transport is not None:
                return self._transport, self._transport.stop(cut)
            if self._lent is None:
                self._rig = load_rig(self.options.rig_file)
                self._lent = self._start_transport()
                threading.Thread(target=self._keep_lent, name="lent", daemon=True).start()
            return self._lent, self._lent.stop(cut)
        finally:
            self._making.release()

    def _on_defect(self, error: Exception) -> None:
        self.get_logger().error(f"transport: {error!r}", throttle_duration_sec=WARN_S)

    def stop_motors(self, cut: bool) -> bool:
        """Stop the motors in any state. If no transport is open, one is opened for the stop.

        Return within `ANSWER_S` whether the motors are known to stop. If they are not, the stop is
        still tried afterwards.
        """
        end = time.monotonic() + ANSWER_S
        try:
            while True:
                transport = self._transport
                if transport is not None:
                    order = transport.stop(cut)
                else:
                    transport, order = self._stop_lent(cut)
                done = transport.stopped(order, cut, end)
                if done or transport in (self._transport, self._lent):
                    break  # otherwise it was closed during the wait
        except PlateError as error:
            done, order = False, Order().settle(str(error))
        self._latch.late = None if done else order
        return done

    @property
    def transport(self) -> TransportThread | None:
        """The open transport."""
        return self._transport

    @property
    def latch(self) -> Latch:
        """Latch that blocks cycles after a stop."""
        return self._latch

    @property
    def status(self) -> DriverStatus:
        """State of the motors and, if they are not ready, the reason."""
        transport = self._transport
        report = None if transport is None else transport.report
        busy = self._experiment is not None or self._friction.running
        return driver_status(self.active, self._latch, report, busy)

    # Work

    @property
    def _simulated(self) -> bool:
        """Whether simulated time is used. With real motors it never is, because they heat in real
        time."""
        transport = self._transport
        plain = transport is not None and not transport.motors
        return plain and bool(self.get_parameter("use_sim_time").value)

    def _now(self) -> float:
        """Return the time [s] used for playback and for the motors' temperature."""
        if self._simulated:
            return 1e-9 * self.get_clock().now().nanoseconds
        return time.monotonic()

    def _listen(self, cycles: UnlockedSubscription, over: threading.Event) -> None:
        """Pass received cycles to the executor until `over` is set."""
        while not over.wait(CYCLE_PERIOD_S):
            executor = self.executor
            while executor is not None and len(self._came) < MOST_WAITING:
                taken = cycles.take()
                if taken is None:
                    break
                self._came.append(taken)
                executor.create_task(self._take)

    def _take(self) -> None:
        """Process the oldest received cycle, unless the node was cleaned up since."""
        if self._came:
            self.take_cycle(*self._came.popleft())

    def _hear_tasks(self) -> None:
        """Receive task_status. Call this about every 20 ms."""
        if time.monotonic() - self._heard_at > STALLED_S:
            time.sleep(SETTLE_S)
        self._heard_at = time.monotonic()
        for subscription, take in self.heard[:1]:  # empty before configure
            for _ in range(MOST_WAITING):
                taken = subscription.take()
                if taken is None:
                    break
                take(*taken)

    def take_task(self, data: bytes, size: int, _: bytes) -> None:
        """Process a task_status of `size` bytes; `data` is its beginning."""
        try:
            msg = deserialized(data, TaskStatus)
        except PlateError as error:  # invalid or truncated: not from the planner
            self.get_logger().warning(f"task_status: {error}", throttle_duration_sec=WARN_S)
            return
        self.task_runs = msg.state == TaskStatus.RUNNING
        if size <= len(data) and not self.task_runs:
            self._freshness = self._freshness.ended(nanoseconds(msg.header.stamp))

    def _look(self) -> DriverStatus:
        """Return the status, and record when the motors became ready or this process stalled.

        In simulated time stalls are not recorded.
        """
        status = self.status
        number = self._latch.number if status.state is DriverState.READY else None
        now = 0.0 if self._simulated else time.monotonic()
        self._freshness = self._freshness.seen(number, now, self.get_clock().now().nanoseconds)
        return status

    def _left_s(self, cycle: PlateCycle, stamp_ns: int) -> float:
        """Return the remaining time in which a moving cycle may be sent [s], or refuse it."""
        if rivals := self.rivals("plate_cycle"):
            raise CycleError(rivals)
        clock_ns = self.get_clock().now().nanoseconds
        if self._simulated:  # the clock may be heard after the cycle
            clock_ns = max(clock_ns, stamp_ns)
        left = self._freshness.left(stamp_ns, clock_ns, cycle.period)
        return math.inf if self._simulated else left

    def take_cycle(self, data: bytes, size: int, source: bytes = b"") -> None:
        """Check a cycle of `size` bytes and send it to the motors.

        `data` is its beginning, and `source` identifies its publisher.
        """
        transport = self._transport
        if not self.active or transport is None:
            return
        number, status = self._latch.number, self._look()
        self._freshness = self._freshness.came(source, time.monotonic())
        if status.state is not DriverState.READY:
            self._guard = self._guard.refused()
            text = f"cycle refused: the driver is {status.text}"  # reported before any other reason
            self.get_logger().warning(text, throttle_duration_sec=WARN_S)
            return
        try:
            check_length(data, size, min(MAX_KNOTS, transport.max_knots))
            msg = deserialized(data, JointTrajectory)
            stamp_ns = nanoseconds(msg.header.stamp)
            now = self._now()
            if self._simulated:  # the clock may be heard after the cycle
                now = max(now, 1e-9 * stamp_ns)
            cycle = msg_to_cycle(msg)
            guard, fit = self._guarded(transport).accepted(cycle, stamp_ns, now)
            if cycle.moves:
                self._hear_tasks()  # last: the task of this cycle may have ended by now
                guard = guard.lasting(time.monotonic() + self._left_s(cycle, stamp_ns))
            self._send(transport, guard, number)
            if guard.correction is not None:
                motions = [*self._motions.items(), (stamp_ns, fit.cycle)]
                self._motions = dict(motions[-MOTIONS_KEPT:])
        except PlateError as error:
            self._guard, self._refusal = self._guard.refused(), str(error)
            self.get_logger().warning(f"cycle refused: {error}", throttle_duration_sec=WARN_S)
            return
        self._refusal = ""
        if fit.factor < WORTH_A_WARNING:
            self.get_logger().warning(fit.summary, throttle_duration_sec=WARN_S)

    def _guarded(self, transport: TransportThread) -> Guard:
        """Return the guard with the device's current `hold_s`."""
        return replace(self._guard, hold_s=transport.hold_s)

    def _send(self, transport: TransportThread, guard: Guard, number: int) -> None:
        """Send the table of a guard, and make this the current guard."""
        assert guard.table is not None
        transport.send(guard.table, guard.plays, number)
        if transport.motors:
            self._setpoints.publish(self._message(guard.table))
        self._guard = guard

    def _play(self, table: MotorTable) -> None:
        """Publish a table for the simulator, unless it is too old by now."""
        msg = self._message(table)
        table.check_age(time.monotonic())
        self._setpoints.publish(msg)

    def _message(self, table: MotorTable) -> JointTrajectory:
        joints = [motor.name for motor in self._rig.motors]
        stamp = to_time(table.stamp_ns)
        return trajectory_to_msg(joints, table.times, table.q, table.qd, table.qdd, stamp)

    def _halted(self) -> None:
        """Record that the plate rests, and end an experiment."""
        self._experiment = None
        self._guard = self._guard.resting(self._now())

    def _note_start(self, measured: Measured) -> None:
        """Publish the start of each cycle or tail. While the motors rest, publish rest cycles."""
        transport = self._transport
        if not self.active or transport is None or not transport.calibrates:
            return
        cycle, now = PlateCycle.rest(REST_CYCLE_S), time.monotonic()
        if measured.table and measured.playing is not None:
            table = measured.playing
            cycle = self._motions.get(table.stamp_ns, table.cycle)
        self._cycle_starts, began, problem = self._cycle_starts.heard(measured, cycle.period, now)
        if problem:
            self._guard = self._guard.noted(NO_START)
            text = f"{NO_START}: table {measured.table} {problem}"
            self.get_logger().warning(text, throttle_duration_sec=WARN_S)
        if began is not None and self._starts.get_subscription_count():
            age_ns = max(0, round(1e9 * (now - began)))
            stamp = to_time(max(0, self.get_clock().now().nanoseconds - age_ns))
            self._starts.publish(cycle_to_msg(cycle, stamp))

    def _watch(self) -> None:
        """Process measurements and problems of the transport, and detect missing cycles."""
        transport = self._transport
        if transport is None:
            return
        for measured in transport.measured():
            self._measured = measured
            self._unplayed = None if measured.table else self._unplayed
            self._note_start(measured)
            if self._experiment is not None:
                self._experiment = self._experiment.with_sample(measured)
        quiet_since = time.monotonic() - WARN_S
        self._warned = {t: at for t, at in self._warned.items() if at > quiet_since}
        for trouble in transport.troubles():
            self._guard = self._guard.noted(trouble)
            if self._measured is not None and not self._measured.table:
                self._unplayed = self._unplayed or (time.monotonic(), trouble)
            if trouble not in self._warned:
                self._warned[trouble] = time.monotonic()
                self.get_logger().warning(trouble)
        self._hear_tasks()
        if self._guard.table is None:  # no table is expected to play
            self._unplayed = None
        if not self.active:
            return
        status, now = self._look(), self._now()
        self._ready_since = min(self._ready_since, now)  # a simulated clock may be set back
        if status.state not in (DriverState.READY, DriverState.CALIBRATING):
            self._ready_since = now
            if self._experiment is not None:
                self._calibrated(f"failed: {status.text}", now, failed=True)
            self._friction.fail(status.text)
            if self._guard.table is not None:
                self._halted()
            return
        if self._experiment is not None:
            self._calibrate(transport, now)
            return
        if self._friction.running:
            self._friction.watch(now)
            return
        hold_s = self._guard.lasts_s
        self._guard, over = self._guard.watched(now)
        if over:
            text = f"no plate_cycle for {hold_s:.3g} s: the plate rests"
            if self.task_runs:
                self.get_logger().warning(text, throttle_duration_sec=WARN_S)
            else:  # no task, so no cycles are expected
                self.get_logger().debug(text, throttle_duration_sec=WARN_S)

    # Calibration

    def _on_calibrate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = False
        transport, status = self._transport, self.status
        if not self.options.calibration_file:
            response.message = "calibration_file is '', allowed: the name of a file"
        elif transport is None or not transport.calibrates:
            response.message = "transport is sim or streams, allowed: serial with cycles"
        elif any(motor.drive for motor in self._rig.motors):
            response.message = "the rig has drives, which tell no acceleration, allowed: bridges"
        elif status.state is not DriverState.READY:
            response.message = f"the driver is {status.text}, allowed: ready"
        else:
            try:
                check_writable(self.options.calibration_file)
                self._outcome, self._failed = "", False
                self._begin_experiment(transport, Calibration.start(self._rig), self._now())
                response.success, response.message = True, "see driver_status and diagnostics"
            except PlateError as error:
                self._experiment, response.message = None, str(error)
        return response

    def _begin_experiment(
        self, transport: TransportThread, calibration: Calibration, now: float
    ) -> None:
        """Start the next experiment of a calibration."""
        experiment = Experiment(calibration)
        number = self._latch.number
        before = self._guarded(transport)
        guard, played = before.experimenting(experiment.cycle, now)
        self._experiment = replace(experiment, played=played)
        self._send(transport, guard, number)
        self._guard = guard.after_experiment(before)
        self.get_logger().info(f"calibration: {experiment.calibration.progress}")

    def _calibrate(self, transport: TransportThread, now: float) -> None:
        """Continue the calibration when an experiment is over."""
        experiment = self._experiment
        assert experiment is not None
        try:
            if not experiment.over:
                if self._guard.over(now, 2.0):
                    raise PlateError("the motors have not played the experiment to its end")
                return
            calibration = experiment.finished()
            if calibration.cycle is not None:
                self._begin_experiment(transport, calibration, now)
                return
            save_response(self.options.calibration_file, calibration.response)
            text = f"done: {self.options.calibration_file}, used from the next configure on"
            self._calibrated(text, now, failed=False)
        except PlateError as error:
            self._calibrated(f"failed: {error}", now, failed=True)

    def _calibrated(self, text: str, now: float, failed: bool) -> None:
        """End a calibration."""
        self._outcome, self._failed = text, failed
        if failed:
            self.get_logger().error(f"calibration {text}")
        else:
            self.get_logger().info(f"calibration {text}")
        self._halted()

    # Friction

    @property
    def rig(self) -> Rig:
        """Rig from the rig file."""
        return self._rig

    @property
    def guard(self) -> Guard:
        """Guard with the last commanded table and the time at which the plate rests."""
        return self._guard

    def play_time(self) -> float:
        """Return the time used for playback [s]."""
        return self._now()

    def send_push(self, cycle: PlateCycle, now: float) -> float:
        """Play a motion from rest to rest once, corrected by the learned response. Return the
        factor that scales it down to the rig's limits.

        Raises
        ------
        PlateError
            If the plate cannot perform this motion.
        """
        transport = self._transport
        assert transport is not None
        before = self._guarded(transport)
        stamp_ns = self.get_clock().now().nanoseconds
        guard, fit = replace(before, hold_cycles=1).commanded(cycle, stamp_ns, now)
        self._send(transport, guard, self._latch.number)
        self._guard = replace(guard, hold_cycles=before.hold_cycles)
        return fit.factor

    def rest_guard(self) -> None:
        """Note that the plate rests."""
        self._guard = self._guard.resting(self._now())

    # Reports

    def _publish_state(self) -> None:
        """Publish the measured state of the motors or, without motors, the commanded one."""
        transport = self._transport
        if not self.active or transport is None:
            return
        msg = JointState(name=[motor.name for motor in self._rig.motors])
        now = self.get_clock().now()
        if transport.motors:
            measured, self._measured = self._measured, None
            if measured is None:
                return
            age_ns = max(0, round(1e9 * (time.monotonic() - measured.time)))
            # A simulated clock may stand at zero.
            msg.header.stamp = to_time(max(0, now.nanoseconds - age_ns))
            msg.position = list(measured.position)
            msg.effort = list(measured.acceleration)
        else:
            msg.header.stamp = now.to_msg()
            msg.position, msg.velocity = self._commanded()
        self._states.publish(msg)

    def _commanded(self) -> tuple[list[float], list[float]]:
        """Return the currently commanded travel [m] and speed [m/s]."""
        table = self._guard.table
        if table is None:
            return [0.0] * len(self._rig.motors), [0.0] * len(self._rig.motors)
        cycle, t = table.cycle, max(0.0, self._now() - self._guard.sent_at)
        if cycle.tail is None:
            t %= cycle.period
        elif t > cycle.period:
            t, cycle = min(t - cycle.period, cycle.tail.period), cycle.tail
        q, qd, _ = motor_state(self._rig, cycle.pose(t), cycle.twist(t), cycle.accel(t))
        return q[0].tolist(), qd[0].tolist()

    def _find(self, now: float) -> Finding:
        """Return the severity level of the driver's state, and its reason."""
        lasting = [str(self.failure)] if self.failure is not None else []
        if self._failed:
            lasting.append(f"calibration {self._outcome}")
        if self._reported.get("following_watched") == "no":
            lasting.append("following error is not watched: limits.following_error_m is 0")
        quiet_s = self._quiet_s(self._now())
        if quiet_s is not None and self._refusal:
            lasting.append(f"the last was refused: {self._refusal}")
        since, why = self._unplayed or (math.inf, "")
        silent_s, unplayed = time.monotonic() - since, ""
        if silent_s > UNPLAYED_S:
            unplayed = f"no plate_cycle has been played for {silent_s:.1f} s: {why}"
        statistics = self._guard.statistics
        return health(
            self.status, statistics, self._again, quiet_s, self.task_runs, lasting, unplayed
        )

    def _values(self) -> dict[str, str]:
        """Return the values for the diagnostics by name."""
        experiment, transport = self._experiment, self._transport
        values = self._guard.values(DIAGNOSTICS_PERIOD_S, self._now())
        values["state"] = self.status.text
        if experiment is not None:
            values["calibration"] = experiment.calibration.progress
        elif self._outcome:
            values["calibration"] = self._outcome
        if transport is not None:
            values |= dict(transport.report.values) | transport.values()
        before, now = (int(v.get("retries", "0")) for v in (self._reported, values))
        self._again, self._reported = max(0, now - before), values
        return values

    def _begin_report(self) -> None:
        """Reset the counts for the next diagnostics."""
        self._guard = self._guard.reported()

    def _quiet_s(self, now: float) -> float | None:
        """Return the time without cycles [s] if the plate rests because of that. Otherwise None."""
        if self._guard.table is not None:
            return None
        quiet = now - max(self._guard.sent_at, self._ready_since)
        return quiet if quiet > max(INPUT_TIMEOUT_S, self._guard.lasts_s) else None


def main() -> None:
    """Run the driver."""
    run_node(DriverNode, Options)
