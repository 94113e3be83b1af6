"""What a node logs waits for nobody: a terminal that is held by Ctrl-S, a pipe that nobody empties
or a hung connection would else hold up all its threads at the next line, those that stop motors
too, since ROS writes to stderr with Python's lock held."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import sys
import threading
from collections.abc import Iterator

CHUNK = 4096
LAST_S = 0.5
"""Longest wait at the end for what was written last [s]."""

COLOUR = "RCUTILS_COLORIZED_OUTPUT"
STDERR = 2


@contextlib.contextmanager
def never_held() -> Iterator[None]:
    """Have a thread write out stderr, through a pipe; what finds that full is dropped."""
    _open_closed()
    if os.isatty(STDERR):  # which ROS looks for, and will not find
        os.environ.setdefault(COLOUR, "1")
    kept = os.dup(STDERR)
    read, write = os.pipe()
    os.set_blocking(write, False)
    os.dup2(write, STDERR)
    os.close(write)
    thread = threading.Thread(target=_write_out, args=(read, kept), name="console", daemon=True)
    thread.start()
    traced = faulthandler.is_enabled()
    if traced:  # a crash writes by itself: the thread ends with it
        faulthandler.enable(kept)
    try:
        yield
    finally:
        if traced:
            faulthandler.enable(STDERR)
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os.dup2(kept, STDERR)  # the pipe has an end now
        thread.join(LAST_S)


def _open_closed() -> None:
    """Open stdin, stdout and stderr where they are closed: what took such a number, a serial port
    perhaps, would get the log."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stderr is None:
        sys.stderr = os.fdopen(STDERR, "w", encoding="utf-8", closefd=False)


def _write_out(read: int, kept: int) -> None:
    with contextlib.suppress(OSError):  # nobody reads it any more
        while data := os.read(read, CHUNK):
            while data:
                data = data[os.write(kept, data) :]
    os.close(read)
    os.close(kept)
