"""Driver node. The driver receives plate cycles, converts them to motor tables within the rig's
limits, and sends the tables to a transport. If cycles are missing, invalid or too old, the plate
comes to rest.

The node itself only connects topics, services, timers and parameters with other objects.
`CycleIntake` accepts or refuses cycles, `Playback` sends their tables, and `TransportOwner` opens
the transport and stops the motors."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateError, Rig, load_rig
from plate_core.driver_status import DriverReason, DriverState, DriverStatus
from plate_core.motion import HOLD_CYCLES
from plate_core.ros import (
    DATA,
    DIAGNOSTICS_PERIOD_S,
    WARN_S,
    Diagnostics,
    NodeOptions,
    SafeLifecycleNode,
    cycle_to_msg,
    deserialized,
    nanoseconds,
    parameter,
    run_node,
    to_time,
)
from plate_core.status import Finding
from plate_interfaces.msg import TaskStatus

from .calibration import CalibrationRun, saved_response
from .clocks import Clocks
from .cycle_starts import StartReporter
from .diagnostics import DriverDiagnostics
from .friction.node import FrictionServer
from .intake import CycleIntake, NotReadyError
from .playback import Playback
from .ros import RawInput, RawInputs, bytes_to_cycle, motor_state_to_msg, table_to_msg
from .safety.node import ACKNOWLEDGED_S, SafetyNode
from .setpoints import Guard, MotorTable
from .status import driver_status
from .transport_owner import TransportOwner
from .transport_problems import TransportProblems
from .transports import (
    Latch,
    Measured,
    Transport,
    TransportContext,
    TransportThread,
    check_transport,
    high_priority,
    make_transport,
)

WATCH_PERIOD_S = 0.02
"""Period at which the transport and the motors' state are checked [s]."""

CORRECTED = (
    "the calibration corrects the plate's motion, so cycles that begin in motion are refused, and "
    "cycles that begin at rest are played with their tails"
)
"""Log message when the node is activated with a calibration."""

MIN_FACTOR = 0.99
"""If the driver scales a cycle down by a factor below this value, it logs a warning."""


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the driver."""

    transport: str = parameter("sim", "Transport to the motors: sim, serial or an installed one.")
    port: str = parameter("", "Serial port of the motor controller, or CAN bus of the transport.")
    baud: int = parameter(921_600, "Speed of the serial line [bit/s].", 9600, 4_000_000)
    longest_upload_s: float = parameter(
        0.5,
        "Maximum time to send a cycle of 64 pieces over the serial line [s]. The "
        "driver refuses a slower line.",
        0.01,
        60.0,
    )
    streams: bool = parameter(False, "Whether to stream setpoints instead of sending whole cycles.")
    hold_cycles: int = parameter(
        HOLD_CYCLES,
        "Number of times that a cycle from rest to rest is played if no new cycle arrives.",
        1,
        20,
    )
    repeats: int = parameter(
        1, "Number of times that a cycle that begins in motion is played.", 1, 100, live=True
    )
    state_rate: float = parameter(
        10.0, "Rate at which motor_states is published [1/s]. 0 disables it.", 0.0, 200.0
    )
    calibration_file: str = parameter(
        "",
        "File with the plate's response, which the service calibrate writes. If it is empty, "
        "cycles are not corrected.",
    )


class DriverNode(SafeLifecycleNode[Options]):
    """Lifecycle node `driver`: keeps plate cycles within the limits and sends them to the motors.

    The node subscribes to plate_cycle and task_status. After the end of a task, it refuses the
    cycles of the task. The node always publishes driver_status and diagnostics. While active, it
    also publishes motor_setpoints and motor_states, and cycle_started if the motors play whole
    cycles. Services: enable (switches on the motors' current), emergency_stop, cut_power, home,
    calibrate, measure_friction and write_friction. For the services measure_friction and
    write_friction, the node subscribes to parts and publishes friction.

    emergency_stop, cut_power, enable, home and driver_status must work under any message load and
    in every lifecycle state. Therefore a separate node (`driver_safety`) with its own participant
    and threads provides them. Only `enable` switches on the motors' current.

    Measured motor_states have position [m] and acceleration [m/s2]. The acceleration is in
    `effort`, because JointState has no field for it."""

    def __init__(self) -> None:
        super().__init__("driver", Options)
        self.latch = Latch()
        self.clocks = Clocks(
            time.monotonic, lambda: self.get_clock().now().nanoseconds, self._is_simulated
        )
        self.transports = TransportOwner(
            self.latch,
            lambda: load_rig(self.options.rig_file),
            self._make_transport,
            self._log_defect,
        )
        self.playback = Playback(Guard(load_rig()), self.latch, self._publish_table)
        self._calibration = CalibrationRun(
            self.playback, self.latch, self.clocks, self._log_calibration
        )
        self.intake = CycleIntake(
            self.playback,
            self.latch,
            self.clocks,
            status=lambda: self.status,
            decode=bytes_to_cycle,
            second_publisher=lambda: self.second_publisher("plate_cycle"),
            poll_tasks=lambda: self._inputs.poll_tasks(),
        )
        self._friction = FrictionServer(
            self,
            self.playback,
            self.transports,
            self.intake,
            self.latch,
            self.clocks,
            lambda: self.status,
        )
        self._problems = TransportProblems(WARN_S)
        self._report = DriverDiagnostics(
            self.playback,
            self.intake,
            self._calibration,
            self._problems,
            self.clocks,
            DIAGNOSTICS_PERIOD_S,
        )
        self.raw_inputs: tuple[RawInput, ...] = ()
        self._measured: Measured | None = None  # last measurement, which is not published yet
        # The steady clock also advances while simulated time is paused.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = Diagnostics(
            self, self._diagnose, self._diagnostic_values, lambda: "plate", self._report.reported
        )
        # the threads of this node's DDS participant inherit the high priority
        with high_priority():
            self._safety = SafetyNode(self, self.transports, self.latch, lambda: self.status)

    @property
    def status(self) -> DriverStatus:
        """State of the motors and, if they are not ready, the reason."""
        transport = self.transports.current
        report = None if transport is None else transport.report
        busy = self._calibration.running or self._friction.running
        return driver_status(self.active, self.latch, report, busy)

    # Transitions

    def configure(self) -> None:
        """Read the rig, open the transport, and create publishers, subscriptions and timers."""
        options, learned = self.options, None
        rig = load_rig(options.rig_file)
        if options.calibration_file and Path(options.calibration_file).exists():
            learned = saved_response(options.calibration_file).command
        self.playback.guard = Guard(rig, options.hold_cycles, options.repeats, learned)
        self._setpoints = self.managed_publisher(JointTrajectory, "motor_setpoints", DATA)
        self._states = self.managed_publisher(JointState, "motor_states", DATA)
        transport = self.transports.open(rig)
        if transport.motors and transport.calibrates:
            self._starts = self.managed_publisher(JointTrajectory, "cycle_started", DATA)
        self._inputs = RawInputs(self, self.take_cycle, self.take_task)
        self.keep(RawInputs.close, self._inputs)
        self.raw_inputs = self._inputs.tasks, self._inputs.cycles
        service = self.create_service(Trigger, "calibrate", self._on_calibrate)
        self.keep(self.destroy_service, service)
        self._friction.configure()
        timers = [(WATCH_PERIOD_S, self._on_watch_timer)]
        if options.state_rate > 0:
            timers.append((1 / options.state_rate, self._publish_state))
        for t, tick in timers:
            self.keep(self.destroy_timer, self.create_timer(t, tick, clock=self._steady))

    def begin(self) -> None:
        """Accept cycles when the motors are ready. A transport without motors is ready immediately,
        unless it was stopped."""
        self._report.begin(self.clocks.playback_s())
        self.intake.begin()
        self.playback.begin()
        self._start_reporter = StartReporter(self.playback, time.monotonic())
        if self.playback.guard.correction is not None:
            self.get_logger().info(CORRECTED)
        transport = self.transports.current
        if transport is not None and not transport.motors:
            if self.latch.reason:
                transport.stop()
            else:
                transport.enable(self.latch.number)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the node, and publish driver_status before the first cycle."""
        result = super().on_activate(state)
        self._safety.publish_status()
        return result

    def retune(self) -> None:
        """Apply the changed parameter `repeats`."""
        self.playback.set_repeats(self.options.repeats)

    def rest(self) -> None:
        """Stop the motors and wait until they are off."""
        transport = self.transports.current
        if transport is None:
            return
        self.latch.close(DriverReason.SWITCHED_OFF if transport.motors else DriverReason.NONE)
        self._friction.fail("the driver was deactivated")
        self._calibration.cancel()
        self.playback.rest(self.clocks.playback_s())
        if problem := self.transports.rest():
            self.get_logger().error(problem)
        if not self._setpoints.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S)):
            self.get_logger().debug("not all subscribers have confirmed the last motor table")
        self._safety.publish_status()

    def release(self) -> None:
        """Close the transport."""
        self.transports.close()
        self._calibration.cancel()
        self._measured = None
        self._safety.publish_status()

    def close(self) -> None:
        """Stop the motors in any lifecycle state."""
        try:
            super().close()
        finally:
            self._safety.close()
            # A stop request during `super().close()` may have opened a temporary transport. Close
            # it, too.
            self.transports.close()

    def destroy_node(self) -> None:
        """Destroy this node and the safety node."""
        super().destroy_node()
        self._safety.destroy()

    # Transport

    def _make_transport(self, rig: Rig) -> Transport:
        """Return the transport that the parameters define. The transport is not open yet."""
        check_transport(self.options.transport, self.options.port)
        context = TransportContext(
            rig,
            self._send_to_simulator,
            time.monotonic,
            asdict(self.options),
            time.time_ns() % 2**32,
        )
        return make_transport(self.options.transport, context)

    def _is_simulated(self) -> bool:
        transport = self.transports.current
        plain = transport is not None and not transport.motors
        return plain and bool(self.get_parameter("use_sim_time").value)

    def _publish_table(self, table: MotorTable) -> None:
        self._setpoints.publish(table_to_msg(self.playback.rig, table))

    def _send_to_simulator(self, table: MotorTable) -> None:
        """Publish a table for the simulator, unless the table has become too old."""
        msg = table_to_msg(self.playback.rig, table)
        table.check_age(time.monotonic())
        self._setpoints.publish(msg)

    def _log_defect(self, error: Exception) -> None:
        self.get_logger().error(f"transport: {error!r}", throttle_duration_sec=WARN_S)

    # Inputs

    def take_task(self, data: bytes, size: int, _: bytes) -> None:
        """Process a task_status message of `size` bytes. `data` contains the first bytes of the
        message."""
        try:
            msg = deserialized(data, TaskStatus)
        except PlateError as error:
            # An invalid or truncated message cannot be from the planner.
            self.get_logger().warning(f"task_status: {error}", throttle_duration_sec=WARN_S)
            return
        stamp_ns = nanoseconds(msg.header.stamp) if size <= len(data) else None
        self.intake.record_task(msg.state == TaskStatus.RUNNING, stamp_ns)

    def take_cycle(self, data: bytes, size: int, source: bytes = b"") -> None:
        """Check a plate_cycle message of `size` bytes, and send the cycle to the motors. `data`
        contains the first bytes of the message, and `source` identifies the publisher.
        """
        transport = self.transports.current
        if not self.active or transport is None:
            return
        try:
            scaled = self.intake.accept(data, size, source, transport)
        # The same warning occurs twice in the code, because rclpy limits the rate of each line of
        # code separately.
        except NotReadyError as error:
            self.get_logger().warning(f"cycle refused: {error}", throttle_duration_sec=WARN_S)
        except PlateError as error:
            self.get_logger().warning(f"cycle refused: {error}", throttle_duration_sec=WARN_S)
        else:
            if scaled.factor < MIN_FACTOR:
                self.get_logger().warning(scaled.summary, throttle_duration_sec=WARN_S)

    def _on_watch_timer(self) -> None:
        """Process measurements and problems of the transport, and detect missing cycles."""
        transport = self.transports.current
        if transport is None:
            return
        for measured in transport.measured():
            self._measured = measured
            if measured.table:
                self._problems.clear_unplayed()
            if self.active and transport.calibrates:
                self._report_start(measured)
            self._calibration.record(measured)
        self._record_problems(transport)
        self._inputs.poll_tasks()
        if self.playback.guard.table is None:  # no table that can be played was sent
            self._problems.clear_unplayed()
        if self.active:
            self._continue_activity(transport)

    def _continue_activity(self, transport: TransportThread) -> None:
        """Continue a calibration or a measurement of friction, or check whether cycles arrive."""
        status, now = self.intake.observe(), self.clocks.playback_s()
        ready = status.state in (DriverState.READY, DriverState.CALIBRATING)
        self._report.record_ready(ready, now)
        if not ready:
            self._calibration.fail(status.text, now)
            self._friction.fail(status.text)
            if self.playback.guard.table is not None:
                self.playback.rest(now)
        elif self._calibration.running:
            self._calibration.step(transport, now)
        elif self._friction.running:
            self._friction.watch(now)
        elif text := self.playback.check_end(now):
            if self.intake.task_runs:
                self.get_logger().warning(text, throttle_duration_sec=WARN_S)
            else:  # without a task, the driver does not expect cycles
                self.get_logger().debug(text, throttle_duration_sec=WARN_S)

    def _record_problems(self, transport: TransportThread) -> None:
        """Record and log the problems that the transport reports."""
        problems, last = transport.troubles(), self._measured
        for problem in problems:
            self.playback.note(problem)
        motors_rest = last is not None and not last.table
        for problem in self._problems.new(problems, motors_rest, time.monotonic()):
            self.get_logger().warning(problem)

    # Calibration

    def _on_calibrate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        path = self.options.calibration_file
        try:
            self._calibration.start(self.transports.current, self.status, path)
            response.success = True
            response.message = "the calibration has started; see driver_status and diagnostics"
        except PlateError as error:
            response.success, response.message = False, str(error)
        return response

    def _log_calibration(self, text: str, failed: bool) -> None:
        if failed:  # rclpy permits only one severity per call in the code, so there are two calls
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    # Reports

    def _report_start(self, measured: Measured) -> None:
        """Publish the start of each cycle or tail. While the motors rest, publish rest cycles."""
        now = time.monotonic()
        cycle, began, problem = self._start_reporter.update(measured, now)
        if problem:
            self.get_logger().warning(problem, throttle_duration_sec=WARN_S)
        if began is not None and self._starts.get_subscription_count():
            self._starts.publish(cycle_to_msg(cycle, to_time(self._stamp_ns(now - began))))

    def _publish_state(self) -> None:
        """Publish the measured state of the motors. If the transport has no motors, publish the
        commanded state."""
        transport, rig = self.transports.current, self.playback.rig
        if not self.active or transport is None:
            return
        if not transport.motors:
            q, qd = self.playback.commanded(self.clocks.playback_s())
            self._states.publish(motor_state_to_msg(rig, self._stamp_ns(0.0), q, qd))
            return
        measured, self._measured = self._measured, None
        if measured is not None:
            stamp_ns = self._stamp_ns(time.monotonic() - measured.time)
            msg = motor_state_to_msg(
                rig, stamp_ns, measured.position, acceleration=measured.acceleration
            )
            self._states.publish(msg)

    def _stamp_ns(self, age_s: float) -> int:
        """Return the stamp of an event that is `age_s` [s] old. The stamp is never negative. A
        negative value could occur because a simulated clock may still be at 0."""
        return max(0, self.get_clock().now().nanoseconds - max(0, round(1e9 * age_s)))

    def _diagnose(self, now: float) -> Finding:
        return self._report.finding(self.status, self.failure)

    def _diagnostic_values(self) -> dict[str, str]:
        return self._report.values(self.status, self.transports.current)


def main() -> None:
    """Run the driver."""
    run_node(DriverNode, Options)
