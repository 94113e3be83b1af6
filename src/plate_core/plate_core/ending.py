"""Process exit: a time limit for destroying ROS nodes, and an exit without a traceback when the
reader closes a pipe.

The Fast DDS version in the wheels can block forever in `DomainParticipant::set_listener`. The call
blocks if the process discovers another participant while it destroys its own participant. The cause
is an overflow of the default timeout. rclpy holds Python's global interpreter lock during this
call, so that Python's signal handlers, threads and timers do not run. Therefore `ends` uses a POSIX
timer that calls `_exit`.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

DESTROYED_S = 2.0
"""Maximum time for destroying the ROS nodes of a process [s]. Destroying the nodes usually takes
about 10 ms."""

SIGEV_THREAD = 2


class _Event(ctypes.Structure):
    """`struct sigevent` of 64-bit Linux. This structure requests that a timer calls `function` with
    `value` in a new thread."""

    _fields_ = (
        ("value", ctypes.c_int64),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """`struct itimerspec`: period and first expiration, each in seconds and nanoseconds."""

    _fields_ = (("period", ctypes.c_long * 2), ("first", ctypes.c_long * 2))


@contextmanager
def piped() -> Iterator[None]:
    """Exit without a traceback if the reader of the program's output closes the pipe, as in
    `check_rig | head -1`.

    Use this function as a decorator of `main` or in a `with` statement. Clean-up code in the
    decorated function still runs. The exit code is 141, the code that shells report for SIGPIPE.
    """
    try:
        try:
            yield
        except SystemExit:
            _flush_stdout()
            raise
        _flush_stdout()
    except BrokenPipeError:
        if not _has_lost_reader():
            raise  # the error comes from another pipe or a socket, so it is a defect of the program
        # discard the output in Python's buffer
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)


def _flush_stdout() -> None:
    if sys.stdout is not None:
        sys.stdout.flush()


def _has_lost_reader() -> bool:
    """Whether stdout or stderr is a pipe whose reader has closed it."""
    poll = select.poll()
    for file in (sys.stdout, sys.stderr):
        if file is not None:
            poll.register(file.fileno(), 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


@contextmanager
def ends(code: int, within_s: float = DESTROYED_S) -> Iterator[None]:
    """Limit the time for destroying nodes inside this context.

    If the time limit `within_s` [s] is exceeded, the process exits immediately with the exit code
    `code`, without Python's own clean-up. Therefore enter this context as the last step of the
    program.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    function = ctypes.cast(libc._exit, ctypes.c_void_p).value
    event = _Event(code, 0, SIGEV_THREAD, function)
    timer, seconds = ctypes.c_void_p(), int(within_s)
    times = _Times((0, 0), (seconds, int(1e9 * (within_s - seconds))))
    call = libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer))
    call = call or libc.timer_settime(timer, 0, ctypes.byref(times), None)
    if call:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    try:
        yield
    finally:
        libc.timer_delete(timer)
