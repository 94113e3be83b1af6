"""The same clean start and stop for every node."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from ..errors import PlateError


def run_node(make: Callable[[], Node], args: Sequence[str] | None = None) -> None:
    """Make a node, spin it until it is told to stop, and leave nothing behind.

    Exit code 0 after SIGINT, SIGTERM or a shutdown; 2, with one line, if `make` refuses its
    parameters or files; 1, with a traceback, after a defect.
    """
    rclpy.init(args=list(args) if args is not None else None)
    # Stock rclpy turns SIGINT into KeyboardInterrupt only inside spin(); SIGTERM ends the context.
    node = None
    code = 0
    try:
        node = make()
        # EventsExecutor.spin() hangs in some builds; spin_once on it works and is the fastest.
        executor = EventsExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except PlateError as error:
        print(f"error: {error}", file=sys.stderr, flush=True)
        code = 2
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not break the teardown
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if code:
        sys.exit(code)
