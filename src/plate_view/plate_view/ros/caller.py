"""Asynchronous calls of the services of other nodes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from plate_core import PlateError
from plate_core.ros import CALLS

from ..commands import URGENT
from .pending import PendingCommand

ANSWER_S = 5.0
"""Maximum wait for the reply of a service [s]."""

URGENT_S = 1.0
"""Maximum wait for the reply to an urgent command [s]."""

AGAIN_S = 0.25
"""Interval at which a request to stop is repeated until there is a reply [s]."""

POLL_S = 0.02
"""Interval at which pending calls are polled [s]."""

Then = Callable[[Any], None]


class Caller:
    """The service clients of a node, and its pending calls.

    Parameters
    ----------
    node : Node

    Attributes
    ----------
    pollers : set of callables
        Functions that are called every `POLL_S`, see `poll`.
    """

    def __init__(self, node: Node) -> None:
        self._node, self._clients = node, dict[str, Any]()
        self.pollers: set[Callable[[], None]] = set()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(POLL_S, self._poll_calls, clock=steady)

    def close(self) -> None:
        """Destroy all clients."""
        self._node.destroy_timer(self._timer)
        for client in self._clients.values():
            self._node.destroy_client(client)

    def poll(self, poller: Callable[[], None]) -> None:
        """Call `poller` every `POLL_S` while it is in `pollers`."""
        if not self.pollers:
            self._timer.reset()
        self.pollers.add(poller)

    def _poll_calls(self) -> None:
        for poller in list(self.pollers):
            poller()
        if not self.pollers:  # stop the timer if no calls are pending
            self._timer.cancel()

    def client(self, kind: Any, name: str) -> Any:
        """Return the client of a service. If the client is created early, ROS has discovered the
        service before the client is needed."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name, qos_profile=CALLS)
        return self._clients[name]

    def call(self, pending: PendingCommand, kind: Any, name: str, request: Any, then: Then) -> None:
        """Call a service, and call `then` with the response of the service.

        An urgent request is repeated until there is a reply. DDS may lose the reply of a node that
        has just started.
        """
        client = self.client(kind, name)
        urgent = pending.command.name in URGENT
        end = time.monotonic() + (URGENT_S if urgent else ANSWER_S)
        again_s = AGAIN_S if urgent else math.inf
        sent: list[Any] = []
        last = 0.0

        def on_answer(future: Any) -> None:
            if future not in sent:  # ignore this reply, because an earlier reply has ended the call
                return
            self.pollers.discard(check_timeout)
            for request_future in sent:
                client.remove_pending_request(request_future)
            sent.clear()
            if not future.cancelled():
                try:
                    then(future.result())
                except PlateError as error:
                    pending.refuse(str(error))

        def check_timeout() -> None:
            nonlocal last
            now = time.monotonic()
            due = not sent or now - last > again_s
            if now < end and due and client.service_is_ready():
                last = now
                sent.append(client.call_async(request))
                sent[-1].add_done_callback(on_answer)
            elif now > end:
                self.pollers.discard(check_timeout)
                for future in sent:
                    client.remove_pending_request(future)
                pending.refuse(f"{name} {'does not reply' if sent else 'is not available'}")

        self.poll(check_timeout)
        check_timeout()
