"""Commands that are being executed, and their replies."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ..calls import call_text
from ..commands import Command
from ..server import PageServer, Socket

UNLOGGED = ("parameters",)
"""Commands that are not shown in the page's log, because they change nothing."""


class PendingCommand:
    """A command that is being executed, and the browser that receives the reply.

    Attributes
    ----------
    values : mapping
        Arguments of the command.
    call : str
        Equivalent terminal command, if it differs from the result of `call_text`.
    answered : callable
        Function that is called with the reply: whether the command succeeded, and a text.
    """

    def __init__(self, server: PageServer, browser: Socket, command: Command) -> None:
        self._server, self._browser, self.command = server, browser, command
        self.values, self.call = command.values, ""
        self.answered: Callable[[bool, str], None] = lambda ok, text: None

    def accept(self, text: str) -> None:
        """Reply that the command succeeded."""
        self.answer(True, text)

    def refuse(self, text: str) -> None:
        """Reply that the command failed, and give the reason."""
        self.answer(False, text)

    def done(self, response: Any) -> None:
        """Pass the reply of a service to the browser."""
        self.answer(bool(response.success), str(response.message))

    def answer(self, ok: bool, text: str) -> None:
        """Reply to the browser. Show the equivalent call to all browsers."""
        self.answered(ok, text)
        self._server.answer(self._browser, self.command.number, ok, text)
        if self.command.name in UNLOGGED or (self.values.get("dragging") and not self.call):
            return
        scene = {
            "kind": "call", "time": time.time(), "who": self._browser.request.remote_ip,
            "text": self.call or call_text(self.command), "ok": ok, "answer": text,
        }  # fmt: skip
        self._server.publish("call", scene, keep=False)
