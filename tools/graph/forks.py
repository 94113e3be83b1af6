"""Nodes as forks of one process that has loaded their code: they start in a fraction of the time
and share its memory. What runs is the file that `ros2 run` would start.

A node is a child of the program that wants it, as others are: the kernel gives it to that program
when the process ends that stood between them.

python tools/graph/forks.py MODULE ...    is that process: orders come at stdin, one JSON a line
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
"""Beginnings of variables that may be read when code is loaded: a server is for one set of them."""

START_S = 120.0
"""Longest wait for the server to load its code and start a node [s]: a busy computer needs long."""

END_S = 5.0
"""Longest wait for the server to end [s]."""

LOOK_S = 0.01
"""Between two looks whether a node has ended [s]."""

PR_SET_PDEATHSIG, PR_SET_NAME, PR_SET_CHILD_SUBREAPER = 1, 15, 36

_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Have this process end when the one that started it does, also without a word."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


class Server:
    """The process that becomes nodes, for those who want some. It hears no signal of a terminal."""

    newest: Server | None = None

    def __init__(self, modules: Iterable[str], environment: Mapping[str, str]) -> None:
        self._loaded = _of_loading(environment)
        _libc.prctl(PR_SET_CHILD_SUBREAPER, 1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # ignored, no end of a child can be heard of
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
        """Return the one that runs, or a new one; None if other variables were in force when its
        code was loaded."""
        if cls.newest is None or cls.newest._process.poll() is not None:
            cls.newest = cls(modules, environment)
        return cls.newest if cls.newest._loaded == _of_loading(environment) else None

    def start(self, words: list[str], environment: Mapping[str, str], log: Path) -> int:
        """Start a node; returns its process id.

        Raises
        ------
        OSError
            If the server has ended: there can be no more processes. One that does not answer is
            ended.
        """
        order = {"words": words, "environment": dict(environment), "log": str(log.absolute())}
        self._orders.write(json.dumps(order | {"folder": os.getcwd()}).encode() + b"\n")
        self._orders.flush()
        told = select.select([self._answers], [], [], START_S)[0] and self._answers.readline()
        if not told:
            self._process.kill()
            raise OSError("the process that starts nodes has ended, or does not answer")
        return int(told)

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            self._orders.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Fork:
    """A node that a server has started, as `subprocess.Popen` has programs.

    Attributes
    ----------
    pid : int
    returncode : int, optional
        Exit code; negative: ended by that signal; None: it ran when it was looked at last.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    @classmethod
    def start(
        cls, words: list[str], environment: Mapping[str, str], log: Path, modules: Iterable[str]
    ) -> Fork | None:
        """Start a command that is a Python script; None if it is none, or needs a process anew.

        Parameters
        ----------
        words : list of str
        environment : mapping of str to str
        log : path
            File to which it adds what it says.
        modules : iterable of str
            What it needs: loaded with the first node, and for all others too.
        """
        with contextlib.suppress(OSError), open(words[0], "rb") as script:
            if b"python" in script.readline(100) and (server := Server.of(modules, environment)):
                return cls(server.start(words, environment, log))
        return None

    def poll(self) -> int | None:
        """Return the exit code, if it has ended."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Return the exit code.

        Raises
        ------
        subprocess.TimeoutExpired
            It still runs after that time [s].
        """
        end = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(LOOK_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)


def _of_loading(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(AT_LOADING)}


def serve(modules: Iterable[str]) -> None:
    """Be the server, until there are no more orders."""
    answers = os.dup(1)
    os.dup2(2, 1)  # what code says while it is loaded
    for name in modules:
        with contextlib.suppress(Exception, SystemExit):  # the node that needs it will tell
            import_module(name)
    for module in list(sys.modules.values()):
        for kind in list(getattr(module, "__dict__", {}).values()):
            if isinstance(kind, type) and hasattr(kind, "__import_type_support__"):
                kind.__import_type_support__()  # of a ROS message
    sys.stdout.flush()  # or each node would say it again
    gc.collect()
    gc.freeze()  # or a node's first collection copies all pages
    # Python warns of any thread. These are rclpy's own, and each node starts them again.
    warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
    while order := sys.stdin.readline():
        if not (child := os.fork()):
            _become(answers, **json.loads(order))
        if os.waitpid(child, 0)[1]:  # there can be no more processes
            return


def _become(
    answers: int, words: list[str], environment: dict[str, str], log: str, folder: str
) -> None:
    """Be a node: a session, an environment and a log of its own, as a new process has."""
    code: Any = 1
    try:
        between = os.getpid()
        if os.fork():
            os._exit(0)
        while os.getppid() == between:  # then the program is the parent
            time.sleep(1e-3)
        end_with_parent()
        os.setsid()
        os.write(answers, f"{os.getpid()}\n".encode())  # fails if the program has ended before
        os.close(answers)
        said = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        for number in (1, 2):
            os.dup2(said, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        _libc.prctl(PR_SET_NAME, os.path.basename(words[0]).encode())
        faulthandler.enable()  # a crash shows where it was
        for stream in (sys.stdout, sys.stderr):
            assert isinstance(stream, TextIOWrapper)
            stream.reconfigure(line_buffering=True)
        sys.path[0] = os.path.dirname(words[0])
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        sys.argv = words
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code or 0
        if not isinstance(code, int):
            print(code, file=sys.stderr)
            code = 1
    except BaseException:  # whatever it is, as Python shows it when a program ends
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)  # at an end as of other programs, libraries of a fork crash


if __name__ == "__main__":
    serve(sys.argv[1:])
