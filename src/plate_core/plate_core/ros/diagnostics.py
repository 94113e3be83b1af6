"""Publishing and reading of the topic `diagnostics`.

Every node publishes its level, message and values once per second, independently of its inputs. If
the level becomes worse, the node publishes the new level within 0.1 s. `msg_to_reports` reads these
messages.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ..status import Finding, Level
from .qos import DATA

DIAGNOSTICS_PERIOD_S = 1.0
"""Period of the diagnostics [s]. A node that publishes no diagnostics for a longer time has ended
or is blocked."""

POLL_PERIOD_S = 0.1
"""Period at which a node checks whether its level has become worse [s]."""


class Report(NamedTuple):
    """Diagnostics of one node: the node's name without namespace, its level, its message, and its
    values as text. If the status is from a node of another package, `own` is False, and `node` is
    the name of the status."""

    node: str
    level: Level
    message: str
    values: dict[str, str]
    own: bool = True


def msg_to_reports(msg: DiagnosticArray, namespace: str) -> Iterator[Report]:
    """Yield the reports in a diagnostics message that concern the nodes of a namespace.

    This project's nodes name a status by their full name. Several plates can share one topic, so
    statuses of nodes in other namespaces are skipped. Other packages often name a status `node:
    component`, without a namespace. A status with an unknown level is skipped.

    Parameters
    ----------
    msg : DiagnosticArray
    namespace : str
        Namespace of the node that has received the message, as `Node.get_namespace` returns it.
    """
    for status in msg.status:
        level = int.from_bytes(status.level, "little")
        space, _, node = status.name.rpartition("/")
        is_absolute = status.name.startswith("/")
        if level in set(Level) and (not is_absolute or f"{space}/" == f"{namespace.rstrip('/')}/"):
            values = {item.key: item.value for item in status.values}
            name = node if is_absolute else status.name
            yield Report(name, Level(level), status.message, values, is_absolute)


def diagnostics_topics(node: Node) -> list[str]:
    """Return the full names of the topics on which the nodes in the namespace of `node` can publish
    diagnostics. Several plates can share the topic /diagnostics."""
    return sorted({node.resolve_topic_name("diagnostics"), "/diagnostics"})


class Diagnostics:
    """Publisher of the diagnostics of a node, timed by the steady clock. See `plate_core.status`.

    Parameters
    ----------
    node : Node
    find : callable
        Function of the time [s, steady clock]. The function returns the level and the reason for
        the level.
    values : callable
        Function that returns the values to publish, by name.
    hardware_id : callable
        Function that returns the identifier of the hardware, such as the name of a rig.
    reported : callable, optional
        Function that is called after each periodic report. For example, it resets the counters of a
        period.
    stamp : callable, optional
        Function that returns the stamp of a report. Default: the time of the node's clock.
    """

    def __init__(
        self,
        node: Node,
        find: Callable[[float], Finding],
        values: Callable[[], Mapping[str, Any]],
        hardware_id: Callable[[], str] = str,
        reported: Callable[[], None] = lambda: None,
        stamp: Callable[[], Time] | None = None,
    ) -> None:
        self._node, self._diagnose, self._values = node, find, values
        self._hardware_id, self._begin_report, self._stamp = hardware_id, reported, stamp
        self._level, self._due = Level.OK, time.monotonic() + DIAGNOSTICS_PERIOD_S
        self._publisher = node.create_publisher(DiagnosticArray, "diagnostics", DATA)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(POLL_PERIOD_S, self._poll, clock=steady)

    def publish(self) -> None:
        """Publish immediately, in addition to the periodic reports."""
        self._publish(self._diagnose(time.monotonic()))

    def destroy(self) -> None:
        """Stop publishing. Nodes call this method before they are configured again."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)

    def _poll(self) -> None:
        now = time.monotonic()
        finding = self._diagnose(now)
        if now < self._due:
            if finding.level.rank > self._level.rank:
                self._publish(finding)
            return
        # If a stall of the process delayed this report, the next report follows after at least half
        # a period.
        self._due = max(self._due, now - DIAGNOSTICS_PERIOD_S / 2) + DIAGNOSTICS_PERIOD_S
        self._publish(finding)
        self._begin_report()

    def _publish(self, finding: Finding) -> None:
        self._level = finding.level
        status = DiagnosticStatus(
            level=bytes([finding.level]),
            name=self._node.get_fully_qualified_name(),
            message=finding.message,
            hardware_id=self._hardware_id(),
        )
        status.values = [KeyValue(key=k, value=str(v)) for k, v in self._values().items()]
        msg = DiagnosticArray(status=[status])
        msg.header.stamp = (
            self._node.get_clock().now().to_msg() if self._stamp is None else self._stamp()
        )
        self._publisher.publish(msg)
