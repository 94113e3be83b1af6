"""Nodes as forks of one process that has loaded their code: they start in a fraction of the time
and share its memory. What runs is the file that `ros2 run` would start."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import fcntl
import gc
import multiprocessing
import os
import runpy
import select
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from multiprocessing.context import ForkServerProcess
from pathlib import Path

OF_A_RUN = ("ROS_", "RCUTILS_", "FASTRTPS_", "SKIP_DEFAULT_XML_FILE", "PYTHON")
"""Beginnings of variables that are read when a node starts; others may be when code is loaded."""

PR_SET_PDEATHSIG, PR_SET_NAME = 1, 15

_server = multiprocessing.get_context("forkserver")
_libc = ctypes.CDLL(None)


def end_with_parent() -> None:
    """Have this process end when the one that started it does, also without a word."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


class Fork:
    """A node, as `subprocess.Popen` has programs.

    Parameters
    ----------
    words : list of str
        Its command line.
    environment : mapping of str to str
    log : path
        File to which it adds what it says.
    modules : iterable of str
        What it needs: loaded with the first node, and for all others too.
    """

    def __init__(
        self, words: list[str], environment: Mapping[str, str], log: Path, modules: Iterable[str]
    ) -> None:
        _server.set_forkserver_preload([*modules])
        self._process: ForkServerProcess = _server.Process(
            target=_become, args=(words, dict(environment), str(log))
        )
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code; negative: ended by that signal; None: it runs."""
        return self._process.exitcode

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
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.returncode is None:
            os.kill(self.pid, number)


def can_fork(words: list[str], environment: Mapping[str, str]) -> bool:
    """Whether a command is a Python script, and code that was loaded with our own variables is as
    if it was loaded with these."""
    mine, its = (
        {name: value for name, value in each.items() if not name.startswith(OF_A_RUN)}
        for each in (os.environ, environment)
    )
    with contextlib.suppress(OSError), open(words[0], "rb") as script:
        return mine == its and b"python" in script.readline(100)
    return False


def _become(words: list[str], environment: dict[str, str], log: str) -> None:
    """Be the node: a session, an environment and a log of its own, as a new process has."""
    gc.freeze()  # or the first collection copies all pages of the server
    os.setsid()
    end_with_parent()  # the server; and with whom it serves:
    asked_by = multiprocessing.parent_process().sentinel  # type: ignore[union-attr]
    fcntl.fcntl(asked_by, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(asked_by, fcntl.F_SETSIG, signal.SIGTERM)
    fcntl.fcntl(asked_by, fcntl.F_SETFL, os.O_ASYNC)
    if select.select([asked_by], [], [], 0)[0]:
        sys.exit()
    _libc.prctl(PR_SET_NAME, os.path.basename(words[0]).encode())
    said = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for number in (1, 2):
        os.dup2(said, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdout, sys.stderr = (open(number, "w", buffering=1) for number in (1, 2))  # noqa: SIM115
    faulthandler.enable()  # a crash shows where it was
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = words
    runpy.run_path(words[0], run_name="__main__")
