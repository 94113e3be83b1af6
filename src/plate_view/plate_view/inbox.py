"""Queue that passes commands from the thread of the web server to the thread of the ROS node."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from .commands import Command

OLD_S = 2.0
"""Maximum age of a waiting command [s]. An older command is refused, because the person who sent it
may not expect its effect any more."""


class Inbox:
    """Queue of commands. One thread appends commands, and another thread removes them."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Any, Command, float]] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, browser: Any, command: Command) -> None:
        """Append a command of a browser."""
        self._waiting.append((browser, command, time.monotonic()))

    def take(self) -> tuple[Any, Command, bool]:
        """Remove the oldest command from the queue. Return the browser that sent the command, the
        command, and whether the command is too old.

        Raises
        ------
        IndexError
            If the queue is empty.
        """
        browser, command, since = self._waiting.popleft()
        return browser, command, time.monotonic() - since > OLD_S
