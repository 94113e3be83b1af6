"""Cycle each node of the loop through its lifecycle while messages and calls flood it: no crash.

python tools/lifecycle_flood.py [NODE ...] [--cycles 100] [--json FILE]

Each node is a process of its own, as installed. Another one sends empty messages to all its topics
and calls all its services, but for those that change its state, without waiting for answers.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rclpy
from graph.domains import own_domain
from graph.observer import Observer
from graph.processes import Processes, command, signals_raise

from plate_bringup import GraphError, RunOptions, load_graph
from plate_core.ros import DATA

NODES = ("simulator", "detector", "planner", "solver", "driver", "feeder", "page")
CYCLE = ("configure", "activate", "deactivate", "cleanup")
START_S = 60.0
PAUSE_S, ROUNDS = 0.0005, 5
"""Between two messages or calls, and how often each topic and service is used before what there is
is looked for again: it comes and goes [s]."""


@dataclass
class Verdict:
    """What was seen of one node; `problem`: how it ended, or what it refused."""

    node: str
    cycles: int = 0
    sent: int = 0
    problem: str = ""


def kind_of(name: str) -> Any:
    """Return the class of a type such as std_msgs/msg/String, or of a part of an action."""
    package, group, kind = name.split("/")
    module = import_module(f"{package}.{group}")
    if group == "action":
        action, part = kind.rsplit("_", 1)
        parts = getattr(module, action).Impl
        return getattr(parts, part, None) or getattr(parts, f"{part}Service")
    return getattr(module, kind)


def call(client: Any, request: Any) -> None:
    """Call a service, and do not wait for the answer."""
    client.remove_pending_request(client.call_async(request))


class Flood:
    """Sends to whatever a node has, in a thread and a context of its own."""

    def __init__(self, domain: int, target: str, verdict: Verdict) -> None:
        self._context, self._target, self._verdict = rclpy.Context(), target, verdict
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._node = rclpy.create_node("flood", context=self._context)
        self._sends: dict[str, Callable[[], None]] = {}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _look(self) -> None:
        node, where = self._node, (self._target, "/")
        try:
            topics = node.get_subscriber_names_and_types_by_node(*where)
            services = node.get_service_names_and_types_by_node(*where)
        except RuntimeError:  # the node is not seen yet
            return
        for name, (kind, *_) in topics:
            if name not in self._sends and "clock" not in name:
                publisher, msg = node.create_publisher(kind_of(kind), name, DATA), kind_of(kind)()
                self._sends[name] = partial(publisher.publish, msg)
        for name, (kind, *_) in services:
            if name not in self._sends and not name.endswith("change_state"):
                client, request = node.create_client(kind_of(kind), name), kind_of(kind).Request()
                self._sends[name] = partial(call, client, request)

    def _run(self) -> None:
        while not self._over.is_set():
            self._look()
            for send in [*self._sends.values()] * ROUNDS:
                if self._over.wait(PAUSE_S):
                    return
                send()
                self._verdict.sent += 1
            self._over.wait(PAUSE_S)

    def __enter__(self) -> Flood:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        ended = not self._thread.is_alive()
        self._over.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)
        if ended:
            self._verdict.problem = "the flood has ended before"


@contextmanager
def running(name: str, folder: Path) -> Iterator[tuple[Processes, Observer, int]]:
    """Run one node, unconfigured."""
    options = RunOptions(scenario="feed", autostart=False, view=True, robot_port=0)
    nodes = [node for node in load_graph() if node.name == name]
    with (
        own_domain() as domain,
        Processes((), options, folder, domain) as processes,
        Observer(domain, processes.check, pictures=False) as observer,
    ):
        words = command(nodes[0], {**options.parameters(nodes[0]), "autostart": False})
        processes.add({name: words}, {})
        observer.await_nodes([name], START_S)
        yield processes, observer, domain


def cycled(name: str, cycles: int, folder: Path) -> Verdict:
    """Cycle one node so often."""
    verdict = Verdict(name)
    try:
        with running(name, folder) as (processes, observer, domain):
            observer.change_state(name, "configure")
            observer.change_state(name, "cleanup")
            with Flood(domain, name, verdict):
                for _ in range(cycles):
                    for transition in CYCLE:
                        observer.change_state(name, transition)
                    verdict.cycles += 1
            processes.check()
    except GraphError as problem:
        verdict.problem = str(problem)
    return verdict


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("nodes", nargs="*", help="all if left out: " + ", ".join(NODES))
    parser.add_argument("--cycles", type=int, default=100, help="of each node")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    unknown = [name for name in args.nodes if name not in NODES]
    if unknown:
        parser.error(f"node is {unknown[0]!r}, allowed: {', '.join(NODES)}")
    verdicts = []
    with signals_raise(), TemporaryDirectory(prefix="lifecycle_flood_") as folder:
        for name in args.nodes or NODES:
            verdicts.append(cycled(name, args.cycles, Path(folder)))
            print(verdicts[-1], flush=True)
    if args.json:
        text = json.dumps([vars(each) for each in verdicts], indent=1)
        args.json.write_text(text, encoding="utf-8")
    return int(any(each.problem for each in verdicts))


if __name__ == "__main__":
    sys.exit(main())
