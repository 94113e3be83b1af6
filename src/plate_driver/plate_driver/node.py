"""The driver node: plate cycles in, motor tables out, within the limits and never left moving."""

from __future__ import annotations

import functools
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateError, Rig, load_rig
from plate_core.kinematics import motor_state
from plate_core.ros.convert import msg_to_cycle, nanoseconds, to_time, trajectory_to_msg
from plate_core.ros.main import run_node
from plate_core.ros.params import declare, follow, parameter
from plate_core.ros.qos import DATA

from .motor_table import MotorTable, check_order, prepare
from .record import Record
from .serial_transport import Measured, SerialTransport, open_port
from .transport import SimTransport, Transport, check_transport
from .watchdog import Watchdog

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
    hold_cycles: int = parameter(
        5, "Periods that the plate goes on without a new cycle before it rests.", 1, 1000, live=True
    )
    repeats: int = parameter(
        1, "Times that a cycle which does not start at rest is played.", 1, 100, live=True
    )
    state_rate: float = parameter(10.0, "Messages of motor_states [1/s]; 0: none.", 0.0, 200.0)
    autostart: bool = parameter(True, "Configure and activate at start.")


Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def logged(transition: Transition) -> Transition:
    """Log what a transition raises: rclpy turns it into an error state without a word."""

    @functools.wraps(transition)
    def wrapper(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except PlateError as error:
            self.problem = str(error)
            self.get_logger().error(f"{transition.__name__}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception:  # whatever it is: unlogged, it would be an error state without a reason
            self.problem = traceback.format_exc()
            self.get_logger().error(f"{transition.__name__} failed:\n{self.problem}")
            return TransitionCallbackReturn.ERROR

    return wrapper


class DriverNode(LifecycleNode):
    """Lifecycle node `driver`: subscribes plate_cycle, publishes motor_setpoints, motor_states and
    diagnostics while active, and brings the plate to rest before it stops being active.

    With serial transport motor_states are measured: position [m], and in `effort`, since JointState
    has no field for it, acceleration [m/s2]; stamped by the device's clock."""

    def __init__(self) -> None:
        super().__init__("driver")
        self.problem = ""
        self._active = False
        self._last_ns: int | None = None
        self._table: MotorTable | None = None
        self._sent_at = 0.0
        self._watchdog = Watchdog()
        self._record = Record()
        self._timers_made: list[Any] = []
        self._subscription: Any = None
        self._publishers_made: list[Any] = []
        self._options = declare(self, Options)
        check_transport(self._options.transport, self._options.port)
        self._measured: Measured | None = None
        self._follow = follow(self, self._options, self._set_options)
        if self._options.autostart:
            self._autostart()

    def _autostart(self) -> None:
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise PlateError(self.problem)

    def _set_options(self, options: Options) -> None:
        self._options = options

    # Transitions

    @logged
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the rig, open the transport, make publishers, subscription and timers."""
        self._rig: Rig = load_rig(self._options.rig_file)
        self._setpoints = self.create_lifecycle_publisher(JointTrajectory, "motor_setpoints", DATA)
        self._states = self.create_lifecycle_publisher(JointState, "motor_states", DATA)
        self._diagnostics = self.create_lifecycle_publisher(DiagnosticArray, "diagnostics", DATA)
        self._publishers_made = [self._setpoints, self._states, self._diagnostics]
        self._transport: Transport = self._make_transport()
        self._transport.open()
        self._subscription = self.create_subscription(
            JointTrajectory, "plate_cycle", self._on_cycle, DATA
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # ticks also while simulated time stands
        timers = [(WATCH_PERIOD_S, self._watch), (REPORT_PERIOD_S, self._report)]
        if isinstance(self._transport, SerialTransport):
            timers.append((POLL_PERIOD_S, self._poll))
        if self._options.state_rate > 0:
            timers.append((1 / self._options.state_rate, self._publish_state))
        self._timers_made = [self.create_timer(t, tick, clock=steady) for t, tick in timers]
        return super().on_configure(state)

    @logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen and to publish."""
        result = super().on_activate(state)
        self._active = True
        return result

    @logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the plate to rest, then fall silent."""
        self._stop()
        return super().on_deactivate(state)

    @logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that on_configure made."""
        self._release()
        return super().on_cleanup(state)

    @logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the plate to rest and release everything."""
        self._stop()
        self._release()
        return super().on_shutdown(state)

    @logged
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the plate to rest if that still works, and begin anew from unconfigured."""
        self._stop()
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Bring the plate to rest, also when the process is told to stop."""
        if self._active and self.context.ok():
            self.trigger_deactivate()
        super().destroy_node()

    def _stop(self) -> None:
        if not self._active:
            return
        self._active = False
        self._rest()
        if not self._setpoints.wait_for_all_acked(Duration(seconds=FAREWELL_S)):
            self.get_logger().debug("not everyone has confirmed the last motor table")

    def _release(self) -> None:
        for timer in self._timers_made:
            self.destroy_timer(timer)
        if self._subscription is not None:
            self.destroy_subscription(self._subscription)
            self._transport.close()
        for publisher in self._publishers_made:
            self.destroy_lifecycle_publisher(publisher)
        self._timers_made, self._subscription, self._publishers_made = [], None, []
        self._last_ns, self._table, self._watchdog = None, None, Watchdog()
        self._measured = None

    # Work

    def _make_transport(self) -> Transport:
        if self._options.transport == "sim":
            return SimTransport(self._publish)
        port = self._options.port
        return SerialTransport(lambda: open_port(port), time.monotonic, time.time_ns() % 2**32)

    def _poll(self) -> None:
        """Serve the serial link, and tell what is wrong with it."""
        if not isinstance(self._transport, SerialTransport):
            return
        for measured in self._transport.poll():
            self._measured = measured
        for trouble in self._transport.troubles():
            self._record = self._record.trouble(trouble)
            self.get_logger().warning(trouble, throttle_duration_sec=QUIET_S)

    def _now(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def _on_cycle(self, msg: JointTrajectory) -> None:
        if not self._active:
            return
        stamp_ns = nanoseconds(msg.header.stamp)
        try:
            check_order(self._last_ns, stamp_ns)
            table, fit = prepare(self._rig, msg_to_cycle(msg), stamp_ns, self._options.repeats)
            self._send(table)
        except PlateError as error:
            self._record = self._record.refusal()
            self.get_logger().warning(f"cycle refused: {error}", throttle_duration_sec=QUIET_S)
            return
        self._last_ns = stamp_ns
        self._watchdog = self._watchdog.fed(
            self._sent_at, table.cycle.period, self._options.hold_cycles
        )
        self._record = self._record.accepted(fit)
        if fit.factor < WORTH_A_WARNING:
            self.get_logger().warning(
                f"cycle scaled by {fit.factor:.3g}: it used {fit.asked.worst:.3g} times the limits "
                f"({fit.asked.stroke_m * 1e3:.3g} mm, {fit.asked.speed:.3g} m/s, "
                f"{fit.asked.accel:.3g} m/s2)",
                throttle_duration_sec=QUIET_S,
            )

    def _send(self, table: MotorTable) -> None:
        self._transport.send(table)
        if isinstance(self._transport, SerialTransport):
            self._publish(table)
        self._table, self._sent_at = table, self._now()

    def _publish(self, table: MotorTable) -> None:
        joints = [motor.name for motor in self._rig.motors]
        stamp = to_time(table.stamp_ns)
        self._setpoints.publish(
            trajectory_to_msg(joints, table.cycle.times, table.q, table.qd, table.qdd, stamp)
        )

    def _rest(self) -> None:
        """Send the table that keeps the plate at home; nothing to do if none was ever sent."""
        self._watchdog = self._watchdog.rested()
        if self._table is not None:
            period = self._table.cycle.period
            self._send(MotorTable.rest(self._rig, period, self._table.stamp_ns))

    def _watch(self) -> None:
        now = self._now()
        self._watchdog = self._watchdog.synchronised(now)
        if self._active and self._watchdog.tripped(now):
            self.get_logger().warning(
                f"no plate_cycle for {self._watchdog.patience:.3g} s: the plate is brought to rest",
                throttle_duration_sec=QUIET_S,
            )
            self._record = self._record.rest()
            self._rest()

    def _publish_state(self) -> None:
        """Publish what was measured, or else what the motors were told to do now."""
        if isinstance(self._transport, SerialTransport):
            self._publish_measured()
            return
        if not self._active or self._table is None:
            return
        now = self.get_clock().now()
        cycle = self._table.cycle
        t = max(0.0, now.nanoseconds * 1e-9 - self._sent_at) % cycle.period
        q, qd, _ = motor_state(self._rig, cycle.pose(t), cycle.twist(t), cycle.accel(t))
        msg = JointState(name=[motor.name for motor in self._rig.motors])
        msg.header.stamp = now.to_msg()
        msg.position, msg.velocity = q[0].tolist(), qd[0].tolist()
        self._states.publish(msg)

    def _publish_measured(self) -> None:
        measured, self._measured = self._measured, None
        if not self._active or measured is None:
            return
        msg = JointState(name=[motor.name for motor in self._rig.motors])
        age = Duration(seconds=max(0.0, time.monotonic() - measured.time))
        msg.header.stamp = (self.get_clock().now() - age).to_msg()
        msg.position = list(measured.telemetry.position)
        msg.effort = list(measured.telemetry.acceleration)
        self._states.publish(msg)

    def _report(self) -> None:
        if not self._active:
            return
        record, self._record = self._record, self._record.reported()
        status = DiagnosticStatus(name=self.get_fully_qualified_name(), hardware_id="plate")
        status.level = DiagnosticStatus.WARN if record.troubles else DiagnosticStatus.OK
        status.message = ", ".join(record.troubles) or "all cycles as asked"
        status.values = [KeyValue(key=k, value=v) for k, v in record.values().items()]
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(msg)


def main() -> None:
    """Run the driver."""
    run_node(DriverNode)
