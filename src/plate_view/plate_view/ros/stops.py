"""Commands that stop the plate. Other work of the page cannot delay these commands."""

from __future__ import annotations

import contextlib
import threading
from collections import deque

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..commands import URGENT
from .caller import Caller
from .pending import PendingCommand

END_S = 2.0
"""Maximum time to wait until the thread ends [s]."""


class Stops:
    """Calls the services that stop the plate. For these calls, the class uses a separate ROS node
    on a separate thread.

    Parameters
    ----------
    node : Node
        Node of the page.
    """

    def __init__(self, node: Node) -> None:
        self._waiting: deque[PendingCommand] = deque()
        self._node = Node(
            f"{node.get_name()}_stops", context=node.context, namespace=node.get_namespace(),
            use_global_arguments=False, start_parameter_services=False, enable_rosout=False,
        )  # fmt: skip
        self._caller = Caller(self._node)
        for name in URGENT:  # discover the services before they are needed
            self._caller.client(Trigger, name)
        self._guard = self._node.create_guard_condition(self._call_services)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._ended = False
        self._thread = threading.Thread(target=self._spin, name="stops", daemon=True)
        self._thread.start()

    def do(self, pending: PendingCommand) -> None:
        """Call a service, from any thread. The browser that sent the command receives the reply."""
        self._waiting.append(pending)
        self._guard.trigger()

    def close(self) -> None:
        """End the thread, and destroy the node."""
        self._ended = True
        self._guard.trigger()
        self._thread.join(END_S)
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not self._ended:
                self._executor.spin_once()

    def _call_services(self) -> None:
        """Call a service only once for all waiting commands with the same name, so that many
        commands do not delay each other."""
        waiting: dict[str, list[PendingCommand]] = {}
        while self._waiting:
            pending = self._waiting.popleft()
            waiting.setdefault(pending.command.name, []).append(pending)
        for name, (first, *others) in waiting.items():

            def on_answer(ok: bool, text: str, others: list[PendingCommand] = others) -> None:
                for call in others:
                    call.answer(ok, text)

            first.answered = on_answer
            self._caller.call(first, Trigger, name, Trigger.Request(), first.done)
