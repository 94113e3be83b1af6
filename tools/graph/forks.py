"""Starts nodes as forks of one server process that has loaded their code.

Forked nodes start faster than new processes, and share the memory of the code. Each node runs the
file that `ros2 run` would start. The server forks twice, and the process in the middle ends. The
program that requested the node is a subreaper. Therefore the kernel makes the node a child of this
program.

python tools/graph/forks.py MODULE ... runs the server. The server reads requests from stdin, one
JSON object per line.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import gc
import json
import os
import runpy
import select
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Iterable, Mapping
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import Any

AT_LOADING = (
    "AMENT_", "GLIBC_", "LD_", "NPY_", "OMP_", "OPENBLAS_", "OPENCV_", "PYTHONHOME",
    "PYTHONOPTIMIZE", "PYTHONPATH", "PYTHONWARNINGS", "ROS_PYTHON_",
)  # fmt: skip
"""Prefixes of the names of environment variables that may be read when code is loaded. A server can
only start nodes with the same values of these variables."""

START_S = 120.0
"""Maximum wait until the server has loaded its code and started a node [s]. The value is large,
because the computer can be busy."""

END_S = 5.0
"""Maximum wait for the server to end [s]."""

POLL_S = 0.01
"""Interval at which `Fork.wait` checks whether a node has ended [s]."""

PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36

_libc = ctypes.CDLL(None)


def show_command(words: Iterable[str]) -> None:
    """Set the command line of this process that `ps` shows. Linux keeps it in the process's memory,
    with the length of the first command line. Longer command lines are cut."""
    numbers = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    begin, end = map(int, numbers[45:47])  # arg_start and arg_end of proc_pid_stat(5)
    text = b"".join(word.encode() + b"\0" for word in words)[: end - begin - 1]
    ctypes.memmove(begin, text.ljust(end - begin, b"\0"), end - begin)


def end_with_parent(parent: int | None = None) -> None:
    """Make the kernel send SIGTERM to this process when its parent ends for any reason. If the
    process `parent` has already ended, send SIGTERM now."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if parent is not None and os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGTERM)


class Server:
    """Client of the server process that starts nodes. The server runs in a separate session.
    Therefore signals of a terminal do not reach it."""

    newest: Server | None = None

    def __init__(self, modules: Iterable[str], environment: Mapping[str, str]) -> None:
        self._loaded = _loading_environment(environment)
        _libc.prctl(PR_SET_CHILD_SUBREAPER, 1)
        # A parent program may have set SIGCHLD to be ignored. With this setting, the exit codes of
        # children would be lost, so restore the default.
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        self._process = subprocess.Popen(
            [sys.executable, __file__, *modules],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
            preexec_fn=end_with_parent,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._orders, self._answers = self._process.stdin, self._process.stdout
        atexit.register(self._end)

    @classmethod
    def of(cls, modules: Iterable[str], environment: Mapping[str, str]) -> Server | None:
        """Return the running server. If no server runs, start one. Return None if the server loaded
        its code with other values of the variables in `AT_LOADING`."""
        if cls.newest is None or cls.newest._process.poll() is not None:
            cls.newest = cls(modules, environment)
        return cls.newest if cls.newest._loaded == _loading_environment(environment) else None

    def start(self, words: list[str], environment: Mapping[str, str], log: Path) -> int:
        """Start a node, and return its process id.

        Raises
        ------
        OSError
            If the server has ended, for example because the limit of processes is reached, or if it
            does not answer. A server that does not answer is killed.
        """
        order = {"words": words, "environment": dict(environment), "log": str(log.absolute())}
        self._orders.write(json.dumps(order | {"folder": os.getcwd()}).encode() + b"\n")
        self._orders.flush()
        line = select.select([self._answers], [], [], START_S)[0] and self._answers.readline()
        if not line:
            self._process.kill()
            raise OSError("the process that starts nodes has ended, or does not answer")
        return int(line)

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            self._orders.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Fork:
    """A node that the server has started. This class has the interface of `subprocess.Popen`.

    Attributes
    ----------
    pid : int
    returncode : int, optional
        Exit code. A negative exit code is the signal that ended the node. None if the node was
        running at the last call of `poll`.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    @classmethod
    def start(
        cls, words: list[str], environment: Mapping[str, str], log: Path, modules: Iterable[str]
    ) -> Fork | None:
        """Start a command that is a Python script. Return None if the command is not a Python
        script, or if the server cannot start it.

        Parameters
        ----------
        words : list of str
            Command line.
        environment : mapping of str to str
        log : path
            File to which the node appends its output.
        modules : iterable of str
            Modules that a new server loads.
        """
        with contextlib.suppress(OSError), open(words[0], "rb") as script:
            if b"python" in script.readline(100) and (server := Server.of(modules, environment)):
                return cls(server.start(words, environment, log))
        return None

    def poll(self) -> int | None:
        """Return the exit code of the node, or None if the node still runs."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait until the node ends, and return the exit code.

        Raises
        ------
        subprocess.TimeoutExpired
            If the node still runs after the time `timeout` [s].
        """
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(POLL_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal if the node still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)


def _loading_environment(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(AT_LOADING)}


def serve(modules: Iterable[str]) -> None:
    """Run the server until stdin ends."""
    answers = os.dup(1)
    os.dup2(2, 1)  # redirect stdout to stderr, because modules can print while they are loaded
    for name in modules:
        # ignore errors here, because the node itself will report them
        with contextlib.suppress(Exception, SystemExit):
            import_module(name)
    for module in list(sys.modules.values()):
        for kind in list(getattr(module, "__dict__", {}).values()):
            if isinstance(kind, type) and hasattr(kind, "__import_type_support__"):
                kind.__import_type_support__()  # load the type support of the ROS message
    sys.stdout.flush()  # empty the buffer, because each fork would print its content again
    gc.collect()
    # exclude the present objects: the first garbage collection of a node would copy all their
    # memory pages
    gc.freeze()
    # Python warns if a process with threads forks. The threads of this process belong to rclpy.
    # Each node starts its own threads, so the warning is suppressed.
    warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
    while order := sys.stdin.readline():
        if not (child := os.fork()):
            _become_node(answers, **json.loads(order))
        # the second fork failed, because the limit of processes is reached
        if os.waitpid(child, 0)[1]:
            return


def _become_node(
    answers: int, words: list[str], environment: dict[str, str], log: str, folder: str
) -> None:
    """Turn this process into a node, with a separate session, environment and log, like a new
    process."""
    code: Any = 1
    try:
        between = os.getpid()
        if os.fork():
            os._exit(0)
        # wait until the intermediate process has ended and the requesting program is the parent
        while os.getppid() == between:
            time.sleep(1e-3)
        end_with_parent()
        os.setsid()
        # If the requesting program has ended, this call raises an error.
        os.write(answers, f"{os.getpid()}\n".encode())
        os.close(answers)
        log_file = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        for number in (1, 2):
            os.dup2(log_file, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        _libc.prctl(PR_SET_NAME, os.path.basename(words[0]).encode())
        faulthandler.enable()  # print a traceback if the process crashes
        for stream in (sys.stdout, sys.stderr):
            assert isinstance(stream, TextIOWrapper)
            stream.reconfigure(line_buffering=True)
        sys.path[0] = os.path.dirname(words[0])
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        sys.argv = words
        show_command(words)
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code or 0
        if not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except BaseException:  # print any exception, as Python does at the end of a program
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)  # exit without the usual exit handlers, because some of them crash in a fork


if __name__ == "__main__":
    serve(sys.argv[1:])
