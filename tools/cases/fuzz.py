"""Send malformed messages to every topic of the real nodes. A node must not crash, leak
memory or make the plate exceed its limits.

Each node's class is created in this process, and its callbacks receive messages that were
serialised and deserialised, like any message from the network. Most messages are valid messages in
which up to four fields were changed. The new values are not finite, huge, empty, too long, in the
wrong order, or another stamp. The motion that the driver sends, and the motion that the simulated
device executes, are checked at samples. This check is independent of the limit checks in the driver
and the device.
"""

from __future__ import annotations

import gc
import importlib
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import rclpy
from graph.domains import own_domain
from graph.proc import memory_mb
from graph.processes import ros_environment
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.serialization import deserialize_message, serialize_message
from record.limits import limit_fractions
from trajectory_msgs.msg import JointTrajectory

from cases import Outcome, select_nodes
from plate_bringup import RunOptions, load_graph
from plate_core import CycleRequest, Parts, PlateCycle, Rig, load_rig
from plate_core.ros import (
    SafeLifecycleNode,
    array_to_image,
    cycle_to_msg,
    motors_to_msg,
    msg_to_motors,
    request_to_msg,
    start_nodes,
    targets_to_msg,
    to_time,
)
from plate_core.tasks import PartTarget
from plate_interfaces.srv import PlacePart, RemovePart

NODES = {node.name: node.component for node in RunOptions().nodes(load_graph())}
NUMBERS = (0.0, -0.0, 1e-300, 1.0, -1.0, 1e3, -1e9, 1e200, -1e308, np.nan, np.inf, -np.inf)
TEXTS = ("", "x", "black_1", "motor_1", "ready", "stopped", "mono8", "\u00e9\u00e4", "a" * 5000)
WARM = 0.2
"""Fraction of the messages after which memory is measured for the first time."""

POOL = 200
"""Number of valid messages of each type from which the test chooses."""

COUNTS, PROBABILITIES = (0, 1, 2, 3, 11), (0.2, 0.5, 0.2, 0.09, 0.01)
"""Numbers of parts in valid messages, and the probabilities of these numbers. Messages with many
parts are rare, because the solver needs 0.1 s for such a message."""

TICK = 20
"""Number of messages between two calls of the node's timer callback."""

MAX_GROWTH_MB = 20.0
"""Maximum growth of a node's memory [MB]."""

ROUNDING = {"driver": 1e-4, "simulator": 0.02}
"""Fraction of a limit by which a motion may exceed the limit. For the driver, this fraction is the
rounding error. For the simulator, this fraction is the tolerance of the simulated device."""


@dataclass
class Verdict:
    """Result of the test of one node."""

    node: str
    messages: int = 0
    crashes: int = 0
    first: str = ""
    growth_mb: float = 0.0
    tables: int = 0
    moving: int = 0
    worst_share: float = 0.0
    slowest_ms: float = 0.0
    seconds: float = 0.0


def message_templates(rig: Rig, rng: np.random.Generator) -> dict[type, bytes]:
    """Return a random valid message of each type, serialised."""
    t = np.arange(24) / 24
    size = rng.choice([0.0, 1e-3, 3e-3, 0.01, 1.0])
    wave = size * np.outer(np.sin(np.pi * t) ** 4 * np.sin(4 * np.pi * t), [1, 1, 3])
    cycle = PlateCycle.from_samples(float(rng.choice([0.02, 0.1, 0.2])), wave)
    stamp = to_time(0)  # `fuzzed_message` sets the stamp
    count = int(rng.choice(COUNTS, p=PROBABILITIES))
    ids = tuple(f"{'black' if k % 2 else 'grey'}_{k // 2 + 1}" for k in range(count))
    place = rng.uniform(-1.1, 1.1, (count, 2)) * rig.plate.half
    force = rng.choice([0.003, 0.03], p=[0.95, 0.05]) * rng.normal(size=(count, 2))
    parts = Parts.make(ids, place, 0.01 * rng.normal(size=(count, 2)))
    request = CycleRequest.make(parts, force)
    size_px = (rig.camera.height_px, rig.camera.width_px)
    # use mostly small images, because the changes of a full-size image take 20 ms
    if rng.random() < 0.9:
        size_px = (int(rng.integers(1, 64)), int(rng.integers(1, 64)))
    pixels = rng.integers(0, 255, size_px, np.uint8)
    message = cycle_to_msg(cycle, stamp)
    if rng.random() < 0.5:
        message = motors_to_msg(rig, cycle, stamp)
    name, (x, y) = str(rng.choice(["", "black_1", "grey_2"])), rng.uniform(-0.3, 0.3, 2).tolist()
    targets = [PartTarget(i, tuple(position)) for i, position in zip(ids, place, strict=True)]
    right = (
        message, request_to_msg(request, stamp), array_to_image(pixels, stamp),
        targets_to_msg(targets, stamp),
        PlacePart.Request(id=name, type="black", x=x, y=y), RemovePart.Request(id=name),
    )  # fmt: skip
    return {type(msg): serialize_message(msg) for msg in right}


def change_random_field(msg: Any, rng: np.random.Generator) -> None:
    """Change one random field of a message, or of a message in it, to an unusual value."""
    kinds = msg.get_fields_and_field_types()
    name = str(rng.choice(list(kinds)))
    value = getattr(msg, name)
    if hasattr(value, "get_fields_and_field_types"):
        change_random_field(value, rng)
    elif isinstance(value, bool):
        setattr(msg, name, not value)
    elif isinstance(value, str):
        setattr(msg, name, str(rng.choice(TEXTS)))
    elif isinstance(value, float):
        setattr(msg, name, float(rng.choice(NUMBERS)))
    elif isinstance(value, int):
        low, high = (0, 255) if "int8" in kinds[name] else (0, 2**31 - 1)
        setattr(msg, name, int(rng.choice([low, 1, high])))
    else:
        change_list(msg, name, value, rng)


def change_list(msg: Any, name: str, value: Any, rng: np.random.Generator) -> None:
    """Make a list shorter, longer, empty or unordered, or change one of its items."""
    fixed = isinstance(value, np.ndarray)
    items = list(value)
    kind = int(rng.integers(0, 5))
    if items and hasattr(items[0], "get_fields_and_field_types") and kind < 3:
        change_random_field(items[int(rng.integers(len(items)))], rng)
        return
    if fixed or (items and isinstance(items[0], float) and kind < 3):
        if items:
            items[int(rng.integers(len(items)))] = float(rng.choice(NUMBERS))
    elif kind == 0:
        items = []
    elif kind == 1:
        items = items[: int(rng.integers(0, len(items) + 1))]
    elif kind == 2:
        items = items * 2 if len(items) < 5000 else items[:10]
    elif kind == 3:
        items = [items[k] for k in rng.permutation(len(items))]
    elif items:
        items[int(rng.integers(len(items)))] = items[0]
    setattr(msg, name, np.array(items) if fixed else items)


def message_only(callback: Any) -> Any:
    """Return a callback that takes only a message, without the middleware's information."""
    if len(signature(callback).parameters) == 1:
        return callback
    return lambda msg: callback(msg, {"publication_sequence_number": None})


def find_topics(node: Any) -> list[tuple[str, type, Any]]:
    """Return the topics of a node, and the services whose requests contain numbers. Each entry has
    the name, the type and the callback."""
    topics = [(s.topic_name, s.msg_type, message_only(s.callback)) for s in node.subscriptions]
    for subscription, take in getattr(node, "raw_inputs", ()):  # the driver receives bytes

        def take_bytes(msg: Any, take: Any = take) -> None:
            data = serialize_message(msg)
            if crc32(data) % 5 == 0:  # sometimes send a truncated message
                data = data[: len(data) // 2]
            take(data, len(data), b"")

        topics.append((subscription.topic_name, subscription.kind, take_bytes))
    for service in node.services:
        kind = service.srv_type
        # only these requests contain numbers; other requests are empty or contain one bool
        if kind in (PlacePart, RemovePart):

            def ask(request: Any, kind: Any = kind, answer: Any = service.callback) -> None:
                serialize_message(answer(request, kind.Response()))

            topics.append((service.srv_name, kind.Request, ask))
    of_ros = ("clock", "parameter_events")
    return [item for item in topics if item[0].rsplit("/", 1)[-1] not in of_ros]


def fuzzed_message(kind: type, pool: list[dict[type, bytes]], rng: np.random.Generator) -> Any:
    """Return a message with up to four changed fields, serialised and deserialised."""
    right = pool[int(rng.integers(len(pool)))].get(kind)
    msg = deserialize_message(right, kind) if right is not None else kind()
    if hasattr(msg, "header"):
        age_ns = int(rng.integers(0, 2 * 10**8 if rng.random() < 0.9 else 10**12))
        msg.header.stamp = to_time(time.time_ns() - age_ns)
    for _ in range(int(rng.integers(0, 5))):
        change_random_field(msg, rng)
    return deserialize_message(serialize_message(msg), kind)


class MotionCheck:
    """Checks the motion that the driver sends, or the motion that the simulated device executes."""

    def __init__(self, node: Any, verdict: Verdict) -> None:
        self.node, self.verdict, self.rig = node, verdict, load_rig()
        if verdict.node == "driver":
            self.publish = node._setpoints.publish
            node._setpoints.publish = self._on_table

    def _on_table(self, msg: Any) -> None:
        if isinstance(msg, JointTrajectory):
            self._check(msg_to_motors(self.rig, msg))
        self.publish(msg)

    def tick(self) -> None:
        """Call the node's timer callback. For the simulator, also check the played motion."""
        if self.verdict.node == "driver":
            self.node._on_watch_timer()
        elif self.verdict.node == "simulator":
            self.node._begin_cycle()
            self._check(self.node._timeline.cycle)

    def _check(self, cycle: PlateCycle) -> None:
        use = float(np.max(limit_fractions(self.rig, cycle)))
        self.verdict.tables += 1
        self.verdict.moving += use > 0
        self.verdict.worst_share = max(self.verdict.worst_share, use)


def own_memory_mb() -> float:
    """Return the memory of this process [MB], after a garbage collection."""
    gc.collect()
    return memory_mb(os.getpid())


def fuzz_node(name: str, count: int, seed: int) -> Verdict:
    """Send `count` messages to one node, to each of its topics in turn."""
    module, _, kind = NODES[name].rpartition(".")
    rng, verdict = np.random.default_rng(seed), Verdict(name)
    node = getattr(importlib.import_module(module), kind)()
    if isinstance(node, SafeLifecycleNode):
        start_nodes(node)
    set_logger_level(node.get_logger().name, LoggingSeverity.FATAL)
    try:
        check = MotionCheck(node, verdict)
        topics = find_topics(node)
        rig = load_rig()
        pool = [message_templates(rig, rng) for _ in range(POOL)]
        began, base = time.monotonic(), 0.0
        for k in range(count):
            if k == int(WARM * count):
                base = own_memory_mb()
            topic, taken, give = topics[k % len(topics)]
            msg = fuzzed_message(taken, pool, rng)
            sent = time.thread_time()
            try:
                give(msg)
            except Exception as error:  # in a running node, any exception would end the node
                verdict.crashes += 1
                verdict.first = verdict.first or f"{topic}: {error!r}"
            if k > WARM * count:  # measure the time only after all modules and caches are loaded
                verdict.slowest_ms = max(verdict.slowest_ms, 1e3 * (time.thread_time() - sent))
            if k % TICK == 0:
                check.tick()
        verdict.messages = count
        verdict.growth_mb = round(own_memory_mb() - base, 1)
        verdict.slowest_ms = round(verdict.slowest_ms, 1)
        verdict.seconds = round(time.monotonic() - began, 1)
    finally:
        node.destroy_node()
    return verdict


def has_failed(verdict: Verdict) -> bool:
    """Return whether a node crashed, used too much memory, or exceeded a limit."""
    return (
        verdict.crashes > 0
        or verdict.growth_mb > MAX_GROWTH_MB
        or verdict.worst_share > 1 + ROUNDING.get(verdict.node, 0)
    )


def run(
    logs: Path, nodes: Iterable[str] = (), count: int = 100_000, seed: int = 0
) -> Iterator[Outcome]:
    """Send `count` messages to each node, in this process."""
    verdicts: list[Verdict] = []
    with own_domain() as domain:
        os.environ.update(ros_environment(domain))
        rclpy.init(args=["--ros-args", "--disable-external-lib-logs"])
        try:
            for name in select_nodes(nodes, NODES):
                verdicts.append(fuzz_node(name, count, seed))
                well = not any(map(has_failed, verdicts))
                crashes = f"{sum(v.crashes for v in verdicts)} crashes"
                yield Outcome([vars(v) for v in verdicts], str(verdicts[-1]), well, crashes)
        finally:
            rclpy.try_shutdown()
