"""Publication times of each message in the chain of topics from the image to the motor setpoints.

The times are the middleware's source timestamps. All messages that result from one image have the
stamp of this image. Therefore the messages are collected by stamp.
"""

from __future__ import annotations

import struct
import threading
from collections import defaultdict
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor

from plate_core.ros import CAMERA

from .gate import CHAIN

STAMP = struct.Struct("<4xiI")
"""First bytes of a serialised message: 4 bytes of encapsulation, then the header's stamp."""


class Listener:
    """ROS node that receives messages with their publication times, in a separate thread. Use this
    class as a context manager inside the context of an `Observer`."""

    def __init__(self, name: str) -> None:
        self.node = rclpy.create_node(name)
        # rclpy's EventsExecutor is not used, because it does not support raw messages with
        # publication times.
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()


class Hops(Listener):
    """Receives the topics of `CHAIN`, and stores their publication times.

    Parameters
    ----------
    images : bool
        Whether to receive images. If False, an image counts as published at the time of its stamp.

    Attributes
    ----------
    times : dict of int to list
        For each image's stamp [ns], the publication times of the image and of the messages that
        result from it [ns, UTC]. The order is that of `CHAIN`. A time is 0 if the message is not
        published yet. If a topic has several messages with the stamp, the first one counts.
    """

    def __init__(self, images: bool = True) -> None:
        super().__init__("hops")
        self._images = images
        self.times: dict[int, list[int]] = defaultdict(lambda: [0] * len(CHAIN))
        for number, (topic, kind) in enumerate(CHAIN):
            if number or images:
                on_message = self._make_listener(number)
                self.node.create_subscription(kind, topic, on_message, CAMERA, raw=True)

    def _make_listener(self, number: int) -> Any:
        def on_message(data: bytes, info: dict[str, int]) -> None:
            second, nanosecond = STAMP.unpack_from(data)
            stamp = second * 1_000_000_000 + nanosecond
            row = self.times[stamp]
            row[0] = row[0] if self._images else stamp
            row[number] = row[number] or info["source_timestamp"]

        return on_message
