"""The same clean start and stop for every node."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ..errors import PlateError
from .lifecycle import SafeLifecycleNode, start_nodes
from .usage import answered

POLL_S = 0.1
"""A signal waits at most this long: Python sees it only when the executor returns."""


def run_node(
    make: Callable[[], Node], options: type | None = None, args: Sequence[str] | None = None
) -> None:
    """Make a node, start it, spin it until it has to stop, and leave nothing behind.

    With `--help` on the command line it only prints what the node's docstring says, and the
    parameters of `options`, the dataclass that the node gives to `declare`.

    The node's `destroy_node` runs while ROS still works, so a node can say its last words there:
    rclpy's own handlers would have shut the context down at the signal.

    Exit code 0 after SIGINT, SIGTERM or a shutdown; 2, with one line, if the node refuses its
    parameters or files; 1, with a traceback, after a defect.
    """
    try:
        if answered(make, options, args):
            return
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        sys.exit(2)
    stopped = spinning = False
    node = None
    code = 0

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        again, stopped = stopped, True  # a second signal must not break the teardown
        if not again and (not spinning or getattr(node, "configuring", False)):
            raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    try:
        _init(args)
        node = make()
        # EventsExecutor.spin() hangs in some builds; spin_once on it works and is the fastest.
        executor = EventsExecutor()
        executor.add_node(node)
        if isinstance(node, SafeLifecycleNode):
            start_nodes(node)
        spinning = True
        while rclpy.ok() and not stopped:
            executor.spin_once(timeout_sec=POLL_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        code = 2
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if code:
        sys.exit(code)


def _init(args: Sequence[str] | None) -> None:
    """Start ROS; a wrong command line or parameter file is the user's error, not a defect."""
    try:
        rclpy.init(
            args=list(args) if args is not None else None,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # RCLError, which has no public name
        raise PlateError(str(error).splitlines()[0]) from None
