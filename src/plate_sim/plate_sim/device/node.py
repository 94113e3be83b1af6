"""ROS node that emulates the motor controller on a pseudo-terminal in real time. The driver node
can use this pseudo-terminal in the same way as the serial port of a real board."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from plate_core import load_rig
from plate_core.ros import (
    DATA,
    NodeOptions,
    SafeLifecycleNode,
    parameter,
    run_node,
    to_time,
    trajectory_to_msg,
)
from plate_core.status import Finding, Level

from .emulator import TICK_US, Emulator
from .faults import FaultSchedule, LineFaults
from .firmware import FirmwareOnDesk
from .limits import DeviceLimits
from .plate import Segment, SuspendedPlate
from .pty import PseudoTerminal

SERVE_PERIOD_S = 0.002
"""Time between two reads of the port [s]. The value is the duration of two ticks of the device."""

MAX_BEHIND_US = 100_000
"""On a busy computer, the simulated device may lag behind the computer's clock. This value is the
maximum lag that the device makes up at once [us]. If the lag is longer, the device omits the rest.
Without this limit, the device would report a timeout, although the host has sent messages in
time."""

HOST_SILENT_S, HOST_ENDS_S = 0.3, 2.0
"""When the process must end, the device first waits until it has received no bytes from the host
for `HOST_SILENT_S`, at most `HOST_ENDS_S` [s]."""


def _fraction_parameter(description: str) -> Any:
    return parameter(0.0, description, 0.0, 1.0, live=True)


def _period_parameter(description: str) -> Any:
    return parameter(0.0, description, 0.0, 1e5, live=True)


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the device."""

    link: str = parameter("/tmp/plate_device", "Name of the serial port to create.")
    seed: int = parameter(0, "Seed of the random faults.", 0, 2**31 - 1)
    firmware: str = parameter(
        "",
        "Program of the firmware for drives on a CAN bus. It runs with simulated drives. If it is "
        "empty, there is no bus.",
    )
    baud: float = parameter(
        921_600.0, "Speed of the line [bit/s]. 0 means that bytes take no time.", 0, 1e9, live=True
    )
    dropped: float = _fraction_parameter("Fraction of bytes that are lost on the line.")
    corrupted: float = _fraction_parameter("Fraction of bytes that are changed on the line.")
    repeated: float = _fraction_parameter("Fraction of bytes that are repeated on the line.")
    split: float = _fraction_parameter("Fraction of transmissions that arrive in two parts.")
    delay: float = parameter(0.0, "Delay of the line in each direction [s].", 0.0, 1.0, live=True)
    disconnect_every: float = _period_parameter(
        "Time between two disconnections [s]. 0 disables them."
    )
    disconnect_s: float = parameter(2.0, "Duration of a disconnection [s].", 0.0, 1e3, live=True)
    reset_every: float = _period_parameter(
        "Time between two resets of the device [s]. 0 disables them."
    )
    brown_out_every: float = _period_parameter("Time between two brown-outs [s]. 0 disables them.")

    @property
    def schedule(self) -> FaultSchedule:
        """Schedule of faults that results from the node's parameters."""
        line = LineFaults(**{f.name: getattr(self, f.name) for f in fields(LineFaults)})
        field_names = [f.name for f in fields(FaultSchedule) if f.name != "line"]
        return FaultSchedule(line, **{name: getattr(self, name) for name in field_names})


class DeviceNode(SafeLifecycleNode[Options]):
    """Lifecycle node `device`. The node emulates a motor controller on a pseudo-terminal in real
    time.

    The node publishes motor_motion, camera_trigger and diagnostics. The node communicates by the
    serial protocol on the port `link`.

    motor_motion contains the executed motion of the motors in segments. The stamp of a segment is
    its start time. The simulator's plate follows this motion. For each trigger pulse, the node
    publishes a message camera_trigger whose stamp is the time of the pulse. A segment ends at each
    pulse, and this segment is published before camera_trigger. The port exists from the
    configuration of the node on. While the node is not active, the device has no power. On
    activation, the device restarts.
    """

    def __init__(self) -> None:
        super().__init__("device", Options)
        self.report(self._diagnose, self._diagnostic_values, "device", self._begin_report)

    def configure(self) -> None:
        """Read the rig file, and create the serial port."""
        options = self.options
        self._rig = load_rig(options.rig_file)
        self._emulator = self._make_device()
        self._terminal = PseudoTerminal(options.link)
        self.keep(PseudoTerminal.close, self._terminal)
        self._terminal.plug()
        self._motions = self.managed_publisher(JointTrajectory, "motor_motion", DATA)
        self._pulses = self.managed_publisher(Header, "camera_trigger", DATA)
        self.managed_timer(SERVE_PERIOD_S, self._on_serve_timer)
        self.get_logger().info(f"serial port: {options.link}")

    def _make_device(self) -> Emulator | FirmwareOnDesk:
        options, rig = self.options, self._rig
        if options.firmware:
            desk = FirmwareOnDesk(options.firmware, rig, options.seed, options.schedule)
            self.keep(FirmwareOnDesk.close, desk)
            return desk
        plate = SuspendedPlate(rig, TICK_US * 1e-6) if rig.suspension else None
        limits = DeviceLimits.of_rig(rig)
        return Emulator(limits, options.seed, options.schedule, plate=plate)

    def begin(self) -> None:
        """Switch the device on."""
        now_us = self._emulator.now_us
        self._begin_ns = self.get_clock().now().nanoseconds - 1_000 * now_us
        self._steady_ns = time.monotonic_ns() - 1_000 * now_us
        self._late_ms = self._lost_ms = self._received_at = 0.0
        self._terminal.read()  # a device without power discards the bytes that it receives

    def before_end(self) -> None:
        """Continue until the host is silent. If all processes are interrupted together, the driver
        still makes the device brake, and waits for its reply. A real board also runs longer than
        its driver."""
        end = time.monotonic() + HOST_ENDS_S
        while time.monotonic() < min(end, self._received_at + HOST_SILENT_S):
            self._on_serve_timer()
            time.sleep(SERVE_PERIOD_S)

    def rest(self) -> None:
        """Switch the device off. The device then loses its state."""
        self._emulator.reset()

    def retune(self) -> None:
        """Apply new values of the parameters for faults."""
        self._emulator.configure(self.options.schedule)

    def _on_serve_timer(self) -> None:
        """Simulate the device up to the current time, and exchange bytes with the port."""
        emulator, received = self._emulator, self._terminal.read()
        if received:
            self._received_at = time.monotonic()
        due = (time.monotonic_ns() - self._steady_ns) // 1_000 - emulator.now_us
        self._late_ms = max(self._late_ms, due * 1e-3 - 1e3 * SERVE_PERIOD_S)
        lost = max(0, due - MAX_BEHIND_US)
        due -= lost
        self._steady_ns += 1_000 * lost
        self._begin_ns += 1_000 * lost
        self._lost_ms += lost * 1e-3
        if emulator.connected != self._terminal.plugged:
            (self._terminal.plug if emulator.connected else self._terminal.unplug)()
        ticks = due // TICK_US
        # The bytes from the host are stamped with the present time. The simulated time of the
        # device lags behind, and the host sent the bytes after this time.
        emulator.to_device.sent(received, emulator.now + ticks * TICK_US * 1e-6)
        for _ in range(ticks):
            for segment in emulator.tick():
                self._publish_motion(segment)
            if emulator.triggered:
                self._pulses.publish(Header(stamp=self._to_ros_time(emulator.now)))
        self._terminal.write(emulator.to_host.arrived(emulator.now))

    def _publish_motion(self, segment: Segment) -> None:
        joints = [motor.name for motor in self._rig.motors]
        q, qd, qdd = segment.motors.transpose(1, 0, 2)
        stamp = self._to_ros_time(segment.start)
        self._motions.publish(trajectory_to_msg(joints, segment.times, q, qd, qdd, stamp))

    def _to_ros_time(self, time_s: float) -> Time:
        """Convert a time of the device's clock [s] to a ROS stamp."""
        return to_time(self._begin_ns + round(time_s * 1e9))

    def _diagnose(self, _: float) -> Finding:
        faults = self._emulator.faults
        names = [fault.name.lower().replace("_", " ") for fault in faults if fault.name]
        level = Level.WARN if faults else Level.OK
        return Finding(level, ", ".join(names) or str(self._emulator.values()["state"]))

    def _diagnostic_values(self) -> Mapping[str, object]:
        return {
            **self._emulator.values(),
            "latest tick [ms]": f"{self._late_ms:.1f}",
            "clock stalled [ms]": f"{self._lost_ms:.0f}",
        }

    def _begin_report(self) -> None:
        self._late_ms = 0.0


def main() -> None:
    """Run the device."""
    run_node(DeviceNode, Options)
