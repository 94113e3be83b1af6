"""Logging that never blocks a node.

ROS writes to stderr while it holds Python's global interpreter lock. A write blocks if the terminal
is paused with Ctrl-S, a pipe is not read, or a connection hangs. The next log line would then block
all threads, including the threads that stop the motors. Therefore `nonblocking_stderr` redirects
stderr to a non-blocking pipe. A thread writes the content of the pipe to the original stderr.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import sys
import threading
from collections.abc import Iterator

CHUNK = 4096
LAST_S = 0.5
"""Maximum wait at the end of the program for the output of the last lines [s]."""

COLOUR = "RCUTILS_COLORIZED_OUTPUT"
STDERR = 2


@contextlib.contextmanager
def nonblocking_stderr() -> Iterator[None]:
    """Write stderr through a pipe and a thread. While the pipe is full, further output is
    dropped."""
    _open_closed_streams()
    if os.isatty(STDERR):  # ROS colours its output only if stderr is a terminal
        os.environ.setdefault(COLOUR, "1")
    kept = os.dup(STDERR)
    read, write = os.pipe()
    os.set_blocking(write, False)
    os.dup2(write, STDERR)
    os.close(write)
    thread = threading.Thread(target=_copy_pipe, args=(read, kept), name="console", daemon=True)
    thread.start()
    traced = faulthandler.is_enabled()
    # during a crash, the thread does not run, so write the traceback to the original stderr
    if traced:
        faulthandler.enable(kept)
    try:
        yield
    finally:
        if traced:
            faulthandler.enable(STDERR)
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os.dup2(kept, STDERR)  # `dup2` closes the write end of the pipe, so the thread ends
        thread.join(LAST_S)


def _open_closed_streams() -> None:
    """Open stdin, stdout and stderr if they are closed. If one of these streams stayed closed,
    another file, such as a serial port, could get its file descriptor and receive the log."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stderr is None:
        sys.stderr = os.fdopen(STDERR, "w", encoding="utf-8", closefd=False)


def _copy_pipe(read: int, kept: int) -> None:
    with contextlib.suppress(OSError):  # the program that reads the original stderr may have ended
        while data := os.read(read, CHUNK):
            while data:
                data = data[os.write(kept, data) :]
    os.close(read)
    os.close(kept)
