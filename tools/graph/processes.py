"""Processes of the nodes: start, supervision and stop. No process remains after a run.

Each node has its own process, log and parameter file. Stopping sends SIGINT, then SIGTERM, then
SIGKILL. `signals_raise` and `signals_wait` control how signals interrupt this program during a run.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from plate_bringup import GraphError, GraphNode, RunOptions
from plate_core import config_path

from .forks import Fork, end_with_parent

KILL_S = 3.0
"""Maximum time until a process has ended after SIGKILL [s]."""

STOP_SIGNALS = ((signal.SIGINT, 6.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, KILL_S))
"""Signals that stop a node, and the time until the next signal is sent [s]."""

LAST = "device"
"""Process that is stopped after the others, because the driver makes the device brake when it
ends."""

TAIL_LINES = 12
"""Number of last lines of a log that are shown when a node has failed."""

MAX_ENDS, WITHIN_S = 5, 60.0
"""If a program has ended `MAX_ENDS` times within `WITHIN_S` [s], the program is not started
again."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a program."""

ONE_PROCESS = "one_process"
"""Name of the program that runs all nodes, and of its log."""


class Interrupted(KeyboardInterrupt):
    """A signal has requested the end of this program. `number` is the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextlib.contextmanager
def signals_raise() -> Iterator[None]:
    """Context in which the first signal of `ENDING` raises `Interrupted`, so that `finally` blocks
    run.

    Later signals are ignored, so that the cleanup is not interrupted.
    """

    def on_signal(number: int, frame: object) -> None:
        for signal_number in ENDING:
            signal.signal(signal_number, signal.SIG_IGN)
        raise Interrupted(number)

    before = {number: signal.signal(number, on_signal) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Context that must not be interrupted. The first signal of `ENDING` takes effect at the end of
    the context. Only the main thread runs signal handlers. In another thread, the context does
    nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pending: list[int] = []
    before = {number: signal.getsignal(number) for number in ENDING}
    for number in ENDING:
        signal.signal(number, lambda number, _: pending.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if pending:
            os.kill(os.getpid(), pending[0])


def ros_environment(domain: int) -> dict[str, str]:
    """Return the environment variables that restrict a graph to this computer and to a domain."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_STATIC_PEERS": "",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(config_path("fastdds.xml")),
        "SKIP_DEFAULT_XML_FILE": "1",
        "RCUTILS_COLORIZED_OUTPUT": "0",
        "PYTHONUNBUFFERED": "1",
    }


def executable(package: str, name: str) -> Path:
    """Return the file that `ros2 run` would start.

    Raises
    ------
    GraphError
        If the node is not installed.
    """
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
    for prefix in prefixes:
        path = prefix / "lib" / package / name
        if os.access(path, os.X_OK):
            return path
    raise GraphError(f"{package} {name} is not installed; run `make setup`, then `source env.sh`")


ROS_ARGS = ("--ros-args", "--disable-external-lib-logs", "--params-file")


class Processes:
    """Processes of all nodes of a run. Use this class as a context manager. At the end of the
    context, the processes are stopped.

    If all nodes run in one process, its name is `ONE_PROCESS` in all methods.

    Parameters
    ----------
    nodes : iterable of GraphNode
    options : RunOptions
        Determines the nodes' parameters.
    logs : path
        Folder for the files of each process: the log NAME.log and the parameters NAME.yaml.
    domain : int
        ROS domain.
    prefix : mapping of str to list, optional
        Words that are put before the command line of a node.
    environment : mapping, optional
        Additional environment variables, which override those of `ros_environment`.
    remaps : mapping of str to (str, str), optional
        For each node, a topic and a new name. Only this node uses the new name for the topic.

    Attributes
    ----------
    exit_codes : dict of str to int
        Exit code by process, after `stop`. A negative exit code is the signal that ended the
        process.
    """

    def __init__(
        self,
        nodes: Iterable[GraphNode],
        options: RunOptions,
        logs: Path,
        domain: int,
        prefix: Mapping[str, list[str]] | None = None,
        environment: Mapping[str, str] | None = None,
        remaps: Mapping[str, tuple[str, str]] | None = None,
    ) -> None:
        self.exit_codes: dict[str, int] = {}
        remaps, prefix, nodes = remaps or {}, prefix or {}, list(nodes)
        self._views = {node.name for node in nodes if node.view}
        self._modules = [node.component.rpartition(".")[0] for node in nodes]
        self._commands: dict[str, list[str]] = {}
        self._logs = logs
        logs.mkdir(parents=True, exist_ok=True)
        if options.one_process:
            names = [node.name for node in nodes]
            runs = {ONE_PROCESS: ([str(executable("plate_bringup", ONE_PROCESS)), *names], nodes)}
        else:
            runs = {n.name: ([str(executable(n.package, n.executable))], [n]) for n in nodes}
        for name, (command, some) in runs.items():
            file = logs / f"{name}.yaml"
            file.write_text(options.parameter_file(some), encoding="utf-8")
            command = [*prefix.get(name, []), *command, *ROS_ARGS, str(config_path("nodes.yaml"))]
            remap = ["-r", ":=".join(remaps[name])] if name in remaps else []
            self._commands[name] = [*command, "--params-file", str(file), *remap]
        # with this variable, a process that crashes prints a traceback
        traced = {"PYTHONFAULTHANDLER": "1"}
        self._environment = os.environ | traced | ros_environment(domain) | dict(environment or {})
        self._running: dict[str, Fork | subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Processes:
        try:
            for name, command in self._commands.items():
                self._start(name, command)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _start(self, name: str, command: list[str], log_mode: str = "wb") -> None:
        # Each node process has its own session. Therefore Ctrl-C in the terminal interrupts only
        # this program, which then stops the nodes.
        with self.log(name).open(log_mode) as log, signals_wait():
            if fork := Fork.start(command, self._environment, self.log(name), self._modules):
                self._running[name] = fork
                return
            self._running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )

    def add(self, commands: Mapping[str, list[str]]) -> None:
        """Start other programs, which are then treated like nodes."""
        self._commands |= commands
        for name, command in commands.items():
            self._start(name, command)

    def restart(self, name: str, *arguments: str) -> None:
        """Start a node again that has ended, with `arguments` added to its command line. The output
        is appended to the log of the node."""
        self._start(name, [*self._commands[name], *arguments], "ab")

    @property
    def names(self) -> list[str]:
        """Names of the processes that were started."""
        return list(self._running)

    def log(self, name: str) -> Path:
        """Return the path of a node's log."""
        return self._logs / f"{name}.log"

    def pid(self, name: str) -> int:
        """Return a node's process id."""
        return self._running[name].pid

    def check(self) -> None:
        """Check that no node has ended, except nodes that only display.

        Raises
        ------
        GraphError
            If a node has ended. The message contains the name, the exit code and the end of the
            log.
        """
        for name in self._running:
            if name not in self._views and (end := self.end_of(name)):
                raise GraphError(end)

    def end_of(self, name: str) -> str:
        """Return a text with the exit code of a node and the end of its log. The text is empty if
        the node runs."""
        code = self._running[name].poll()
        return "" if code is None else f"{name} {ending_text(code)}\n{self.tail(name)}"

    def tail(self, name: str) -> str:
        """Return the last lines of a node's log, and the path of the log."""
        path = self.log(name)
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL_LINES:]
        return "\n".join([*(f"    {line}" for line in lines), f"  log: {path}"])

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node."""
        self._running[name].send_signal(number)

    def wait(self, name: str, timeout_s: float) -> int:
        """Wait until a node ends, and return its exit code.

        Raises
        ------
        GraphError
            If the node does not end within `timeout_s` [s]. The node is then aborted, and its log
            shows the traceback of each thread.
        """
        process = self._running[name]
        try:
            return process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(KILL_S)
            log = self.log(name).read_text(encoding="utf-8", errors="replace")
            raise GraphError(f"{name} has not ended within {timeout_s:g} s\n{log}") from None

    def stop(self) -> dict[str, int]:
        """Stop all nodes by the signals of `STOP_SIGNALS`, and return their exit codes."""
        with signals_wait():
            for number, seconds in STOP_SIGNALS:
                for last in (False, True):
                    alive = [
                        process
                        for name, process in self._running.items()
                        if process.poll() is None and (name == LAST) is last
                    ]
                    for process in alive:
                        process.send_signal(number)
                    until = time.monotonic() + seconds
                    for process in alive:
                        with contextlib.suppress(subprocess.TimeoutExpired):
                            process.wait(max(0.0, until - time.monotonic()))
        self.exit_codes = {
            name: process.returncode if process.returncode is not None else -signal.SIGKILL
            for name, process in self._running.items()
        }
        return self.exit_codes


class Ends:
    """Counts how often a program has ended, to limit how often it is started again."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=MAX_ENDS)

    def too_many(self, now: float) -> bool:
        """Count an end at the time `now` [s]. Return whether the program has ended `MAX_ENDS` times
        within `WITHIN_S`."""
        self._times.append(now)
        return len(self._times) == MAX_ENDS and now - self._times[0] <= WITHIN_S


def ending_text(code: int) -> str:
    """Return a text that describes how a process ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}"
