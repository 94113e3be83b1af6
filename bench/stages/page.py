"""Effect of the live page on the graph: latency and CPU time.

The latency from image to setpoints and the page's fraction of a CPU core are measured with no, one
and ten browsers, and with one that hangs. A browser is a connection, in a separate process, that
requests images and fields and reads all messages. It draws nothing, because a real browser would
run on another computer. All conditions are measured in turn with the same running graph. In the
first condition the page's process does not run.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from cases.page_flood import connect
from graph.hops import Hops
from graph.proc import cpu_s
from graph.series import one_task
from graph.session import session

from harness import Result, Table
from plate_bringup import RunOptions

ROUNDS, QUICK_ROUNDS = 2, 1
SCENARIO = "sort_10"
TASK_S, QUICK_S = 30.0, 4.0
"""Maximum duration of a task [s]."""

HANGS = -1
"""Value instead of a number of browsers: one browser that reads nothing."""

CONDITIONS = {
    "no page": None,
    "no browser": 0,
    "1 browser": 1,
    "10 browsers": 10,
    "1 that hangs": HANGS,
}
"""Number of browsers."""


def measure(quick: bool) -> Result:
    """Sort in real time with and without browsers."""
    with TemporaryDirectory() as logs:
        found, shares = measured(quick, Path(logs))
    rows = [row(name, found[name], shares[name]) for name in CONDITIONS]
    compared = [{**r, "ratio": r["median"] / rows[0]["median"]} for r in rows]
    return Result([Table.of("page", compared, scenario=SCENARIO)])


def row(name: str, tasks: list[Any], share: list[float]) -> dict[str, Any]:
    """Return the row of one condition."""
    ms = 1e3 * np.concatenate([task.latency for task in tasks])
    counts = np.array([task.counts for task in tasks])
    return {
        "browsers": name, "median": np.median(ms), "p99": np.percentile(ms, 99),
        "held": int(counts[:, 1].sum()), "late": int(counts[:, 2].sum()),
        "images": len(ms), "cpu": 100 * float(np.mean(share)) if share else 0.0,
    }  # fmt: skip


def measured(quick: bool, logs: Path) -> tuple[dict[str, list[Any]], dict[str, list[float]]]:
    """Return the tasks and the page's fractions of a CPU core, by condition."""
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
                    graph.observer.record.diagnostics.pop("page", None)
                    url = graph.page()
                    continue
                with browsers(url, count):
                    pid, began = graph.processes.pid("page"), time.monotonic()
                    before = cpu_s(pid)
                    found[name].append(one_task(graph, hops, None, 0.0, longest_s))
                    shares[name].append((cpu_s(pid) - before) / (time.monotonic() - began))
    return found, shares


@contextmanager
def browsers(url: str, count: int) -> Iterator[None]:
    """Context in which a number of browsers are connected."""
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
    """Connect browsers and read all messages of the page. With `HANGS`, connect one and read
    nothing."""

    async def read() -> None:
        connection = await connect(url)
        await connection.write_message(json.dumps({"do": "watch", "image": True, "field": True}))
        if count == HANGS:
            await asyncio.Event().wait()
        while await connection.read_message() is not None:
            pass

    async def all_of_them() -> None:
        await asyncio.gather(*(read() for _ in range(abs(count))))

    asyncio.run(all_of_them())
