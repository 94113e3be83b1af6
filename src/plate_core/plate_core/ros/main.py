"""The same clean start and stop for every node."""

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
from ..network import choose_network, ros_domain
from .console import never_held
from .executor import NodeExecutor
from .lifecycle import SafeLifecycleNode, start_nodes
from .usage import answered, check_parameter_files

LAST_ROUNDS = 5
"""Rounds of the executor in which what was said at the end is sent."""

POLL_S = 0.1
"""A signal waits at most this long: Python sees it only when the executor returns."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a node. SIGHUP, from a closed terminal, does so unless it is ignored."""


def run_node(
    make: Callable[[], Node], options: type | None = None, args: Sequence[str] | None = None
) -> None:
    """Make a node, start it, spin it until it has to stop, and leave nothing behind.

    With `--help` on the command line it only prints what the node's docstring says, and the
    parameters of `options`, the dataclass that the node gives to `declare`.

    The node's `destroy_node` runs while ROS still works, so a node can say its last words there:
    rclpy's own handlers would have shut the context down at the signal.

    The node also ends when the process that started it has ended, such as `ros2 launch` after
    SIGTERM, unless its parameter `end_with_parent` is false.

    Exit code 0 after SIGINT, SIGTERM, SIGHUP or a shutdown; 2, with one line, if the node refuses
    its parameters or files; 1, with a traceback, after a defect.
    """
    try:
        with piped():
            if answered(make, options, args):
                return
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        sys.exit(2)
    run_nodes({"": make}, args)


def run_nodes(makes: Mapping[str, Callable[[], Node]], args: Sequence[str] | None = None) -> None:
    """Do the same for several nodes in one process and one executor, given by name: all are made,
    then configured, then activated, in this order. What one refuses begins with its name.
    """
    nodes: list[Any] = []
    code = 1  # of a defect
    try:
        with never_held():
            code = _run(makes, nodes, args)
    finally:  # all that was logged is written out by now
        with ends(code), contextlib.ExitStack() as stack:
            stack.callback(rclpy.try_shutdown)
            for node in nodes:
                stack.callback(node.destroy_node)
    if code:
        sys.exit(code)


def _run(
    makes: Mapping[str, Callable[[], Node]], nodes: list[Any], args: Sequence[str] | None
) -> int:
    """Do so, but leave the nodes to be destroyed, and return the exit code."""
    stopped, spinning = False, False
    code = 0

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        again, stopped = stopped, True  # a second signal must not break the teardown
        waiting = spinning and not any(getattr(node, "configuring", False) for node in nodes)
        if not (again or waiting):
            raise KeyboardInterrupt

    for number in ENDING:  # override inherited handlers: in a script `program &` ignores SIGINT
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, on_signal)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    # A program notes its parent before it loads code, because the parent may end meanwhile.
    parent = getattr(sys.modules["__main__"], "PARENT", os.getppid())
    try:
        _init(args)
        # EventsExecutor takes half the time, but a node ends or crashes by a transition under load.
        executor = NodeExecutor()
        for make in makes.values():
            nodes.append(make())
            executor.add_node(nodes[-1])
        start_nodes(*(node for node in nodes if isinstance(node, SafeLifecycleNode)))
        options = (getattr(node, "options", None) for node in nodes)
        bound = all(getattr(each, "end_with_parent", True) for each in options)
        spinning = True
        while rclpy.ok() and not stopped and not (bound and os.getppid() != parent):
            executor.spin_once(timeout_sec=POLL_S)
        for node in nodes:  # while messages still go out: results of goals that end with it
            if isinstance(node, SafeLifecycleNode) and node.active and rclpy.ok():
                node.trigger_deactivate()
        for _ in range(LAST_ROUNDS if rclpy.ok() else 0):
            executor.spin_once(timeout_sec=0.01)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (PlateError, InvalidParameterTypeException) as error:  # the latter: of rclpy's own
        if len(makes) > 1:
            failed = (n.get_name() for n in nodes if getattr(n, "failure", None) is error)
            being_made = [*makes, ""][len(nodes)]
            error = PlateError(f"{next(failed, being_made)}: {error}")
        print(f"error: {error}", file=sys.stderr, flush=True)
        code = 2
    finally:
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)
        with contextlib.ExitStack() as stack:
            for node in nodes:
                if isinstance(node, SafeLifecycleNode):
                    stack.callback(node.close)
    return code


def _init(args: Sequence[str] | None) -> None:
    """Start ROS; a wrong command line or parameter file is the user's error, not a defect."""
    if opened := choose_network(os.environ):
        print(f"warning: {opened}", file=sys.stderr, flush=True)
    check_parameter_files(args)
    ros_domain(os.environ)
    try:
        rclpy.init(
            args=list(args) if args is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # RCLError, which has no public name
        raise PlateError(str(error).splitlines()[0]) from None
