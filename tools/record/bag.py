"""Recording of all messages of a graph to a bag that ros2 bag and Foxglove open.

The module uses the package rosbags, which writes the serialised messages to one .mcap file with
metadata.yaml.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from plate_core import PlateError

DISCOVERY_S = 0.5
"""Interval at which the recorder searches for new topics [s]."""

DEPTH = 200
"""Length of the subscriptions' queues [messages]."""

INTERFACES = "plate_interfaces"
"""Package with the project's messages, which rosbags does not know."""

BAG_VERSION: Final = 9
"""Version of the bag's metadata.yaml, as ROS 2 Jazzy writes it."""


class Recorder:
    """Subscribes to every topic that appears, and writes its messages. Use this class as a context
    manager.

    Parameters
    ----------
    node : Node
        Node of the subscriptions. The caller must spin the node, and call `discover` regularly.
    folder : path
        New folder for the bag.

    Raises
    ------
    PlateError
        If the package rosbags is missing.
    """

    def __init__(self, node: Node, folder: Path) -> None:
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError:
            raise PlateError(
                "recording needs the package rosbags; run `pip install rosbags`, or use "
                "`ros2 bag record -a`"
            ) from None
        self._node, self._checked_at = node, -DISCOVERY_S
        self._types = get_typestore(Stores.ROS2_JAZZY)
        for path in Path(get_package_share_directory(INTERFACES)).glob("msg/*.msg"):
            text = path.read_text(encoding="utf-8")
            self._types.register(get_types_from_msg(text, f"{INTERFACES}/msg/{path.stem}"))
        self._writer = Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
        self._recorded: set[str] = set()

    def __enter__(self) -> Recorder:
        self._writer.open()
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()

    def discover(self) -> None:
        """Subscribe to topics that are new since the last search. Within `DISCOVERY_S` after a
        search, do nothing."""
        if time.monotonic() - self._checked_at < DISCOVERY_S:
            return
        self._checked_at = time.monotonic()
        for topic, kinds in self._node.get_topic_names_and_types():
            publishers = self._node.get_publishers_info_by_topic(topic)
            if topic in self._recorded or not publishers or kinds[0] not in self._types.types:
                continue
            self._recorded.add(topic)
            offered = [publisher.qos_profile for publisher in publishers]
            package, _, name = kinds[0].split("/")
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            write = self._make_writer(topic, kinds[0], offered)
            self._node.create_subscription(kind, topic, write, profile_for(offered), raw=True)

    def _make_writer(
        self, topic: str, kind: str, offered: Sequence[QoSProfile]
    ) -> Callable[[bytes], None]:
        connection = self._writer.add_connection(
            topic,
            kind,
            typestore=self._types,
            offered_qos_profiles=[_bag_qos(qos) for qos in offered],
        )

        def write(data: bytes) -> None:
            self._writer.write(connection, time.time_ns(), bytes(data))

        return write


def profile_for(offered: Sequence[QoSProfile]) -> QoSProfile:
    """Return the quality of service that is compatible with all publishers of a topic. If all
    publishers are latched, also request the messages from before the subscription."""
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _bag_qos(qos: QoSProfile) -> Any:
    """Convert a publisher's quality of service to the bag's form. The playback then publishes with
    the same quality of service."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    def time(duration: Duration) -> QosTime:
        return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))

    return Qos(
        QosHistory[qos.history.name], qos.depth, QosReliability[qos.reliability.name],
        QosDurability[qos.durability.name], time(qos.deadline), time(qos.lifespan),
        QosLiveliness[qos.liveliness.name], time(qos.liveliness_lease_duration),
        qos.avoid_ros_namespace_conventions,
    )  # fmt: skip
