"""When each message on the way from image to motors was published, as the middleware notes it."""

from __future__ import annotations

import struct
import threading
from collections import defaultdict
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory

from plate_core.ros import CAMERA
from plate_interfaces.msg import PartForces, Parts

CHAIN: tuple[tuple[str, Any], ...] = (
    ("image_raw", Image),
    ("parts", Parts),
    ("part_forces", PartForces),
    ("plate_cycle", JointTrajectory),
    ("motor_setpoints", JointTrajectory),
)
"""Topics from image to motors."""

STAMP = struct.Struct("<4xiI")
"""Begin of a message on the wire: encapsulation, then the header's stamp."""

TAKE_S = 0.2


class Hops:
    """A node that listens in a thread of its own; a context manager, inside an `Observer`'s.

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
        self._images = images
        self.times: dict[int, list[int]] = defaultdict(lambda: [0] * len(CHAIN))
        self.newest: dict[str, bytes] = {}
        self._over = False
        self._node = rclpy.create_node("hops", namespace=namespace)
        self._executor = SingleThreadedExecutor()  # EventsExecutor has no raw messages with times
        self._executor.add_node(self._node)
        for number, (topic, kind) in enumerate(CHAIN):
            if number == 0 and not images:
                continue
            heard = self._listener(number, topic)
            self._node.create_subscription(kind, topic, heard, CAMERA, raw=True)
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def _listener(self, number: int, topic: str) -> Any:
        def heard(data: bytes, info: dict[str, int]) -> None:
            second, nanosecond = STAMP.unpack_from(data)
            stamp = second * 1_000_000_000 + nanosecond
            row = self.times[stamp]
            row[0] = row[0] if self._images else stamp
            row[number] = row[number] or info["source_timestamp"]
            self.newest[topic] = data

        return heard

    def _listen(self) -> None:
        while not self._over:
            self._executor.spin_once(timeout_sec=TAKE_S)

    def __enter__(self) -> Hops:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over = True
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
