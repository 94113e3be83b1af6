"""A process whose work is done ends, whatever the middleware does.

Fast DDS, as the wheels have it, waits without end in `DomainParticipant::set_listener` if another
participant is heard of just while this one is destroyed (its default timeout overflows), and rclpy
holds Python's lock meanwhile: no signal, thread or timer of Python's own would come through.
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
"""Longest wait for ROS to let go of a process [s]; it takes some 10 ms."""

SIGEV_THREAD = 2


class _Event(ctypes.Structure):
    """`struct sigevent` of Linux, 64 bit: call a function with this value in a new thread."""

    _fields_ = (
        ("value", ctypes.c_int64),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """`struct itimerspec`: period and first time, each in seconds and nanoseconds."""

    _fields_ = (("period", ctypes.c_long * 2), ("first", ctypes.c_long * 2))


@contextmanager
def piped() -> Iterator[None]:
    """End a program without a traceback when the reader of its output has closed the pipe, as in
    `check_rig | head -1`.

    Use it as a decorator of `main`, or in a `with` statement: clean-up inside still runs. The exit
    code is then 141, which is SIGPIPE's in shells.
    """
    try:
        try:
            yield
        except SystemExit:
            _flush()
            raise
        _flush()
    except BrokenPipeError:
        if not _unread():
            raise  # another pipe, or a socket: a defect
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what Python still has
        sys.exit(128 + signal.SIGPIPE)


def _flush() -> None:
    if sys.stdout is not None:
        sys.stdout.flush()


def _unread() -> bool:
    """Whether stdout or stderr is a pipe that nobody reads."""
    poll = select.poll()
    for file in (sys.stdout, sys.stderr):
        if file is not None:
            poll.register(file.fileno(), 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


@contextmanager
def ends(code: int, within_s: float = DESTROYED_S) -> Iterator[None]:
    """Destroy nodes in this context: if it takes longer, the process ends with this exit code.

    To be used once all else is done, as nothing that Python would do at the end is done then.
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
