"""Commands that stop: nothing else that the page does holds them up."""

from __future__ import annotations

import contextlib
import threading
from collections import deque

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..commands import URGENT
from .asked import Asked
from .caller import Caller

END_S = 2.0
"""Longest wait for the thread at the end [s]."""


class Stops:
    """Calls the services that stop, by a node and a thread of its own.

    Parameters
    ----------
    node : Node
        The page's.
    """

    def __init__(self, node: Node) -> None:
        self._waiting: deque[Asked] = deque()
        self._node = Node(
            f"{node.get_name()}_stops", context=node.context, namespace=node.get_namespace(),
            use_global_arguments=False, start_parameter_services=False, enable_rosout=False,
        )  # fmt: skip
        self._caller = Caller(self._node)
        for name in URGENT:  # found before they are needed
            self._caller.client(Trigger, name)
        self._guard = self._node.create_guard_condition(self._call)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._ended = False
        self._thread = threading.Thread(target=self._spin, name="stops", daemon=True)
        self._thread.start()

    def do(self, asked: Asked) -> None:
        """Call a service, from any thread; the answer goes to who has asked."""
        self._waiting.append(asked)
        self._guard.trigger()

    def close(self) -> None:
        """End the thread, and let go of the node."""
        self._ended = True
        self._guard.trigger()
        self._thread.join(END_S)
        self._executor.shutdown()
        self._node.destroy_node()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not self._ended:
                self._executor.spin_once()

    def _call(self) -> None:
        """Make one call for all that wait, by name: however many come, they are soon done."""
        waiting: dict[str, list[Asked]] = {}
        while self._waiting:
            asked = self._waiting.popleft()
            waiting.setdefault(asked.command.name, []).append(asked)
        for name, (first, *others) in waiting.items():

            def answered(ok: bool, text: str, others: list[Asked] = others) -> None:
                for each in others:
                    each.answer(ok, text)

            first.answered = answered
            self._caller.call(first, Trigger, name, Trigger.Request(), first.done)
