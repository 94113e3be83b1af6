"""Commands that wait: the order in which they are taken."""

import time

from plate_view import inbox
from plate_view.commands import Command


def command(name):
    return Command(name, 1, {})


def test_stops_come_first_and_never_grow_old(monkeypatch):
    box = inbox.Inbox()
    for name in ("move", "emergency_stop", "enable", "stop"):
        box.put("browser", command(name))
    later = time.monotonic() + inbox.OLD_S + 1
    taken = [box.take() for _ in range(3)]
    assert [(each.name, old) for _, each, old in taken] == [
        ("emergency_stop", False), ("stop", False), ("move", False),
    ]  # fmt: skip
    box.put("browser", command("emergency_stop"))
    monkeypatch.setattr(inbox.time, "monotonic", lambda: later)
    assert box.take()[2] is False
    _, each, old = box.take()
    assert (each.name, old) == ("enable", True)
