"""What a node says while it compiles: in its log and diagnostics, from a thread of its own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ..status import COMPILING
from .diagnostics import COMPILING_S
from .qos import DATA

QUIET_S = 3.0
"""Loading what was compiled before takes less [s]; nothing is said of it."""

TELL_S, LOG_S = 1.0, 10.0
"""Between two diagnostics, and between two lines in the log [s]."""


@contextmanager
def compiling(node: Node) -> Iterator[None]:
    """Say that the node compiles, and for how long it has, as long as the context lasts.

    To be entered in the node's constructor, before it listens to anything: who waits for an answer
    hears why there is none yet.
    """
    publisher = node.create_publisher(DiagnosticArray, "diagnostics", DATA)
    over, began = Event(), time.monotonic()
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name=node.get_fully_qualified_name())

    def tell() -> None:
        logged = -LOG_S
        pause_s = QUIET_S
        while not over.wait(pause_s):
            pause_s, now = TELL_S, time.monotonic() - began
            status.message = f"{COMPILING} for {now:.0f} s (at the first start: a minute or two)"
            status.values = [KeyValue(key=COMPILING_S, value=f"{now:.0f}")]
            msg = DiagnosticArray(status=[status])
            msg.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(msg)
            if now - logged >= LOG_S:
                logged = now
                node.get_logger().info(status.message)

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
        if status.message:
            node.get_logger().info(f"compiled within {time.monotonic() - began:.0f} s")
        node.destroy_publisher(publisher)
