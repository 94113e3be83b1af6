"""Clock that a test advances, for nodes in its process that receive each other's messages at
once."""

import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.executors import TimeoutException
from rclpy.time import Time

from plate_core.ros import NodeExecutor

STEP_S = 0.05
"""Maximum step of the time if no callback is ready [s]. A timer that is due earlier shortens the
step."""

OTHERS_S = 0.001
"""Real time that the threads of the middleware get before each step [s], for discovery and latched
messages."""

MAX_S = 60.0
"""Maximum simulated time of a wait [s]."""


class SteppedClock:
    """Clock that stands still until it is advanced. In all imported modules of the project it
    replaces the module `time`, the system clock and the steady clock."""

    def __init__(self, monkeypatch):
        self.ns, self._led = 10**12, []
        self.steady_ahead_s = 0.0  # the steady clock's lead, as after a step back of the other
        self.clock = Clock(clock_type=ClockType.ROS_TIME)
        self.lead(self.clock)

        def make(clock_type):
            return Clock(clock_type=clock_type) if clock_type is ClockType.ROS_TIME else self.clock

        for module in [each for name, each in sys.modules.items() if name.startswith("plate_")]:
            if getattr(module, "time", None) is time:
                monkeypatch.setattr(module, "time", self)
            if getattr(module, "Clock", None) is Clock:
                monkeypatch.setattr(module, "Clock", make)

    def __getattr__(self, name):
        return getattr(time, name)

    def monotonic_ns(self):
        return self.ns

    def monotonic(self):
        return 1e-9 * self.ns + self.steady_ahead_s

    def lead(self, clock):
        """Let a node's clock follow this one."""
        clock._set_ros_time_is_active(True)  # rclpy has no public name for it
        self._led.append(clock)
        self.step(0.0)

    def step(self, seconds=STEP_S):
        self.go_to(self.ns + round(1e9 * seconds))

    def go_to(self, ns):
        self.ns = ns
        for clock in self._led:
            clock.set_ros_time_override(Time(nanoseconds=ns, clock_type=ClockType.ROS_TIME))


class SteppedExecutor(NodeExecutor):
    """Executor that advances the clock when no callback of its nodes is ready."""

    def __init__(self, clock):
        super().__init__()
        self.clock = clock

    def spin_once(self, timeout_sec=STEP_S):
        """Call one callback. If none is ready, advance the time."""
        self._spin_once(self.clock.ns + round(1e9 * timeout_sec))

    def settle(self):
        """Call all callbacks that are ready."""
        while self._turn():
            pass

    def spin_for(self, seconds):
        end = self.clock.ns + round(1e9 * seconds)
        while self.clock.ns < end:
            self._spin_once(end)
        self.settle()

    def until(self, condition):
        end = self.clock.monotonic() + MAX_S
        while not condition():
            assert self.clock.monotonic() < end, "it did not come"
            self.spin_once()

    def _spin_once(self, latest):
        if not self._turn():
            time.sleep(OTHERS_S)
            timers = [timer for node in self.get_nodes() for timer in node.timers]
            dues = [self.clock.ns + max(1, timer.time_until_next_call()) for timer in timers]
            self.clock.go_to(min([latest, *dues]))

    def _turn(self):
        for _ in range(2):  # the first attempt may find the end of a round
            try:
                handler, *_ = self.wait_for_ready_callbacks(timeout_sec=0)
            except TimeoutException:
                continue
            handler()
            if handler.exception() is not None:
                raise handler.exception()
            return True
        return False
