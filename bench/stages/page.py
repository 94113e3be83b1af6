"""The live page beside the graph: latency, processor time, targets that are dragged.

The live page beside the graph: latency and processor time with none, one, ten browsers, and one
that hangs; and how long a target takes from a browser to the planner.

Browsers are connections that ask for images and fields and read all they get, in a process of their
own; they draw nothing, as a browser on another machine would not draw here. The conditions come in
turn, in one running graph, the page's process gone for the first.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from harness import ROOT, Result, Table

sys.path.append(str(ROOT / "tools"))

ROUNDS, QUICK_ROUNDS = 2, 1
SCENARIO = "sort_10"
TASK_S, QUICK_S = 30.0, 4.0
"""A task is broken off after that long [s]."""

DRAGS, DRAG_PERIOD_S = 200, 0.03
"""Targets that are published one after the other, and the time between two [s]."""

CONDITIONS = {
    "no page": None,
    "no browser": 0,
    "1 browser": 1,
    "10 browsers": 10,
    "1 that hangs": -1,
}
"""Number of browsers; -1: one that reads nothing."""


def measure(quick: bool) -> Result:
    """Sort in real time with and without browsers, then drag targets."""
    with TemporaryDirectory() as logs:
        found, shares, drags = measured(quick, Path(logs))
    rows = [row(name, found[name], shares[name]) for name in CONDITIONS]
    without = rows[0]
    return Result(
        [
            Table(
                "page", f"Scenario {SCENARIO}, image to setpoints, by who looks on",
                {
                    "browsers": "who looks on", "median": "median [ms]", "p99": "99 % [ms]",
                    "ratio": "ratio of medians", "held": "repeated cycles", "late": "late cycles",
                    "images": "images", "cpu": "page: share of a core [%]",
                },
                [{**r, "ratio": r["median"] / without["median"]} for r in rows],
            ),
            Table(
                "drag", "From a browser's message to the planner's answer",
                {"what": "until", "median": "median [ms]", "p99": "99 % [ms]", "count": "targets"},
                [
                    {"what": what, "median": np.median(ms), "p99": np.percentile(ms, 99),
                     "count": len(ms)}
                    for what, ms in drags.items()
                ],
            ),
        ],
    )  # fmt: skip


def row(name: str, tasks: list[Any], share: list[float]) -> dict[str, Any]:
    """Return what was seen under one condition."""
    ms = 1e3 * np.concatenate([task.latency for task in tasks])
    counts = np.array([task.counts for task in tasks])
    return {
        "browsers": name, "median": np.median(ms), "p99": np.percentile(ms, 99),
        "held": int(counts[:, 1].sum()), "late": int(counts[:, 2].sum()),
        "images": len(ms), "cpu": 100 * float(np.mean(share)) if share else 0.0,
    }  # fmt: skip


def measured(
    quick: bool, logs: Path
) -> tuple[dict[str, list[Any]], dict[str, list[float]], dict[str, np.ndarray]]:
    """Return tasks and the page's shares of a core by condition, and the times of drags [ms]."""
    from graph.hops import Hops
    from graph.series import cpu_s, one_task
    from graph.session import session

    from plate_bringup import RunOptions

    options = RunOptions(scenario=SCENARIO, autostart=False, view=True)
    found: dict[str, list[Any]] = {name: [] for name in CONDITIONS}
    shares: dict[str, list[float]] = {name: [] for name in CONDITIONS}
    rng, longest_s = np.random.default_rng(0), QUICK_S if quick else TASK_S
    with session(options, logs, pictures=False) as graph, Hops(images=False) as hops:
        graph.free()
        url = graph.page()
        for _ in range(QUICK_ROUNDS if quick else ROUNDS):
            for name in rng.permutation(list(CONDITIONS)).tolist():
                count = CONDITIONS[name]
                if count is None:
                    graph.processes.signal("page", signal.SIGTERM)
                    graph.processes.wait("page", 10.0)
                    found[name].append(one_task(graph, hops, None, 0.0, longest_s))
                    graph.processes.restart("page")
                    graph.observer.record.reports.pop("page", None)
                    url = graph.page()
                    continue
                with browsers(url, count):
                    pid, began = graph.processes.pid("page"), time.monotonic()
                    before = cpu_s(pid)
                    found[name].append(one_task(graph, hops, None, 0.0, longest_s))
                    shares[name].append((cpu_s(pid) - before) / (time.monotonic() - began))
        return found, shares, drags(graph, url, 20 if quick else DRAGS)


@contextmanager
def browsers(url: str, count: int) -> Iterator[None]:
    """Look on with so many browsers; -1: one that reads nothing."""
    if count < 0:
        with hung(url):
            yield
        return
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=look_on, args=(url, count), daemon=True)
    process.start()
    time.sleep(2.0)
    try:
        yield
    finally:
        process.terminate()
        process.join()


def look_on(url: str, count: int) -> None:
    """Read all that the page sends to so many browsers."""

    from page_flood import connect

    async def read() -> None:
        connection = await connect(url)
        await connection.write_message(json.dumps({"do": "watch", "image": True, "field": True}))
        while await connection.read_message() is not None:
            pass

    async def all_of_them() -> None:
        await asyncio.gather(*(read() for _ in range(count)))

    asyncio.run(all_of_them())


@contextmanager
def hung(url: str) -> Iterator[None]:
    """Ask for everything, and read nothing."""
    port = int(url.rstrip("/").rsplit(":", 1)[1])
    lines = (
        "GET /socket HTTP/1.1", f"Host: 127.0.0.1:{port}", f"Origin: http://127.0.0.1:{port}",
        "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "", "",
    )  # fmt: skip
    watch = json.dumps({"do": "watch", "image": True, "field": True}).encode()
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.sendall("\r\n".join(lines).encode())
        line.sendall(bytes([0x81, 0x80 | len(watch), 0, 0, 0, 0]) + watch)  # masked with zeros
        yield


def drags(graph: Any, url: str, count: int) -> dict[str, np.ndarray]:
    """Drag a part's target in the running graph; return times since the browser sent it [ms]."""
    from page_flood import connect

    from plate_core.ros import DATA, LATCHED
    from plate_interfaces.msg import Targets

    heard: dict[str, dict[float, float]] = {"targets": {}, "part_targets": {}}
    node = graph.observer.node

    def listener(topic: str) -> Any:
        def on_targets(msg: Targets) -> None:
            for target in msg.targets:
                heard[topic].setdefault(round(target.x, 9), time.monotonic())

        return on_targets

    listening = [
        node.create_subscription(Targets, "targets", listener("targets"), DATA),
        node.create_subscription(Targets, "part_targets", listener("part_targets"), LATCHED),
    ]
    graph.observer.trigger("stop")
    sent: dict[float, float] = {}

    async def read(connection: Any) -> None:
        while await connection.read_message() is not None:
            pass

    async def drag() -> None:
        connection = await connect(url)
        reading = asyncio.ensure_future(read(connection))
        for k in range(-10, count):  # the first ones start the task
            x = round(0.0001 * k, 9)
            target = {"id": "black_1", "x": x, "y": 0.02, "angle": None}
            if k >= 0:
                sent[x] = time.monotonic()
            await connection.write_message(
                json.dumps({"do": "move", "number": 1, "targets": [target], "dragging": True})
            )
            end = time.monotonic() + (0.3 if k < 0 else DRAG_PERIOD_S)
            while time.monotonic() < end:
                graph.observer.until(lambda: False, 0.002)
                await asyncio.sleep(0)
        connection.close()
        await reading

    asyncio.run(drag())
    graph.observer.until(lambda: False, 1.0)
    for each in listening:
        node.destroy_subscription(each)
    names = {"targets": "published as targets", "part_targets": "taken over by the planner"}
    return {
        name: 1e3 * np.array([heard[topic][x] - at for x, at in sent.items() if x in heard[topic]])
        for topic, name in names.items()
    }
