"""The nodes as processes of their own: started, watched, and stopped without leftovers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from plate_bringup import GraphError, GraphNode, RunOptions
from plate_core import config_path

from .forks import Fork, end_with_parent

KILL_S = 3.0
"""Time for the system to end a node that must [s]."""

STOP_SIGNALS = ((signal.SIGINT, 6.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, KILL_S))
"""Signals that stop a node, and how long each may take [s]."""

LAST = "device"
"""Ends after the others: the driver has it brake when it ends."""

TAIL_LINES = 12
"""Last lines of a log that are shown when a node has failed."""

MOST_ENDS, WITHIN_S = 5, 60.0
"""A program that ends by itself so often within so long [s] is not started again."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a program to end."""

ONE_PROCESS = "one_process"
"""The program that runs all nodes, and the name of its log."""


class Interrupted(KeyboardInterrupt):
    """A signal asked us to stop; `number` is the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextlib.contextmanager
def signals_raise() -> Iterator[None]:
    """Turn the first signal that ends a program into `Interrupted`, so that `finally` is reached.

    Later ones are ignored, so that what is to be done at the end is done.
    """

    def on_signal(number: int, frame: object) -> None:
        for each in ENDING:
            signal.signal(each, signal.SIG_IGN)
        raise Interrupted(number)

    before = {number: signal.signal(number, on_signal) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def signals_wait() -> Iterator[None]:
    """Hold signals back while something must not be interrupted; they take effect at its end."""
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
    """Return the variables that keep a graph on this machine and in its own domain."""
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
    """Return the file that `ros2 run` would start."""
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
    for prefix in prefixes:
        path = prefix / "lib" / package / name
        if os.access(path, os.X_OK):
            return path
    raise GraphError(f"{package} {name} is not installed; run: make setup, then: source env.sh")


ROS_ARGS = ("--ros-args", "--disable-external-lib-logs", "--params-file")


class Processes:
    """All nodes of a run. A context manager: at its end none of them is left.

    Parameters
    ----------
    nodes : iterable of GraphNode
    options : RunOptions
        Decides their parameters.
    logs : path
        Folder for NODE.log and its parameters, NODE.yaml; or of one_process.
    domain : int
        ROS domain.
    prefix : mapping of str to list, optional
        Words before the command line of a node.
    environment : mapping, optional
        Variables over those of `ros_environment`.
    remaps : mapping of str to (str, str), optional
        By node a topic, and the name that it has for this node alone.

    Attributes
    ----------
    exit_codes : dict of str to int
        By node, once stopped; negative: ended by that signal. Of all nodes in one process: by
        `one_process`, which is then the name to be given here.
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
        for name, (words, some) in runs.items():
            file = logs / f"{name}.yaml"
            file.write_text(options.parameter_file(some), encoding="utf-8")
            words = [*prefix.get(name, []), *words, *ROS_ARGS, str(config_path("nodes.yaml"))]
            remap = ["-r", ":=".join(remaps[name])] if name in remaps else []
            self._commands[name] = [*words, "--params-file", str(file), *remap]
        traced = {"PYTHONFAULTHANDLER": "1"}  # a crash shows where it was
        self._environment = os.environ | traced | ros_environment(domain) | dict(environment or {})
        self._running: dict[str, Fork | subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Processes:
        try:
            for name, words in self._commands.items():
                self._start(name, words)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _start(self, name: str, words: list[str], log_mode: str = "wb") -> None:
        # A session of its own: Ctrl-C at the terminal reaches us alone, and we tell the nodes.
        with self.log(name).open(log_mode) as log, signals_wait():
            if fork := Fork.start(words, self._environment, self.log(name), self._modules):
                self._running[name] = fork
                return
            self._running[name] = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )

    def add(self, commands: Mapping[str, list[str]]) -> None:
        """Start other programs beside the nodes; what is said of nodes holds for them too."""
        self._commands |= commands
        for name, words in commands.items():
            self._start(name, words)

    def restart(self, name: str, *words: str) -> None:
        """Start a node that has ended again, with these words after its command line; its log goes
        on."""
        self._start(name, [*self._commands[name], *words], "ab")

    @property
    def names(self) -> list[str]:
        """Names of what runs."""
        return list(self._running)

    def log(self, name: str) -> Path:
        """Return the path of a node's log."""
        return self._logs / f"{name}.log"

    def pid(self, name: str) -> int:
        """Return a node's process id."""
        return self._running[name].pid

    def check(self) -> None:
        """Raise if a node has ended by itself; those that only look on may.

        Raises
        ------
        GraphError
            Names the node and its exit code, and shows the end of its log.
        """
        for name in self._running:
            if name not in self._views and (end := self.end_of(name)):
                raise GraphError(end)

    def end_of(self, name: str) -> str:
        """Say how a node has ended, and show the end of its log; empty: it runs."""
        code = self._running[name].poll()
        return "" if code is None else f"{name} {ended(code)}\n{self.tail(name)}"

    def tail(self, name: str) -> str:
        """Return the last lines of a node's log, and where the rest is."""
        path = self.log(name)
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()[-TAIL_LINES:]
        return "\n".join([*(f"    {line}" for line in lines), f"  log: {path}"])

    def signal(self, name: str, number: int) -> None:
        """Send a signal to one node."""
        self._running[name].send_signal(number)

    def wait(self, name: str, timeout_s: float) -> int:
        """Return the exit code of a node that ends within the time [s].

        Raises
        ------
        GraphError
            It has not: it is ended, and its log shows where each of its threads was.
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
        """End all nodes, politely at first, and return their exit codes."""
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
    """Counts how often a program has ended by itself, for who starts it again."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=MOST_ENDS)

    def too_many(self, now: float) -> bool:
        """Count an end at a time [s]; tell whether it was the last of `MOST_ENDS` within
        `WITHIN_S`."""
        self._times.append(now)
        return len(self._times) == MOST_ENDS and now - self._times[0] <= WITHIN_S


def ended(code: int) -> str:
    """Say how a process ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}"
