"""Program that supervises the episodes of agents. `plate_gym.isolation` starts it.

The supervisor reads requests from its standard input and writes replies to its standard output, as
one JSON object per line. For each request, it forks a process that runs `episode.episode`. When the
episode has ended or a limit is exceeded, the supervisor ends the forked process. The supervisor
also ends all processes that the agent has started. If the agent ends the supervisor, a guard ends
these processes. The guard is the parent process of the supervisor. The program requires Linux, but
no root privileges.
"""

from __future__ import annotations

import codecs
import contextlib
import ctypes
import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

from plate_core import PlateError

from .episode import episode, named, one_line
from .isolation import ALIVE, REPLY_BYTES, Limits, parsed
from .result import printable

__all__ = ["main"]

OUTPUT_BYTES = 100_000
"""Maximum number of bytes of an agent's output that are copied to the terminal per episode."""

MAX_PROCESSES = 256
"""Maximum number of processes that an episode may have, including the process that simulates."""

MORE_TASKS = 2000
"""Number of processes and threads that the user may start during an episode, in addition to those
that already run. The limit slows down an agent that starts processes without end. The limit does
not apply to root."""

SPARE_BYTES = 500_000_000
"""If an agent fills the memory or a disk with files, its episode ends before less than this number
of bytes is free. If less than twice this number was free at the start, the episode ends before less
than half of the free bytes is free."""

POLL_S = 0.2
"""Interval between two checks of the time, the memory, the disks and the number of processes
[s]."""

ALIVE_S = 1.0
"""Interval between two lines `ALIVE`, which tell the parent process that this process still runs
[s]."""

ENDING_S = 10.0
"""Time in which `_kill_all` must end the processes of an agent [s]."""

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
"""Options of prctl, from linux/prctl.h. `PR_SET_PDEATHSIG` sets the signal that a process receives
when its parent ends. With `PR_SET_CHILD_SUBREAPER`, descendants whose parent has ended become
children of this process."""

PF_EXITING = 4
"""Flag of a process that ends, from linux/sched.h."""

BEAT = b"."
"""Byte that the forked process sends to the supervisor before each decision of the agent."""


def main() -> None:
    """Execute the requests from the standard input until the standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _adopt_orphans()
    if supervisor := os.fork():
        _guard(supervisor)
    _adopt_orphans()
    requests, replies = os.dup(0), os.dup(1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    os.write(replies, ALIVE)
    with os.fdopen(requests, "rb", buffering=0) as lines:
        while line := lines.readline():
            reply = Episode(json.loads(line), requests, replies).run()
            os.write(replies, json.dumps(reply).encode() + b"\n")


def _adopt_orphans() -> None:
    """Make descendants of this process its children when their parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _guard(supervisor: int) -> NoReturn:
    """Wait until the supervisor has ended, and end the processes that it has left running."""
    os.closerange(0, 2)  # only the supervisor keeps the pipes open
    status = os.waitpid(supervisor, 0)[1]
    _kill_all()
    os._exit(status != 0)


class Episode:
    """An episode that runs in a separate process. The object is mutable, and its method `run` can
    be called only once.

    Parameters
    ----------
    request : dict
        Request as in `plate_gym.isolation.play`, with the additional keys `limits`, `path` (for
        `sys.path`) and `folder` (the working directory).
    requests, replies : int
        File descriptors of the pipes from and to the process that sends the request. If the other
        end of `requests` is closed, the episode ends.
    """

    def __init__(self, request: dict[str, Any], requests: int, replies: int) -> None:
        self._request, self._requests, self._replies = request, requests, replies
        self._limits = Limits(**request["limits"])
        self._decisions, self._reply = 0, b""
        self._printed, self._line = 0, ""
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._reserve = {
            name: min(SPARE_BYTES, free / 2)
            for name, free in _free_bytes(request["folder"]).items()
        }

    def run(self) -> dict[str, Any]:
        """Run the episode, and return the reply. The reply has the form that
        `plate_gym.isolation.play` returns."""
        messages, to_messages = os.pipe()
        output, to_output = os.pipe()
        child = os.fork()
        if not child:
            self._play(to_messages, to_output)
        os.close(to_messages)
        os.close(to_output)
        failure = shortage = ""
        try:
            failure = self._watch(child, messages, output)
        except PlateError as problem:
            shortage = str(problem)
        end = "" if failure or shortage else self._end_of(child)
        left = _kill_all() - {child}
        self._forward_rest(output)
        os.close(messages)
        os.close(output)
        if left:
            self._note(f"ended processes that the agent had left running: {len(left)}")
        if self._printed > OUTPUT_BYTES:
            self._note(f"omitted the agent's output after {OUTPUT_BYTES:,} bytes")
        if shortage:
            return {"error": shortage}
        if failure:
            return {"failure": failure, "steps": self._steps}
        try:
            return parsed(self._reply) | {"steps": self._steps}
        except ValueError:
            return {"error": f"{self._where()}: its process {end}"}

    @property
    def _steps(self) -> int:
        """Number of completed steps."""
        return max(0, self._decisions - 1)

    def _where(self) -> str:
        request = self._request
        return named(request["agent"], request["task"], request["seed"], self._steps)

    def _note(self, text: str) -> None:
        _print(f"note: {self._where()}: {text}\n".encode())

    def _play(self, messages: int, output: int) -> NoReturn:
        """Run the episode, and send the reply to the supervisor. Only the forked process calls this
        method."""
        reply: dict[str, Any] = {}
        try:
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
            os.setsid()
            for number, file in ((1, output), (2, output), (3, messages)):
                os.dup2(file, number)
            for name in os.listdir("/proc/self/fd"):
                if int(name) > 3:
                    os.closerange(int(name), int(name) + 1)
            size = int(1e9 * self._limits.memory_gb)
            _limit(resource.RLIMIT_DATA, size)
            # The memory limit of a process does not include files on a file system in memory.
            # Therefore the file size is limited, too.
            _limit(resource.RLIMIT_FSIZE, size)
            _limit(resource.RLIMIT_NPROC, _tasks_of_user() + MORE_TASKS)
            _limit(resource.RLIMIT_CORE, 0)
            sys.path[:] = self._request["path"]
            os.chdir(self._request["folder"])
            reply = self._result(lambda: os.write(3, BEAT))
            sys.stdout.flush()
        except BaseException as problem:
            reply = reply or {"error": f"{self._where()}: {one_line(problem)}"}
        finally:
            try:
                os.write(3, json.dumps(reply).encode() + b"\n")
            finally:
                os._exit(0)

    def _result(self, beat: Callable[[], object]) -> dict[str, Any]:
        request = self._request
        try:
            return {
                "row": episode(
                    request["agent"], request["world"], request["task"], request["seed"], beat
                )
            }
        except PlateError as problem:
            if isinstance(problem.__cause__, MemoryError):
                return {"failure": self._too_large()}
            return {"error": str(problem)}

    def _watch(self, child: int, messages: int, output: int) -> str:
        """Wait until the reply arrives, the forked process ends or a limit is exceeded. Return a
        text that names the exceeded limit, or an empty text.

        Raises
        ------
        PlateError
            If the computer has too little free memory, or too little free space on a disk.
        """
        poll = select.poll()
        for file in (messages, output, self._requests):
            poll.register(file, select.POLLIN)
        waited = 0.0
        checked = 0.0
        sent = 0.0
        total = 0.0
        before = time.monotonic()
        total_s = self._limits.episode_s
        while True:
            events = dict(poll.poll(1e3 * POLL_S))
            # If this process was suspended, the episode was suspended, too. Therefore at most 2
            # POLL_S are counted per pass of the loop.
            passed = min(time.monotonic() - before, 2 * POLL_S)
            before = time.monotonic()
            waited, checked, sent = waited + passed, checked + passed, sent + passed
            total += passed
            if self._requests in events:
                _kill_all()
                self._forward_rest(output)
                os._exit(0)
            if output in events and not self._forward(output, wait=True):
                poll.unregister(output)
            if messages in events:
                waited = 0.0
                if not self._receive(os.read(messages, 65536)):
                    return ""
            if waited > self._limits.decision_s:
                return f"no decision within {self._limits.decision_s:g} s"
            if total > total_s:
                return f"no end of the episode within {total_s:g} s"
            if checked > POLL_S:
                checked = 0.0
                if failure := self._excess():
                    return failure
                if _has_ended(child):
                    os.set_blocking(messages, False)
                    while self._receive(_read(messages)):
                        pass
                    return ""
            if sent > ALIVE_S:
                sent = 0.0
                os.write(self._replies, ALIVE)

    def _receive(self, data: bytes) -> bool:
        """Process data that the forked process has sent. Return whether more data are expected."""
        beats = 0 if self._reply else len(data) - len(data.lstrip(BEAT))
        self._decisions += beats
        self._reply += data[beats:]
        return bool(data) and b"\n" not in self._reply and len(self._reply) < REPLY_BYTES

    def _end_of(self, child: int) -> str:
        """Return a text that describes how the forked process ended. If the process has not ended,
        the text states that its reply was invalid."""
        # try several times, because the pipe closes slightly before the process ends
        tries = 10
        while tries:
            if state := _has_ended(child):
                if state.si_code == os.CLD_EXITED:
                    return f"died: it exited with code {state.si_status} before its last step"
                number = state.si_status
                known = number in set(signal.Signals)
                name = signal.Signals(number).name if known else f"signal {number}"
                return f"died: it was ended by {name}"
            tries -= not _is_ending(child)
            time.sleep(0.1)
        return "closed its pipe, or sent no valid reply"

    def _excess(self) -> str:
        """Check the memory and the number of processes of the episode. Return a text that names the
        exceeded limit, or an empty text.

        Raises
        ------
        PlateError
            If the computer has too little free memory, or too little free space on a disk.
        """
        processes = list(_descendants())
        if len(processes) > MAX_PROCESSES:
            return f"more than {MAX_PROCESSES} processes"
        limit = 1e9 * self._limits.memory_gb
        if sum(map(_resident, processes)) > limit and sum(map(_proportional, processes)) > limit:
            return self._too_large()
        for name, free in _free_bytes(self._request["folder"]).items():
            if free < self._reserve.get(name, 0):
                raise PlateError(
                    f"{self._where()}: stopped, because only {free / 1e9:.2g} GB of {name} are free"
                )
        return ""

    def _too_large(self) -> str:
        return f"more than {self._limits.memory_gb:g} GB of memory"

    def _forward(self, output: int, wait: bool) -> bool:
        """Copy lines that the agent prints to the standard error, up to `OUTPUT_BYTES`. If `wait`
        is False, copy only the output that is already available. Return whether more output can
        follow."""
        os.set_blocking(output, wait)
        while data := _read(output):
            text = self._decoder.decode(data[: max(0, OUTPUT_BYTES - self._printed)])
            *lines, self._line = (self._line + text).replace("\r", "\n").split("\n")
            for line in lines:
                self._show(line)
            self._printed += len(data)
            if wait:
                return True
        return False

    def _forward_rest(self, output: int) -> None:
        """Copy the output that is still available, and an incomplete last line."""
        self._forward(output, wait=False)
        if self._line:
            self._show(self._line)

    def _show(self, line: str) -> None:
        """Write a line of the agent to the standard error. The beginning of the line shows its
        source, because an agent could print a false result of a check."""
        text = printable(line.replace("\t", " "))
        _print(f"agent: {text}\n".encode())


def _read(file: int) -> bytes:
    """Read the available bytes from a pipe. The result is empty if no data are available."""
    try:
        return os.read(file, 65536)
    except BlockingIOError:
        return b""


def _print(data: bytes) -> None:
    """Write bytes to the standard error. Do nothing if the standard error is closed."""
    with contextlib.suppress(OSError):
        os.write(2, data)


def _has_ended(child: int) -> os.waitid_result | None:
    """Return how a child process ended, or None if it has not ended."""
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT)


def _is_ending(process: int) -> bool:
    """Return whether Linux already ends a process (its flag PF_EXITING). On a busy computer, this
    can take seconds."""
    try:
        fields = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return False
    return bool(int(fields[6]) & PF_EXITING)


def _descendants() -> Iterator[int]:
    """Yield the ids of all running descendants of this process: its child processes, their child
    processes, and so on."""
    children: dict[int, list[int]] = {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            with contextlib.suppress(OSError):  # the process has ended in the meantime
                fields = Path(f"/proc/{name}/stat").read_bytes().rpartition(b")")[2].split()
                children.setdefault(int(fields[1]), []).append(int(name))
    waiting = children.pop(os.getpid(), [])
    while waiting:
        process = waiting.pop()
        yield process
        waiting += children.pop(process, [])


def _kill_all() -> set[int]:
    """End all descendants of this process. Return the ids of the processes that were still running.

    Raises
    ------
    TimeoutError
        If the descendants cannot be ended.
    """
    ran: set[int] = set()
    end = time.monotonic() + ENDING_S
    while processes := list(_descendants()):
        # All processes are stopped first, because a stopped process starts no other process.
        for process in processes:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGSTOP)
        for process in processes:
            with contextlib.suppress(OSError):
                if b"Z" not in _field(f"{process}/status", b"State:"):
                    ran.add(process)
                os.kill(process, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if time.monotonic() > end:
            raise TimeoutError(f"processes {processes} cannot be ended")
    return ran


def _limit(kind: int, limit: int) -> None:
    """Set the resource limit `kind` of this process to `limit`, unless a lower limit is already
    set."""
    present = resource.getrlimit(kind)[0]
    if present == resource.RLIM_INFINITY or present > limit:
        resource.setrlimit(kind, (limit, limit))


def _tasks_of_user() -> int:
    """Return the number of processes and threads of this user."""
    count = 0
    for name in os.listdir("/proc"):
        if name.isdigit():
            with contextlib.suppress(OSError):  # the process has ended in the meantime
                if os.stat(f"/proc/{name}").st_uid == os.getuid():
                    count += len(os.listdir(f"/proc/{name}/task"))
    return count


def _free_bytes(folder: str) -> dict[str, float]:
    """Return the free memory, and the free space on the disks of the working directory `folder` and
    of temporary files [bytes]."""
    found: dict[str, float] = {"memory": 1024 * _number("meminfo", b"MemAvailable:")}
    places = {"the disk": folder, "the disk of temporary files": tempfile.gettempdir()}
    for name, place in places.items():
        with contextlib.suppress(OSError):  # the agent has deleted the folder
            disk = os.statvfs(place)
            found[name] = disk.f_bavail * disk.f_frsize
    return found


def _resident(process: int) -> int:
    """Return the resident memory of a process [bytes]. The result includes memory that the process
    shares with other processes."""
    return 1024 * _number(f"{process}/status", b"VmRSS:")


def _proportional(process: int) -> int:
    """Return the proportional memory of a process [bytes]. If n processes share memory, 1/n of this
    memory is counted."""
    return 1024 * _number(f"{process}/smaps_rollup", b"Pss:")


def _number(file: str, name: bytes) -> int:
    try:
        return int(_field(file, name).split()[0])
    except (OSError, IndexError, ValueError):  # the process has ended in the meantime
        return 0


def _field(file: str, name: bytes) -> bytes:
    """Return the text of a field of a file in /proc, or an empty text if the file does not contain
    the field."""
    lines = Path(f"/proc/{file}").read_bytes().splitlines()
    return next((line[len(name) :] for line in lines if line.startswith(name)), b"")


if __name__ == "__main__":
    main()
