"""Main functions of all node programs. These functions start, spin and cleanly stop one or several
nodes.

`run_node` runs one node, `run_nodes` several in one process. Both functions handle signals, wrong
parameters and the end of the parent process. Both functions destroy the nodes within a time limit.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..ending import ends, piped
from ..errors import PlateError
from ..network import choose_network, memory_problem, ros_domain
from .console import nonblocking_stderr
from .executor import NodeExecutor
from .lifecycle import SafeLifecycleNode, start_nodes
from .usage import check_parameter_files, print_help

LAST_ROUNDS = 5
"""Number of executor rounds after the nodes are deactivated. In these rounds, the nodes send their
last messages."""

POLL_S = 0.1
"""Maximum delay of the reaction to a signal [s]. Python handles a signal only when the executor
returns."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a node. The system sends SIGHUP when the terminal closes. SIGHUP does not end a
node if the process ignores this signal."""


def run_node(
    make: Callable[[], Node], options: type | None = None, args: Sequence[str] | None = None
) -> None:
    """Create a node, start it, spin it until it must stop, and destroy it.

    With `--help` on the command line, only the node's docstring and its parameters are printed.
    `options` is the dataclass that the node passes to `declare`.

    `destroy_node` is called while ROS still works, so that the node can publish its last messages.
    The signal handlers of rclpy are not used, because they would shut the context down first.

    The node also ends when its parent process has ended, for example `ros2 launch` after SIGTERM.
    If its parameter `end_with_parent` is false, the node continues without its parent process.

    The exit code is 0 after SIGINT, SIGTERM, SIGHUP or a shutdown. The exit code is 2, with a
    one-line message, if the node refuses its parameters or files. The exit code is 1, with a
    traceback, if the program has a defect.
    """
    try:
        with piped():
            if print_help(make, options, args):
                return
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        sys.exit(2)
    run_nodes({"": make}, args)


def run_nodes(makes: Mapping[str, Callable[[], Node]], args: Sequence[str] | None = None) -> None:
    """Run several nodes in one process and one executor, like `run_node`.

    `makes` maps names to node constructors. All nodes are created, then all nodes are configured,
    then all nodes are activated, each time in the order of `makes`. An error message starts with
    the node's name.
    """
    nodes: list[Any] = []
    code = 1  # exit code after an unexpected exception
    try:
        with nonblocking_stderr():
            code = _run_nodes(makes, nodes, args)
    finally:  # all log lines are written at this point
        with ends(code), contextlib.ExitStack() as stack:
            stack.callback(rclpy.try_shutdown)
            for node in nodes:
                stack.callback(node.destroy_node)
    if code:
        sys.exit(code)


class _Signals:
    """Handler of the signals that end the nodes.

    Attributes
    ----------
    stopped : bool
        Whether a signal has arrived.
    interrupted : bool
        Whether a signal has raised a KeyboardInterrupt.
    spinning : bool
        Whether the nodes are spinning. The loop then reads `stopped`, so a signal need not raise an
        exception, unless a node is being configured.
    """

    def __init__(self, nodes: Sequence[Any]) -> None:
        self._nodes = nodes
        self.stopped = False
        self.interrupted = False
        self.spinning = False

    def install(self) -> None:
        """Replace inherited signal handlers. For example, a program that a script starts with &
        would ignore SIGINT."""
        for number in ENDING:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

    def ignore(self) -> None:
        """Ignore all further signals."""
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # a second signal has no effect, so that it does not interrupt the clean-up
        was_stopped, self.stopped = self.stopped, True
        configuring = any(getattr(node, "configuring", False) for node in self._nodes)
        if not (was_stopped or (self.spinning and not configuring)):
            self.interrupted = True
            raise KeyboardInterrupt


def _run_nodes(
    makes: Mapping[str, Callable[[], Node]], nodes: list[Any], args: Sequence[str] | None
) -> int:
    """Run the nodes until they must stop. Return the exit code. The new nodes are appended to
    `nodes`, and the caller destroys the nodes."""
    code = 0
    signals = _Signals(nodes)
    signals.install()
    # A program stores the process id of its parent in PARENT before it loads code. The parent may
    # end while the code is loaded.
    parent = getattr(sys.modules["__main__"], "PARENT", os.getppid())
    try:
        _init_ros(args)
        _spin_nodes(makes, nodes, signals, parent)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (PlateError, InvalidParameterTypeException) as error:
        if len(makes) > 1:
            failed = (n.get_name() for n in nodes if getattr(n, "failure", None) is error)
            being_made = [*makes, ""][len(nodes)]
            error = PlateError(f"{next(failed, being_made)}: {error}")
        print(f"error: {error}", file=sys.stderr, flush=True)
        code = 2
    except Exception:
        # If a KeyboardInterrupt is raised while rclpy converts a message, rclpy raises a
        # RuntimeError instead.
        if not signals.interrupted:
            raise
    finally:
        signals.ignore()
        with contextlib.ExitStack() as stack:
            for node in nodes:
                if isinstance(node, SafeLifecycleNode):
                    stack.callback(node.close)
    return code


def _spin_nodes(
    makes: Mapping[str, Callable[[], Node]], nodes: list[Any], signals: _Signals, parent: int
) -> None:
    """Create the nodes, start them, and spin them until they must stop. Then deactivate them.

    `parent` is the id of the parent process. When this process has ended, the nodes end too, unless
    their parameter `end_with_parent` is false.
    """
    # rclpy's EventsExecutor would need half the CPU time. However, under load, a lifecycle
    # transition with this executor can end or crash a node.
    executor = NodeExecutor()
    for make in makes.values():
        nodes.append(make())
        executor.add_node(nodes[-1])
    start_nodes(*(node for node in nodes if isinstance(node, SafeLifecycleNode)))
    options = (getattr(node, "options", None) for node in nodes)
    bound = all(getattr(node_options, "end_with_parent", True) for node_options in options)
    signals.spinning = True
    while rclpy.ok() and not signals.stopped and not (bound and os.getppid() != parent):
        executor.spin_once(timeout_sec=POLL_S)
    # Deactivation ends the running action goals. The calls of `spin_once` below send the results of
    # these goals.
    for node in nodes:
        if isinstance(node, SafeLifecycleNode) and node.active and rclpy.ok():
            node.before_end()
            node.trigger_deactivate()
    for _ in range(LAST_ROUNDS if rclpy.ok() else 0):
        executor.spin_once(timeout_sec=0.01)


def _init_ros(args: Sequence[str] | None) -> None:
    """Start ROS. A wrong command line or parameter file is an error of the user, not a defect, so
    it raises a PlateError."""
    for problem in filter(None, (choose_network(os.environ), memory_problem())):
        print(f"warning: {problem}", file=sys.stderr, flush=True)
    check_parameter_files(args)
    ros_domain(os.environ)
    try:
        rclpy.init(
            args=list(args) if args is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # rclpy raises RCLError, a RuntimeError that has no public name
        raise PlateError(str(error).splitlines()[0]) from None
