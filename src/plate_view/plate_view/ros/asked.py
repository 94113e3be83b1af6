"""Commands on their way into the graph."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ..calls import call_text
from ..commands import Command
from ..server import PageServer, Socket

QUIET = ("parameters",)
"""Commands that change nothing: no line in the log."""


class Asked:
    """A command on its way, and to whom its answer goes.

    Attributes
    ----------
    values : mapping
        What came with the command.
    call : str
        The line for a terminal that does the same, where it is not `call_text` of the command.
    answered : callable
        Called with the answer: whether it was done, and the text.
    """

    def __init__(self, server: PageServer, browser: Socket, command: Command) -> None:
        self._server, self._browser, self.command = server, browser, command
        self.values, self.call = command.values, ""
        self.answered: Callable[[bool, str], None] = lambda ok, text: None

    def accept(self, text: str) -> None:
        """Answer that it was done."""
        self.answer(True, text)

    def refuse(self, text: str) -> None:
        """Answer why not."""
        self.answer(False, text)

    def done(self, response: Any) -> None:
        """Answer what a service has answered."""
        self.answer(bool(response.success), str(response.message))

    def answer(self, ok: bool, text: str) -> None:
        """Answer the browser; all of them see the call."""
        self.answered(ok, text)
        self._server.answer(self._browser, self.command.number, ok, text)
        if self.command.name in QUIET or (self.values.get("dragging") and not self.call):
            return
        scene = {
            "kind": "call", "time": time.time(), "who": self._browser.request.remote_ip,
            "text": self.call or call_text(self.command), "ok": ok, "answer": text,
        }  # fmt: skip
        self._server.publish("call", scene, keep=False)
