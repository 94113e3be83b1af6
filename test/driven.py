"""The driver's node in the process of a test. The test is its clock and executor, so nothing
waits."""

import threading
import time
from collections import defaultdict
from types import SimpleNamespace

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.clock import ClockType
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.time import Time
from shaking import shaking
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import cycle_to_msg, nanoseconds, start_nodes, to_time
from plate_driver.node import DriverNode
from plate_driver.status import CHECK_RIG
from plate_driver.transports import TransportThread

TICK_S = 0.01
"""Step of the clock [s]. All periods of the driver's timers are multiples of it."""

EMERGENCY, CUT = (f"stopped: {what}; {CHECK_RIG}" for what in ("emergency stop", "power cut"))

EPOCH_NS = 1_700_000_000_000_000_000


class Clock:
    """Time of the test. It replaces the module `time` [s], and the clock of images."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now

    def time_ns(self):
        return EPOCH_NS + round(1e9 * self.now)

    def sleep(self, seconds):
        if threading.current_thread() is threading.main_thread():
            self.now += seconds
        else:
            time.sleep(seconds)


class Log:
    """All lines that a node logs, except those of level debug. Throttled lines are included."""

    def __init__(self):
        self.lines = []
        self.error = self.warning = self.info = self._line
        self.debug = lambda text, **_: None

    def _line(self, text, **_):
        self.lines.append(text)


class Driven:
    """A driver with its published messages, and functions that send it messages and calls.

    Parameters
    ----------
    monkeypatch
    parameters : str
        Parameters of the node, each `name:=value`. With `use_sim_time:=true` the clock of images is
        ROS's.
    start : bool
        Whether the node is configured and activated.
    """

    def __init__(self, monkeypatch, *parameters, start=True):
        self.clock = Clock()
        self.log = Log()
        self.published = defaultdict(list)
        self._ticks = 0
        for module in (
            "plate_core.ros.diagnostics", "plate_driver.node", "plate_driver.safety.node",
            "plate_driver.transports.thread", "plate_driver.transport_owner",
            "plate_driver.ros.raw_inputs",
        ):  # fmt: skip
            monkeypatch.setattr(f"{module}.time", self.clock)
        monkeypatch.setattr(TransportThread, "start", lambda _: None)  # `pass_time` polls
        publish = Publisher.publish

        def record_and_publish(publisher, msg):
            self.published[publisher.topic_name.rsplit("/", 1)[1]].append(msg)
            publish(publisher, msg)

        monkeypatch.setattr(Publisher, "publish", record_and_publish)
        words = ["--ros-args", "-r", "__ns:=/driven"]
        rclpy.init(args=words + [word for each in parameters for word in ("-p", each)])
        self.node = DriverNode()
        self.node.get_logger = lambda: self.log
        if "use_sim_time:=true" not in parameters:
            self.node.get_clock = lambda: SimpleNamespace(now=self._now)
        if start:
            start_nodes(self.node)

    def _now(self):
        return Time(nanoseconds=self.clock.time_ns(), clock_type=ClockType.ROS_TIME)

    def pass_time(self, seconds):
        """Advance the time by `seconds`, and call the transports and the node's timers when they
        are due."""
        for _ in range(round(seconds / TICK_S)):
            self.clock.now += TICK_S
            self._ticks += 1
            transports = self.node.transports
            for transport in filter(None, (transports.current, transports.temporary)):
                transport.poll()
            for timer in [*self.node.timers, *self.node._safety.node.timers]:
                if self._ticks % round(timer.timer_period_ns * 1e-9 / TICK_S) == 0:
                    timer.callback()

    # Messages and calls to the node

    def send(self, cycle, stamp_ns=None, source=b"solver"):
        """Send the node a cycle with a stamp (default: now). Return the stamp, or the reason of the
        refusal."""
        stamp_ns = self.clock.time_ns() if stamp_ns is None else stamp_ns
        why = self.send_bytes(serialize_message(cycle_to_msg(cycle, to_time(stamp_ns))), source)
        return why or stamp_ns

    def send_bytes(self, data, source=b"solver"):
        """Send the node bytes as a cycle. Return the reason of the refusal, or an empty text."""
        lines, answers = len(self.log.lines), len(self.setpoints)
        self.node.take_cycle(data, len(data), source)
        why = [line for line in self.log.lines[lines:] if line.startswith("cycle refused: ")]
        assert len(why) == 1 - len(self.setpoints[answers:])  # one or the other
        return why[0].removeprefix("cycle refused: ") if why else ""

    def call(self, name, request=None):
        """Call a service of the node, and return the reply."""
        services = [*self.node.services, *self.node._safety.node.services]
        [service] = [each for each in services if each.srv_name.split("/")[-1] == name]
        answer = service.callback(request or Trigger.Request(), service.srv_type.Response())
        self.node._safety.publish_status()
        return answer

    def enable(self, on=True):
        return self.call("enable", SetBool.Request(data=on))

    # Messages of the node

    @property
    def setpoints(self):
        return self.published["motor_setpoints"]

    def stamps(self):
        return [nanoseconds(msg.header.stamp) for msg in self.setpoints]

    @property
    def texts(self):
        """Texts of driver_status, without repetitions."""
        texts = []
        for text in [msg.text for msg in self.published["driver_status"]]:
            texts += [text] if texts[-1:] != [text] else []
        return texts

    @property
    def report(self):
        """The last diagnostics."""
        return self.published["diagnostics"][-1].status[0]

    def values(self):
        """Return the values of each diagnostics message, by name."""
        return [
            {v.key: v.value for v in msg.status[0].values} for msg in self.published["diagnostics"]
        ]

    def close(self):
        self.node.destroy_node()
        rclpy.try_shutdown()


def answered_once(calls, wait):
    """Call each client, and repeat the call if there is no reply. A reply is lost if the server has
    not discovered the client yet.

    Parameters
    ----------
    calls : list
        Clients and their requests.
    wait : callable
        Waits until a condition is true, for a maximum time [s]. Returns whether it is true.
    """
    requested = [[] for _ in calls]

    def silent(futures):
        return not any(future.done() for future in futures)

    for _ in range(20):
        for (client, request), futures in zip(calls, requested, strict=True):
            if silent(futures):
                futures.append(client.call_async(request))
        if wait(lambda: not any(map(silent, requested)), 3.0):
            return True
    return False


CALM = shaking(0.0005, 0.3)


def at_rest(msg: JointTrajectory) -> bool:
    return not any(
        value for p in msg.points for value in (*p.positions, *p.velocities, *p.accelerations)
    )


def transition(label: str) -> ChangeState.Request:
    return ChangeState.Request(transition=Transition(label=label))
