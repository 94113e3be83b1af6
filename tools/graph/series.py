"""One task after the other in the same running graph, the parts put down anew each time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from record.judge import check_limits

from plate_bringup import RunOptions
from plate_core import load_rig

from .hops import Hops
from .proc import cpu_s, memory_mb
from .relays import CHAIN, NAMESPACE, NODES, command
from .session import Session, session

TASK_S = 240.0
"""Longest wait for a task's end [s]."""

STAGES = ("camera", "detector", "planner", "solver", "driver")
"""What happens until the messages of `CHAIN` are published."""


@dataclass(frozen=True)
class Task:
    """One task of a series.

    Attributes
    ----------
    at_s : float
        When it ended, since the series began [s].
    ended : str
        How, in words.
    done : bool
        Whether its goal was reached.
    counts : tuple of int
        Plate cycles; those repeated since no new one had come; those begun too late.
    tables, faults : int
        Motor tables, and those that broke a limit.
    memory_mb : dict of str to float
        Of each node at the end of the task [MB].
    hops, beside : (n, 6) arrays
        Of each image that was answered: its stamp, and when it and its answers were published [s,
        UTC]; in the real graph, and in the one that only forwards.
    """

    at_s: float
    ended: str
    done: bool
    counts: tuple[int, int, int]
    tables: int
    faults: int
    memory_mb: dict[str, float]
    hops: np.ndarray
    beside: np.ndarray

    @property
    def latency(self) -> np.ndarray:
        """From an image's stamp to the motors' setpoints (n,) [s]."""
        return np.asarray(self.hops[:, -1] - self.hops[:, 0])


@dataclass
class Series:
    """Tasks so far, and the share of a core that each process took meanwhile."""

    tasks: list[Task] = field(default_factory=list)
    cpu: dict[str, float] = field(default_factory=dict)

    def hops(self, kind: str = "hops") -> np.ndarray:
        """Return those of all tasks."""
        return np.concatenate([getattr(task, kind) for task in self.tasks])


def work_again(
    options: RunOptions,
    logs: Path,
    done: Callable[[Series], bool],
    beside: bool = False,
    longest_s: float = TASK_S,
    world: Mapping[str, float] | None = None,
) -> Iterator[Series]:
    """Run tasks in real time until `done`; yield after each what was seen so far.

    Parameters
    ----------
    options : RunOptions
        In real time.
    logs : path
        Folder for the nodes' logs.
    done : callable
    beside : bool
        Whether a graph that only forwards runs meanwhile.
    longest_s : float
        A task is broken off after that long [s].
    world : mapping, optional
        Parameters of the simulator.
    """
    with ExitStack() as stack:
        graph = stack.enter_context(session(options, logs, pictures=False))
        hops = stack.enter_context(Hops())
        graph.free()
        for name, value in (world or {}).items():
            graph.observer.set_parameter("simulator", name, value)
        names, others = [*graph.processes.names], None
        if beside:
            one_task(graph, hops, None, 0.0, min(longest_s, 5.0))  # messages of their true size
            others = stack.enter_context(Hops(NAMESPACE))
            names += forward(graph, hops, others, logs)
        series, began = Series(), time.monotonic()
        before = {name: cpu_s(graph.processes.pid(name)) for name in names}
        while not done(series):
            series.tasks.append(one_task(graph, hops, others, began, longest_s))
            passed = time.monotonic() - began
            for name in names:
                used = cpu_s(graph.processes.pid(name)) - before[name]
                series.cpu[name] = used / passed
            yield series


def forward(graph: Session, hops: Hops, others: Hops, logs: Path) -> list[str]:
    """Start the graph that only forwards; return its processes' names once it answers."""
    for topic, _ in CHAIN:
        (logs / topic).write_bytes(hops.newest[topic])
    commands = {f"{NAMESPACE}_{name}": command(name, str(logs)) for name in NODES}
    graph.processes.add(commands)
    graph.observer.until(lambda: any(map(all, [*others.times.values()])), TASK_S)
    return list(commands)


def one_task(
    graph: Session, hops: Hops, others: Hops | None, began: float, longest_s: float
) -> Task:
    """Run one task, and return what was seen of it."""
    observer, record = graph.observer, graph.observer.record
    names = ("cycles", "held cycles", "late cycles")
    before = [int(record.last("simulator", name, "0")) for name in names]
    observer.begin_anew(graph.scenario)
    start = time.time()
    observer.until(lambda: record.ended, longest_s)
    end = time.time()
    observer.until(lambda: False, 1.2)  # the simulator's next report
    counts = [int(record.last("simulator", name, "0")) for name in names]
    limits = check_limits(record, load_rig(graph.options.rig_file))
    task = Task(
        time.monotonic() - began,
        record.states[-1],
        record.done,
        (counts[0] - before[0], counts[1] - before[1], counts[2] - before[2]),
        limits.tables,
        len(limits.faults),
        {
            name: memory_mb(graph.processes.pid(name))
            for name in graph.processes.names
            if not name.startswith(("beside_", "page"))
        },
        rows(hops, start, end),
        rows(others, start, end) if others is not None else np.zeros((0, len(CHAIN) + 1)),
    )
    record.tables.clear()
    record.truth.clear()
    for said in record.said.values():
        del said[:-1]
    return task


def rows(hops: Hops, start: float, end: float) -> np.ndarray:
    """Return stamps and times (n, 6) [s] of the images since `start` that were answered."""
    times = sorted((stamp, *row) for stamp, row in list(hops.times.items()) if all(row))
    hops.times.clear()
    found = 1e-9 * np.array(times, dtype=float).reshape(-1, len(CHAIN) + 1)
    inside = (found[:, 0] > start) & (found[:, 0] < end)
    return np.asarray(found[inside])


def stages_ms(hops: np.ndarray) -> dict[str, np.ndarray]:
    """Return how long each stage of `STAGES` took (n,) [ms], and all of them."""
    parts = 1e3 * np.diff(hops, axis=1)
    columns: dict[str, Any] = dict(zip(STAGES, parts.T, strict=True))
    columns["image to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 1])
    columns["stamp to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 0])
    return columns
