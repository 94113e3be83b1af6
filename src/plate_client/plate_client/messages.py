"""Processing of messages until a condition is true. Signals never interrupt the processing of a
message."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

POLL_S = 0.02
"""Maximum wait for one message before the condition is checked again [s]."""

_noted: list[int] = []
"""Received signals for which KeyboardInterrupt has not been raised yet."""


def defer_signals() -> None:
    """Defer Ctrl-C, SIGTERM and SIGHUP from now on, so that they interrupt only `spin_until`."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _note)


def spin_until(
    spin_once: Callable[[float], object], condition: Callable[[], bool], timeout_s: float
) -> bool:
    """Process messages until a condition is true, or until a timeout [s]. Return whether the
    condition is true.

    Ctrl-C raises KeyboardInterrupt only between two messages. An exception during the processing of
    a message could lose a reply. This reply may contain the handle of a running task. Without the
    handle, the task could not be canceled. Only the main thread reacts to Ctrl-C.

    Raises
    ------
    KeyboardInterrupt
        If a signal was received. The exception contains the number of the signal.
    """
    main = threading.current_thread() is threading.main_thread()
    deferred = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if deferred:
        signal.signal(signal.SIGINT, _note)
    end, held = time.monotonic() + timeout_s, True
    try:
        while not ((main and _noted) or condition()):
            if time.monotonic() > end:
                held = False
                break
            spin_once(POLL_S)
    finally:
        if deferred:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    if main and _noted:
        number = _noted[0]
        _noted.clear()
        raise KeyboardInterrupt(number)
    return held


def _note(number: int, frame: FrameType | None) -> None:
    _noted.append(number)
