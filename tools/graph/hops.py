"""When each message on the way from image to motors was published, as the middleware notes it."""

from __future__ import annotations

import struct
import threading
from collections import defaultdict
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor

from plate_core.ros import CAMERA

from .relays import CHAIN

STAMP = struct.Struct("<4xiI")
"""Begin of a message on the wire: encapsulation, then the header's stamp."""


class Listener:
    """A node that hears messages, and when they were published, in a thread of its own; a context
    manager, inside an `Observer`'s."""

    def __init__(self, name: str, namespace: str = "") -> None:
        self.node = rclpy.create_node(name, namespace=namespace)
        self._executor = SingleThreadedExecutor()  # EventsExecutor has no raw messages with times
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
    """Listens to the topics of `CHAIN`.

    Parameters
    ----------
    namespace : str
    images : bool
        Whether to listen to images too; if not, they count as published at their stamp.

    Attributes
    ----------
    times : dict of int to list
        Stamp of an image [ns] -> when it and its answers were published [ns, UTC], in the order of
        `CHAIN`; 0: not yet. Of several answers the first counts.
    newest : dict of str to bytes
        The last message of each topic, as on the wire.
    """

    def __init__(self, namespace: str = "", images: bool = True) -> None:
        super().__init__("hops", namespace)
        self._images = images
        self.times: dict[int, list[int]] = defaultdict(lambda: [0] * len(CHAIN))
        self.newest: dict[str, bytes] = {}
        for number, (topic, kind) in enumerate(CHAIN):
            if number or images:
                heard = self._listener(number, topic)
                self.node.create_subscription(kind, topic, heard, CAMERA, raw=True)

    def _listener(self, number: int, topic: str) -> Any:
        def heard(data: bytes, info: dict[str, int]) -> None:
            second, nanosecond = STAMP.unpack_from(data)
            stamp = second * 1_000_000_000 + nanosecond
            row = self.times[stamp]
            row[0] = row[0] if self._images else stamp
            row[number] = row[number] or info["source_timestamp"]
            self.newest[topic] = data

        return heard
