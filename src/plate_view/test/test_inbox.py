"""Commands that wait: the order in which they are taken."""

import time

from plate_view import inbox
from plate_view.commands import Command


def test_a_command_that_waits_too_long_is_old(monkeypatch):
    box = inbox.Inbox()
    for name in ("move", "enable"):
        box.put("browser", Command(name, 1, {}))
    assert len(box) == 2
    assert [(box.take()[1].name, old) for old in (False,)] == [("move", False)]
    later = time.monotonic() + inbox.OLD_S + 1
    monkeypatch.setattr(inbox.time, "monotonic", lambda: later)
    _, each, old = box.take()
    assert (each.name, old) == ("enable", True)
    assert not box
