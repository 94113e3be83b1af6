"""An executor that needs less CPU time for nodes with many topics."""

import math
import time

from rclpy.event_handler import EventHandler
from rclpy.executors import SingleThreadedExecutor

from .rclpy_workarounds import can_execute

EVENTS_S = 1.0
"""Period of the checks for middleware events [s]."""


class NodeExecutor(SingleThreadedExecutor):
    """A `SingleThreadedExecutor` that checks for middleware events only once per second.

    An incompatible quality of service, for example, causes such an event. Each publisher and each
    subscription has two event handlers. Events stay queued until they are checked. Rare checks
    reduce the CPU time of an idle graph by 20 %, compared with checks in every round.
    """

    _next_check, _checking = -math.inf, False

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Execute one callback that is ready. If no callback is ready, wait up to `timeout_sec`
        [s]."""
        now = time.monotonic()
        self._checking = now >= self._next_check
        if self._checking:
            self._next_check = now + EVENTS_S
        super().spin_once(timeout_sec)

    def can_execute(self, entity: object) -> bool:
        """Return whether the executor waits for an entity (such as a subscription or a timer) in
        this round."""
        return (self._checking or not isinstance(entity, EventHandler)) and can_execute(entity)
