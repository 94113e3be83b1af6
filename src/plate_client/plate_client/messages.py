"""Handling messages until a condition holds."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

POLL_S = 0.02
"""Longest wait for one message [s]."""

_noted: list[int] = []
"""Signals that have come, and for which nobody has been interrupted yet."""


def defer_signals() -> None:
    """From now on Ctrl-C, SIGTERM and SIGHUP interrupt nothing but `spin_until`."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _note)


def spin_until(
    spin_once: Callable[[float], object], true: Callable[[], bool], timeout_s: float
) -> bool:
    """Handle messages until a condition holds, or for a time [s]; returns whether it holds.

    Ctrl-C raises KeyboardInterrupt between two messages. Inside of one an answer would be lost: the
    handle of a running task, say, without which it cannot be canceled.

    Raises
    ------
    KeyboardInterrupt
        With the signal's number.
    """
    deferred = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if deferred:
        signal.signal(signal.SIGINT, _note)
    end, held = time.monotonic() + timeout_s, True
    try:
        while not (_noted or true()):
            if time.monotonic() > end:
                held = False
                break
            spin_once(POLL_S)
    finally:
        if deferred:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    if _noted:
        number = _noted[0]
        _noted.clear()
        raise KeyboardInterrupt(number)
    return held


def _note(number: int, frame: FrameType | None) -> None:
    _noted.append(number)
