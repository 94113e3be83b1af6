"""The driver node: plate cycles in, motor tables out, within the limits and never left moving."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateError, load_rig
from plate_core.kinematics import motor_state
from plate_core.ros.convert import msg_to_cycle, nanoseconds, to_time, trajectory_to_msg
from plate_core.ros.lifecycle import SafeLifecycleNode, logged
from plate_core.ros.main import run_node
from plate_core.ros.params import declare, follow, parameter
from plate_core.ros.qos import DATA, LATCHED

from .calibration import Calibration, Run, save_response, saved_response
from .guard import Guard, Mode
from .motor_table import MotorTable
from .serial_transport import Measured, SerialTransport, open_port
from .transport import SimTransport, Transport, check_transport

WATCH_PERIOD_S = 0.02
POLL_PERIOD_S = 0.005
"""Time between looks at the serial port [s]: an upload takes some four of them."""

REPORT_PERIOD_S = 1.0
QUIET_S = 2.0
"""Least time between two warnings of the same kind [s]."""

WORTH_A_WARNING = 0.99
"""A cycle scaled by less than this much is counted, but no cause for a warning."""

FAREWELL_S = 0.5
"""How long to wait until the last rest table has arrived [s]."""


@dataclass(frozen=True)
class Options:
    """Parameters of the driver."""

    rig_file: str = parameter("", "Rig file (YAML); empty: the default rig.")
    transport: str = parameter("sim", "What moves the plate: sim or serial.")
    port: str = parameter("", "Serial port of the motor controller, if transport is serial.")
    streams: bool = parameter(False, "Whether to stream setpoints, not to send whole cycles ahead.")
    hold_cycles: int = parameter(
        5, "Periods that the plate goes on without a new cycle before it rests.", 1, 1000, live=True
    )
    repeats: int = parameter(
        1, "Times that a cycle which does not start at rest is played.", 1, 100, live=True
    )
    state_rate: float = parameter(10.0, "Messages of motor_states [1/s]; 0: none.", 0.0, 200.0)
    calibration_file: str = parameter(
        "", "What `calibrate` has learned of the plate: written then, read at configure; or empty."
    )
    autostart: bool = parameter(True, "Configure and activate at start.")


class DriverNode(SafeLifecycleNode):
    """Lifecycle node `driver`: subscribes plate_cycle, publishes motor_setpoints, motor_states and
    diagnostics while active, and brings the plate to rest before it stops being active. Serves
    emergency_stop, enable, home and calibrate; driver_state says whether the motors obey.

    With serial transport motor_states are measured: position [m], and in `effort`, since JointState
    has no field for it, acceleration [m/s2]; stamped by the device's clock."""

    def __init__(self) -> None:
        super().__init__("driver")
        self._guard = Guard(load_rig())
        self._state = ""
        self._run: Run | None = None
        self._transport: Transport = SimTransport(self._publish)
        self._options = declare(self, Options)
        check_transport(self._options.transport, self._options.port)
        self._measured: Measured | None = None
        self._follow = follow(self, self._options, self._set_options)
        if self._options.autostart:
            self.start()

    def _set_options(self, options: Options) -> None:
        self._options = options
        self._guard = replace(self._guard, hold_cycles=options.hold_cycles, repeats=options.repeats)

    # Transitions

    @logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the rig, open the transport, make publishers, subscription and timers."""
        self._rig = rig = load_rig(self._options.rig_file)
        options, learned = self._options, None
        if options.calibration_file and Path(options.calibration_file).exists():
            learned = saved_response(options.calibration_file).command
        self._guard = Guard(rig, options.hold_cycles, options.repeats, learned)
        self._transport = self._make_transport()
        self._transport.open()
        self._setpoints = self.create_lifecycle_publisher(JointTrajectory, "motor_setpoints", DATA)
        self._states = self.create_lifecycle_publisher(JointState, "motor_states", DATA)
        self._diagnostics = self.create_lifecycle_publisher(DiagnosticArray, "diagnostics", DATA)
        self._driver_state = self.create_publisher(String, "driver_state", LATCHED)
        self.keep(
            self.destroy_lifecycle_publisher, self._setpoints, self._states, self._diagnostics
        )
        self.keep(self.destroy_publisher, self._driver_state)
        cycles = self.create_subscription(JointTrajectory, "plate_cycle", self._on_cycle, DATA)
        self.keep(self.destroy_subscription, cycles)
        self.keep(
            self.destroy_service,
            self.create_service(Trigger, "emergency_stop", self._on_stop),
            self.create_service(SetBool, "enable", self._on_enable),
            self.create_service(Trigger, "home", self._on_home),
            self.create_service(Trigger, "calibrate", self._on_calibrate),
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # ticks also while simulated time stands
        timers = [(WATCH_PERIOD_S, self._watch), (REPORT_PERIOD_S, self._report)]
        if isinstance(self._transport, SerialTransport):
            timers.append((POLL_PERIOD_S, self._poll))
        if self._options.state_rate > 0:
            timers.append((1 / self._options.state_rate, self._publish_state))
        for t, tick in timers:
            self.keep(self.destroy_timer, self.create_timer(t, tick, clock=steady))
        return super().on_configure(state)

    def begin(self) -> None:
        """Say that the motors obey."""
        self._tell_state()

    def rest(self) -> None:
        """Bring the plate to rest."""
        self._turn(Mode.STOPPED if self._guard.mode is Mode.STOPPED else Mode.READY)
        self._tell_state()
        if not self._setpoints.wait_for_all_acked(Duration(seconds=FAREWELL_S)):
            self.get_logger().debug("not everyone has confirmed the last motor table")

    def release(self) -> None:
        """Let go of the transport."""
        self._transport.close()
        self._measured, self._run, self._state = None, None, ""

    # Work

    def _make_transport(self) -> Transport:
        if self._options.transport == "sim":
            return SimTransport(self._publish)
        port, seed = self._options.port, time.time_ns() % 2**32
        return SerialTransport(lambda: open_port(port), time.monotonic, seed, self._options.streams)

    def _poll(self) -> None:
        """Serve the serial link, and tell what is wrong with it."""
        if not isinstance(self._transport, SerialTransport):
            return
        for measured in self._transport.poll():
            self._measured = measured
            if self._run is not None:
                self._run = self._run.noted(measured.telemetry)
        for trouble in self._transport.troubles():
            self._guard = self._guard.troubled(trouble)
            self.get_logger().warning(trouble, throttle_duration_sec=QUIET_S)

    def _now(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def _on_cycle(self, msg: JointTrajectory) -> None:
        if not self.active:
            return
        stamp_ns = nanoseconds(msg.header.stamp)
        try:
            guard, fit = self._guard.accepted(msg_to_cycle(msg), stamp_ns, self._now())
            self._send(guard)
        except PlateError as error:
            self._guard = self._guard.refused()
            self.get_logger().warning(f"cycle refused: {error}", throttle_duration_sec=QUIET_S)
            return
        if fit.factor < WORTH_A_WARNING:
            self.get_logger().warning(fit.told, throttle_duration_sec=QUIET_S)

    def _send(self, guard: Guard) -> None:
        """Send the table of a guard, and take the guard for ours."""
        assert guard.table is not None
        self._transport.send(guard.table)
        if isinstance(self._transport, SerialTransport):
            self._publish(guard.table)
        self._guard = guard

    def _publish(self, table: MotorTable) -> None:
        joints = [motor.name for motor in self._rig.motors]
        stamp = to_time(table.stamp_ns)
        self._setpoints.publish(
            trajectory_to_msg(joints, table.cycle.times, table.q, table.qd, table.qdd, stamp)
        )

    def _turn(self, mode: Mode) -> None:
        """Bring the plate to rest, and let through from now on what a mode lets through."""
        self._run = None
        self._guard, table = self._guard.turned(mode, self._now())
        if table is not None:
            self._send(self._guard)

    def _watch(self) -> None:
        if not self.active:
            return
        now = self._now()
        before = self._guard.watchdog.patience
        guard, table = self._guard.watched(now)
        if table is None:
            self._guard = guard
        else:
            self.get_logger().warning(
                f"no plate_cycle for {before:.3g} s: the plate is brought to rest",
                throttle_duration_sec=QUIET_S,
            )
            self._send(guard)
        self._calibrate(now)
        self._tell_state()

    def _tell_state(self) -> None:
        """Publish whether the motors obey, when that changes."""
        state = self._guard.mode.value if self.active else "inactive"
        if self.active and not self._transport.connected:
            state = "error: the device is silent"
        if state != self._state:
            self._state = state
            self._driver_state.publish(String(data=state))

    # Services

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._turn(Mode.STOPPED)
        self._transport.stop()
        self._tell_state()
        self.get_logger().error("emergency stop: the plate brakes; call enable to go on")
        response.success, response.message = True, Mode.STOPPED.value
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._turn(Mode.READY if request.data else Mode.DISABLED)
        if request.data:
            self._transport.enable()
        else:
            self._transport.stop()
        self._tell_state()
        response.success, response.message = self.active, self._guard.mode.value
        return response

    def _on_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.active and self._guard.mode is Mode.DISABLED
        response.message = "the plate goes home"
        if not response.success:
            response.message = f"the driver is {self._state}, allowed: disabled; call enable, false"
        else:
            self._transport.home()
        return response

    def _on_calibrate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = False
        if not self._options.calibration_file:
            response.message = "calibration_file is '', allowed: the name of a file"
        elif not isinstance(self._transport, SerialTransport) or self._options.streams:
            response.message = "transport is sim or streams, allowed: serial with cycles"
        elif self._state != Mode.READY.value:
            response.message = f"the driver is {self._state}, allowed: ready"
        else:
            self._turn(Mode.CALIBRATING)
            self._experiment(Run(Calibration.begun(self._rig)), self._now())
            response.success, response.message = True, "see driver_state and diagnostics"
        return response

    def _experiment(self, run: Run, now: float) -> None:
        """Begin the next experiment of a calibration."""
        guard, played = self._guard.experimenting(run.cycle, now)
        self._run = run = run.playing(played)
        self._send(guard)
        self.get_logger().info(f"calibration: {run.calibration.progress}")

    def _calibrate(self, now: float) -> None:
        """Go on with the calibration when an experiment is over."""
        if self._run is None or not self._run.over:
            return
        try:
            calibration = self._run.heard()
            if calibration.cycle is not None:
                self._experiment(Run(calibration), now)
                return
            save_response(self._options.calibration_file, calibration.response)
            text = f"done: {self._options.calibration_file}, used from the next configure on"
        except PlateError as error:
            self._guard = self._guard.troubled("calibration failed")
            text = f"failed: {error}"
        self.get_logger().info(f"calibration {text}")
        self._turn(Mode.READY)

    def _publish_state(self) -> None:
        """Publish what was measured, or else what the motors were told to do now."""
        if isinstance(self._transport, SerialTransport):
            self._publish_measured()
            return
        if not self.active or self._guard.table is None:
            return
        now = self.get_clock().now()
        cycle = self._guard.table.cycle
        t = max(0.0, now.nanoseconds * 1e-9 - self._guard.sent_at) % cycle.period
        q, qd, _ = motor_state(self._rig, cycle.pose(t), cycle.twist(t), cycle.accel(t))
        msg = JointState(name=[motor.name for motor in self._rig.motors])
        msg.header.stamp = now.to_msg()
        msg.position, msg.velocity = q[0].tolist(), qd[0].tolist()
        self._states.publish(msg)

    def _publish_measured(self) -> None:
        measured, self._measured = self._measured, None
        if not self.active or measured is None:
            return
        msg = JointState(name=[motor.name for motor in self._rig.motors])
        age = Duration(seconds=max(0.0, time.monotonic() - measured.time))
        msg.header.stamp = (self.get_clock().now() - age).to_msg()
        msg.position = list(measured.telemetry.position)
        msg.effort = list(measured.telemetry.acceleration)
        self._states.publish(msg)

    def _report(self) -> None:
        if not self.active:
            return
        guard = self._guard
        record, self._guard = guard.record, replace(guard, record=guard.record.reported())
        status = DiagnosticStatus(name=self.get_fully_qualified_name(), hardware_id="plate")
        status.level = DiagnosticStatus.WARN if record.troubles else DiagnosticStatus.OK
        if self._state not in (Mode.READY.value, Mode.CALIBRATING.value):
            status.level = DiagnosticStatus.ERROR
        values = guard.values(REPORT_PERIOD_S, self._now()) | {"state": self._state}
        if self._run is not None:
            values["calibration"] = self._run.calibration.progress
        if isinstance(self._transport, SerialTransport):
            values |= self._transport.values()
        status.message = ", ".join(record.troubles) or "all cycles as asked"
        status.values = [KeyValue(key=k, value=v) for k, v in values.items()]
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(msg)


def main() -> None:
    """Run the driver."""
    run_node(DriverNode)
