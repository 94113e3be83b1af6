"""Commands that wait for the graph's thread."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from .commands import Command

OLD_S = 2.0
"""What has waited longer is not done any more [s]: who asked for it does something else by now."""


class Inbox:
    """Keeps commands until their turn. Filled on one thread and emptied on another."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Any, Command, float]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, browser: Any, command: Command) -> None:
        """Keep a browser's command."""
        self._waiting.append((browser, command, time.monotonic()))

    def take(self) -> tuple[Any, Command, bool]:
        """Return the next browser, its command, and whether it has grown old."""
        browser, command, since = self._waiting.popleft()
        return browser, command, time.monotonic() - since > OLD_S
