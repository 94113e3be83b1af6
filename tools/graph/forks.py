"""Nodes as forks of one process that has loaded their code: they start in a fraction of the time
and share its memory. What runs is the file that `ros2 run` would start.

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
import threading
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

LOOK_S = 0.05
"""Between two looks at a node whose server has ended [s]."""

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15

_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Have this process end when the one that started it does, also without a word."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


class Server:
    """The process that becomes nodes, for those who want some. It hears no signal of a terminal."""

    newest: Server | None = None

    def __init__(self, modules: Iterable[str], environment: Mapping[str, str]) -> None:
        self._loaded = _of_loading(environment)
        self._codes: dict[int, int] = {}
        self._said, self._lock = b"", threading.Lock()
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
        self._orders, self._answers = self._process.stdin, self._process.stdout.fileno()
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
            If there can be no more processes, or the server has ended. One that does not answer
            is ended, and its nodes with it.
        """
        order = {"words": words, "environment": dict(environment), "log": str(log.absolute())}
        with self._lock:
            self._orders.write(json.dumps(order | {"folder": os.getcwd()}).encode() + b"\n")
            self._orders.flush()
            end = time.monotonic() + START_S
            while (answer := self._heard(max(0.0, end - time.monotonic()))) and "ended" in answer:
                pass
            if answer is None:
                self._process.kill()
                raise OSError("the process that starts nodes has ended, or does not answer")
            if "problem" in answer:
                raise OSError(answer["problem"])
            return int(answer["started"])

    def code(self, pid: int, timeout_s: float) -> int | None:
        """Return the exit code of a node that ends within a time [s]; None: it runs on."""
        with self._lock:
            end = time.monotonic() + timeout_s
            while pid not in self._codes:
                left_s = max(0.0, end - time.monotonic())
                if self._heard(left_s) is not None:
                    continue
                alone = self._process.poll() is not None
                if alone and not _runs(pid):
                    self._codes[pid] = -signal.SIGTERM  # as happens to nodes without a server
                elif not left_s:
                    break
                elif alone:
                    time.sleep(min(left_s, LOOK_S))
            return self._codes.get(pid)

    def _heard(self, timeout_s: float) -> dict[str, Any] | None:
        """Take in what the server says next, the end of a node or an answer; None: nothing, or the
        server has ended."""
        while b"\n" not in self._said:
            if not select.select([self._answers], [], [], timeout_s)[0]:
                return None
            data = os.read(self._answers, 4096)
            if not data:
                return None
            self._said += data
        line, _, self._said = self._said.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        if "ended" in answer:
            self._codes[answer["ended"]] = answer["code"]
        return answer

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            self._orders.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Fork:
    """A node that a server has started, as `subprocess.Popen` has programs."""

    def __init__(self, server: Server, pid: int) -> None:
        self._server, self.pid = server, pid

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
                return cls(server, server.start(words, environment, log))
        return None

    @property
    def returncode(self) -> int | None:
        """Exit code; negative: ended by that signal; None: it runs."""
        return self._server.code(self.pid, 0.0)

    def poll(self) -> int | None:
        """Return the same."""
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Return the exit code.

        Raises
        ------
        subprocess.TimeoutExpired
            It still runs after that time [s].
        """
        code = self._server.code(self.pid, timeout)
        if code is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


def _runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def _of_loading(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(AT_LOADING)}


def serve(modules: Iterable[str]) -> None:
    """Be the server, until there are no more orders."""
    answers = os.dup(1)
    os.dup2(2, 1)  # what code says while it is loaded

    def say(**answer: Any) -> None:
        os.write(answers, json.dumps(answer).encode() + b"\n")

    for module in modules:
        with contextlib.suppress(Exception, SystemExit):  # the node that needs it will tell
            import_module(module)
    sys.stdout.flush()  # or each node would say it again
    gc.collect()
    gc.freeze()  # or a node's first collection copies all pages
    # Of rclpy's own threads, which nodes start anew. Python 3.12 warns of any thread.
    warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    while True:
        ready, _, _ = select.select([0, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            with contextlib.suppress(ChildProcessError):
                while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                    say(ended=ended[0], code=os.waitstatus_to_exitcode(ended[1]))
        elif line := sys.stdin.readline():
            try:
                pid = os.fork()
            except OSError as problem:
                say(problem=f"no more processes: {problem.strerror}")
                continue
            if not pid:
                for pipe in (answers, woken, wake):
                    os.close(pipe)
                _become(**json.loads(line))
            say(started=pid)
        else:
            return


def _become(words: list[str], environment: dict[str, str], log: str, folder: str) -> None:
    """Be a node: a session, an environment and a log of its own, as a new process has."""
    code: Any = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        said = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        for number in (1, 2):
            os.dup2(said, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.setsid()
        end_with_parent()
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
        os._exit(code)


if __name__ == "__main__":
    serve(sys.argv[1:])
