"""Make and destroy entities while messages and calls flood in: which executor of rclpy survives?

python tools/executors.py [EXECUTOR ...] [--seconds 60] [--ways WAY ...] [--json FILE]

Each executor spins a node in a process of its own, as `run_node` does. Two threads flood the node's
topic and service. Meanwhile subscriptions, timers, clients and services come and go:

callbacks  in the node's own callbacks, as at the transitions of a lifecycle node
tasks      in tasks that another thread hands over by `create_task`, as of the page and the feeder
thread     in another thread: nothing of this project does that

A process that crashes, hangs or raises is counted, and started again until the time is over.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from graph.domains import own_domain
from graph.processes import ros_environment

WAYS = ("callbacks", "tasks", "thread")
EXECUTORS = ("EventsExecutor", "SingleThreadedExecutor", "MultiThreadedExecutor")

LEAST, MOST = 4, 12
"""Entities that are there besides the lasting ones."""

PAUSE_S = 0.0005
"""Between two messages of the flood, and between two changes [s]."""

HUNG_S = 10.0
"""A process that executes nothing for so long hangs [s]."""


@dataclass
class Verdict:
    """What was seen of one executor and way: of `runs` processes each ends in one of `ends`."""

    executor: str
    way: str
    changes: int = 0
    executed: int = 0
    runs: int = 0
    ends: Counter[str] = field(default_factory=Counter)


class Crowd:
    """Entities of a node that come and go."""

    def __init__(self, node: Any) -> None:
        self._node, self._lock = node, threading.Lock()
        self._there: list[tuple[Any, Any]] = []
        self.changes = self.executed = 0

    def heard(self, *_: Any) -> Any:
        """Count one callback; services have an answer as their second argument."""
        self.executed += 1
        return _[1] if len(_) > 1 else None

    def change(self) -> None:
        """Destroy an entity, or make one."""
        with self._lock:  # tasks and callbacks may run at the same time
            if len(self._there) >= MOST or (len(self._there) > LEAST and random.random() < 0.5):
                destroy, entity = self._there.pop(random.randrange(len(self._there)))
                destroy(entity)
            else:
                self._there.append(self._made())
            self.changes += 1

    def _made(self) -> tuple[Any, Any]:
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        node = self._node
        kind = random.choice(("subscription", "timer", "client", "service"))
        if kind == "subscription":
            return node.destroy_subscription, node.create_subscription(
                String, "flood", self.heard, 50
            )
        if kind == "timer":
            return node.destroy_timer, node.create_timer(0.001, self.heard)
        if kind == "service":
            return node.destroy_service, node.create_service(Trigger, "asked", self.heard)
        client = node.create_client(Trigger, "asked")
        for _ in range(5):  # answers are on their way when it goes
            client.call_async(Trigger.Request()).add_done_callback(self.heard)
        return node.destroy_client, client


def spin(executor_name: str, way: str, seconds: float) -> None:
    """Spin a node for a while; print what was done. To be called in a process of its own."""
    import rclpy
    import rclpy.executors
    import rclpy.experimental
    from std_msgs.msg import String
    from std_srvs.srv import Trigger

    rclpy.init()
    home = rclpy.experimental if executor_name == "EventsExecutor" else rclpy.executors
    executor = getattr(home, executor_name)()
    node, flood = rclpy.create_node("node"), rclpy.create_node("flood")
    crowd, over = Crowd(node), threading.Event()

    def heard(*given: Any) -> Any:
        if way == "callbacks":
            crowd.change()
        return crowd.heard(*given)

    node.create_subscription(String, "flood", heard, 50)
    node.create_service(Trigger, "asked", heard)
    executor.add_node(node)
    publisher, client = flood.create_publisher(String, "flood", 50), flood.create_client(
        Trigger, "asked"
    )  # fmt: skip

    def publish() -> None:
        while not over.wait(PAUSE_S):
            publisher.publish(String(data="x"))

    def call() -> None:
        while not over.wait(PAUSE_S):
            client.remove_pending_request(client.call_async(Trigger.Request()))

    def meddle() -> None:
        while not over.wait(PAUSE_S):
            if way == "tasks":
                executor.create_task(crowd.change)
            elif way == "thread":
                crowd.change()

    def watch() -> None:
        executed = -1
        while not over.wait(HUNG_S):
            if crowd.executed == executed:
                os._exit(HUNG)
            executed = crowd.executed

    for each in (publish, call, meddle, watch):
        threading.Thread(target=each, daemon=True).start()
    end, problem = time.monotonic() + seconds, ""
    try:
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
    except Exception as error:  # whatever it is, it would have ended a node
        problem = f"{type(error).__name__}: {error}".splitlines()[0]
    over.set()
    print(json.dumps([crowd.changes, crowd.executed, problem]), flush=True)
    os._exit(0)  # the end is not what is looked at


HUNG = 99
"""Exit code of a process that hangs."""


def judged(executor: str, way: str, seconds: float) -> Verdict:
    """Stress an executor for so long [s], in as many processes as that takes."""
    verdict, end = Verdict(executor, way), time.monotonic() + seconds
    while (left := end - time.monotonic()) > 1:
        words = [
            sys.executable,
            __file__,
            executor,
            "--ways",
            way,
            "--seconds",
            str(left),
            "--spin",
        ]
        run = subprocess.run(words, capture_output=True, text=True, timeout=left + 60)
        verdict.runs += 1
        ended = "survived"
        if run.returncode == HUNG:
            ended = "hung"
        elif run.returncode < 0:
            ended = signal.Signals(-run.returncode).name
        elif run.returncode:
            ended = (run.stderr.strip() or "nothing said").splitlines()[-1]
        else:
            changes, executed, problem = json.loads(run.stdout.splitlines()[-1])
            verdict.changes += changes
            verdict.executed += executed
            ended = problem or ended
        verdict.ends[ended] += 1
    return verdict


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("executors", nargs="*", help="all if left out: " + ", ".join(EXECUTORS))
    parser.add_argument("--seconds", type=float, default=60.0, help="for each and each way [s]")
    parser.add_argument("--ways", nargs="*", default=WAYS, choices=WAYS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--spin", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    unknown = [name for name in args.executors if name not in EXECUTORS]
    if unknown:
        parser.error(f"executor is {unknown[0]!r}, allowed: {', '.join(EXECUTORS)}")
    if args.spin:
        spin(args.executors[0], args.ways[0], args.seconds)
    verdicts = []
    with own_domain() as domain:
        os.environ.update(ros_environment(domain))
        for executor in args.executors or EXECUTORS:
            for way in args.ways:
                verdicts.append(judged(executor, way, args.seconds))
                print(verdicts[-1], flush=True)
    if args.json:
        text = json.dumps([vars(each) for each in verdicts], indent=1)
        args.json.write_text(text, encoding="utf-8")
    return int(any(set(each.ends) - {"survived"} for each in verdicts))


if __name__ == "__main__":
    sys.exit(main())
