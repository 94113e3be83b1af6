"""Handling messages until a condition holds."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

POLL_S = 0.02
"""Longest wait for one message [s]."""


def spin_until(
    spin_once: Callable[[float], object], true: Callable[[], bool], timeout_s: float
) -> bool:
    """Handle messages until a condition holds, or for a time [s]; returns whether it holds.

    Ctrl-C raises KeyboardInterrupt between two messages. Inside of one an answer would be lost: the
    handle of a running task, say, without which it cannot be canceled. A second Ctrl-C does not
    wait.
    """
    interrupts = 0

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupts
        interrupts += 1
        if interrupts > 1:
            raise KeyboardInterrupt

    deferred = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if deferred:
        signal.signal(signal.SIGINT, on_interrupt)
    end, held = time.monotonic() + timeout_s, True
    try:
        while not (interrupts or true()):
            if time.monotonic() > end:
                held = False
                break
            spin_once(POLL_S)
    finally:
        if deferred:
            signal.signal(signal.SIGINT, signal.default_int_handler)
    if interrupts:
        raise KeyboardInterrupt
    return held
