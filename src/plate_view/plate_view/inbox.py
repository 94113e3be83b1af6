"""Commands that wait for the graph's thread."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from .commands import URGENT, Command

OLD_S = 2.0
"""What has waited longer is not done any more [s]: who asked for it does something else by now."""


class Inbox:
    """Keeps commands until their turn: those that stop come first, whatever else waits.

    Filled on one thread and emptied on another.
    """

    def __init__(self) -> None:
        self._stops: deque[tuple[Any, Command, float]] = deque()
        self._others: deque[tuple[Any, Command, float]] = deque()

    def put(self, browser: Any, command: Command) -> None:
        """Keep a browser's command."""
        queue = self._stops if command.name in URGENT else self._others
        queue.append((browser, command, time.monotonic()))

    def take(self) -> tuple[Any, Command, bool]:
        """Return the next browser, its command, and whether it has grown old; a stop never does."""
        queue = self._stops or self._others
        browser, command, since = queue.popleft()
        return browser, command, queue is self._others and time.monotonic() - since > OLD_S
