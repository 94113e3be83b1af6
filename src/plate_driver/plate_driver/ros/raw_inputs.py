"""Subscriptions to plate_cycle and task_status. The driver deserializes the messages of both topics
itself, so that a long message does not delay a stop."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import DATA, LATCHED, UnlockedSubscription
from plate_interfaces.msg import TaskStatus

from ..raw_cycle import HEAD_BYTES, POINT_BYTES
from ..setpoints import MAX_KNOTS

CLOSE_S = 0.05
"""Maximum time after `close` until the thread that waits for cycles ends [s]."""

BUSY_S = 0.002
"""Time between two checks whether the executor has processed a cycle, while too many cycles wait
[s]."""

MAX_WAITING = 5
"""Maximum number of messages that wait for the executor. This limit leaves the executor time for
other work if messages arrive too fast."""

STATUS_BYTES = 100_000
"""Maximum size of a task_status [bytes]. The planner never sends a longer message."""

STALLED_S = 0.05
"""Time without a poll after which the process counts as stalled [s]."""

SETTLE_S = 0.01
"""Time for which the process waits after a stall, so that it receives all waiting messages [s].
Without this wait, a cycle could be processed before an earlier message that reports the end of its
task."""

Process = Callable[[bytes, int, bytes], None]
"""Callback for a message. The arguments of the callback are the first bytes of the serialized
message, the length of the message [bytes], and a key that identifies the publisher."""


class RawInput(NamedTuple):
    """A subscription, and the callback for its messages."""

    subscription: UnlockedSubscription
    process: Process


class RawInputs:
    """Subscriptions to plate_cycle and task_status. A thread receives the cycles, and `poll_tasks`
    receives the task_status messages.

    Parameters
    ----------
    node : Node
        Node whose executor calls `on_cycle`.
    on_cycle, on_task : callable
        Callbacks for the messages.
    """

    def __init__(self, node: Node, on_cycle: Process, on_task: Process) -> None:
        self._node = node
        max_bytes = HEAD_BYTES + POINT_BYTES * MAX_KNOTS
        cycles = UnlockedSubscription(node, JointTrajectory, "plate_cycle", DATA, max_bytes)
        tasks = UnlockedSubscription(node, TaskStatus, "task_status", LATCHED, STATUS_BYTES)
        self.cycles, self.tasks = RawInput(cycles, on_cycle), RawInput(tasks, on_task)
        # Received cycles that the executor has not processed yet, in the order of arrival.
        self._waiting: deque[tuple[bytes, int, bytes]] = deque()
        self._polled_at = 0.0  # time of the last poll of task_status [s, steady]
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._receive_cycles, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, drop waiting messages, and destroy the subscriptions."""
        self._closed.set()
        self._thread.join()
        self._waiting.clear()
        self.cycles.subscription.destroy()
        self.tasks.subscription.destroy()

    def poll_tasks(self) -> None:
        """Process the waiting messages on task_status. Call this method about every 20 ms."""
        if time.monotonic() - self._polled_at > STALLED_S:
            time.sleep(SETTLE_S)
        self._polled_at = time.monotonic()
        for _ in range(MAX_WAITING):
            message = self.tasks.subscription.take()
            if message is None:
                break
            self.tasks.process(*message)

    def _receive_cycles(self) -> None:
        """Pass received cycles to the executor until `close`."""
        while not self._closed.is_set():
            executor = self._node.executor
            if executor is None or len(self._waiting) >= MAX_WAITING:
                self._closed.wait(BUSY_S)
                continue
            message = self.cycles.subscription.take()
            if message is None:
                self.cycles.subscription.wait(CLOSE_S)
                continue
            self._waiting.append(message)
            executor.create_task(self._process_cycle)

    def _process_cycle(self) -> None:
        """Process the oldest received cycle, unless the inputs were closed in the meantime."""
        if self._waiting:
            self.cycles.process(*self._waiting.popleft())
